use super::*;
use crate::{
    plan::{OutputId, Policy},
    recording::{Recording, codec},
    replay::{ReplayOptions, replay_plan},
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::{Item, Join};
use osteoflow_toy::{Number, registry};
use serde_json::{Value as Json, json};
use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

/// Calls that give one number each on one port, as (stamp, port, number).
pub(super) fn calls(calls: &[(i64, usize, f64)]) -> Json {
    calls.iter().map(|(stamp_ns, port, x)| json!({ "stamp_ns": stamp_ns, "give": [[port, x]] })).collect()
}

/// Keeps every recorded item in encoded form.
#[derive(Default)]
struct Keep(Mutex<BTreeMap<OutputId, Vec<Vec<u8>>>>);

impl Tap for Keep {
    fn listens(&self, _: OutputId) -> bool {
        true
    }

    fn item(&self, wire: OutputId, item: &Item) {
        self.0.lock().unwrap().entry(wire).or_default().push(codec::encode(item));
    }
}

pub(super) fn options(workers: usize) -> RunOptions {
    RunOptions { workers, fixed_results: vec![("notice".into(), json!("toy"))], ..RunOptions::default() }
}

/// Runs on 1, 2 and 8 workers, compares results and every recorded item, and returns the last report.
pub(super) fn check(plan: &Plan) -> RunReport {
    let mut first: Option<(Json, BTreeMap<_, _>)> = None;
    let mut last = None;
    for workers in [1, 2, 8] {
        let keep = Keep::default();
        let report = run_with(plan, &registry(), &options(workers), &(), Replayed::default(), Some(&keep)).unwrap();
        for link in &report.links {
            assert_eq!(link.sent, link.received + link.dropped, "{} -> {} on {workers} workers", link.from, link.to);
        }
        let left = (report.results.clone(), keep.0.into_inner().unwrap());
        match &first {
            None => first = Some(left),
            Some(first) => assert_eq!(left, *first, "one worker and {workers} differ"),
        }
        last = Some(report);
    }
    last.unwrap()
}

pub(super) fn refusal_of(report: &RunReport) -> &Refusal {
    match &report.outcome {
        Outcome::Refused(refusal) => refusal,
        other => panic!("{other:?} where a refusal was expected"),
    }
}

/// 135 samples of a marker before the one scan that lets `follow` begin.
fn parks() -> Plan {
    let mut script: Vec<_> = (0..135).map(|i| (i, 0, i as f64 + 0.25)).collect();
    script.push((135, 1, 1000.0));
    script.extend((136..200).map(|i| (i, 0, i as f64 + 0.25)));
    PlanBuilder::new()
        .script("recording", 2, calls(&script))
        .node("fit", "toy.add", json!({}), &[("a", "recording.p1", None)])
        .node(
            "follow",
            "toy.add",
            json!({ "noise": true }),
            &[("a", "recording.p0", None), ("b", "fit.out", Some(Join::Once))],
        )
        .record(&["recording.p0", "recording.p1", "fit.out", "follow.out"])
        .result("plane.last", "follow.out", false, false)
        .result("plane.all", "follow.out", true, false)
        .plan()
}

#[test]
fn a_stuck_graph_goes_on_with_a_longer_queue_and_the_same_results() {
    let report = check(&parks());
    assert_eq!(report.outcome, Outcome::Complete);
    assert_eq!(report.results["plane"]["all"].as_array().unwrap().len(), 199);
    let last = report.results["plane"]["last"].as_f64().unwrap();
    assert!((1199.25..1200.25).contains(&last), "{last} is not 199.25 + 1000 and noise below 1");
    let sizes: Vec<_> = report.enlargements.iter().map(|e| (e.from.as_str(), e.to.as_str(), e.after)).collect();
    let to = |n| ("recording.p0", "follow.a", n);
    assert_eq!(sizes, [to(8), to(16), to(32), to(64), to(128), to(256)]);
}

#[test]
fn a_graph_that_may_not_grow_is_refused_with_the_full_and_the_empty_links() {
    let mut plan = parks();
    // Twenty numbers; the queue of four has been doubled to 32 by then.
    let max_bytes = 20 * (size_of::<Item>() + size_of::<Number>()) as u64;
    plan.links.iter_mut().for_each(|link| link.max_bytes = max_bytes);
    let report = check(&plan);
    let refusal = refusal_of(&report);
    let expected = format!(
        "the graph is stuck: nothing can run; full: recording.p0 -> follow.a (20 items, {max_bytes} bytes); \
         empty: fit.out -> follow.b, recording.p1 -> fit.a; give the full links a larger max_bytes"
    );
    assert_eq!((refusal.node.as_str(), &refusal.reason), ("recording", &expected));
    let sizes: Vec<_> = report.enlargements.iter().map(|e| (e.to.as_str(), e.after)).collect();
    assert_eq!(sizes, [("follow.a", 8), ("follow.a", 16), ("follow.a", 32)]);
    assert!(report.results.get("plane").is_none() && report.results["notice"] == "toy");
}

#[test]
fn progress_of_silent_ports_keeps_queues_short() {
    // The scan waits for samples around it; earlier samples are released as its wire's progress passes them.
    let mut script: Vec<_> = (0..300).map(|i| (i * 10, 0, i as f64)).collect();
    script.push((3000, 0, 300.0));
    script.push((3005, 1, 1000.0));
    script.push((3010, 0, 301.0));
    let plan = PlanBuilder::new()
        .script("recording", 2, calls(&script))
        .node(
            "to_world",
            "toy.add",
            json!({}),
            &[("a", "recording.p1", None), ("b", "recording.p0", Some(Join::Interpolate { max_gap_ns: Some(10) }))],
        )
        .record(&["to_world.out"])
        .result("x", "to_world.out", false, false)
        .plan();
    let report = check(&plan);
    assert_eq!(report.results["x"], 1300.5);
    assert_eq!(report.enlargements, []);
}

#[test]
fn progress_passes_through_nodes_that_do_not_fire() {
    // `scan` passes through two nodes before it meets the samples: their progress must be passed on.
    let mut script: Vec<_> = (0..300).map(|i| (i * 10, 0, i as f64)).collect();
    script.push((3000, 1, 1000.0));
    script.push((3010, 0, 302.0));
    let plan = PlanBuilder::new()
        .script("recording", 2, calls(&script))
        .node("crop", "toy.add", json!({}), &[("a", "recording.p1", None)])
        .node("smooth", "toy.add", json!({}), &[("a", "crop.out", None)])
        .node("to_world", "toy.add", json!({}), &[("a", "smooth.out", None), ("b", "recording.p0", Some(Join::Latest))])
        .result("x", "to_world.out", false, false)
        .plan();
    for _ in 0..20 {
        let report = check(&plan);
        assert_eq!((report.results["x"].as_f64(), report.enlargements.len()), (Some(1299.0), 0));
    }
}

/// Three numbers through `first`, then `second`; `other` is a separate branch.
fn branches(numbers: [f64; 3], optional: bool) -> PlanBuilder {
    let script: Vec<_> = numbers.iter().zip(1..).map(|(x, stamp)| (stamp, 0, *x)).collect();
    PlanBuilder::new()
        .script("scan", 1, calls(&script))
        .node("first", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .node("second", "toy.add", json!({}), &[("a", "first.out", None)])
        .node("other", "toy.sum", json!({}), &[("all", "scan.p0", None)])
        .record(&["scan.p0", "first.out", "second.out", "other.out"])
        .result("pose", "second.out", false, optional)
        .result("sum", "other.out", false, false)
}

#[test]
fn a_failing_node_is_named_with_item_and_line_and_there_are_no_results() {
    let report = check(&branches([1.0, 13.0, 3.0], false).plan());
    let refusal = refusal_of(&report);
    assert_eq!(refusal.to_string(), "toy.toml:11: node \"first\", item 1: 13 is not a number to add to");
    let refused = json!({ "reason": "13 is not a number to add to", "node": "first", "item": 1 });
    assert_eq!((&report.results["notice"], &report.results["refused"]), (&"toy".into(), &refused));
    assert_eq!((report.results.get("pose"), report.results.get("sum")), (None, None));
    let items: Vec<_> = report.nodes.iter().map(|n| (n.name.as_str(), n.items, n.skipped, n.failed)).collect();
    let expected = [("scan", 3, 0, 0), ("first", 2, 0, 1), ("second", 2, 1, 0), ("other", 1, 0, 0)];
    assert_eq!(items, expected, "the failing node ends, the other branch goes on");
}

#[test]
fn a_panic_is_the_nodes_error() {
    let report = check(&branches([666.0, 2.0, 3.0], false).plan());
    let refusal = refusal_of(&report);
    assert!(refusal.panicked && refusal.reason.ends_with("the beast of item 0"), "{}", refusal.reason);
    assert!(refusal.reason.starts_with("panicked at engine/tests/toy/src/arithmetic.rs:"), "{}", refusal.reason);
}

#[test]
fn a_failure_that_only_optional_results_follow_is_a_warning() {
    let report = check(&branches([1.0, 13.0, 3.0], true).plan());
    assert_eq!(report.outcome, Outcome::Complete);
    assert_eq!(report.results, json!({ "notice": "toy", "sum": 17.0 }));
    let messages: Vec<_> = report.warnings.iter().map(|w| (w.node.as_str(), w.item, w.message.as_str())).collect();
    assert_eq!(messages, [("first", 1, "13 is not a number to add to")]);
}

#[test]
fn a_node_that_skips_errors_is_rebuilt_and_goes_on() {
    let report = check(&branches([1.0, 13.0, 3.0], false).skip_errors("first").plan());
    assert_eq!(report.results, json!({ "notice": "toy", "pose": 3.0, "sum": 17.0 }));
    assert_eq!((report.nodes[1].items, report.nodes[1].failed, report.nodes[2].skipped), (3, 1, 1));
    // Where the last item is the one that failed, the item before it does not replace it.
    let report = check(&branches([1.0, 3.0, 13.0], false).skip_errors("first").plan());
    assert_eq!(
        report.results["refused"],
        json!({ "reason": "13 is not a number to add to", "node": "first", "item": 2 })
    );
}

#[test]
fn a_failing_source_keeps_its_items_and_refuses_the_run() {
    let script = json!([
        { "stamp_ns": 1, "give": [[0, 5.0]] },
        { "stamp_ns": 2, "give": [], "fail": "the file was cut short" },
    ]);
    let plan = PlanBuilder::new()
        .script("scan", 1, script)
        .node("first", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .record(&["scan.p0", "first.out"])
        .result("pose", "first.out", false, false)
        .plan();
    let report = check(&plan);
    assert_eq!(report.results["refused"], json!({ "reason": "the file was cut short", "node": "scan", "item": 1 }));
}

#[test]
fn stamps_that_decrease_are_refused() {
    for (port, script) in [(0, [(5, 0, 1.0), (4, 0, 2.0)]), (1, [(5, 0, 1.0), (4, 1, 2.0)])] {
        let plan = PlanBuilder::new().script("scan", 2, calls(&script)).result("x", "scan.p0", false, false).plan();
        let report = check(&plan);
        let message = &refusal_of(&report).reason;
        assert_eq!(*message, format!("output p{port} gave stamp 4 ns after 5 ns; stamps never decrease along a wire"));
    }
}

#[test]
fn a_second_item_on_a_constant_is_refused_and_the_wires_stay_the_same() {
    let plan = PlanBuilder::new()
        .script("scan", 2, calls(&[(1, 1, 7.0), (2, 0, 1.0), (3, 1, 8.0), (4, 0, 2.0)]))
        .node("add", "toy.add", json!({}), &[("a", "scan.p0", None), ("b", "scan.p1", Some(Join::Once))])
        .record(&["add.out"])
        .result("x", "add.out", true, false)
        .plan();
    let report = check(&plan);
    let refusal = refusal_of(&report);
    assert_eq!((refusal.node.as_str(), refusal.item), ("add", Some(1)));
    assert!(refusal.reason.contains("input \"b\" takes one item for the whole run"), "{}", refusal.reason);
}

#[test]
fn a_missing_result_names_the_wire_that_carried_no_item() {
    let plan = PlanBuilder::new()
        .script("recording", 2, calls(&[(1, 0, 1.0)]))
        .node("hole", "toy.add", json!({}), &[("a", "recording.p1", None)])
        .node("coarse", "toy.sum", json!({}), &[("all", "hole.out", Some(Join::Collect { n: Some(3) }))])
        .record(&["recording.p0", "coarse.out"])
        .result("pose", "coarse.out", false, false)
        .plan();
    let report = check(&plan);
    let expected = json!({ "reason": "no item ever came on recording.p1", "node": "recording" });
    assert_eq!(report.results["refused"], expected);
}

#[test]
fn a_missing_third_item_is_reported_by_the_node_that_waited_for_it() {
    let plan = PlanBuilder::new()
        .script("recording", 1, calls(&[(1, 0, 1.0), (2, 0, 2.0)]))
        .node("coarse", "toy.sum", json!({}), &[("all", "recording.p0", Some(Join::Collect { n: Some(3) }))])
        .result("pose", "coarse.out", false, false)
        .plan();
    let report = check(&plan);
    assert_eq!(refusal_of(&report).reason, "input \"all\": 2 of 3 items came before the end");
}

#[test]
fn the_last_empty_of_the_node_itself_is_the_reason() {
    let plan = PlanBuilder::new()
        .script("recording", 1, calls(&[(1, 0, -1.0)]))
        .node("coarse", "toy.sum", json!({}), &[("all", "recording.p0", None)])
        .result("pose", "coarse.out", false, false)
        .plan();
    let refused = check(&plan).results["refused"].clone();
    assert_eq!(refused, json!({ "reason": "the sum is not positive", "node": "coarse", "item": 0 }));
}

#[test]
fn an_empty_in_a_list_is_an_unknown_value() {
    let script = json!([
        { "stamp_ns": 1, "give": [[0, 5.0]] },
        { "stamp_ns": 2, "give": [[0, null]] },
        { "stamp_ns": 3, "give": [[0, 6.0]] },
    ]);
    let plan = PlanBuilder::new()
        .script("marker", 1, script)
        .node("follow", "toy.add", json!({}), &[("a", "marker.p0", None)])
        .result("all", "follow.out", true, false)
        .plan();
    let expected = json!([5.0, { "unknown": "lost", "node": "marker" }, 6.0]);
    assert_eq!(check(&plan).results["all"], expected);
}

#[test]
fn dropped_items_become_empties_so_that_each_never_shifts() {
    let n = 40;
    let script: Vec<_> = (0..n).map(|i| (i, 0, i as f64 + 0.5)).collect();
    let plan = PlanBuilder::new()
        .script("live", 1, calls(&script))
        .node("fast", "toy.add", json!({}), &[("a", "live.p0", None)])
        .node("both", "toy.add", json!({}), &[("a", "live.p0", None), ("b", "fast.out", Some(Join::Each))])
        .link("both.a", |link| link.policy = Policy::Sample(4))
        .record(&["both.out"])
        .result("all", "both.out", true, false)
        .plan();
    let report = check(&plan);
    let all = report.results["all"].as_array().unwrap();
    assert_eq!(all.len(), n as usize);
    for (i, value) in all.iter().enumerate() {
        match i % 4 {
            0 => assert_eq!(*value, json!(2.0 * i as f64 + 1.0), "item {i} met its own partner"),
            _ => assert_eq!(value["unknown"], "dropped on live.p0 by its policy sample, one in 4"),
        }
    }
    let link = report.links.iter().find(|link| link.to == "both.a").unwrap();
    assert_eq!((link.sent, link.received, link.dropped), (40, 10, 30));
}

#[test]
fn a_full_link_that_must_not_be_full_refuses_the_run() {
    let script: Vec<_> = (0..64).map(|i| (i, 0, i as f64 + 0.5)).collect();
    let plan = PlanBuilder::new()
        .script("live", 2, calls(&script))
        .node("hold", "toy.add", json!({}), &[("a", "live.p1", None)])
        .node("both", "toy.add", json!({}), &[("a", "live.p0", None), ("b", "hold.out", Some(Join::Once))])
        .link("both.a", |link| link.policy = Policy::Fail)
        .result("x", "both.out", true, false)
        .plan();
    for workers in [1, 8] {
        let report = run(&plan, &registry(), &options(workers), &()).unwrap();
        let message = &refusal_of(&report).reason;
        assert!(
            message.starts_with("the link live.p0 -> both.a is full at 4 items or 1048576 bytes, and"),
            "{message}"
        );
    }
}

#[test]
fn nodes_that_cannot_be_built_are_all_named_before_anything_runs() {
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&[(1, 0, 1.0)]))
        .node("first", "toy.add", json!({ "bad": true }), &[("a", "scan.p0", None)])
        .node("second", "toy.add", json!({ "bad": true }), &[("a", "first.out", None)])
        .plan();
    let dir = tempfile::tempdir().unwrap();
    let options = RunOptions { out_dir: Some(dir.path().join("out")), ..options(1) };
    let message = run(&plan, &registry(), &options, &()).unwrap_err().to_string();
    let fault = |line: u32, node: &str| {
        format!("toy.toml:{line}: node \"{node}\": parameter \"bad\": expected false, found true")
    };
    assert_eq!(message, format!("{}\n{}", fault(11, "first"), fault(12, "second")));
    assert!(!dir.path().join("out").exists(), "nothing is left of a run that did not begin");
}

/// Stops the run at the third answer of the source.
struct Stop(Arc<AtomicBool>, AtomicUsize);

impl Observer for Stop {
    fn event(&self, event: &Event<'_>) {
        if let Event::Fired { node: "scan", item: 2, .. } = event {
            self.0.store(true, Ordering::Relaxed);
        }
        if let Event::Ended { .. } = event {
            self.1.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[test]
fn an_interrupted_run_drains_and_writes_complete_files_without_results() {
    for workers in [1, 8] {
        let script: Vec<_> = (1..1000).map(|i| (i, 0, 1.0)).collect();
        let plan = PlanBuilder::new()
            .script("scan", 1, calls(&script))
            .node("sum", "toy.sum", json!({}), &[("all", "scan.p0", None)])
            .record(&["scan.p0", "sum.out"])
            .result("sum", "sum.out", false, false)
            .plan();
        let dir = tempfile::tempdir().unwrap();
        let options = RunOptions { out_dir: Some(dir.path().into()), record: true, ..options(workers) };
        let stop = Stop(options.cancelled.clone(), AtomicUsize::new(0));
        let report = run(&plan, &registry(), &options, &stop).unwrap();
        assert_eq!((report.outcome, stop.1.into_inner()), (Outcome::Interrupted, 2));
        assert_eq!(report.results["refused"]["reason"], "the run was interrupted before its end");
        let recording = Recording::open(&dir.path().join("run.mcap")).unwrap();
        assert!(recording.truncated.is_none() && recording.interrupted);
        assert_eq!(recording.wires["scan.p0"].messages.len(), 3);
        assert_eq!(recording.wires["sum.out"].messages.len(), 1);
    }
}

fn read_json(dir: &Path, name: &str) -> Json {
    serde_json::from_slice(&std::fs::read(dir.join(name)).unwrap()).unwrap()
}

#[test]
fn a_run_writes_results_manifest_and_a_recording_that_replays_equal() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("input.txt");
    std::fs::write(&input, "abc").unwrap();
    let mut plan = parks();
    plan.input_files.push(input);
    let out = dir.path().join("out");
    let options = RunOptions { out_dir: Some(out.clone()), record: true, ..options(2) };
    let report = run(&plan, &registry(), &options, &()).unwrap();
    assert_eq!(read_json(&out, "results.json"), report.results);
    let manifest = read_json(&out, "manifest.json");
    assert_eq!(manifest["outcome"]["status"], "complete");
    assert_eq!(manifest["inputs"][0]["sha256"].as_str().unwrap()[..8], *"ba7816bf");
    assert_eq!(manifest["links"][0]["from"], "recording.p1");
    assert_eq!(manifest["recording"]["wires"][0], json!({ "wire": "fit.out", "items": 1, "values": 1 }));

    let recording = Recording::open(&out.join("run.mcap")).unwrap();
    assert_eq!((recording.run.name.as_str(), recording.run.seed, &recording.truncated), ("toy", 7, &None));
    assert_eq!(recording.run.graph, plan.resolved);
    let items = recording.items("follow.out", &registry()).unwrap();
    assert_eq!((items.len(), items[3].number, items[3].stamp_ns), (199, 3, 3));

    for workers in [1, 8] {
        let again = RunOptions { workers, ..RunOptions::default() };
        let replayed = replay_plan(&plan, &recording, &ReplayOptions::default(), &registry(), &again, &()).unwrap();
        assert!(replayed.is_equal(), "{:#?}", replayed.wires);
        assert_eq!((replayed.run.results, replayed.results_equal), (report.results.clone(), Some(true)));
    }

    // Another seed draws other noise: the replay reports the first difference.
    plan.seed = 8;
    let replayed =
        replay_plan(&plan, &recording, &ReplayOptions::default(), &registry(), &RunOptions::default(), &()).unwrap();
    assert!(!replayed.is_equal() && replayed.results_equal == Some(false));
    let of = |wire: &str| replayed.wires.iter().find(|w| w.wire == wire).unwrap().clone();
    assert_eq!(of("fit.out").first_difference, None);
    let difference = of("follow.out").first_difference.unwrap();
    let what = &difference.what;
    assert!(difference.item == 0 && what.field == "value" && what.a.starts_with("1000."), "{difference:?}");
    assert!(what.distance.is_some_and(|distance| distance > 0.0), "{what:?}");
    assert_eq!(replayed.first_divergence().unwrap().wire, "follow.out");
}

#[test]
fn a_truncated_recording_gives_its_whole_chunks_and_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let options = RunOptions { out_dir: Some(dir.path().into()), record: true, ..options(1) };
    run(&parks(), &registry(), &options, &()).unwrap();
    let path = dir.path().join("run.mcap");
    let bytes = std::fs::read(&path).unwrap();
    let whole = Recording::open(&path).unwrap();
    let n_items = |recording: &Recording| recording.wires.values().map(|w| w.messages.len()).sum::<usize>();
    for cut in (0..bytes.len()).step_by(97) {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        match Recording::open(&path) {
            Ok(part) => {
                assert!(part.truncated.is_some(), "{cut} of {} bytes pass for the whole", bytes.len());
                assert!(n_items(&part) <= n_items(&whole));
            }
            Err(error) => assert!(error.to_string().contains("is no recording of a run"), "{cut}: {error}"),
        }
        // With one flipped bit: a named fault, or the items before it.
        let mut damaged = bytes.clone();
        damaged[cut] ^= 0x40;
        std::fs::write(&path, &damaged).unwrap();
        if let Ok(part) = Recording::open(&path) {
            assert!(n_items(&part) <= n_items(&whole), "byte {cut}");
        }
    }
}

#[test]
fn viewers_see_constants_at_the_first_time_of_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let plan = PlanBuilder::new()
        .script("plan", 1, calls(&[(0, 0, 4.0)]))
        .script("scan", 1, calls(&[(5_000, 0, 1.0)]))
        .node("add", "toy.add", json!({}), &[("a", "scan.p0", None), ("b", "plan.p0", Some(Join::Once))])
        .record(&["plan.p0", "scan.p0", "add.out"])
        .result("x", "add.out", false, false)
        .plan();
    let options = RunOptions { out_dir: Some(dir.path().into()), record: true, ..options(1) };
    run(&plan, &registry(), &options, &()).unwrap();
    let bytes = std::fs::read(dir.path().join("run.mcap")).unwrap();
    let mut seen = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        assert_eq!(message.log_time, message.publish_time);
        seen.insert(message.channel.topic.clone(), (message.sequence, message.log_time));
    }
    let expected = [
        ("/exact/add.out", (0, 5_000)),
        ("/exact/plan.p0", (0, 5_000)),
        ("/exact/scan.p0", (0, 5_000)),
        ("/run/log", (0, 5_000)),
        ("/run/timing", (1, 5_000)),
        ("/view/add.out", (0, 5_000)),
        ("/view/plan.p0", (0, 5_000)),
        ("/view/scan.p0", (0, 5_000)),
    ];
    assert_eq!(seen, expected.map(|(topic, at)| (topic.to_owned(), at)).into());
}

