use super::*;
use crate::{
    partial::{FinishedNode, PartialRun},
    plan::Plan,
    recording::Recording,
    replay::{ReplayOptions, ReplayReport, replay_plan},
    store::{Settings, Store},
    tests::plan_builder::PlanBuilder,
};
use osteoflow_node::{Context, Describe, Function, Inputs, Join, NodeError, OutputPorts, Outputs};
use osteoflow_toy::{NoParams, Number, n_fired};
use serde_json::{Value as Json, json};
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

/// Takes a number.
#[derive(Describe)]
struct Sink;

#[derive(Inputs)]
struct SinkIn {
    /// The first.
    a: Number,
    /// The second.
    b: Option<Number>,
}

/// Takes a number, if there is one.
#[derive(Describe)]
struct PerhapsSink;

#[derive(Inputs)]
struct PerhapsIn {
    /// The first.
    a: Option<Number>,
    /// The second.
    #[port(join = "once")]
    b: Option<Number>,
}

#[derive(Outputs)]
struct NoOutputs {}

impl Function for Sink {
    const KIND: &'static str = "test.sink";
    type Params = NoParams;
    type Inputs = SinkIn;
    type Outputs = NoOutputs;

    fn process(_: &NoParams, i: SinkIn, _: &mut Context) -> Result<NoOutputs, NodeError> {
        assert!(i.a.0.is_finite() && i.b.is_none_or(|b| b.0.is_finite()));
        Ok(NoOutputs {})
    }
}

impl Function for PerhapsSink {
    const KIND: &'static str = "test.perhaps_sink";
    type Params = NoParams;
    type Inputs = PerhapsIn;
    type Outputs = NoOutputs;

    fn process(_: &NoParams, i: PerhapsIn, _: &mut Context) -> Result<NoOutputs, NodeError> {
        assert!(i.a.is_none_or(|a| a.0.is_finite()) && i.b.is_none_or(|b| b.0.is_finite()));
        Ok(NoOutputs {})
    }
}

fn registry() -> Registry {
    let mut registry = osteoflow_toy::registry();
    registry.function::<Sink>().function::<PerhapsSink>();
    registry
}

/// Makes the last node, a `toy.add`, one of another kind with the same input names.
fn last_as(mut plan: Plan, kind: &str) -> Plan {
    let registry = registry();
    let description = &registry.kind(kind).unwrap().description;
    assert!(matches!(&description.outputs, OutputPorts::Fixed(ports) if ports.is_empty()));
    let node = plan.nodes.last_mut().unwrap();
    node.kind = kind.into();
    node.outputs.clear();
    for (input, port) in node.inputs.iter_mut().zip(&description.inputs) {
        let join = if input.port.join == Join::Each { port.join } else { input.port.join };
        input.port = osteoflow_node::InputPort { join, ..port.clone() };
    }
    plan
}

/// Runs the plan on several numbers of workers, which must agree.
fn report(plan: &Plan) -> RunReport {
    let of = |workers| run(plan, &registry(), &RunOptions { workers, ..RunOptions::default() }, &()).unwrap();
    let first = of(1);
    for workers in [2, 8] {
        let other = of(workers);
        assert_eq!((&other.results, &other.warnings), (&first.results, &first.warnings), "{workers} workers");
        assert_eq!(other.outcome, first.outcome);
    }
    first
}

/// Node, rule, reason, item and number of each reason.
fn reasons(results: &Json) -> Vec<(String, String, String, u64, u64)> {
    let text = |reason: &Json, key: &str| reason[key].as_str().unwrap().to_owned();
    let number = |reason: &Json, key: &str| reason[key].as_u64().unwrap();
    let all = results.get("reasons").and_then(Json::as_array).into_iter().flatten();
    all.map(|r| (text(r, "node"), text(r, "rule"), text(r, "reason"), number(r, "item"), number(r, "n"))).collect()
}

fn short(results: &Json) -> Vec<String> {
    reasons(results)
        .into_iter()
        .map(|(node, rule, reason, item, n)| format!("{node} {rule} {item} x{n}: {reason}"))
        .collect()
}

