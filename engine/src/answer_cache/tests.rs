use super::*;
use crate::{
    options::RunOptions,
    plan::OutputId,
    replay::{ReplayOptions, replay_plan},
    run::{Outcome, RunReport, run_with},
    runtime::{Injected, Injection, Replayed, Tap},
    store::Settings,
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::{StampNs, Value};
use osteoflow_toy::{Number, n_fired, registry};
use proptest::prelude::*;
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;

/// Encoded items of the recorded wires.
#[derive(Default)]
struct Wires(Mutex<BTreeMap<OutputId, Vec<Vec<u8>>>>);

impl Tap for Wires {
    fn listens(&self, _: OutputId) -> bool {
        true
    }

    fn item(&self, wire: OutputId, item: &Item) {
        self.0.lock().unwrap().entry(wire).or_default().push(codec::encode(item));
    }
}

fn store() -> (Arc<Store>, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    (Arc::new(Store::open(Settings::in_dir(dir.path()))), dir)
}

/// A plan in which `node` of this kind receives `numbers`, one at each stamp from `first_ns` on.
fn plan(kind: &str, params: Json, numbers: &[f64], first_ns: StampNs) -> Plan {
    let calls = numbers.iter().zip(first_ns..);
    let calls: Json = calls.map(|(x, stamp_ns)| json!({ "stamp_ns": stamp_ns, "give": [[0, x]] })).collect();
    PlanBuilder::new()
        .script("scan", 1, calls)
        .node("node", kind, params, &[("a", "scan.p0", None)])
        .record(&["scan.p0", "node.out", "node.positive"])
        .result("doubles", "node.out", true, false)
        .result("positive", "node.positive", true, true)
        .plan()
}

fn run_plan(plan: &Plan, options: &RunOptions) -> (RunReport, BTreeMap<OutputId, Vec<Vec<u8>>>) {
    let wires = Wires::default();
    let report = run_with(plan, &registry(), options, &(), Replayed::default(), Some(&wires)).unwrap();
    (report, wires.0.into_inner().unwrap())
}

fn options(store: &Arc<Store>, workers: usize) -> RunOptions {
    RunOptions { workers, store: Some(store.clone()), ..RunOptions::default() }
}

/// Numbers of firings in two runs with one store: of the first plan, then of the second.
fn firings(counter: &str, first: &Plan, second: &Plan) -> (u64, u64) {
    let (store, _dir) = store();
    run_plan(first, &options(&store, 1));
    let after_first = n_fired(counter);
    run_plan(second, &options(&store, 1));
    (after_first, n_fired(counter) - after_first)
}

#[test]
fn a_warm_run_gives_the_same_wires_results_and_warnings_without_a_firing() {
    let (store, _dir) = store();
    let plan = plan("toy.kept", json!({ "counter": "warm" }), &[3.0, 99.0, -1.0, 3.0], 100);
    let (computed, wires) = run_plan(&plan, &RunOptions::default());
    assert_eq!((computed.warnings.len(), n_fired("warm")), (1, 4));
    let (cold, cold_wires) = run_plan(&plan, &options(&store, 1));
    // The last item equals the first.
    assert_eq!(n_fired("warm"), 7);
    assert_eq!(cold.cached_answers.iter().map(|r| (r.node.as_str(), r.item)).collect::<Vec<_>>(), [("node", 3)]);
    for workers in [1, 2, 8] {
        let (warm, warm_wires) = run_plan(&plan, &options(&store, workers));
        assert_eq!(n_fired("warm"), 7, "a kept answer was computed on {workers} workers");
        assert_eq!(warm.cached_answers.len(), 4);
        for (report, wires_now) in [(&cold, &cold_wires), (&warm, &warm_wires)] {
            assert_eq!(report.results, computed.results);
            assert_eq!(report.warnings, computed.warnings);
            assert_eq!(*wires_now, wires);
            let items = |report: &RunReport| report.nodes.iter().map(|n| (n.items, n.failed)).collect::<Vec<_>>();
            assert_eq!(items(report), items(&computed));
        }
    }
}

#[test]
fn errors_and_panics_are_not_cached() {
    for (number, reason) in [(13.0, "13 is not a number to double"), (666.0, "the beast")] {
        let (store, dir) = store();
        let counter = format!("fails at {number}");
        let plan = plan("toy.kept", json!({ "counter": counter }), &[number], 0);
        for n in 1..=2 {
            let (report, _) = run_plan(&plan, &options(&store, 1));
            let Outcome::Refused(refusal) = report.outcome else { panic!("{number} was doubled") };
            assert!(refusal.reason.contains(reason), "{}", refusal.reason);
            assert_eq!(n_fired(&counter), n);
        }
        let kept = std::fs::read_dir(dir.path()).unwrap().map(|file| file.unwrap().file_name());
        let kept: Vec<_> = kept.filter(|name| name.to_string_lossy().starts_with("answer")).collect();
        assert!(kept.is_empty(), "{kept:?}");
    }
}

#[test]
fn an_answer_depends_on_inputs_and_parameters_not_on_stamps_and_seed() {
    let of = |counter: &str, kind: &str, params: Json, numbers: &[f64], first_ns, seed| {
        let mut all = json!({ "counter": counter });
        all.as_object_mut().unwrap().extend(params.as_object().unwrap().clone());
        Plan { seed, ..plan(kind, all, numbers, first_ns) }
    };
    let kept = |counter, params, x, first_ns, seed| of(counter, "toy.kept", params, &[x], first_ns, seed);
    let none = || json!({});
    let first = |counter| kept(counter, none(), 1.0, 0, 7);
    assert_eq!(firings("same", &first("same"), &kept("same", none(), 1.0, 50, 8)), (1, 0));
    assert_eq!(firings("input", &first("input"), &kept("input", none(), 1.5, 0, 7)), (1, 1));
    assert_eq!(firings("param", &first("param"), &kept("param", json!({ "takes": "-" }), 1.0, 0, 7)), (1, 1));
    let other = of("kind", "toy.kept_with_seed", none(), &[1.0], 0, 7);
    assert_eq!(firings("kind", &first("kind"), &other), (1, 1));

    let drawn = |counter, numbers: &[f64], seed| {
        of(counter, "toy.kept_with_seed", json!({ "takes": "draws" }), numbers, 0, seed)
    };
    assert_eq!(firings("drawn", &drawn("drawn", &[1.0], 7), &drawn("drawn", &[1.0], 7)), (1, 0));
    assert_eq!(firings("seed", &drawn("seed", &[1.0], 7), &drawn("seed", &[1.0], 8)), (1, 1));
    assert_eq!(firings("item", &drawn("item", &[1.0, 1.0], 7), &drawn("item", &[1.0, 1.0], 7)), (2, 0));
    let mut renamed = drawn("name", &[1.0], 7);
    renamed.nodes[1].name = "other".into();
    assert_eq!(firings("name", &drawn("name", &[1.0], 7), &renamed), (1, 1));
}

#[test]
fn an_optional_port_that_is_wired_later_gives_another_answer() {
    let wired = |with_b: bool| {
        let inputs = [("a", "scan.p0", None), ("b", "scan.p1", None)];
        let both = json!([{ "stamp_ns": 0, "give": [[0, 1.0], [1, 2.0]] }]);
        let toy = PlanBuilder::new().script("scan", 2, both);
        let n = if with_b { 2 } else { 1 };
        toy.node("node", "toy.kept", json!({ "counter": "optional" }), &inputs[..n]).plan()
    };
    assert_eq!(firings("optional", &wired(false), &wired(true)), (1, 1));
}

#[test]
fn an_answer_that_depends_on_more_than_its_kind_declares_is_not_cached() {
    for (kind, takes, is_kept) in [
        ("toy.kept", "draws", false),
        ("toy.kept", "stamp", false),
        ("toy.kept", "clock", false),
        ("toy.kept_with_seed", "draws", true),
        ("toy.kept_with_seed", "stamp", false),
        ("toy.kept_with_seed", "clock", false),
    ] {
        let (store, _dir) = store();
        let counter = format!("{kind} takes {takes}");
        let plan = plan(kind, json!({ "counter": counter, "takes": takes }), &[1.0], 5);
        let (report, _) = run_plan(&plan, &options(&store, 1));
        let warned = report.warnings.iter().any(|w| w.message.contains("this answer is not kept"));
        assert_eq!(warned, !is_kept, "{counter}: {:?}", report.warnings);
        run_plan(&plan, &options(&store, 1));
        assert_eq!(n_fired(&counter), if is_kept { 1 } else { 2 }, "{counter}");
    }
}

#[test]
fn a_damaged_answer_is_computed_again_and_replaced() {
    let (store, dir) = store();
    let plan = plan("toy.kept", json!({ "counter": "damaged" }), &[4.0], 0);
    let (cold, _) = run_plan(&plan, &options(&store, 1));
    for file in std::fs::read_dir(dir.path()).unwrap() {
        let path = file.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(path, bytes).unwrap();
    }
    let (again, _) = run_plan(&plan, &options(&store, 1));
    assert_eq!((n_fired("damaged"), &again.results, again.warnings.len()), (2, &cold.results, 0));
    run_plan(&plan, &options(&store, 1));
    assert_eq!(n_fired("damaged"), 2);
}

#[test]
fn a_store_that_cannot_be_written_is_one_warning_and_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("file"), "").unwrap();
    let store = Arc::new(Store::open(Settings::in_dir(dir.path().join("file"))));
    let plan = plan("toy.kept", json!({ "counter": "unwritable" }), &[1.0, 2.0, 3.0], 0);
    let (report, _) = run_plan(&plan, &options(&store, 2));
    assert_eq!(report.outcome, Outcome::Complete);
    let messages: Vec<_> = report.warnings.iter().map(|w| w.message.as_str()).collect();
    assert!(matches!(messages[..], [one] if one.contains("nothing can be kept in the store")), "{messages:?}");
    assert_eq!(report.results, run_plan(&plan, &RunOptions::default()).0.results);
}

