use super::*;
use crate::{
    plan::{OnError, Policy},
    recording::codec,
    run::{Outcome, run},
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::Join;
use osteoflow_toy::registry;
use serde_json::{Value as Json, json};
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

fn options(workers: usize) -> RunOptions {
    RunOptions { workers, fixed_results: vec![("notice".into(), json!("toy"))], ..RunOptions::default() }
}

/// Numbers on two ports, with an empty among them.
fn calls(factor: f64) -> Json {
    let call = |i: i64| match i {
        3 => json!({ "stamp_ns": 30, "give": [[0, null], [1, 3.5]] }),
        _ => json!({ "stamp_ns": 10 * i, "give": [[0, factor * i as f64], [1, -factor * i as f64]] }),
    };
    (1..12).map(call).collect()
}

/// Settings of a variant of the toy graph.
#[derive(Clone)]
struct Variant {
    factor: f64,
    noise: bool,
    kept: &'static str,
    rewired: bool,
    join: Join,
    sum: &'static str,
    late: bool,
    extra: bool,
    without_side: bool,
}

const BASE: Variant = Variant {
    factor: 1.0,
    noise: false,
    kept: "toy.kept",
    rewired: false,
    join: Join::Latest,
    sum: "toy.some",
    late: false,
    extra: false,
    without_side: false,
};

impl Variant {
    fn plan(&self) -> Plan {
        let mut toy = PlanBuilder::new()
            .script("scan", 2, calls(self.factor))
            .node("first", "toy.add", json!({ "noise": self.noise }), &[("a", "scan.p0", None)])
            .node("kept", self.kept, json!({}), &[("a", "first.out", None), ("b", "scan.p1", Some(self.join))]);
        if !self.without_side {
            toy = toy.node("side", "toy.add", json!({ "noise": true }), &[("a", "scan.p1", None)]);
        }
        let from = if self.rewired { "kept.out" } else { "kept.positive" };
        toy = toy.node("sum", self.sum, json!({}), &[("all", from, Some(Join::Collect { n: Some(2) }))]).node(
            "last",
            "toy.add",
            json!({ "noise": self.late }),
            &[("a", "sum.out", None)],
        );
        if self.extra {
            toy = toy.node("extra", "toy.add", json!({ "noise": true }), &[("a", "first.out", None)]);
            toy = toy.result("extra", "extra.out", true, true);
        }
        toy.result("last", "last.out", false, false).result("all.kept", "kept.positive", true, true).plan()
    }
}

/// Each differs from the base in one thing that a user may edit.
fn variants() -> Vec<Variant> {
    vec![
        BASE,
        Variant { factor: 2.0, ..BASE },
        Variant { noise: true, ..BASE },
        Variant { kept: "toy.kept_with_seed", ..BASE },
        Variant { rewired: true, ..BASE },
        Variant { join: Join::Interpolate { max_gap_ns: None }, ..BASE },
        Variant { sum: "toy.sum", ..BASE },
        Variant { late: true, ..BASE },
        Variant { extra: true, ..BASE },
        Variant { without_side: true, ..BASE },
    ]
}

/// Every item of every wire, encoded.
fn wires(session: &Session) -> BTreeMap<String, Vec<Vec<u8>>> {
    let memory = session.memory.as_ref().unwrap();
    let ids = (0..memory.plan.nodes.len()).flat_map(|node| memory.plan.outputs(node));
    let items =
        |id: crate::plan::OutputId| memory.left[id.node].outputs[id.port].items.iter().map(codec::encode).collect();
    ids.map(|id| (memory.plan.wire_name(id), items(id))).collect()
}

fn rerun(session: &mut Session, plan: &Plan, workers: usize) -> (RunReport, Vec<String>) {
    let next = session.next(plan.clone());
    let computed = next.computed().iter().map(ToString::to_string).collect();
    (session.run(next, &registry(), &options(workers), &()).unwrap(), computed)
}

/// Reruns the plan, compares the outcome with a run of the whole, and returns the computed nodes.
fn check(session: &mut Session, plan: &Plan, workers: usize) -> Vec<String> {
    let (report, computed) = rerun(session, plan, workers);
    let whole = run(plan, &registry(), &options(workers), &()).unwrap();
    assert_eq!(report.results, whole.results, "{computed:?}");
    assert_eq!(report.outcome, whole.outcome);
    let figures = |report: &RunReport| {
        let nodes: Vec<_> = report.nodes.iter().map(|n| (n.name.clone(), n.items, n.skipped, n.failed)).collect();
        let links: Vec<_> = report.links.iter().map(|l| (l.from.clone(), l.to.clone(), l.sent, l.received)).collect();
        (nodes, links, report.warnings.clone())
    };
    assert_eq!(figures(&report), figures(&whole));
    let mut fresh = Session::default();
    rerun(&mut fresh, plan, 1);
    assert_eq!(wires(session), wires(&fresh), "{computed:?}");
    computed
}

#[test]
fn a_rerun_after_any_edit_equals_a_full_run_bit_for_bit() {
    for workers in [1, 2, 8] {
        let mut session = Session::default();
        // From each variant to each, so that nodes are added and removed, and items kept over two runs are played.
        for before in variants() {
            for after in variants() {
                check(&mut session, &before.plan(), workers);
                check(&mut session, &after.plan(), workers);
            }
        }
    }
}

/// Numbers that are judged, with a list that is withheld if they are refused, and one that is not.
fn judged(refused_above: f64, trusted: bool) -> Plan {
    let plan = PlanBuilder::new()
        .script("scan", 2, calls(1.0))
        .node("fit", "toy.add", json!({}), &[("a", "scan.p1", None)])
        .node(
            "judge",
            "toy.judge",
            json!({ "doubtful_above": -20.0, "refused_above": refused_above }),
            &[("number", "fit.out", None)],
        )
        .result("verdict", "judge.verdict", false, false)
        .result("fit", "fit.out", true, false)
        .result("size", "judge.remark", true, false);
    let plan = if trusted { plan.require_trusted() } else { plan }.plan();
    Plan { resolved: format!("require = {trusted}"), ..plan }
}

#[test]
fn a_rerun_has_the_verdict_of_a_full_run() {
    let mut session = Session::default();
    for (plan, status, computed) in [
        (judged(0.0, false), "complete", 3),
        (judged(-15.0, false), "refused", 1),
        (judged(0.0, false), "complete", 1),
        (judged(0.0, true), "refused", 0),
        (judged(0.0, false), "complete", 0),
    ] {
        assert_eq!(check(&mut session, &plan, 2).len(), computed);
        let whole = run(&plan, &registry(), &options(1), &()).unwrap();
        assert_eq!(whole.outcome.status(), status, "{}", whole.results);
        assert_eq!(whole.results.get("fit").is_some(), status == "complete");
    }
}

#[test]
fn only_changed_nodes_and_those_downstream_are_computed() {
    let mut session = Session::default();
    let mut to = |variant: &Variant| {
        check(&mut session, &BASE.plan(), 2);
        check(&mut session, &variant.plan(), 2)
    };
    let all = ["scan", "first", "kept", "side", "sum", "last"];
    let expected: [&[&str]; 9] = [
        &all,
        &["first", "kept", "sum", "last"],
        &["kept", "sum", "last"],
        &["sum", "last"],
        &["kept", "sum", "last"],
        &["sum", "last"],
        &["last"],
        &["extra"],
        &[],
    ];
    for (variant, expected) in variants().iter().skip(1).zip(expected) {
        assert_eq!(to(variant), expected);
    }
    assert_eq!(session.next(BASE.plan()).computed(), ["side"], "what was gone comes back");
}

#[test]
fn changes_are_described_by_the_keys_of_the_graph_file() {
    let mut session = Session::default();
    rerun(&mut session, &BASE.plan(), 1);
    let describe = |plan: Plan| {
        let next = session.next(plan);
        let changes = next.changes.iter().map(|change| format!("{}: {}", change.node, change.why.join(", ")));
        (changes.collect::<Vec<_>>(), next.removed.to_vec())
    };
    let changed = |variant: Variant| describe(variant.plan()).0;
    assert_eq!(changed(Variant { late: true, ..BASE }), ["last: noise false -> true"]);
    assert_eq!(changed(Variant { kept: "toy.kept_with_seed", ..BASE }), ["kept: kind toy.kept -> toy.kept_with_seed"]);
    assert_eq!(changed(Variant { rewired: true, ..BASE }), ["sum: in.all kept.positive -> kept.out"]);
    assert_eq!(changed(Variant { join: Join::Interpolate { max_gap_ns: None }, ..BASE }), ["kept: in.b"]);
    assert_eq!(changed(Variant { extra: true, ..BASE }), ["extra: new"]);
    assert_eq!(describe(Variant { without_side: true, ..BASE }.plan()), (vec![], vec!["side".to_owned()]));
    assert_eq!(describe(Plan { seed: 8, ..BASE.plan() }).0, ["graph: seed 7 -> 8"]);
    assert!(session.next(Plan { seed: 8, ..BASE.plan() }).is_whole());
}

#[test]
fn a_change_of_library_error_rule_or_lossy_wire_changes_the_node() {
    let mut session = Session::default();
    rerun(&mut session, &BASE.plan(), 1);
    let first = |change: &dyn Fn(&mut Plan)| {
        let mut plan = BASE.plan();
        change(&mut plan);
        session.next(plan).changes.iter().map(|change| change.node.clone()).collect::<Vec<_>>()
    };
    assert_eq!(first(&|plan| plan.nodes[2].plugin = Some("0123".into())), ["kept"]);
    assert_eq!(first(&|plan| plan.nodes[2].on_error = OnError::Skip), ["kept"]);
    assert_eq!(first(&|plan| plan.links[0].policy = Policy::Sample(2)), ["first"]);
    assert_eq!(first(&|plan| plan.links[0].capacity = 9), [""; 0]);
}

#[test]
fn a_change_of_the_text_alone_leaves_nothing_to_compute() {
    let mut session = Session::default();
    rerun(&mut session, &BASE.plan(), 1);
    let mut plan = BASE.plan();
    plan.nodes[1].location.line = 99;
    assert!(session.next(plan).is_unchanged);
}

#[test]
fn other_results_of_unchanged_nodes_need_no_computation() {
    let mut session = Session::default();
    let plan = BASE.plan();
    rerun(&mut session, &plan, 1);
    let mut more = BASE.plan();
    more.results[0].all = true;
    more.resolved.push_str("[results]\n");
    for workers in [1, 8] {
        assert_eq!(check(&mut session, &more, workers), [""; 0]);
        assert_eq!(check(&mut session, &plan, workers), [""; 0]);
    }
}

#[test]
fn a_node_whose_file_has_changed_is_computed_again() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("bone.stl");
    std::fs::write(&file, "a").unwrap();
    let mut plan = BASE.plan();
    plan.nodes[2].files.push(file.clone());
    plan.input_files.push(file.clone());
    let mut session = Session::default();
    rerun(&mut session, &plan, 1);
    assert!(session.next(plan.clone()).is_unchanged);
    std::fs::write(&file, "ab").unwrap();
    let next = session.next(plan.clone());
    assert_eq!(next.computed(), ["kept", "sum", "last"]);
    assert_eq!(next.changes[0].why, [format!("{} has changed", file.display())]);
    check(&mut session, &plan, 2);
    std::fs::remove_file(&file).unwrap();
    assert_eq!(session.next(plan).changes[0].node, "kept");
}

