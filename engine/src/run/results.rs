//! `results.json`: the verdict and the values that `[results]` names, or why there are none.

use super::{
    Finished, Outcome, nothing_came,
    verdict::{Answer, FAILURE, INTERRUPTED, REQUIRE, Verdict},
};
use crate::{
    graph::grammar::{REASONS, VERDICT},
    hash::Digest,
    options::RunOptions,
    plan::{OutputId, Plan, PlanInput, Require, ResultEntry},
    runtime::{Failure, Refusal, Sign, refusal as refusal_of},
    shown_paths::ShownPaths,
};
use osteoflow_node::{Body, Role, Value};
use serde_json::{Map, Value as Json, json};

/// Prefix of the names of payloads that say how the run went. Of refused results, only these are given.
const REPORT: &str = "report/";

/// Determines how the run ended, and the content of `results.json`.
pub(super) fn collect(plan: &Plan, options: &RunOptions, run: &mut Finished, shown: &ShownPaths) -> (Outcome, Json) {
    let (outcome, mut results) = outcome_of(plan, options, run);
    add_reasons(&mut results, &run.ended.signs, shown);
    (outcome, results)
}

/// Lists the signs that inputs are wrong.
pub(super) fn add_reasons(results: &mut Json, signs: &[Sign], shown: &ShownPaths) {
    if !signs.is_empty() {
        let shown = |sign: &Sign| json!(Sign { reason: shown.text(&sign.reason), ..sign.clone() });
        results[REASONS] = signs.iter().map(shown).collect();
    }
}

fn outcome_of(plan: &Plan, options: &RunOptions, run: &mut Finished) -> (Outcome, Json) {
    if run.ended.interrupted {
        return (Outcome::Interrupted, interrupted(options));
    }
    let mut ended = ended(plan, run);
    if let Ok(Entries { refusal: None, .. }) = ended
        && let Some((node, sign)) = nothing_came::note(plan, run)
    {
        ended = Err(refusal_at(plan, node, None, sign.reason));
    }
    match ended {
        Ok(Entries { verdict, refusal, values }) => {
            let mut results = begin(options, verdict);
            if let Some(refusal) = &refusal {
                results.insert("refused".into(), refused(refusal));
            }
            values.into_iter().for_each(|(key, value)| insert(&mut results, key, value));
            (refusal.map_or(Outcome::Complete, Outcome::Refused), Json::Object(results))
        }
        Err(refusal) => {
            let (remedy, refused) = (remedy(options, run, &refusal), refused(&refusal));
            (Outcome::Refused(refusal), without_results(options, FAILURE, &remedy, refused))
        }
    }
}

/// The content of `results.json` of a run that the user stopped.
fn interrupted(options: &RunOptions) -> Json {
    let refused = json!({ "reason": "the run was interrupted before its end" });
    without_results(options, INTERRUPTED, "run it again to its end", refused)
}

/// The content of `results.json` of a run whose recording could not be written.
pub(crate) fn not_recorded(options: &RunOptions, why: &str) -> Json {
    without_results(options, FAILURE, MEND, json!({ "reason": why }))
}

const MEND: &str = "mend the cause and run again";

/// What to do about a failure. The folder of the run is not named, because the results do not depend on it.
fn remedy(options: &RunOptions, run: &Finished, refusal: &Refusal) -> String {
    let saved = run.saved.bundles.iter().find(|b| b.node == refusal.node && Some(b.item) == refusal.item);
    let inside = saved.and_then(|bundle| bundle.dir.strip_prefix(options.out_dir.as_ref()?).ok());
    match inside {
        Some(inside) => {
            let inside = inside.components().map(|part| part.as_os_str().to_string_lossy()).collect::<Vec<_>>();
            format!("osteoflow repro DIR/{} runs it again alone, where DIR is the folder of the run", inside.join("/"))
        }
        None => MEND.into(),
    }
}

/// The verdict, if there is one, and the constants.
fn begin(options: &RunOptions, verdict: Option<Json>) -> Map<String, Json> {
    let mut results: Map<_, _> = verdict.map(|verdict| (VERDICT.to_owned(), verdict)).into_iter().collect();
    for (key, value) in &options.fixed_results {
        insert(&mut results, key, value.clone());
    }
    results
}

/// The content of `results.json` of a run without results, which `refused` explains.
fn without_results(options: &RunOptions, rule: &str, remedy: &str, refused: Json) -> Json {
    let mut reason = json!({ "rule": rule, "answer": Answer::Refused.name() });
    for key in ["node", "item", "reason"] {
        if let Some(value) = refused.get(key) {
            reason[key] = value.clone();
        }
    }
    reason["remedy"] = remedy.into();
    let verdict = json!({
        "answer": Answer::Refused.name(), "reasons": [reason], "assumptions": [], "predicted": null,
    });
    let mut results = begin(options, Some(verdict));
    results.insert("refused".into(), refused);
    Json::Object(results)
}

/// The key `refused`.
fn refused(refusal: &Refusal) -> Json {
    let mut refused = json!({ "reason": refusal.reason, "node": refusal.node });
    if let Some(item) = refusal.item {
        refused["item"] = item.into();
    }
    refused
}

