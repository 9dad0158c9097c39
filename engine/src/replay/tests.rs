use super::*;
use crate::{
    plan::Policy,
    run::{Event, Outcome, run},
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::Join;
use osteoflow_toy::{Gate, registry};
use serde_json::json;
use std::sync::atomic::{AtomicBool, Ordering};

/// Runs the plan into a folder and reads its recording.
fn recorded(plan: &Plan, dir: &Path) -> (RunReport, Recording) {
    let options = RunOptions { workers: 2, out_dir: Some(dir.into()), record: true, ..RunOptions::default() };
    let report = run(plan, &registry(), &options, &()).unwrap();
    (report, Recording::open(&dir.join("run.mcap")).unwrap())
}

fn replay_again(plan: &Plan, recording: &Recording, changes: &ReplayOptions, workers: usize) -> ReplayReport {
    let options = RunOptions { workers, ..RunOptions::default() };
    replay_plan(plan, recording, changes, &registry(), &options, &()).unwrap()
}

/// A live source that produces more than a node with a time budget can process.
fn overloaded() -> Plan {
    let calls: Vec<_> = (0..60).map(|i| json!({ "stamp_ns": 10 + i, "give": [[0, f64::from(i)]] })).collect();
    PlanBuilder::new()
        .source("scan", "toy.live", 1, json!({ "calls": calls }))
        .node("slow", "toy.add", json!({ "budget_us": 50, "most_looks": 1_000_000 }), &[("a", "scan.p0", None)])
        .node("after", "toy.add", json!({ "noise": true }), &[("a", "slow.out", None)])
        .record(&["scan.p0", "slow.out", "after.out"])
        .result("all", "after.out", true, false)
        .link("slow.a", |link| link.policy = Policy::Sample(3))
        .plan()
}

/// Requests a stop when a node fires for the first time.
struct StopIn(&'static str, Arc<AtomicBool>);

impl Observer for StopIn {
    fn event(&self, event: &Event<'_>) {
        if matches!(event, Event::Started { node } if *node == self.0) {
            self.1.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn what_a_node_gives_because_it_was_asked_to_stop_is_no_value_and_nothing_follows_from_it() {
    for workers in [1, 2, 8] {
        let gate = format!("stopped {workers}");
        let calls: Vec<_> = (0..20).map(|i| json!({ "stamp_ns": 10 + i, "give": [[0, f64::from(i)]] })).collect();
        let plan = PlanBuilder::new()
            .source("scan", "toy.live", 1, json!({ "calls": calls }))
            .node("slow", "toy.add", json!({ "gate": gate }), &[("a", "scan.p0", None)])
            .node("next", "toy.add", json!({}), &[("a", "slow.out", None)])
            .node("after", "toy.add", json!({}), &[("a", "scan.p0", None), ("b", "slow.out", Some(Join::Latest))])
            .record(&["scan.p0", "slow.out", "next.out", "after.out"])
            .result("all", "after.out", true, false)
            .plan();
        let dir = tempfile::tempdir().unwrap();
        let options = RunOptions { workers, out_dir: Some(dir.path().into()), record: true, ..RunOptions::default() };
        let stop = StopIn("slow", options.cancelled.clone());
        // The gate lets the node go on only because of the stop.
        let report = run(&plan, &registry(), &options, &stop).unwrap();
        assert_eq!(report.outcome, Outcome::Interrupted);
        let recording = Recording::open(&dir.path().join("run.mcap")).unwrap();
        for wire in ["slow.out", "next.out", "after.out"] {
            assert_eq!(recording.wires[wire].messages.len(), 0, "{wire}, {workers} workers");
        }
        assert!(!recording.wires["scan.p0"].messages.is_empty());
        Gate::of(&gate).open();
        let replayed = replay_again(&plan, &recording, &ReplayOptions::default(), workers);
        assert!(replayed.is_equal(), "{:#?}", replayed.wires);
    }
}

#[test]
fn drops_and_readings_of_the_clock_are_recorded_and_replayed() {
    let dir = tempfile::tempdir().unwrap();
    let plan = overloaded();
    let (report, recording) = recorded(&plan, dir.path());
    let n_dropped: u64 = report.links.iter().map(|link| link.dropped).sum();
    let drops = &recording.drops[&("scan.p0".to_owned(), "slow.a".to_owned())];
    assert_eq!(drops.len() as u64, n_dropped, "every drop is recorded");
    assert_eq!(n_dropped, 40);
    assert!(!recording.readings.is_empty() && recording.readings.keys().all(|(node, _)| node == "slow"));
    for workers in [1, 2, 8] {
        let replayed = replay_again(&plan, &recording, &ReplayOptions::default(), workers);
        assert!(replayed.is_equal() && replayed.results_equal == Some(true), "{:#?}", replayed.wires);
        let asked = replayed
            .run
            .warnings
            .iter()
            .filter(|warning| warning.node == "slow" && !warning.message.contains("dropped"));
        assert_eq!(asked.count(), 0, "{:?}", replayed.run.warnings);
    }
    // Without the beginning, the same items are dropped among those played.
    let late = ReplayOptions { start: Some(Moment::Stamp(40)), ..ReplayOptions::default() };
    let replayed = replay_again(&plan, &recording, &late, 1);
    let n_late = drops.iter().filter(|number| **number >= 30).count() as u64;
    assert_eq!(replayed.run.links[0].dropped, n_late);
    assert!(replayed.not_compared.is_some() && replayed.is_equal());
}

#[test]
fn a_failed_source_is_played_to_the_same_failure() {
    let dir = tempfile::tempdir().unwrap();
    let calls = json!([
        { "stamp_ns": 10, "give": [[0, 1.0]] },
        { "stamp_ns": 20, "give": [[1, 2.0]] },
        { "stamp_ns": 30, "give": [[0, 0.0]], "fail": "the cable was pulled" },
    ]);
    let plan = PlanBuilder::new()
        .script("scan", 2, calls)
        .node("sum", "toy.add", json!({}), &[("a", "scan.p0", None), ("b", "scan.p1", Some(Join::Latest))])
        .record(&["scan.p0", "scan.p1", "sum.out"])
        .result("last", "sum.out", false, true)
        .result("all", "scan.p0", true, false)
        .plan();
    let (report, recording) = recorded(&plan, dir.path());
    assert_eq!(recording.failures.len(), 1);
    let replayed = replay_again(&plan, &recording, &ReplayOptions::default(), 1);
    assert!(replayed.is_equal() && replayed.results_equal == Some(true), "{:#?}", replayed.wires);
    assert_eq!(replayed.run.outcome.status(), report.outcome.status());
    assert_eq!(replayed.run.results["refused"]["reason"], "the cable was pulled");
    let wires = replayed.wires.iter().map(|wire| (wire.n_recorded, wire.n_replayed));
    assert!(wires.clone().all(|(recorded, replayed)| recorded == replayed), "{:?}", wires.collect::<Vec<_>>());
}

#[test]
fn an_empty_of_a_node_upstream_keeps_its_name_when_it_is_played() {
    let dir = tempfile::tempdir().unwrap();
    let calls = json!([{ "stamp_ns": 10, "give": [[0, null]] }, { "stamp_ns": 20, "give": [[0, 2.0]] }]);
    let plan = PlanBuilder::new()
        .script("scan", 1, calls)
        .node("first", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .node("second", "toy.add", json!({}), &[("a", "first.out", None)])
        .record(&["scan.p0", "first.out", "second.out"])
        .result("all", "second.out", true, false)
        .plan();
    let (_, recording) = recorded(&plan, dir.path());
    let from = ReplayOptions { from: Some("second".into()), ..ReplayOptions::default() };
    let replayed = replay_again(&plan, &recording, &from, 1);
    assert!(replayed.is_equal(), "{:#?}", replayed.wires);
    let parts: Vec<_> = replayed.wires.iter().map(|wire| wire.part).collect();
    assert_eq!(parts, [WirePart::Played, WirePart::Played, WirePart::Computed]);
}

#[test]
fn an_unrecorded_wire_is_computed_from_the_nearest_recorded_ones() {
    let dir = tempfile::tempdir().unwrap();
    let calls: Vec<_> = (1..9).map(|i| json!({ "stamp_ns": i, "give": [[0, i]] })).collect();
    let plan = PlanBuilder::new()
        .script("scan", 1, json!(calls))
        .node("a", "toy.add", json!({ "noise": true }), &[("a", "scan.p0", None)])
        .node("b", "toy.add", json!({ "noise": true }), &[("a", "a.out", None)])
        .node("c", "toy.add", json!({ "noise": true }), &[("a", "b.out", None)])
        .node("aside", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .record(&["scan.p0", "a.out", "c.out"])
        .result("all", "c.out", true, false)
        .plan();
    let (_, mut recording) = recorded(&plan, dir.path());
    let from = ReplayOptions { from: Some("c".into()), ..ReplayOptions::default() };
    let replayed = replay_again(&plan, &recording, &from, 2);
    assert!(replayed.is_equal(), "{:#?}", replayed.wires);
    assert_eq!(replayed.computed_too, ["b"]);
    let fired: Vec<_> = replayed.run.nodes.iter().map(|node| node.name.as_str()).collect();
    assert_eq!(fired, ["scan", "a", "b", "c"], "what nobody needs is left out");

    recording.wires.remove("a.out");
    recording.wires.remove("scan.p0");
    let options = RunOptions::default();
    let error = replay_plan(&plan, &recording, &from, &registry(), &options, &()).unwrap_err().to_string();
    assert!(error.contains("lacks the source wire scan.p0"), "{error}");
}

#[test]
fn times_are_seconds_after_the_first_stamp_or_stamps() {
    assert_eq!("12.5".parse::<Moment>().unwrap().stamp(1_000), 12_500_001_000);
    assert_eq!("-1".parse::<Moment>().unwrap().stamp(2_000_000_000), 1_000_000_000);
    assert_eq!("1750000000418500001ns".parse::<Moment>().unwrap().stamp(5), 1_750_000_000_418_500_001);
    assert_eq!("1e300".parse::<Moment>().unwrap().stamp(5), StampNs::MAX);
    assert!(["", "x", "NaN", "inf", "1.5ns"].into_iter().all(|text| text.parse::<Moment>().is_err()));
}