/// A source with a sign, and two nodes that find negative numbers; `last` comes before `first` in time.
fn signing(numbers: &[f64], sign: bool) -> PlanBuilder {
    let call = |(x, stamp_ns): (&f64, i64)| json!({ "stamp_ns": stamp_ns, "give": [[0, x]], "sign": sign.then_some("the stamps are in ms") });
    PlanBuilder::new()
        .script("scan", 1, numbers.iter().zip(10..).map(call).collect())
        .node("first", "toy.add", json!({ "sleep_us": 300 }), &[("a", "scan.p0", None)])
        .node("last", "toy.kept", json!({ "counter": "signs" }), &[("a", "scan.p0", None)])
        .record(&["scan.p0", "first.out", "last.out"])
        .result("all", "first.out", true, false)
        .result("doubles", "last.out", true, false)
}

const EXPECTED: [&str; 5] = [
    "scan script_wrong 0 x4: the stamps are in ms",
    "first number_negative 1 x2: -2 is below -1",
    "first number_negative 2 x1: -3 is below -1",
    "last number_negative 1 x2: -2 is below -1",
    "last number_negative 2 x1: -3 is below -1",
];

#[test]
fn signs_are_listed_by_node_and_item_each_once_on_any_number_of_workers() {
    let report = report(&signing(&[1.0, -2.0, -3.0, -2.0], true).plan());
    assert_eq!(short(&report.results), EXPECTED);
    assert_eq!(report.results.as_object().unwrap().keys().next_back().unwrap(), "reasons");
    let warnings: Vec<_> = report.warnings.iter().filter(|w| w.node == "last").map(|w| w.message.as_str()).collect();
    assert_eq!(
        warnings,
        ["-2 is below -1 [number_negative]", "-3 is below -1 [number_negative]", "-2 is below -1 [number_negative]"]
    );
}

#[test]
fn results_without_a_sign_have_no_reasons() {
    // 99 is a warning that names no rule.
    let report = report(&signing(&[1.0, 99.0], false).plan());
    assert_eq!(report.warnings.len(), 2);
    assert_eq!(report.results, json!({ "all": [1.0, 99.0], "doubles": [2.0, 198.0] }));
}

#[test]
fn a_node_that_warns_often_hides_no_sign() {
    let numbers: Vec<f64> = (0..300).map(|k| if k < 299 { 99.0 } else { -2.0 }).collect();
    let report = report(&signing(&numbers, false).plan());
    assert_eq!(
        short(&report.results),
        ["first number_negative 299 x1: -2 is below -1", "last number_negative 299 x1: -2 is below -1"]
    );
}

/// Stops the run at its first warning.
struct StopAtWarning(Arc<AtomicBool>);