/// A run that ended without a failure.
struct Entries<'a> {
    verdict: Option<Json>,
    /// Why the verdict refuses the results.
    refusal: Option<Refusal>,
    /// The other entries, by key; of refused results, only the reports.
    values: Vec<(&'a str, Json)>,
}

/// The verdict and every entry with its value, or why the whole run is refused.
fn ended<'a>(plan: &'a Plan, run: &Finished) -> Result<Entries<'a>, Refusal> {
    if let Some(failure) = run.ended.stall.iter().chain(&run.ended.failures).find(|failure| refuses(plan, failure)) {
        return Err(refusal_of(plan, failure));
    }
    let entry = plan.results.iter().find(|entry| entry.key == VERDICT);
    let (verdict, refusal) = match entry.map(|entry| judged(plan, run, entry)).transpose()? {
        Some((verdict, refusal)) => (Some(verdict), refusal),
        None => (None, None),
    };
    let mut values = Vec::new();
    for entry in plan.results.iter().filter(|entry| entry.key != VERDICT) {
        if refusal.is_some() && !is_report(run, entry) {
            continue;
        }
        match value(run, entry) {
            Some(value) => values.push((entry.key.as_str(), value)),
            None if entry.optional || refusal.is_some() => {}
            None => return Err(cause(plan, run, entry.from)),
        }
    }
    Ok(Entries { verdict, refusal, values })
}

/// The verdict, and the refusal if it does not suffice.
fn judged(plan: &Plan, run: &Finished, entry: &ResultEntry) -> Result<(Json, Option<Refusal>), Refusal> {
    let Some(given) = value(run, entry) else { return Err(cause(plan, run, entry.from)) };
    let refusal = |reason: String| {
        let item = run.outputs[entry.from.node][entry.from.port].items.last().map(|item| item.number);
        refusal_at(plan, entry.from.node, item, reason)
    };
    let no_verdict = |why: String| refusal(format!("{} gives no verdict: {why}", plan.wire_name(entry.from)));
    let verdict = Verdict::read(&given).map_err(no_verdict)?;
    if let Some(reason) = verdict.reasons().iter().find(|r| [FAILURE, INTERRUPTED, REQUIRE].contains(&&*r.rule)) {
        return Err(no_verdict(format!("the rule \"{}\" is one of the engine's own; name it otherwise", reason.rule)));
    }
    let first = verdict.first().map(ToString::to_string).unwrap_or_default();
    Ok(match (verdict.answer(), plan.require) {
        (Answer::Refused, _) => (verdict.into_json(), Some(refusal(format!("the result is refused: {first}")))),
        (Answer::Doubtful, Require::Trusted) => {
            let reason = json!({
                "rule": REQUIRE, "answer": Answer::Refused.name(),
                "reason": "the result is doubtful, and [results] require = \"trusted\"",
                "remedy": "remove the doubts, or let doubtful results pass with require = \"doubtful\"",
            });
            let why = format!("the result is doubtful, and [results] require = \"trusted\": {first}");
            (verdict.refused(&reason).into_json(), Some(refusal(why)))
        }
        _ => (verdict.into_json(), None),
    })
}

/// Whether the values of an entry say how the run went.
fn is_report(run: &Finished, entry: &ResultEntry) -> bool {
    let items = &run.outputs[entry.from.node][entry.from.port].items;
    let first = if entry.all { 0 } else { items.len().saturating_sub(1) };
    items[first..].iter().all(|item| match &item.body {
        Body::Value(value) => value.ty().name.starts_with(REPORT),
        Body::Empty(_) => true,
    })
}

/// Whether a failure refuses the run. It does not if only optional results depend on the node. A panic is a bug and
/// always refuses.
fn refuses(plan: &Plan, failure: &Failure) -> bool {
    if failure.panicked || failure.refuses {
        return !failure.skipped;
    }
    let mut reached = vec![false; plan.nodes.len()];
    reached[failure.node] = true;
    plan.mark_downstream(&mut reached);
    let mut fed = plan.results.iter().filter(|entry| reached[entry.from.node]).peekable();
    !failure.skipped && (fed.peek().is_none() || fed.any(|entry| !entry.optional))
}

/// The last item's value, or all values. In a list an empty becomes an unknown value with its reason; a single empty is
/// no value.
fn value(run: &Finished, entry: &ResultEntry) -> Option<Json> {
    let items = &run.outputs[entry.from.node][entry.from.port].items;
    if !entry.all {
        return items.last()?.body.value().map(shown);
    }
    let has_value = items.iter().any(|item| matches!(item.body, Body::Value(_)));
    has_value.then(|| {
        let values = items.iter().map(|item| match &item.body {
            Body::Value(value) => shown(value),
            Body::Empty(empty) => json!({ "unknown": empty.reason, "node": empty.node }),
        });
        values.collect()
    })
}

/// Most values of a list within a result: a table of 100 columns and 100 rows. A column of an image has millions.
const MAX_IN_LIST: usize = 10_000;

fn shown(value: &Value) -> Json {
    let mut result = value.to_result();
    bound(&mut result);
    result
}