#[test]
fn a_node_with_an_injected_failure_fires_although_its_answer_is_cached() {
    let (store, _dir) = store();
    let plan = plan("toy.kept", json!({ "counter": "injected" }), &[1.0], 0);
    run_plan(&plan, &options(&store, 1));
    let inject = vec![Injection { node: "node".into(), item: 0, how: Injected::Error }];
    let (report, _) = run_plan(&plan, &RunOptions { inject, ..options(&store, 1) });
    assert!(matches!(report.outcome, Outcome::Refused(_)), "{:?}", report.outcome);
}

#[test]
fn a_replay_recomputes_cached_answers() {
    let (store, dir) = (store(), tempfile::tempdir().unwrap());
    let plan = plan("toy.kept", json!({ "counter": "replayed" }), &[1.0, 2.0], 0);
    run_plan(&plan, &options(&store.0, 1));
    let recorded = RunOptions { out_dir: Some(dir.path().into()), record: true, ..options(&store.0, 1) };
    let (report, _) = run_plan(&plan, &recorded);
    assert_eq!((report.cached_answers.len(), n_fired("replayed")), (2, 2));
    let manifest: Json = serde_json::from_slice(&std::fs::read(dir.path().join("manifest.json")).unwrap()).unwrap();
    assert_eq!(manifest["store"]["recalled"][1]["item"], 1);
    let recording = crate::Recording::open(&dir.path().join("run.mcap")).unwrap();
    let changes = ReplayOptions::default();
    let replayed = replay_plan(&plan, &recording, &changes, &registry(), &options(&store.0, 1), &()).unwrap();
    assert!(replayed.is_equal());
    assert_eq!((replayed.run.cached_answers.len(), n_fired("replayed")), (0, 4));
}