impl Observer for StopAtWarning {
    fn event(&self, event: &Event<'_>) {
        if let Event::Warned(_) = event {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn runs_that_fail_or_are_stopped_list_the_signs_too() {
    let failed = report(&signing(&[-2.0, 13.0, 1.0], true).plan());
    assert!(matches!(failed.outcome, Outcome::Refused(_)) && failed.results["refused"].is_object());
    assert_eq!(short(&failed.results)[1], "first number_negative 0 x1: -2 is below -1");

    let calls = json!([{ "stamp_ns": 1, "give": [[0, 1.0]], "sign": "odd" }, { "stamp_ns": 2, "give": [[0, 1.0]], "device": "waits for the stop" }]);
    let plan = PlanBuilder::new().source("scan", "toy.live", 1, json!({ "calls": calls })).plan();
    let options = RunOptions { workers: 2, ..RunOptions::default() };
    let stopped = run(&plan, &registry(), &options, &StopAtWarning(options.cancelled.clone())).unwrap();
    assert_eq!(stopped.outcome, Outcome::Interrupted);
    assert_eq!(short(&stopped.results), ["scan script_wrong 0 x1: odd"]);
}

fn recorded(plan: &Plan, dir: &Path) -> (RunReport, Recording) {
    let options = RunOptions { workers: 2, out_dir: Some(dir.into()), record: true, ..RunOptions::default() };
    let report = run(plan, &registry(), &options, &()).unwrap();
    (report, Recording::open(&dir.join(files::RECORDING)).unwrap())
}

fn replayed(plan: &Plan, recording: &Recording, from: Option<&str>, workers: usize) -> ReplayReport {
    let options = RunOptions { workers, ..RunOptions::default() };
    let changes = ReplayOptions { from: from.map(str::to_owned), ..ReplayOptions::default() };
    replay_plan(plan, recording, &changes, &registry(), &options, &()).unwrap()
}

#[test]
fn a_replay_has_the_signs_of_the_sources_that_it_plays_and_of_the_nodes_that_it_computes() {
    for (numbers, sign) in [(&[1.0, -2.0, -3.0, -2.0][..], true), (&[-2.0, 13.0], true), (&[1.0, 2.0], false)] {
        let (dir, plan) = (tempfile::tempdir().unwrap(), signing(numbers, sign).plan());
        let (report, recording) = recorded(&plan, dir.path());
        let written: Json = serde_json::from_slice(&std::fs::read(dir.path().join(files::RESULTS)).unwrap()).unwrap();
        assert_eq!(written, report.results);
        assert_eq!(reasons(&report.results).is_empty(), !sign);
        for workers in [1, 8] {
            let again = replayed(&plan, &recording, None, workers);
            assert!(again.is_equal() && again.results_equal == Some(true), "{numbers:?}: {:#}", again.run.results);
            assert_eq!(again.run.results["reasons"], report.results["reasons"]);
        }
        let part = replayed(&plan, &recording, Some("last"), 1);
        let kept = |of: &RunReport| {
            short(&of.results).into_iter().filter(|reason| !reason.starts_with("first")).collect::<Vec<_>>()
        };
        assert_eq!(kept(&part.run), kept(&report), "those of the played source and of the computed node");
    }
}

#[test]
fn a_replay_that_no_longer_finds_a_sign_differs() {
    let dir = tempfile::tempdir().unwrap();
    let (_, mut recording) = recorded(&signing(&[1.0, -2.0], true).plan(), dir.path());
    recording.results.as_mut().unwrap()["reasons"][1]["reason"] = "-7 is below -1".into();
    let again = replayed(&signing(&[1.0, -2.0], true).plan(), &recording, None, 1);
    assert_eq!(again.results_equal, Some(false));
}

#[test]
fn cached_answers_give_the_same_reasons_without_a_firing() {
    let dir = tempfile::tempdir().unwrap();
    let store = Arc::new(Store::open(Settings::in_dir(dir.path())));
    let mut plan = signing(&[1.0, -2.0, -3.0, -2.0], true).plan();
    plan.nodes[2].params = json!({ "counter": "cached signs" });
    let options = RunOptions { store: Some(store), ..RunOptions::default() };
    let computed = run(&plan, &registry(), &options, &()).unwrap();
    let n = n_fired("cached signs");
    let cached = run(&plan, &registry(), &options, &()).unwrap();
    assert_eq!((n_fired("cached signs"), cached.cached_answers.len()), (n, 4));
    assert_eq!((short(&computed.results), cached.results), (EXPECTED.map(str::to_owned).to_vec(), computed.results));
}

#[test]
fn a_run_that_computes_only_some_nodes_has_the_signs_of_all() {
    let plan = signing(&[1.0, -2.0, -3.0, -2.0], true).plan();
    let options = RunOptions::default();
    let mut left: Vec<Option<Arc<FinishedNode>>> = vec![None; plan.nodes.len()];
    for computed in [&[0, 1, 2][..], &[1], &[2], &[1, 2], &[]] {
        let known: Vec<_> =
            left.iter().enumerate().map(|(k, of)| of.clone().filter(|_| !computed.contains(&k))).collect();
        let mut keep = |finished: Finished| {
            left = (0..known.len()).map(|k| Some(Arc::new(FinishedNode::of(&finished, &plan, k)))).collect();
            finished
        };
        let part = PartialRun::new(&plan, &known).run(&registry(), &options, &(), None, &mut keep).unwrap();
        assert_eq!(short(&part.results), EXPECTED, "computed {computed:?}");
    }
}

/// A source that gives these numbers (null: an empty) on two ports, `middle` after it, and a node `sink`.
fn to_last(numbers: Json, inputs: &[(&str, &str, Option<Join>)]) -> PlanBuilder {
    let call = |(k, x): (usize, &Json)| json!({ "stamp_ns": 10 + k, "give": [[0, x[0]], [1, x[1]]] });
    let calls = numbers.as_array().unwrap().iter().enumerate().map(call).collect();
    PlanBuilder::new().script("scan", 2, calls).node("middle", "toy.add", json!({}), &[("a", "scan.p0", None)]).node(
        "sink",
        "toy.add",
        json!({}),
        inputs,
    )
}

/// The reason for which the run is refused because nothing came to the node; `None` if it is complete.
fn refused(plan: &Plan, node: &str) -> Option<String> {
    let report = report(plan);
    let all = reasons(&report.results);
    match &report.outcome {
        Outcome::Complete => {
            assert!(all.is_empty() && report.warnings.is_empty(), "{all:?} {:?}", report.warnings);
            None
        }
        Outcome::Refused(refusal) => {
            assert_eq!((refusal.node.as_str(), report.results["refused"]["node"].as_str()), (node, Some(node)));
            let (of, rule, reason, ..) = &all[0];
            assert_eq!((of.as_str(), rule.as_str(), reason), (node, "nothing_came", &refusal.reason));
            let warned = format!("{reason} [nothing_came]");
            assert_eq!(report.warnings.iter().filter(|w| w.node == node && w.message == warned).count(), 1);
            Some(reason.clone())
        }
        Outcome::Interrupted => panic!("nobody stopped it"),
    }
}

fn nothing(cause: &str) -> Option<String> {
    Some(format!("nothing came: {cause}"))
}

#[test]
fn a_sink_that_got_only_empties_refuses_the_run_with_the_reason_of_their_origin() {
    let to_sink = |numbers: Json| to_last(numbers, &[("a", "middle.out", None)]);
    let of = |numbers: Json| refused(&last_as(to_sink(numbers).plan(), "test.sink"), "sink");
    let three = json!([[null, 1.0], [null, 1.0], [null, 1.0]]);
    assert_eq!(of(three.clone()), nothing("all 3 items were empty, the last one since node \"scan\" gave none: lost"));
    assert_eq!(of(json!([[null, 1.0]])), nothing("the only item was empty since node \"scan\" gave none: lost"));
    assert_eq!(of(json!([[null, 1.0], [2.0, 1.0], [null, 1.0]])), None, "one of three is a value");
    // Beside results that are all there, which are withheld as where one is missing.
    let beside = last_as(to_sink(three).result("other", "scan.p1", false, false).plan(), "test.sink");
    assert!(refused(&beside, "sink").is_some());
    assert_eq!(report(&beside).results.get("other"), None);
}

#[test]
fn a_sink_to_which_no_item_came_says_which_wire_was_silent() {
    let silent = PlanBuilder::new()
        .script("scan", 2, json!([{ "stamp_ns": 10, "give": [[0, 1.0]] }]))
        .node("middle", "toy.add", json!({}), &[("a", "scan.p1", None)])
        .node("sink", "toy.add", json!({}), &[("a", "middle.out", None)]);
    assert_eq!(refused(&last_as(silent.plan(), "test.sink"), "sink"), nothing("no item ever came on scan.p1"));
    let stamp = Some(Join::Stamp { tolerance_ns: 0 });
    let apart = PlanBuilder::new()
        .script("scan", 2, json!([{ "stamp_ns": 10, "give": [[0, 1.0]] }, { "stamp_ns": 20, "give": [[1, 1.0]] }]))
        .node("sink", "toy.add", json!({}), &[("a", "scan.p0", stamp), ("b", "scan.p1", stamp)]);
    let mut apart = last_as(apart.plan(), "test.sink");
    apart.nodes[1].inputs[1].port.optional = false;
    let report = report(&apart);
    assert!(report.warnings.iter().any(|warning| warning.message.contains("found no partner")));
    let (_, rule, reason, ..) = &reasons(&report.results)[0];
    let expected = "nothing came: it never fired: items came on scan.p0 and scan.p1, but never together";
    assert_eq!((rule.as_str(), reason.as_str()), ("nothing_came", expected));
}

#[test]
fn a_sink_of_optional_inputs_got_nothing_if_none_of_them_brought_a_value() {
    let both = [("a", "scan.p0", None), ("b", "scan.p1", None)];
    let of = |numbers: Json, inputs: &[(&str, &str, Option<Join>)]| {
        refused(&last_as(to_last(numbers, inputs).plan(), "test.perhaps_sink"), "sink")
    };
    let cause = "the only item was empty since node \"scan\" gave none: lost";
    assert_eq!(of(json!([[null, null]]), &both), nothing(cause));
    assert_eq!(of(json!([[null, 1.0]]), &both), None, "the constant came");
    assert_eq!(of(json!([[1.0, null]]), &both), None);
    assert_eq!(of(json!([[null, 1.0]]), &both[..1]), nothing(cause), "the constant is not wired");
    let silent = PlanBuilder::new().script("scan", 2, json!([{ "stamp_ns": 10, "give": [[1, 1.0]] }])).node(
        "sink",
        "toy.add",
        json!({}),
        &[("a", "scan.p0", None)],
    );
    let silent = last_as(silent.plan(), "test.perhaps_sink");
    assert_eq!(refused(&silent, "sink"), nothing("no item ever came on scan.p0"));
}

#[test]
fn nothing_need_come_of_an_optional_stream_that_the_source_does_not_have() {
    let of = |inputs: &[(&str, &str, Option<Join>)], optional: usize| {
        let toy = to_last(json!([[null, 1.0]]), inputs).optional("scan", optional);
        refused(&last_as(toy.plan(), "test.sink"), "sink")
    };
    let one = [("a", "middle.out", None)];
    assert_eq!(of(&one, 0), None);
    assert!(of(&one, 1).is_some(), "another stream is optional");
    assert!(of(&[("a", "middle.out", None), ("b", "scan.p1", None)], 1).is_some(), "the optional one came");
}

#[test]
fn a_graph_without_sinks_and_required_results_is_refused_only_if_nothing_came_to_any_of_its_ends() {
    let of = |numbers: Json| to_last(numbers, &[("a", "middle.out", None)]).result("last", "sink.out", false, true);
    let cause = "the only item was empty since node \"scan\" gave none: lost";
    assert_eq!(refused(&of(json!([[null, 1.0]])).plan(), "sink"), nothing(cause));
    assert_eq!(refused(&of(json!([[2.0, 1.0]])).plan(), "sink"), None);
    let two = of(json!([[null, 1.0]])).node("side", "toy.add", json!({}), &[("a", "scan.p1", None)]);
    assert_eq!(refused(&two.plan(), "sink"), None, "something came to the other end");
    let source = PlanBuilder::new().script("scan", 1, json!([{ "stamp_ns": 1, "give": [[0, null]] }])).plan();
    assert_eq!(refused(&source, "scan"), nothing("no value ever came from it"));
}

#[test]
fn a_failure_is_the_reason_and_not_what_follows_from_it() {
    let plan = last_as(to_last(json!([[13.0, 1.0]]), &[("a", "middle.out", None)]).plan(), "test.sink");
    let report = report(&plan);
    let Outcome::Refused(refusal) = &report.outcome else { panic!("13 was added") };
    assert_eq!((refusal.node.as_str(), report.results.get("reasons")), ("middle", None));
}

#[test]
fn a_replay_of_a_run_that_got_nothing_is_equal() {
    let toy = to_last(json!([[null, 1.0]]), &[("a", "middle.out", None)]);
    let to_sink = last_as(toy.record(&["scan.p0", "scan.p1", "middle.out"]).plan(), "test.sink");
    let source = PlanBuilder::new().script("scan", 1, json!([{ "stamp_ns": 1, "give": [[0, null]] }]));
    for plan in [to_sink, source.record(&["scan.p0"]).plan()] {
        let dir = tempfile::tempdir().unwrap();
        let (report, recording) = recorded(&plan, dir.path());
        assert_eq!(recording.results.as_ref(), Some(&report.results));
        assert_eq!(reasons(&report.results).len(), 1);
        for workers in [1, 8] {
            let again = replayed(&plan, &recording, None, workers);
            assert!(again.is_equal() && again.results_equal == Some(true), "{:#}", again.run.results);
            assert_eq!(again.run.outcome, report.outcome);
        }
    }
}