#[test]
fn a_failed_node_is_computed_again_and_fails_in_the_same_way() {
    let mut session = Session::default();
    let fails = Variant { factor: 13.0, ..BASE };
    for workers in [1, 2] {
        check(&mut session, &BASE.plan(), workers);
        check(&mut session, &fails.plan(), workers);
        assert!(matches!(run(&fails.plan(), &registry(), &options(1), &()).unwrap().outcome, Outcome::Refused(_)));
        let next = session.next(fails.plan());
        assert_eq!(
            next.changes[0],
            Change { node: "first".into(), why: vec!["did not come to its end before".into()] }
        );
        assert_eq!(check(&mut session, &fails.plan(), workers), ["first", "kept", "sum", "last"]);
        check(&mut session, &Variant { late: true, ..fails.clone() }.plan(), workers);
    }
}

#[test]
fn interrupted_nodes_are_computed_again() {
    let mut session = Session::default();
    check(&mut session, &BASE.plan(), 1);
    let next = session.next(Variant { factor: 2.0, ..BASE }.plan());
    let cancelled = RunOptions { cancelled: Arc::new(AtomicBool::new(true)), ..options(1) };
    let report = session.run(next, &registry(), &cancelled, &()).unwrap();
    assert_eq!(report.outcome, Outcome::Interrupted);
    assert_eq!(check(&mut session, &Variant { factor: 2.0, ..BASE }.plan(), 1).len(), 6);
}

