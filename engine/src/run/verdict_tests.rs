//! Verdicts: what refuses a run, and what is left of its results.

use super::{
    tests::{calls, check, options, refusal_of},
    *,
};
use crate::{
    recording::Recording,
    replay::{ReplayOptions, replay_plan},
    tests::plan_builder::PlanBuilder,
};
use osteoflow_toy::registry;
use serde_json::{Value as Json, json};
use std::{path::Path, sync::Arc};

/// Numbers that are judged, with a pose, a report, a list of reports, a mixed list and a missing optional result.
fn judged(numbers: &[f64], params: Json) -> PlanBuilder {
    let script: Vec<_> = numbers.iter().zip(1..).map(|(x, stamp)| (stamp, 0, *x)).collect();
    PlanBuilder::new()
        .script("scan", 2, calls(&script))
        .node("fit", "toy.add", json!({}), &[("a", "scan.p0", None)])
        .node("judge", "toy.judge", params, &[("number", "fit.out", None)])
        .record(&["scan.p0", "scan.p1", "fit.out", "judge.verdict", "judge.remark"])
        .result("pose", "fit.out", false, false)
        .result("fine.report", "judge.remark", false, false)
        .result("fine.reports", "judge.remark", true, false)
        .result("other", "scan.p1", false, true)
        .result("verdict", "judge.verdict", false, false)
}

fn reason(rule: &str, answer: &str) -> Json {
    json!({ "rule": rule, "answer": answer, "reason": format!("{rule} is odd"), "remedy": format!("look at {rule}") })
}

fn says(verdict: &Json) -> Json {
    json!({ "says": [verdict] })
}

fn keys(results: &Json) -> Vec<&str> {
    results.as_object().unwrap().keys().map(String::as_str).collect()
}

#[test]
fn trusted_and_doubtful_results_are_complete_and_begin_with_the_verdict_as_it_was_given() {
    for verdict in [
        json!({ "answer": "trusted", "reasons": [], "assumptions": ["a"], "predicted": { "points": [] }, "more": [1] }),
        json!({ "answer": "trusted", "sentence": "well done", "reasons": [reason("order", "trusted")] }),
        json!({ "answer": "doubtful", "reasons": [reason("order", "trusted"), reason("overlap", "doubtful")] }),
    ] {
        let report = check(&judged(&[1.0, 2.0], says(&verdict)).plan());
        assert_eq!(report.outcome, Outcome::Complete, "{verdict}");
        assert_eq!(keys(&report.results), ["verdict", "notice", "pose", "fine"]);
        assert_eq!(report.results["verdict"].to_string(), verdict.to_string(), "every key, in order");
        assert_eq!(report.results["pose"], 2.0);
    }
}

#[test]
fn a_verdict_that_does_not_suffice_refuses_the_run_and_leaves_the_reports() {
    let doubtful =
        json!({ "answer": "doubtful", "sentence": "hm", "reasons": [reason("overlap", "doubtful")], "x": 1 });
    let refused =
        json!({ "answer": "refused", "reasons": [reason("overlap", "doubtful"), reason("order", "refused")] });
    let required = "the result is doubtful, and [results] require = \"trusted\"";
    for (verdict, require, why) in [
        (&refused, false, "the result is refused: order is odd; look at order".to_owned()),
        (&refused, true, "the result is refused: order is odd; look at order".to_owned()),
        (&doubtful, true, format!("{required}: overlap is odd; look at overlap")),
    ] {
        let builder = judged(&[1.0, 2.0], says(verdict));
        let plan = if require { builder.require_trusted() } else { builder }.plan();
        let report = check(&plan);
        let refusal = refusal_of(&report);
        assert_eq!(refusal.to_string(), format!("toy.toml:12: node \"judge\", item 1: {why}"));
        let results = &report.results;
        assert_eq!(keys(results), ["verdict", "notice", "refused", "fine"], "the pose is withheld");
        assert_eq!(results["refused"], json!({ "reason": why, "node": "judge", "item": 1 }));
        let reports = json!({ "report": { "number": 2.0 }, "reports": [{ "number": 1.0 }, { "number": 2.0 }] });
        assert_eq!(results["fine"], reports);
        if verdict == &refused {
            assert_eq!(results["verdict"], refused, "it is not changed");
            continue;
        }
        let mut expected = doubtful.clone();
        expected["answer"] = "refused".into();
        let reasons = expected["reasons"].as_array_mut().unwrap();
        reasons.insert(0, results["verdict"]["reasons"][0].clone());
        assert_eq!(results["verdict"], expected);
        let first = &expected["reasons"][0];
        assert_eq!(
            (&first["rule"], &first["answer"], &first["reason"]),
            (&"require".into(), &"refused".into(), &required.into())
        );
        assert!(first["remedy"].as_str().unwrap().contains("require = \"doubtful\""), "{first}");
    }
    let trusted = check(&judged(&[1.0], json!({})).require_trusted().plan());
    assert_eq!((trusted.outcome, &trusted.results["pose"]), (Outcome::Complete, &1.0.into()));
}