#[test]
fn a_file_of_another_program_is_named_as_such() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("other.mcap");
    std::fs::write(&path, "not an mcap file at all").unwrap();
    let message = Recording::open(&path).unwrap_err().to_string();
    assert!(message.ends_with("is no recording of a run: it is no MCAP file"), "{message}");
    let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
    writer.finish().unwrap();
    let message = Recording::open(&path).unwrap_err().to_string();
    assert!(message.ends_with("it has no metadata record \"osteoflow\""), "{message}");
}

/// Random graphs and joins: layers of nodes over two sources.
pub(super) fn random_plan(seed: u64) -> Plan {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut draw = |n: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 33) % n
    };
    let mut toy = PlanBuilder::new();
    let mut wires = Vec::new();
    for source in ["s", "t"] {
        let mut now = 0;
        let script: Json = (0..30 + draw(40))
            .map(|i| {
                now += draw(4) as i64;
                let x = if draw(12) == 0 { Json::Null } else { json!(i as f64) };
                json!({ "stamp_ns": now, "give": [[draw(3), x]] })
            })
            .collect();
        toy = toy.script(source, 3, script);
        wires.extend((0..3).map(|port| format!("{source}.p{port}")));
    }
    for layer in 0..8 {
        let name = format!("n{layer}");
        let mut pick = || wires[draw(wires.len() as u64) as usize].clone();
        let (a, b) = (pick(), pick());
        toy = match draw(6) {
            4 => {
                let toy = toy.node(&name, "toy.add", json!({}), &[("a", &a, None)]);
                toy.previous(&format!("{name}.b"), &format!("{name}.out"))
            }
            5 => {
                let n = 1 + draw(3) as u32;
                let joins = [
                    Join::Collect { n: Some(n) },
                    Join::CollectEvery { n, step: 1 + draw(4) as u32 },
                    Join::CollectSpan { span_ns: 1 + draw(9) as i64, step_ns: 1 + draw(9) as i64 },
                ];
                let join = Some(joins[draw(3) as usize]);
                toy.node(&name, "toy.some", json!({}), &[("all", &a, join), ("all", &b, join)])
            }
            0 => {
                let n = (draw(2) == 0).then_some(1 + draw(3) as u32);
                toy.node(&name, "toy.sum", json!({}), &[("all", &a, Some(Join::Collect { n }))])
            }
            _ => {
                let join = [
                    Join::Each,
                    Join::Stamp { tolerance_ns: 2 },
                    Join::Latest,
                    Join::Interpolate { max_gap_ns: Some(6) },
                    Join::Interpolate { max_gap_ns: None },
                ];
                let join = join[draw(5) as usize];
                toy.node(&name, "toy.add", json!({ "noise": true }), &[("a", &a, None), ("b", &b, Some(join))])
            }
        };
        wires.push(format!("{name}.out"));
    }
    let names: Vec<&str> = wires.iter().map(String::as_str).collect();
    toy = toy.record(&names);
    for name in &names {
        toy = toy.result(name, name, true, true);
    }
    let mut plan = toy.plan();
    plan.links.iter_mut().for_each(|link| link.capacity = 1 + draw(3) as usize);
    plan
}

