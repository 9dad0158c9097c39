//! Live sources: behaviour common to all sources, promises, and stopping.

use super::{
    tests::{calls, check, options, refusal_of},
    *,
};
use crate::{
    plan::{OutputId, Policy},
    recording::codec,
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::{ClockReading, Item, Join};
use osteoflow_toy::{Gate, Number, registry};
use serde_json::{Value as Json, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
};

/// Calls that give one number each, as (stamp, port, number).
type Calls<'a> = &'a [(i64, usize, f64)];

fn live(name: &str, n_ports: usize, given: Calls<'_>, params: Json) -> PlanBuilder {
    let mut params = params;
    params["calls"] = calls(given);
    PlanBuilder::new().source(name, "toy.live", n_ports, params)
}

/// 135 samples of a marker before the one scan that lets `follow` begin.
fn parks() -> Plan {
    let mut given: Vec<_> = (0..135).map(|i| (i, 0, i as f64 + 0.25)).collect();
    given.push((135, 1, 1000.0));
    given.extend((136..200).map(|i| (i, 0, i as f64 + 0.25)));
    live("recording", 2, &given, json!({}))
        .node("fit", "toy.add", json!({}), &[("a", "recording.p1", None)])
        .node("follow", "toy.add", json!({}), &[("a", "recording.p0", None), ("b", "fit.out", Some(Join::Once))])
        .record(&["follow.out", "fit.out", "recording.p0", "recording.p1"])
        .result("all", "follow.out", true, false)
        .plan()
}

#[test]
fn a_live_source_runs_any_graph_on_any_number_of_workers() {
    for _ in 0..10 {
        let report = check(&parks());
        assert_eq!(report.outcome, Outcome::Complete);
        assert_eq!(report.results["all"].as_array().unwrap().len(), 199);
        let sizes: Vec<_> = report.enlargements.iter().map(|e| (e.to.as_str(), e.after)).collect();
        let to = |n| ("follow.a", n);
        assert_eq!(sizes, [to(8), to(16), to(32), to(64), to(128), to(256)]);
    }
}

#[test]
fn the_run_does_not_wait_for_a_live_source_without_room() {
    let mut plan = parks();
    plan.links.iter_mut().for_each(|link| link.max_bytes = 20 * (size_of::<Item>() + size_of::<Number>()) as u64);
    for _ in 0..10 {
        let report = check(&plan);
        let message = &refusal_of(&report).reason;
        assert!(
            message.starts_with("the graph is stuck: nothing can run; full: recording.p0 -> follow.a (20 "),
            "{message}"
        );
    }
}

#[test]
fn two_live_sources_and_an_ordinary_one_join_by_stamps_alone() {
    let given = |shift: i64| (0..60).map(|i| (i * 10 + shift, 0, 200.0 + i as f64)).collect::<Vec<_>>();
    let plan = live("camera", 1, &given(3), json!({}))
        .source("tracker", "toy.live", 1, json!({ "calls": calls(&given(0)) }))
        .script("plan", 1, calls(&[(0, 0, 0.5)]))
        .node(
            "place",
            "toy.add",
            json!({}),
            &[("a", "camera.p0", None), ("b", "tracker.p0", Some(Join::Interpolate { max_gap_ns: None }))],
        )
        .node("shift", "toy.add", json!({}), &[("a", "place.out", None), ("b", "plan.p0", Some(Join::Once))])
        .record(&["place.out", "shift.out"])
        .result("all", "shift.out", true, false)
        .plan();
    for _ in 0..10 {
        let report = check(&plan);
        let all = report.results["all"].as_array().unwrap_or_else(|| panic!("{:?}", report.outcome));
        for (i, value) in all.iter().enumerate().take(59) {
            let expected = (200.0 + i as f64) + (200.0 + i as f64 + 0.3) + 0.5;
            assert!(
                (value.as_f64().unwrap_or_else(|| panic!("{i}: {all:?}")) - expected).abs() < 1e-12,
                "{i}: {value}"
            );
        }
        assert_eq!(all[59], json!(259.5), "after the last sample there is nothing to add");
    }
}

#[test]
fn items_later_than_promised_become_empties() {
    // Port 1 may be up to 5 behind port 0; once it is 8 behind, and once its own stamps decrease.
    let given = [(10, 0, 1.0), (6, 1, 2.0), (20, 0, 3.0), (12, 1, 4.0), (18, 1, 5.0), (16, 1, 6.0), (30, 0, 7.0)];
    let plan = live("devices", 2, &given, json!({ "max_delay_ns": 5 }))
        .node("one", "toy.add", json!({}), &[("a", "devices.p1", None)])
        .node("other", "toy.add", json!({}), &[("a", "devices.p0", None), ("b", "devices.p1", Some(Join::Latest))])
        .record(&["devices.p1", "one.out", "other.out"])
        .result("one", "one.out", true, false)
        .result("other", "other.out", true, false)
        .plan();
    let report = check(&plan);
    let late = |ns: u32| {
        let by = format!("0.00000{ns} ms");
        let reason = format!(
            "it came {by} after its wire had been promised to be complete; the source promises a delay of at most \
             0.000005 ms"
        );
        json!({ "unknown": reason, "node": "devices" })
    };
    assert_eq!(report.results["one"], json!([2.0, late(3), 5.0, late(2)]));
    // At 10 the newest item of port 1 is 2; at 20 and at 30 it is the late item's empty at 18, so nothing is added.
    assert_eq!(report.results["other"], json!([3.0, 3.0, 7.0]));
    let messages: Vec<_> = report.warnings.iter().map(|w| w.message.as_str()).collect();
    let late = "devices.p1: 2 items came late, by up to 0.000003 ms more than promised, and are empties; the first was item 1, \
                stamped 12 ns after 15 ns";
    assert_eq!(messages, [late]);
    let stamps: Vec<_> = report.links.iter().map(|l| (l.sent, l.received, l.dropped)).collect();
    assert_eq!(stamps, [(4, 4, 0), (3, 3, 0), (4, 4, 0)]);
}

/// A stamp of the year 2106, which a flipped bit makes of one of today.
const YEAR_2106_NS: i64 = 4_294_000_000_000_000_000;

#[test]
fn a_stamp_ahead_of_its_time_costs_its_own_item_and_is_told_at_once() {
    for at in [0, 4, 9] {
        let mut given: Vec<_> = (0..10).flat_map(|i| [(i * 10 + 10, 0, i as f64), (i * 10 + 10, 1, 0.5)]).collect();
        given[2 * at].0 = YEAR_2106_NS;
        let plan = live("devices", 2, &given, json!({}))
            .node("add", "toy.add", json!({}), &[("a", "devices.p0", None), ("b", "devices.p1", None)])
            .record(&["add.out", "devices.p0"])
            .result("all", "add.out", true, false)
            .plan();
        let report = check(&plan);
        let all = report.results["all"].as_array().unwrap();
        for (i, sum) in all.iter().enumerate().filter(|(i, _)| *i != at) {
            assert_eq!(*sum, json!(i as f64 + 0.5), "bad at {at}: {all:?}");
        }
        let reason = all[at]["unknown"].as_str().unwrap();
        assert!(
            reason.starts_with("its stamp 4294000000000000000 ns is ") && reason.contains("no other item"),
            "{reason}"
        );
        let told: Vec<_> = report.warnings.iter().map(|w| (w.item, w.message.as_str())).collect();
        assert_eq!(told, [(2 * at as u64, reason)]);
        assert_eq!((all.len(), report.links.iter().map(|link| link.late).sum::<u64>()), (10, 0));
    }
}

#[test]
fn a_clock_that_was_set_forward_is_followed() {
    let given: Vec<_> = (0..10).map(|i| (if i < 4 { i } else { YEAR_2106_NS + i }, 0, i as f64)).collect();
    let plan = live("device", 1, &given, json!({}))
        .node("one", "toy.add", json!({}), &[("a", "device.p0", None)])
        .record(&["one.out"])
        .result("all", "one.out", true, false)
        .plan();
    let report = check(&plan);
    assert_eq!(report.results["all"], json!((0..10).map(f64::from).collect::<Vec<_>>()));
    let [told] = &report.warnings[..] else { panic!("{:?}", report.warnings) };
    assert!(told.item == 6 && told.message.contains("3 items in a row agree"), "{told:?}");
}

#[test]
fn a_live_source_that_fails_or_panics_refuses_the_run() {
    let failing = json!({ "stamp_ns": 2, "give": [], "fail": "the cable is out" });
    let panicking = json!({ "stamp_ns": 2, "give": [[0, 1.0]], "device": "panics" });
    for (last, expected) in [(failing, "the cable is out"), (panicking, "the device is on fire")] {
        let script = json!({ "calls": [{ "stamp_ns": 1, "give": [[0, 5.0]] }, last] });
        let plan = PlanBuilder::new()
            .source("scan", "toy.live", 1, script)
            .node("first", "toy.add", json!({}), &[("a", "scan.p0", None)])
            .node("sum", "toy.sum", json!({}), &[("all", "scan.p0", None)])
            .record(&["scan.p0", "first.out"])
            .result("pose", "first.out", false, false)
            .plan();
        let report = check(&plan);
        let refusal = refusal_of(&report);
        assert_eq!((refusal.node.as_str(), refusal.item), ("scan", Some(1)));
        assert!(refusal.reason.ends_with(expected), "{}", refusal.reason);
    }
}

/// Requests a stop when the sink has fired.
struct StopAfter(Arc<AtomicBool>);

impl Observer for StopAfter {
    fn event(&self, event: &Event<'_>) {
        if let Event::Fired { node: "sink", .. } = event {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn an_interrupted_run_ends_although_a_source_waits_for_its_device() {
    for (device, workers) in [("waits", 1), ("waits", 2), ("deaf", 1), ("deaf", 2)] {
        // The sink fires while the source waits for its device; then the stop is requested.
        let name = format!("{device} {workers}");
        let last = json!({ "stamp_ns": 2, "give": [[0, 1.0]], "device": name });
        let script = json!({ "calls": [{ "stamp_ns": 1, "give": [[0, 5.0]] }, last] });
        let plan = PlanBuilder::new()
            .source("scan", "toy.live", 1, script)
            .node("sink", "toy.add", json!({ "gate": format!("in {name}") }), &[("a", "scan.p0", None)])
            .result("pose", "sink.out", false, false)
            .plan();
        let options = options(workers);
        let stop = StopAfter(options.cancelled.clone());
        let report = run(&plan, &registry(), &options, &stop).unwrap();
        assert_eq!(report.outcome, Outcome::Interrupted, "{device}");
        let messages: Vec<_> = report.warnings.iter().map(|w| w.message.as_str()).collect();
        match device {
            "deaf" => {
                assert_eq!(messages, ["it did not notice the wish to stop within 0.5 s; the run ends without it"])
            }
            _ => assert_eq!(messages, [""; 0]),
        }
    }
}

/// Opens a gate at the first warning.
struct OpenAtWarning(Gate);

impl Observer for OpenAtWarning {
    fn event(&self, event: &Event<'_>) {
        if let Event::Warned(_) = event {
            self.0.open();
        }
    }
}

#[test]
fn a_silent_live_source_is_reported_once_and_when_it_resumes() {
    let calls = json!([
        { "stamp_ns": 1, "give": [[0, 5.0]] },
        { "stamp_ns": 2, "give": [[0, 6.0]], "device": "silence" },
        { "stamp_ns": 3, "give": [[0, 7.0]] },
    ]);
    let plan = PlanBuilder::new()
        .source("scan", "toy.live", 1, json!({ "calls": calls, "silent_after_ms": 1 }))
        .node("sink", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .result("all", "sink.out", true, false)
        .plan();
    let report = run(&plan, &registry(), &options(1), &OpenAtWarning(Gate::of("silence"))).unwrap();
    assert_eq!(report.results["all"], json!([5.0, 6.0, 7.0]), "silence changes no result");
    let of = |begin: &str| report.warnings.iter().filter(|w| w.message.starts_with(begin)).count();
    assert!(of("it has given nothing for ") >= 1, "{:?}", report.warnings);
    assert_eq!(of("it has given nothing for "), of("it gave something again after "));
}

/// Requests a stop when the source has been silent after its first item.
struct StopAtSilence(Arc<AtomicBool>);

impl Observer for StopAtSilence {
    fn event(&self, event: &Event<'_>) {
        if let Event::Urgent(warning) = event
            && warning.item == 1
        {
            assert_eq!(warning.node, "scan");
            self.0.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn the_end_of_a_silent_source_is_not_taken_for_an_item() {
    let calls = json!([
        { "stamp_ns": 1, "give": [[0, 5.0]] },
        { "stamp_ns": 2, "give": [[0, 6.0]], "device": "waits for the end" },
    ]);
    let plan = PlanBuilder::new()
        .source("scan", "toy.live", 1, json!({ "calls": calls, "silent_after_ms": 1 }))
        .node("sink", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .result("all", "sink.out", true, false)
        .plan();
    let options = options(1);
    let stop = StopAtSilence(options.cancelled.clone());
    let report = run(&plan, &registry(), &options, &stop).unwrap();
    assert_eq!(report.outcome, Outcome::Interrupted);
    // The first item may be late, too, and then is one that resumes.
    let of = |begin: &str| report.warnings.iter().filter(|w| w.message.starts_with(begin)).count();
    assert_eq!(of("it has given nothing for "), of("it gave something again after ") + 1, "{:?}", report.warnings);
}

/// Panics at the second item of a node, as a fault of the engine or of a listener would.
struct PanicsAt(&'static str);

impl Observer for PanicsAt {
    fn event(&self, event: &Event<'_>) {
        assert!(!matches!(event, Event::Fired { node, item: 1, .. } if *node == self.0), "no place at 1e45");
    }
}

#[test]
fn a_panic_outside_of_the_nodes_ends_the_run_on_every_thread_and_names_the_node() {
    let given: Vec<_> = (0..50).map(|i| (i, 0, i as f64)).collect();
    let live_plan = live("scan", 1, &given, json!({}));
    let plain_plan = PlanBuilder::new().script("scan", 1, calls(&given));
    for (is_live, builder) in [(true, live_plan), (false, plain_plan)] {
        let plan = builder
            .node("first", "toy.add", json!({}), &[("a", "scan.p0", None)])
            .node("second", "toy.add", json!({}), &[("a", "first.out", None)])
            .result("all", "second.out", true, false)
            .plan();
        // A live source's answers are taken on a thread of their own, nodes fire on the workers.
        for (node, workers) in [("scan", 1), ("scan", 8), ("first", 1), ("first", 2), ("second", 8)] {
            let ran =
                crate::runtime::panics::catch(|| run(&plan, &registry(), &options(workers), &PanicsAt(node)).map(drop));
            let said = ran.unwrap_err();
            let expected = format!("panicked: node \"{node}\": panicked at engine/src/run/live_tests.rs:");
            assert!(
                said.starts_with(&expected) && said.ends_with("no place at 1e45"),
                "live {is_live}, {workers}: {said}"
            );
        }
    }
}

/// Opens a gate when the source has ended.
struct OpenAtEnd<'a>(Gate, &'a str);

impl Observer for OpenAtEnd<'_> {
    fn event(&self, event: &Event<'_>) {
        if matches!(event, Event::Ended { node } if *node == self.1) {
            self.0.open();
        }
    }
}

/// Keeps the dropped numbers and the items of every wire.
#[derive(Default)]
struct Dropped(Mutex<BTreeMap<usize, BTreeSet<u64>>>, Mutex<BTreeMap<OutputId, Vec<Vec<u8>>>>);

impl Tap for Dropped {
    fn listens(&self, _: OutputId) -> bool {
        true
    }

    fn item(&self, wire: OutputId, item: &Item) {
        self.1.lock().unwrap().entry(wire).or_default().push(codec::encode(item));
    }

    fn dropped(&self, link: usize, number: u64) {
        assert!(self.0.lock().unwrap().entry(link).or_default().insert(number), "{number} was dropped twice");
    }
}

#[test]
fn a_slow_sink_loses_items_by_its_policy_and_a_replay_loses_the_same() {
    let n = 500;
    let given: Vec<_> = (0..n).map(|i| (i, 0, i as f64 + 0.5)).collect();
    for (case, policy) in [Policy::DropOld, Policy::DropNew, Policy::Sample(7), Policy::Block].into_iter().enumerate() {
        for (max_bytes, workers) in [(u64::MAX, 1), (u64::MAX, 2), (150, 2)] {
            let gate = format!("overload {case} {max_bytes} {workers}");
            // A source without backpressure ends while the sink is still at its first item.
            let holds = matches!(policy, Policy::DropOld | Policy::DropNew);
            let params = if holds { json!({ "gate": gate }) } else { json!({}) };
            let plan = live("camera", 1, &given, json!({}))
                .node("sink", "toy.add", params, &[("a", "camera.p0", None)])
                .node("all", "toy.sum", json!({}), &[("all", "camera.p0", None)])
                .link("all.all", |link| link.capacity = 1000)
                .link("sink.a", |link| (link.policy, link.max_bytes) = (policy, max_bytes))
                .record(&["sink.out"])
                .result("all", "sink.out", true, false)
                .result("sum", "all.out", false, false)
                .plan();
            let seen = Dropped::default();
            let observer = OpenAtEnd(Gate::of(&gate), "camera");
            let live = run_with(&plan, &registry(), &options(workers), &observer, Replayed::default(), Some(&seen));
            let live = live.unwrap();
            assert_eq!(live.outcome, Outcome::Complete, "{policy:?}");
            let link = live.links.iter().find(|link| link.to == "sink.a").unwrap();
            assert_eq!((link.sent, link.sent), (n as u64, link.received + link.dropped), "{policy:?}");
            let drops = seen.0.into_inner().unwrap();
            assert_eq!(drops.values().map(BTreeSet::len).sum::<usize>() as u64, link.dropped, "{policy:?}");
            let results = live.results["all"].as_array().unwrap();
            assert_eq!(results.len(), n as usize, "a dropped item leaves an empty in its place");
            let message =
                format!("camera.p0 -> sink.a dropped {} of its {n} items by its policy {policy}", link.dropped);
            let warned = live.warnings.iter().any(|warning| warning.message == message);
            assert_eq!(warned, link.dropped > 0, "{:?}", live.warnings);
            match policy {
                Policy::DropOld => {
                    assert_eq!(results[n as usize - 1], json!(n as f64 - 0.5), "the newest comes through")
                }
                Policy::DropNew => assert_eq!(results[0], json!(0.5), "the oldest comes through"),
                Policy::Sample(_) => assert_eq!(link.received, (n as u64).div_ceil(7)),
                _ => assert_eq!(link.dropped, 0),
            }
            assert!(!holds || link.dropped > n as u64 / 2, "{policy:?} dropped {} only", link.dropped);
            Gate::of(&gate).open();
            for workers in [1, 8] {
                let replayed = Replayed { drops: Some(drops.clone()), ..Replayed::default() };
                let again = Dropped::default();
                let report = run_with(&plan, &registry(), &options(workers), &(), replayed, Some(&again)).unwrap();
                assert_eq!(report.results, live.results, "{policy:?} on {workers} workers");
                assert_eq!(again.0.into_inner().unwrap(), drops, "{policy:?} on {workers} workers");
                assert_eq!(again.1.into_inner().unwrap(), *seen.1.lock().unwrap(), "{policy:?} on {workers} workers");
            }
        }
    }
}

/// Keeps the clock readings of firings.
#[derive(Default)]
struct Readings(Mutex<BTreeMap<(usize, u64), Vec<ClockReading>>>);

impl Tap for Readings {
    fn item(&self, _: OutputId, _: &Item) {}

    fn live(&self, node: usize, item: u64, readings: &[ClockReading]) {
        let before = self.0.lock().unwrap().insert((node, item), readings.to_vec());
        assert_eq!(before, None, "the readings of a firing are told once");
    }
}

#[test]
fn clock_readings_are_recorded_and_replayed() {
    let given: Vec<_> = (0..6).map(|i| (i, 0, i as f64)).collect();
    // One budget that is used up, and one that never is.
    for (budget_us, most_looks) in [(300, u64::MAX), (3_600_000_000_u64, 7)] {
        let plan = live("scan", 1, &given, json!({}))
            .node("plain", "toy.add", json!({}), &[("a", "scan.p0", None)])
            .node(
                "timed",
                "toy.add",
                json!({ "budget_us": budget_us, "most_looks": most_looks }),
                &[("a", "plain.out", None)],
            )
            .record(&["timed.out"])
            .result("all", "timed.out", true, false)
            .plan();
        let seen = Readings::default();
        let live = run_with(&plan, &registry(), &options(2), &(), Replayed::default(), Some(&seen)).unwrap();
        let readings = seen.0.into_inner().unwrap();
        let timed = plan.node("timed").unwrap();
        assert_eq!(readings.keys().copied().collect::<Vec<_>>(), (0..6).map(|i| (timed, i)).collect::<Vec<_>>());
        for readings in readings.values() {
            let [ClockReading::Budget { looks, over }, ClockReading::Clock { ns }] = readings[..] else {
                panic!("{readings:?}: a budget and then the clock were asked for")
            };
            assert!(ns > 1_600_000_000_000_000_000 && over == (most_looks > 7), "{readings:?}");
            assert!(over || looks == 7, "{readings:?}");
        }
        for workers in [1, 8] {
            let replayed = Replayed { readings: Some(readings.clone()), ..Replayed::default() };
            let again = Readings::default();
            let report = run_with(&plan, &registry(), &options(workers), &(), replayed, Some(&again)).unwrap();
            assert_eq!((&report.results, report.warnings.len()), (&live.results, 0));
            assert_eq!(again.0.into_inner().unwrap(), readings);
        }
        // Readings missing from the recording are taken from the clock, with a warning.
        let replayed = Replayed { readings: Some(BTreeMap::new()), ..Replayed::default() };
        let report = run_with(&plan, &registry(), &options(1), &(), replayed, None).unwrap();
        assert_eq!(report.warnings.len(), 12, "two readings of six firings: {:?}", report.warnings);
    }
}

#[test]
fn items_of_a_lossy_wire_still_join_by_their_stamps() {
    let given: Vec<_> = (0..12).flat_map(|i| [(i * 10, 0, 100.0 + i as f64), (i * 10, 1, 0.5)]).collect();
    for (join, met) in [(Join::Stamp { tolerance_ns: 0 }, 4), (Join::Latest, 4)] {
        let plan = live("both", 2, &given, json!({}))
            .node("add", "toy.add", json!({}), &[("a", "both.p0", None), ("b", "both.p1", Some(join))])
            .link("add.b", |link| link.policy = Policy::Sample(3))
            .record(&["add.out"])
            .result("all", "add.out", true, false)
            .plan();
        let report = check(&plan);
        let all = report.results["all"].as_array().unwrap();
        let expected: Vec<_> = (0..12).map(|i| json!(100.0 + i as f64 + if i % 3 == 0 { 0.5 } else { 0.0 })).collect();
        assert_eq!((all, expected.iter().filter(|x| x.as_f64().unwrap().fract() > 0.0).count()), (&expected, met));
    }
}