#[test]
fn refused_results_are_withheld_whatever_their_type_is_called_unless_it_is_a_report() {
    let plan = judged(&[9.0], json!({ "refused_above": 5.0 }))
        .result("own", "judge.verdict", false, false)
        .result("list", "fit.out", true, false)
        .plan();
    let report = check(&plan);
    assert_eq!(keys(&report.results), ["verdict", "notice", "refused", "fine"]);
}

#[test]
fn a_result_that_is_missing_does_not_hide_that_the_verdict_refuses() {
    let plan = |params| judged(&[9.0], params).result("must", "scan.p1", false, false).plan();
    let report = check(&plan(json!({ "refused_above": 5.0 })));
    assert_eq!(refusal_of(&report).reason, "the result is refused: 9 is too large; take a smaller number");
    for fine in [json!({}), json!({ "doubtful_above": 5.0 })] {
        let report = check(&plan(fine));
        assert_eq!(refusal_of(&report).reason, "no item ever came on scan.p1");
        assert_eq!(report.results["verdict"]["reasons"][0]["rule"], "failure", "{}", report.results);
        assert_eq!(keys(&report.results), ["verdict", "notice", "refused"]);
    }
}

#[test]
fn what_is_no_verdict_refuses_the_run_by_its_node() {
    for (said, why) in [
        (json!(7), "an object was expected, found 7"),
        (json!({ "reasons": [] }), "its \"answer\" must be \"trusted\", \"doubtful\" or \"refused\", found nothing"),
        (
            json!({ "answer": "yes", "reasons": [] }),
            "its \"answer\" must be \"trusted\", \"doubtful\" or \"refused\", found \"yes\"",
        ),
        (json!({ "answer": "trusted" }), "\"reasons\" must be a list, found nothing"),
        (json!({ "answer": "refused", "reasons": ["no"] }), "reason 1 of 1: an object was expected, found \"no\""),
        (json!({ "answer": "refused", "reasons": [] }), "its answer is refused, but it gives no reason for that"),
        (json!({ "answer": "doubtful", "reasons": [] }), "its answer is doubtful, but it gives no reason for that"),
        (
            json!({ "answer": "trusted", "reasons": [reason("order", "refused")] }),
            "its answer is trusted, but the answer of its rule \"order\" is refused",
        ),
        (
            json!({ "answer": "refused", "reasons": [reason("failure", "refused")] }),
            "the rule \"failure\" is one of the engine's own; name it otherwise",
        ),
    ] {
        let report = check(&judged(&[1.0], says(&said)).plan());
        let why = format!("judge.verdict gives no verdict: {why}");
        assert_eq!((refusal_of(&report).node.as_str(), &refusal_of(&report).reason), ("judge", &why), "{said}");
        let reason = json!({
            "rule": "failure", "answer": "refused", "node": "judge", "item": 0, "reason": why,
            "remedy": "mend the cause and run again",
        });
        let verdict = json!({ "answer": "refused", "reasons": [reason], "assumptions": [], "predicted": null });
        let refused = json!({ "reason": why, "node": "judge", "item": 0 });
        assert_eq!(report.results, json!({ "verdict": verdict, "notice": "toy", "refused": refused }));
    }
    let number = judged(&[1.0], json!({})).plan();
    let mut plan = number.clone();
    plan.results.last_mut().unwrap().from = number.results[0].from;
    assert_eq!(refusal_of(&check(&plan)).reason, "fit.out gives no verdict: an object was expected, found 1.0");
}

#[test]
fn the_last_verdict_counts() {
    let trusted = json!({ "answer": "trusted", "reasons": [] });
    let refused = json!({ "answer": "refused", "reasons": [reason("order", "refused")] });
    let run = |said: &[&Json]| check(&judged(&[1.0, 2.0, 3.0], json!({ "says": said })).plan());
    assert_eq!(run(&[&refused, &trusted, &trusted]).outcome, Outcome::Complete);
    assert_eq!(refusal_of(&run(&[&trusted, &trusted, &refused])).item, Some(2));
    assert_eq!(run(&[&json!("no verdict"), &trusted]).outcome, Outcome::Complete);
}