#[test]
fn random_graphs_give_the_same_on_any_number_of_workers() {
    for seed in 0..60 {
        let report = check(&random_plan(seed));
        // Some nodes fail, for example at 13; a refused graph is refused in the same way for any number of workers.
        assert!(!matches!(report.outcome, Outcome::Interrupted), "graph {seed}");
        let stuck = matches!(&report.outcome, Outcome::Refused(r) if r.reason.contains("stuck"));
        assert!(!stuck, "graph {seed}: {:?}", report.outcome);
    }
}

#[test]
fn random_graphs_give_the_same_for_any_interleaving_of_threads() {
    let (n_graphs, n_shuffles) = if std::env::var_os("SLOW_TESTS").is_some() { (60, 40) } else { (12, 6) };
    for graph in 0..n_graphs {
        let plan = random_plan(graph);
        let recorded = |workers: usize, shuffle: Option<u64>| {
            let keep = Keep::default();
            let options = RunOptions { shuffle, ..options(workers) };
            let report = run_with(&plan, &registry(), &options, &(), Replayed::default(), Some(&keep)).unwrap();
            for link in &report.links {
                assert_eq!(link.sent, link.received + link.dropped, "{} -> {}, {shuffle:?}", link.from, link.to);
            }
            (report.results, report.enlargements.len(), keep.0.into_inner().unwrap())
        };
        let expected = recorded(1, None);
        for shuffle in 0..n_shuffles {
            for workers in [1, 2, 8] {
                let found = recorded(workers, Some(shuffle));
                assert_eq!(found, expected, "graph {graph}, shuffle {shuffle}, {workers} workers");
            }
        }
    }
}