#[test]
fn an_answer_round_trips_and_other_bytes_give_none() {
    let (store, _dir) = store();
    let (plan, registry) = (plan("toy.kept", json!({}), &[1.0], 0), registry());
    let cache = StoredAnswers::new(&plan, &registry, &options(&store, 1)).unwrap();
    let key = Key::of("answer").done();
    let entry = |bytes: &[&[u8]]| {
        store.put(&key, bytes).unwrap();
        store.get(&key).unwrap()
    };
    let out = [Emission::Value(Value::new(Number(1.5))), Emission::Empty("it is µ".into())];
    let parts = encode(&out, &["one".into(), String::new()], "node").unwrap();
    let bytes: Vec<u8> = parts.iter().flat_map(Segments::slices).flatten().copied().collect();
    let (emissions, warnings) = cache.read(1, &entry(&[&bytes])).unwrap();
    assert_eq!(warnings, ["one", ""]);
    assert!(matches!(&emissions[0], Emission::Value(v) if v.get() == Some(&Number(1.5))));
    assert!(matches!(&emissions[1], Emission::Empty(reason) if reason == "it is µ"));
    assert!(encode(&[Emission::Silent], &[], "node").is_none());
    // A node with one output does not accept the answer.
    assert!(cache.read(0, &entry(&[&bytes])).is_none());
    proptest!(|(at in 0usize..400, byte: u8, cut in 0usize..400)| {
        let cut = cut % bytes.len();
        prop_assert!(cache.read(1, &entry(&[&bytes[..cut]])).is_none(), "{} bytes are an answer", cut);
        let mut changed = bytes.clone();
        changed[at % bytes.len()] = byte;
        let _ = cache.read(1, &entry(&[&changed]));
    });
}