#[test]
fn a_node_that_cannot_be_built_leaves_the_session_unchanged() {
    let mut session = Session::default();
    check(&mut session, &BASE.plan(), 1);
    let mut bad = BASE.plan();
    bad.nodes[5].params = json!({ "bad": true });
    let next = session.next(bad);
    assert!(matches!(session.run(next, &registry(), &options(1), &()), Err(RunError::Build(_))));
    assert!(session.next(BASE.plan()).is_unchanged);
    assert_eq!(check(&mut session, &Variant { late: true, ..BASE }.plan(), 1), ["last"]);
}

#[test]
fn a_rerun_writes_results_and_a_manifest_that_lists_the_kept_nodes() {
    let dir = tempfile::tempdir().unwrap();
    let mut session = Session::default();
    let mut run_into = |name: &str, plan: Plan| {
        let next = session.next(plan);
        let options = RunOptions { out_dir: Some(dir.path().join(name)), record: true, latency: true, ..options(2) };
        session.run(next, &registry(), &options, &()).unwrap();
        let text = std::fs::read_to_string(dir.path().join(name).join("manifest.json")).unwrap();
        serde_json::from_str::<Json>(&text).unwrap()
    };
    let first = run_into("a", BASE.plan());
    assert!(first.get("watch").is_none() && dir.path().join("a/run.mcap").exists());
    let second = run_into("b", Variant { late: true, ..BASE }.plan());
    let describe = &second["watch"];
    assert_eq!(describe["computed"], json!(["last"]));
    assert_eq!(describe["kept"], json!(["scan", "first", "kept", "side", "sum"]));
    assert_eq!(describe["after"], dir.path().join("a").display().to_string());
    assert!(dir.path().join("b/results.json").exists() && !dir.path().join("b/run.mcap").exists());
    let third = run_into("c", Plan { seed: 9, ..BASE.plan() });
    assert_eq!(third["watch"]["kept"], json!([]));
    assert!(dir.path().join("c/run.mcap").exists(), "a run of the whole graph is recorded");
}