#[test]
fn the_time_from_each_source_to_each_sink_is_measured_where_asked() {
    let script: Vec<_> = (1..50).map(|i| (i, 0, 1.0)).collect();
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&script))
        .script("plan", 1, calls(&[(0, 0, 1.0)]))
        .node("a", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .node("b", "toy.add", json!({}), &[("a", "a.out", None), ("b", "plan.p0", Some(Join::Once))])
        .node("other", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .plan();
    let report = run(&plan, &registry(), &RunOptions { latency: true, ..options(2) }, &()).unwrap();
    let pairs: Vec<_> = report.latencies.iter().map(|l| (l.source.as_str(), l.sink.as_str(), l.firings)).collect();
    assert_eq!(pairs.iter().filter(|(.., n)| *n == 49).count(), 3, "{pairs:?}");
    let mut names: Vec<_> = pairs.iter().map(|(source, sink, _)| (*source, *sink)).collect();
    names.sort_unstable();
    assert_eq!(names, [("plan", "b"), ("scan", "b"), ("scan", "other")]);
    for l in &report.latencies {
        assert!(
            l.spread.p50 <= l.spread.p99 && l.spread.p99 <= l.spread.max && l.spread.max <= report.elapsed,
            "{l:?}"
        );
    }
    assert!(run(&plan, &registry(), &options(2), &()).unwrap().latencies.is_empty());
}

#[test]
fn warnings_of_nodes_and_items_without_partner_are_reported() {
    let plan = PlanBuilder::new()
        .script("scan", 2, calls(&[(1, 0, 99.0), (2, 1, 1.0), (3, 0, 1.0)]))
        .node("add", "toy.add", json!({}), &[("a", "scan.p1", None), ("b", "scan.p0", Some(Join::Each))])
        .node("warns", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .result("x", "add.out", false, false)
        .plan();
    let report = check(&plan);
    let messages: Vec<_> = report.warnings.iter().map(|w| format!("{}/{}: {}", w.node, w.item, w.message)).collect();
    let unmatched = "add/1: input \"b\": 1 item of scan.p0 found no partner to fire with";
    assert_eq!(messages, [unmatched, "warns/0: 99 is nearly 100"]);
    let unmatched: Vec<_> = report.links.iter().map(|l| (l.to.as_str(), l.unmatched)).collect();
    assert_eq!(unmatched, [("add.a", 0), ("add.b", 1), ("warns.a", 0)]);
}

#[test]
fn an_injection_is_parsed_and_a_wrong_one_names_the_nearest_node() {
    let plan = PlanBuilder::new().script("scan", 1, json!([])).node("first", "toy.add", json!({}), &[]).plan();
    let read = |text: &str| Injection::parse(text, &plan).map(|i| i.to_string());
    assert_eq!(read("first").unwrap(), "first@0=panic");
    assert_eq!(read("scan@7=error").unwrap(), "scan@7=error");
    for (text, expected) in [
        ("frist", "the graph has no such node; did you mean \"first\"?"),
        ("first@x", "\"x\" is no item number"),
        ("first@-1", "\"-1\" is no item number"),
        ("first=explode", "\"explode\" cannot be injected; panic and error can"),
        ("", "the graph has no such node; nodes here"),
    ] {
        let message = read(text).unwrap_err();
        assert!(message.contains(expected), "{text}: {message}");
    }
}
