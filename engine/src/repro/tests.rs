use super::*;
use crate::{
    options::RunOptions,
    plan::Plan,
    run::{Outcome, RunReport, run},
    runtime::{Injected, Injection},
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::Join;
use osteoflow_toy::registry;
use serde_json::{Value as Json, json};

fn calls(numbers: &[f64]) -> Json {
    numbers.iter().zip(1..).map(|(x, stamp_ns)| json!({ "stamp_ns": stamp_ns, "give": [[0, x]] })).collect()
}

/// Runs into a new folder.
fn run_plan(plan: &Plan, inject: Vec<Injection>) -> (tempfile::TempDir, RunReport) {
    let dir = tempfile::tempdir().unwrap();
    let options = RunOptions { out_dir: Some(dir.path().into()), record: true, inject, ..RunOptions::default() };
    let report = run(plan, &registry(), &options, &()).unwrap();
    (dir, report)
}

/// Runs the run's only bundle again.
fn rerun(report: &RunReport) -> ReproReport {
    let [bundle] = &report.saved.bundles[..] else { panic!("{:?}", report.saved) };
    repro(&bundle.dir, &registry(), Program::current(Json::Null), false, &[]).unwrap()
}

#[test]
fn an_item_with_an_absent_port_fails_again_with_the_same_message() {
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&[1.0, 13.0, 3.0]))
        .node("first", "toy.add", json!({ "noise": true }), &[("a", "scan.p0", None)])
        .result("x", "first.out", false, false)
        .plan();
    let (_dir, report) = run_plan(&plan, Vec::new());
    let again = rerun(&report);
    assert!(again.same, "{again:?}");
    assert_eq!(again.bundle.failure, Failure { reason: "13 is not a number to add to".into(), panicked: false });
    assert_eq!((again.bundle.item, again.bundle.stamp_ns, again.bundle.seed), (1, 2, 7));
    let given: Vec<_> = again.bundle.inputs.iter().map(|i| (i.port.as_str(), i.given)).collect();
    assert_eq!(given, [("a", Given::Item), ("b", Given::Absent)]);
    let why = &again.bundle.inputs[1].items[0].about;
    assert!(why.starts_with("empty: ") && why.len() > "empty: ".len(), "{why}");
    assert_eq!(again.differences, Vec::<String>::new());
}

#[test]
fn a_panic_is_reproduced_at_the_same_line() {
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&[666.0]))
        .node("first", "toy.add", json!({}), &[("a", "scan.p0", None), ("b", "scan.p0", Some(Join::Latest))])
        .result("x", "first.out", false, true)
        .plan();
    let (_dir, report) = run_plan(&plan, Vec::new());
    // A panic refuses the run even if only optional results depend on the node.
    assert!(matches!(&report.outcome, Outcome::Refused(refusal) if refusal.panicked), "{:?}", report.outcome);
    let again = rerun(&report);
    assert!(again.same, "{again:?}");
    let (place, message) = again.bundle.failure.place();
    assert!(place.unwrap().starts_with("engine/tests/toy/src/arithmetic.rs:") && message == "the beast of item 0");
}

#[test]
fn a_list_with_empties_round_trips() {
    let script = json!([
        { "stamp_ns": 1, "give": [[0, 1.0]] }, { "stamp_ns": 2, "give": [[0, null]] }, { "stamp_ns": 3, "give": [[0, 2.5]] },
    ]);
    let plan = PlanBuilder::new()
        .script("scan", 1, script)
        .node("all", "toy.some", json!({}), &[("all", "scan.p0", None)])
        .result("x", "all.out", false, false)
        .plan();
    let injection = Injection { node: "all".into(), item: 0, how: Injected::Error };
    let (_dir, report) = run_plan(&plan, vec![injection]);
    let again = rerun(&report);
    assert!(again.same, "{again:?}");
    let input = &again.bundle.inputs[0];
    assert_eq!((input.given, input.items.len(), &*input.items[1].about), (Given::Items, 3, "empty: lost"), "{input:?}");
    let items = items::read(&report.saved.bundles[0].dir.join(bundle::INPUTS), &registry()).unwrap();
    let numbers: Vec<_> = items["all"].iter().map(|item| (item.number, item.stamp_ns)).collect();
    assert_eq!(numbers, [(0, 1), (1, 2), (2, 3)]);
}