#[test]
fn a_run_that_fails_is_refused_with_the_failure_as_its_reason_whether_or_not_it_is_judged() {
    let mut plans = vec![(judged(&[13.0], json!({})).plan(), "fit", "13 is not a number to add to")];
    let (mut unjudged, ..) = plans[0].clone();
    unjudged.results.pop();
    plans.push((unjudged, "fit", "13 is not a number to add to"));
    let silent = judged(&[], json!({})).plan();
    plans.push((silent, "scan", "no item ever came on scan.p0"));
    for (plan, node, why) in plans {
        let results = check(&plan).results;
        assert_eq!(keys(&results), ["verdict", "notice", "refused"]);
        let verdict = &results["verdict"];
        assert_eq!((&verdict["answer"], &verdict["assumptions"]), (&"refused".into(), &json!([])), "{verdict}");
        assert_eq!(verdict.get("predicted"), Some(&Json::Null));
        let first = &verdict["reasons"][0];
        assert_eq!((&first["rule"], &first["node"], &first["reason"]), (&"failure".into(), &node.into(), &why.into()));
        assert_eq!((first.get("item"), &results["refused"]["reason"]), (results["refused"].get("item"), &why.into()));
    }
    let complete = judged(&[1.0], json!({}));
    let mut unjudged = complete.plan();
    unjudged.results.pop();
    assert_eq!(check(&unjudged).results.get("verdict"), None, "nothing judged it");
}

#[test]
fn an_interrupted_run_is_refused() {
    let options = RunOptions { cancelled: Arc::new(true.into()), ..options(1) };
    let report = run(&judged(&[1.0], json!({})).plan(), &registry(), &options, &()).unwrap();
    assert_eq!(report.outcome, Outcome::Interrupted);
    let why = "the run was interrupted before its end";
    let reason =
        json!({ "rule": "interrupted", "answer": "refused", "reason": why, "remedy": "run it again to its end" });
    let verdict = json!({ "answer": "refused", "reasons": [reason], "assumptions": [], "predicted": null });
    assert_eq!(report.results, json!({ "verdict": verdict, "notice": "toy", "refused": { "reason": why } }));
}

fn into(dir: &Path) -> RunOptions {
    RunOptions { out_dir: Some(dir.into()), record: true, ..options(2) }
}

#[test]
fn the_remedy_of_a_failure_names_the_saved_item_in_the_folder_of_the_run() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let plan = judged(&[1.0, 13.0], json!({})).plan();
    let results = [&a, &b].map(|dir| run(&plan, &registry(), &into(dir.path()), &()).unwrap().results);
    let remedy = results[0]["verdict"]["reasons"][0]["remedy"].as_str().unwrap();
    assert!(remedy.starts_with("osteoflow repro DIR/repro/fit-1 "), "{remedy}");
    assert!(a.path().join("repro/fit-1").is_dir());
    assert_eq!(results[0], results[1], "it does not depend on the folder");
}

#[test]
fn a_replay_gives_the_same_verdict_and_another_one_differs() {
    let limits = json!({ "doubtful_above": 2.0, "refused_above": 5.0 });
    for (number, status) in [(1.0, "complete"), (3.0, "complete"), (9.0, "refused"), (13.0, "refused")] {
        let dir = tempfile::tempdir().unwrap();
        let plan = judged(&[number], limits.clone()).plan();
        assert_eq!(run(&plan, &registry(), &into(dir.path()), &()).unwrap().outcome.status(), status);
        let recording = Recording::open(&dir.path().join(files::RECORDING)).unwrap();
        let replayed = |plan: &Plan| {
            replay_plan(plan, &recording, &ReplayOptions::default(), &registry(), &options(1), &()).unwrap()
        };
        let report = replayed(&plan);
        assert!(report.is_equal() && report.results_equal == Some(true), "{number}: {}", report.run.results);
        let mut other = plan.clone();
        let judge = other.nodes.iter_mut().find(|node| &*node.name == "judge").unwrap();
        judge.params = json!({ "doubtful_above": 0.5, "refused_above": 5.0 });
        let changed = [1.0].contains(&number);
        assert_eq!(replayed(&other).is_equal(), !changed, "{number}");
    }
}
