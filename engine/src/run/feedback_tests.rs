//! Runs with wires that go in a cycle, and with several wires to one port.

use super::{
    tests::{calls, check, options, refusal_of},
    *,
};
use crate::{
    partial::PartialRun,
    recording::Recording,
    replay::{Moment, ReplayOptions, replay_plan},
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::Join;
use osteoflow_toy::registry;
use serde_json::json;
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

/// A scan of 1, 2, 3 .. through `start` and `fit`, whose answers come back to `start` at the next firing.
fn cycle(script: &[(i64, usize, f64)]) -> PlanBuilder {
    cycle_of(PlanBuilder::new().script("scan", 1, calls(script)))
}

fn cycle_of(scan: PlanBuilder) -> PlanBuilder {
    scan.node("start", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .node("fit", "toy.add", json!({}), &[("a", "start.out", None), ("b", "scan.p0", Some(Join::Each))])
        .previous("start.b", "fit.out")
        .record(&["scan.p0", "start.out", "fit.out"])
        .result("fit", "fit.out", true, false)
        .result("start", "start.out", true, false)
}

fn narrow(mut plan: Plan) -> Plan {
    plan.links.iter_mut().for_each(|link| (link.capacity, link.max_bytes) = (1, 1));
    plan
}

#[test]
fn a_firing_takes_what_its_answer_to_the_one_before_became() {
    let script: Vec<_> = (1..40).map(|i| (i, 0, 2.0 * i as f64)).collect();
    let plan = narrow(cycle(&script).plan());
    let report = check(&plan);
    assert_eq!(report.outcome, Outcome::Complete);
    // fit(k) = start(k) + 2 k, start(k) = 2 k + fit(k - 1): the sum of 4 i up to k.
    let expected: Vec<f64> = (1..40).map(|k| f64::from(2 * k * (k + 1))).collect();
    assert_eq!(report.results["fit"], json!(expected));
    assert!(report.enlargements.is_empty(), "a queue of one item is long enough: {:?}", report.enlargements);
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
    for shuffle in 0..20 {
        let shuffled = RunOptions { shuffle: Some(shuffle), ..options(8) };
        assert_eq!(run(&plan, &registry(), &shuffled, &()).unwrap().results, report.results, "shuffle {shuffle}");
    }
}

#[test]
fn a_node_may_take_its_own_answer_and_the_last_item_of_a_source() {
    let script: Vec<_> = (1..20).map(|i| (i, 0, 2.0 * i as f64)).collect();
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&script))
        .node("sum", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .previous("sum.b", "sum.out")
        .node("pair", "toy.add", json!({}), &[("a", "scan.p0", None), ("b", "scan.p0", Some(Join::Previous))])
        .result("sum", "sum.out", true, false)
        .result("pair", "pair.out", true, false)
        .plan();
    let report = check(&narrow(plan));
    assert_eq!(report.results["sum"], json!((1..20).map(|k| f64::from(k * (k + 1))).collect::<Vec<_>>()));
    assert_eq!(report.results["pair"], json!((1..20).map(|k| f64::from(4 * k - 2)).collect::<Vec<_>>()));
}

#[test]
fn an_empty_comes_back_as_an_empty_and_a_skipped_failure_too() {
    let mut script: Vec<_> = (1..9).map(|i| (i, 0, i as f64)).collect();
    (script[2].2, script[4].2) = (13.0, 6.0);
    let lost = |reason: &str, node: &str| json!({ "unknown": reason, "node": node });
    let report = check(&cycle(&script).skip_errors("start").plan());
    let fit = report.results["fit"].as_array().unwrap();
    // start refuses 13 at item 2, so fit passes the empty on; at item 3 start has nothing to add to.
    assert_eq!(fit[..4], [json!(2.0), json!(6.0), lost("13 is not a number to add to", "start"), json!(8.0)]);
    assert_eq!(fit[4], json!(20.0), "8 + 6 + 6");

    let mut plan = cycle(&[(1, 0, 1.0), (2, 0, 2.0), (3, 0, 3.0), (4, 0, 4.0)]).plan();
    let script = json!([{ "stamp_ns": 1, "give": [[0, 1.0]] }, { "stamp_ns": 2, "give": [[0, null]] },
                        { "stamp_ns": 3, "give": [[0, 3.0]] }]);
    plan.nodes[0].params = json!({ "calls": script });
    let report = check(&plan);
    assert_eq!(report.results["fit"], json!([2.0, lost("lost", "scan"), 6.0]));
}

#[test]
fn a_node_that_ends_by_a_failure_leaves_a_reason_and_no_node_waits_for_it() {
    let mut script: Vec<_> = (1..9).map(|i| (i, 0, i as f64)).collect();
    script[3].2 = 13.0;
    for plan in [cycle(&script).plan(), cycle(&[(1, 0, 13.0), (2, 0, 1.0), (3, 0, 2.0)]).plan()] {
        let report = check(&narrow(plan));
        assert_eq!(refusal_of(&report).node, "start");
    }
    let plan = cycle(&[(1, 0, 6.5), (2, 0, 0.0), (3, 0, 2.0), (4, 0, 3.0)]).plan();
    // start gives 6.5, then 0 + 13 at which fit fails, then 2 and 3 with nothing before.
    let report = check(&plan);
    assert_eq!(refusal_of(&report).node, "fit");
    let link = |to: &str| report.links.iter().find(|link| link.to == to).map(|link| (link.sent, link.received));
    assert_eq!(link("start.b"), Some((2, 2)), "13 and the reason");
    assert_eq!(link("fit.a"), Some((4, 4)), "start goes on without it");
}

#[test]
fn a_recorded_cycle_replays_equal_and_from_any_of_its_nodes() {
    let dir = tempfile::tempdir().unwrap();
    let script: Vec<_> = (1..30).map(|i| (i, 0, 2.0 * i as f64)).collect();
    let plan = cycle(&script).node("after", "toy.add", json!({}), &[("a", "start.out", None)]).plan();
    let recorded = RunOptions { out_dir: Some(dir.path().join("out")), record: true, ..options(2) };
    let report = run(&plan, &registry(), &recorded, &()).unwrap();
    let recording = Recording::open(&dir.path().join("out/run.mcap")).unwrap();
    for from in [None, Some("start"), Some("fit"), Some("after")] {
        let changes = ReplayOptions { from: from.map(str::to_owned), ..Default::default() };
        for workers in [1, 8] {
            let again = RunOptions { workers, ..RunOptions::default() };
            let replayed = replay_plan(&plan, &recording, &changes, &registry(), &again, &()).unwrap();
            assert!(replayed.is_equal(), "{from:?}: {:#?}", replayed.wires);
            assert_eq!(replayed.run.results["fit"], report.results["fit"], "from {from:?}");
        }
    }
    // A part of the recording is a run of its own: the first firing of it has nothing before.
    let changes = ReplayOptions { start: Some(Moment::Stamp(10)), ..Default::default() };
    let part = replay_plan(&plan, &recording, &changes, &registry(), &RunOptions::default(), &()).unwrap();
    assert_eq!(part.run.results["fit"][0], json!(40.0));
}

#[test]
fn a_live_cycle_gives_what_its_replay_gives() {
    let dir = tempfile::tempdir().unwrap();
    let script: Vec<_> = (1..30).map(|i| (i, 0, 2.0 * i as f64)).collect();
    let plan = cycle_of(PlanBuilder::new().source("scan", "toy.live", 1, json!({ "calls": calls(&script) }))).plan();
    let report = check(&narrow(plan.clone()));
    assert_eq!(report.results["fit"][28], json!(1740.0), "the sum of 4 i up to 29");
    let recorded = RunOptions { out_dir: Some(dir.path().join("out")), record: true, ..options(8) };
    run(&plan, &registry(), &recorded, &()).unwrap();
    let recording = Recording::open(&dir.path().join("out/run.mcap")).unwrap();
    let replayed = replay_plan(&plan, &recording, &ReplayOptions::default(), &registry(), &options(1), &()).unwrap();
    assert!(replayed.is_equal(), "{:#?}", replayed.wires);
}

/// Asks the run to stop once `fit` has fired ten times.
struct StopAtTen(Arc<AtomicBool>);

impl Observer for StopAtTen {
    fn event(&self, event: &Event<'_>) {
        if matches!(event, Event::Fired { node: "fit", item: 9, .. }) {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn a_stop_request_ends_a_cycle() {
    let script: Vec<_> = (1..5000).map(|i| (i, 0, 2.0 * i as f64)).collect();
    for workers in [1, 8] {
        let options = options(workers);
        let stop = StopAtTen(options.cancelled.clone());
        let report = run(&narrow(cycle(&script).plan()), &registry(), &options, &stop).unwrap();
        assert_eq!(report.outcome, Outcome::Interrupted, "{workers} workers");
        let n_fired = report.nodes.iter().find(|node| node.name == "fit").unwrap().items;
        assert!((10..4999).contains(&n_fired), "{n_fired}");
    }
}

#[test]
fn a_change_in_a_cycle_computes_all_of_it_again() {
    let plan = cycle(&[(1, 0, 1.0)]).node("other", "toy.add", json!({}), &[("a", "scan.p0", None)]).plan();
    for changed in ["start", "fit"] {
        let mut marked: Vec<_> = plan.nodes.iter().map(|node| &*node.name == changed).collect();
        plan.mark_downstream(&mut marked);
        assert_eq!(marked, [false, true, true, false], "{changed}");
    }
    assert_eq!(plan.cycles(), [0, 1, 1, 3]);
    assert_eq!(plan.upstream(1), [true, true, true, false]);
    // All of a cycle is computed where nothing of it is there.
    let left = vec![None; 4];
    let part = PartialRun::new(&plan, &left);
    let report = part.run(&registry(), &options(1), &(), None, &mut |finished| finished).unwrap();
    assert_eq!(report.results["fit"], json!([2.0]));
}

#[test]
fn a_port_collects_from_several_wires_in_their_order() {
    let plan = |n: Option<u32>, capacity: usize| {
        let collect = Some(Join::Collect { n });
        let script: Vec<_> = (0..12).flat_map(|i| [(i, 0, i as f64 + 1.0), (i, 1, 100.0 * (i as f64 + 1.0))]).collect();
        let mut plan = PlanBuilder::new()
            .script("scan", 2, calls(&script))
            .node("late", "toy.add", json!({ "sleep_us": 50 }), &[("a", "scan.p1", None)])
            .node("sum", "toy.sum", json!({}), &[("all", "late.out", collect), ("all", "scan.p0", collect)])
            .result("sum", "sum.out", true, true)
            .plan();
        plan.links.iter_mut().for_each(|link| link.capacity = capacity);
        plan
    };
    let report = check(&plan(Some(4), 1));
    assert_eq!(report.results["sum"], json!([1010.0, 2626.0, 4242.0]));
    assert_eq!(check(&plan(None, 4)).results["sum"], json!([7878.0]));
    let incomplete = check(&plan(Some(5), 4));
    let last = json!({ "unknown": "input \"all\": 2 of 5 items of late.out came before the end", "node": "sum" });
    assert_eq!(incomplete.results["sum"][2], last);
}

#[test]
fn windows_fire_alike_on_any_number_of_workers() {
    let script: Vec<_> = (1..20).map(|i| (i * i, 0, i as f64)).collect();
    for (join, expected) in [
        (Join::CollectEvery { n: 3, step: 8 }, vec![6.0, 30.0, 54.0]),
        // [1, 101), [51, 151), [101, 201), [151, 251), [201, 301), [251, 351), [301, 401)
        (Join::CollectSpan { span_ns: 100, step_ns: 50 }, vec![55.0, 50.0, 50.0, 42.0, 48.0, 51.0, 37.0]),
    ] {
        let plan = PlanBuilder::new()
            .script("scan", 1, calls(&script))
            .node("sum", "toy.sum", json!({}), &[("all", "scan.p0", Some(join))])
            .result("sum", "sum.out", true, true)
            .plan();
        let report = check(&narrow(plan));
        let sums = report.results["sum"].as_array().unwrap();
        let values: Vec<_> = sums.iter().filter_map(serde_json::Value::as_f64).collect();
        assert_eq!(values, expected, "{join:?}: {sums:?}");
    }
}