/// Replaces each list of more than [`MAX_IN_LIST`] values by their number and digest; the number of values that are left.
fn bound(json: &mut Json) -> usize {
    let n = match json {
        Json::Array(values) => values.iter_mut().map(bound).sum(),
        Json::Object(values) => return values.values_mut().map(bound).sum(),
        _ => return 1,
    };
    if n <= MAX_IN_LIST {
        return n;
    }
    let (note, text) = ("too long to be repeated here; record its wire to have it", json.to_string());
    *json = json!({ "n_values": n, "sha256": Digest::of(text.as_bytes()).to_string(), "note": note });
    1
}

/// Why a wire has no value: the failure or empty that caused it, or the wire that carried no item.
fn cause(plan: &Plan, run: &Finished, wire: OutputId) -> Refusal {
    let kept = &run.outputs[wire.node][wire.port];
    let last = kept.items.iter().rev().find_map(|item| match &item.body {
        Body::Empty(empty) => Some((item, empty)),
        Body::Value(_) => None,
    });
    let Some((item, empty)) = last else {
        let (node, reason) = silent_wire(plan, run, wire);
        return refusal_at(plan, node, None, reason);
    };
    let origin = plan.node(&empty.node).unwrap_or(wire.node);
    let failure = run.ended.failures.iter().find(|f| f.node == origin && f.reason == empty.reason);
    match failure {
        Some(failure) => refusal_of(plan, failure),
        None => refusal_at(plan, origin, (origin == wire.node).then_some(item.number), empty.reason.clone()),
    }
}

/// A refusal by a node that did not fail.
fn refusal_at(plan: &Plan, node: usize, item: Option<u64>, reason: String) -> Refusal {
    let node = &plan.nodes[node];
    Refusal {
        node: node.name.to_string(),
        kind: node.kind.clone(),
        item,
        location: node.location.clone(),
        reason,
        panicked: false,
    }
}

/// The wire furthest upstream that carried no item, and its node.
fn silent_wire(plan: &Plan, run: &Finished, wire: OutputId) -> (usize, String) {
    match plan.nodes[wire.node].role {
        Role::Node => never_fired(plan, run, wire.node),
        _ => (wire.node, format!("no item ever came on {}", plan.wire_name(wire))),
    }
}

/// Why a node without activations has none: the wire furthest upstream that carried no item, and its node.
pub(super) fn never_fired(plan: &Plan, run: &Finished, index: usize) -> (usize, String) {
    let node = &plan.nodes[index];
    let is_required = |input: &&PlanInput| !input.port.unused && !input.port.optional && !input.links.is_empty();
    // A sink may have optional inputs alone.
    let takes_any = node.outputs.is_empty() && !node.inputs.iter().any(|input| is_required(&input));
    let fed = node.inputs.iter().filter(|input| takes_any || is_required(input)).flat_map(|input| &input.links);
    let from = fed.map(|link| plan.links[*link].from);
    if let Some(from) = from.clone().find(|from| run.outputs[from.node][from.port].n_items == 0) {
        return silent_wire(plan, run, from);
    }
    let inputs: Vec<_> = from.map(|from| plan.wire_name(from)).collect();
    (index, format!("it never fired: items came on {}, but never together", inputs.join(" and ")))
}

/// Inserts a value at a dotted key.
fn insert(results: &mut Map<String, Json>, key: &str, value: Json) {
    match key.split_once('.') {
        None => drop(results.insert(key.into(), value)),
        Some((head, rest)) => {
            let inner = results.entry(head).or_insert_with(|| Json::Object(Map::new()));
            if !inner.is_object() {
                *inner = Json::Object(Map::new());
            }
            if let Json::Object(inner) = inner {
                insert(inner, rest, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_list_is_its_number_and_digest_and_all_else_stays() {
        let rows = |n: usize, x: f64| vec![json!([x, 2.0, 3.0]); n];
        let mut short = json!({ "points": rows(3333, 1.0), "name": "a" });
        let before = short.clone();
        bound(&mut short);
        assert_eq!(short, before);
        let bounded = |x: f64| {
            let mut long = json!({ "points": rows(3334, x), "name": "a", "nested": [{ "hits": vec![7; 20_000] }, 5] });
            bound(&mut long);
            long
        };
        let long = bounded(1.0);
        assert_eq!(long["points"]["n_values"], json!(10_002));
        assert_eq!(
            (&long["nested"][0]["hits"]["n_values"], &long["nested"][1], &long["name"]),
            (&json!(20_000), &json!(5), &json!("a"))
        );
        assert_ne!(long["points"]["sha256"], bounded(1.5)["points"]["sha256"], "another value is another digest");
        assert!(long.to_string().len() < 1000);
    }

    #[test]
    fn dotted_keys_nest_in_order() {
        let mut results = Map::new();
        insert(&mut results, "poses.t_ct_world", json!(1));
        insert(&mut results, "icp", json!(2));
        insert(&mut results, "poses.t_a_b", json!(3));
        let text = serde_json::to_string(&results).unwrap();
        assert_eq!(text, r#"{"poses":{"t_ct_world":1,"t_a_b":3},"icp":2}"#);
    }
}