#[test]
fn a_change_is_seen_once_the_file_is_stable() {
    let dir = tempfile::tempdir().unwrap();
    let (file, other) = (dir.path().join("graph.toml"), dir.path().join("base.toml"));
    std::fs::write(&file, "a").unwrap();
    let cancelled = AtomicBool::new(false);
    for change in ["write", "replace", "appears", "vanishes"] {
        let before = Stamps::of([file.clone(), other.clone()]);
        match change {
            "write" => std::fs::write(&file, "ab").unwrap(),
            "replace" => {
                std::fs::write(dir.path().join("new"), "ab").unwrap();
                std::fs::rename(dir.path().join("new"), &file).unwrap();
            }
            "appears" => std::fs::write(&other, "").unwrap(),
            _ => std::fs::remove_file(&other).unwrap(),
        }
        assert!(before.wait(&|| cancelled.load(Ordering::Relaxed)).is_some(), "{change}");
    }
    cancelled.store(true, Ordering::Relaxed);
    assert!(Stamps::of([file]).wait(&|| cancelled.load(Ordering::Relaxed)).is_none());
}

#[test]
fn the_files_of_a_graph_include_extended_files_and_modules_even_if_missing() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    let texts = || {
        let texts = crate::check::files(&dir.path().join("graph.toml"), &[], &registry());
        texts.iter().map(|path| path.file_name().unwrap().to_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(texts(), ["graph.toml"]);
    write("graph.toml", "extends = \"base.toml\"\n[node.m]\nkind = \"module\"\nfile = \"m.toml\"\n");
    assert_eq!(texts(), ["graph.toml", "base.toml", "m.toml"]);
    write("base.toml", "extends = \"deeper.toml\"\n");
    write("m.toml", "extends = \"under.toml\"\n[module]\n[node.n]\nkind = \"module\"\nfile = \"n.toml\"\n");
    assert_eq!(texts(), ["graph.toml", "base.toml", "deeper.toml", "m.toml", "under.toml", "n.toml"]);
}