#[test]
fn a_source_is_called_up_to_the_call_that_failed() {
    let script = json!([
        { "stamp_ns": 1, "give": [[0, 5.0]] },
        { "stamp_ns": 2, "give": [[0, 6.0]] },
        { "stamp_ns": 3, "give": [], "fail": "the file was cut short" },
    ]);
    let toy = |script: Json| PlanBuilder::new().script("scan", 1, script).result("x", "scan.p0", false, false).plan();
    let (_dir, report) = run_plan(&toy(script), Vec::new());
    let answer = rerun(&report);
    assert!(answer.same && answer.n_calls == 2 && answer.bundle.inputs.is_empty(), "{answer:?}");

    // Decreasing stamps are reproduced too, because earlier calls are repeated.
    let script = json!([{ "stamp_ns": 5, "give": [[0, 5.0]] }, { "stamp_ns": 4, "give": [[0, 6.0]] }]);
    let (_dir, report) = run_plan(&toy(script), Vec::new());
    let answer = rerun(&report);
    assert!(answer.same && answer.bundle.failure.reason.contains("stamps never decrease"), "{answer:?}");
}

#[test]
fn five_failures_of_a_node_are_saved_and_all_are_counted() {
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&[vec![13.0; 250], vec![1.0]].concat()))
        .node("first", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .skip_errors("first")
        .result("x", "first.out", false, false)
        .plan();
    let (_dir, report) = run_plan(&plan, Vec::new());
    assert_eq!(report.outcome, Outcome::Complete);
    assert_eq!((report.saved.bundles.len(), &report.saved.more[..]), (5, &[("first".to_owned(), 245)][..]));
    assert_eq!(report.nodes[1].failed, 250);
    // 100 failures and the latest are listed, and the number of others.
    assert_eq!(report.warnings.len(), 102);
    let more = "149 more failures of this node are counted and not listed";
    assert!(report.warnings.iter().any(|warning| warning.message == more), "{:?}", report.warnings.last());
}

#[test]
fn a_hundred_warnings_of_a_node_are_listed_and_the_rest_counted() {
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&[99.0; 250]))
        .node("first", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .result("x", "first.out", false, false)
        .plan();
    let (_dir, report) = run_plan(&plan, Vec::new());
    assert_eq!(report.warnings.len(), 101);
    assert_eq!(report.warnings[100].message, "150 more warnings of this node are counted and not listed");
}

#[test]
fn a_bundle_that_cannot_be_written_is_a_warning_and_hides_nothing() {
    let plan = PlanBuilder::new()
        .script("scan", 1, calls(&[13.0]))
        .node("first", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .result("x", "first.out", false, false)
        .plan();
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("repro"), "a file where the folder would be").unwrap();
    let options = RunOptions { out_dir: Some(dir.path().into()), ..RunOptions::default() };
    let report = run(&plan, &registry(), &options, &()).unwrap();
    assert!(matches!(&report.outcome, Outcome::Refused(r) if r.reason == "13 is not a number to add to"));
    assert!(report.warnings[0].message.starts_with("its item could not be saved as a repro bundle: "));
    assert_eq!(report.saved.bundles, []);
}

#[test]
fn another_program_is_detected_and_a_moved_line_is_the_same_failure() {
    let failure = |reason: &str| Failure { reason: reason.into(), panicked: true };
    let then = failure("panicked at a/src/b.rs:10: no");
    assert!(failure("panicked at a/src/b.rs:12: no").is(&then, false));
    assert!(!failure("panicked at a/src/b.rs:12: no").is(&then, true));
    assert!(!failure("panicked at a/src/c.rs:10: no").is(&then, false));
    assert!(!failure("panicked at a/src/b.rs:10: yes").is(&then, false));
    let program = |avx: bool| Program {
        engine_version: "1".into(),
        sha256: None,
        command: json!({ "cpu_features": if avx { vec!["avx"] } else { vec![] } }),
    };
    let differences = |now| program(true).provenance(None).differences(&program(now).provenance(None), ["A", "B"]);
    assert_eq!(differences(true), Vec::<String>::new());
    assert_eq!(differences(false), ["program, cpu_features: A avx, B no more"]);
}
