//! `results.json`: the values that `[results]` names, or why there are none.

use super::{Finished, Outcome};
use crate::{
    options::RunOptions,
    plan::{OutputId, Plan, ResultEntry},
    runtime::{Failure, Refusal, refusal as refusal_of},
};
use osteoflow_node::{Body, Role};
use serde_json::{Map, Value as Json, json};

/// Determines how the run ended, and the content of `results.json`.
pub(crate) fn collect(plan: &Plan, options: &RunOptions, run: &Finished) -> (Outcome, Json) {
    let mut results = Map::new();
    for (key, value) in &options.fixed_results {
        insert(&mut results, key, value.clone());
    }
    if run.ended.interrupted {
        results.insert("refused".into(), json!({ "reason": "the run was interrupted before its end" }));
        return (Outcome::Interrupted, Json::Object(results));
    }
    match values(plan, run) {
        Ok(values) => {
            values.into_iter().for_each(|(key, value)| insert(&mut results, key, value));
            (Outcome::Complete, Json::Object(results))
        }
        Err(refusal) => {
            let mut refused = json!({ "reason": refusal.reason, "node": refusal.node });
            if let Some(item) = refusal.item {
                refused["item"] = item.into();
            }
            results.insert("refused".into(), refused);
            (Outcome::Refused(refusal), Json::Object(results))
        }
    }
}

/// Every entry with its value, or why the whole run is refused.
fn values<'a>(plan: &'a Plan, run: &Finished) -> Result<Vec<(&'a str, Json)>, Refusal> {
    if let Some(failure) = run.ended.stall.iter().chain(&run.ended.failures).find(|failure| refuses(plan, failure)) {
        return Err(refusal_of(plan, failure));
    }
    let mut values = Vec::new();
    for entry in &plan.results {
        match value(run, entry) {
            Some(value) => values.push((entry.key.as_str(), value)),
            None if entry.optional => {}
            None => return Err(cause(plan, run, entry.from)),
        }
    }
    Ok(values)
}

/// Whether a failure refuses the run. It does not if only optional results depend on the node. A panic is a bug and
/// always refuses.
fn refuses(plan: &Plan, failure: &Failure) -> bool {
    if failure.panicked {
        return !failure.skipped;
    }
    let mut reached = vec![false; plan.nodes.len()];
    reached[failure.node] = true;
    for node in failure.node..plan.nodes.len() {
        if reached[node] {
            let links = plan.nodes[node].outputs.iter().flat_map(|output| &output.links);
            links.for_each(|link| reached[plan.links[*link].to_node] = true);
        }
    }
    let mut fed = plan.results.iter().filter(|entry| reached[entry.from.node]).peekable();
    !failure.skipped && (fed.peek().is_none() || fed.any(|entry| !entry.optional))
}

/// The last item's value, or all values. In a list an empty becomes an unknown value with its reason; a single empty is
/// no value.
fn value(run: &Finished, entry: &ResultEntry) -> Option<Json> {
    let items = &run.outputs[entry.from.node][entry.from.port].items;
    if !entry.all {
        return match &items.last()?.body {
            Body::Value(value) => Some(value.to_result()),
            Body::Empty(_) => None,
        };
    }
    let has_value = items.iter().any(|item| matches!(item.body, Body::Value(_)));
    has_value.then(|| {
        let values = items.iter().map(|item| match &item.body {
            Body::Value(value) => value.to_result(),
            Body::Empty(empty) => json!({ "unknown": empty.reason, "node": empty.node }),
        });
        values.collect()
    })
}

/// Why a wire has no value: the failure or empty that caused it, or the wire that carried no item.
fn cause(plan: &Plan, run: &Finished, wire: OutputId) -> Refusal {
    let refusal = |node: usize, item: Option<u64>, reason: String| Refusal {
        node: plan.nodes[node].name.to_string(),
        kind: plan.nodes[node].kind.clone(),
        item,
        location: plan.nodes[node].location.clone(),
        reason,
        panicked: false,
    };
    let kept = &run.outputs[wire.node][wire.port];
    let last = kept.items.iter().rev().find_map(|item| match &item.body {
        Body::Empty(empty) => Some((item, empty)),
        Body::Value(_) => None,
    });
    let Some((item, empty)) = last else {
        let (node, reason) = silent_wire(plan, run, wire);
        return refusal(node, None, reason);
    };
    let origin = plan.nodes.iter().position(|node| *node.name == *empty.node).unwrap_or(wire.node);
    let failure = run.ended.failures.iter().find(|f| f.node == origin && f.reason == empty.reason);
    match failure {
        Some(failure) => refusal_of(plan, failure),
        None => refusal(origin, (origin == wire.node).then_some(item.number), empty.reason.clone()),
    }
}

/// The wire furthest upstream that carried no item, and its node.
fn silent_wire(plan: &Plan, run: &Finished, wire: OutputId) -> (usize, String) {
    let node = &plan.nodes[wire.node];
    if node.role == Role::Node {
        let fed = |input: &&crate::plan::PlanInput| !input.port.unused && !input.port.optional;
        let from = node.inputs.iter().filter(fed).filter_map(|input| Some(plan.links[input.link?].from));
        if let Some(from) = from.clone().find(|from| run.outputs[from.node][from.port].n_items == 0) {
            return silent_wire(plan, run, from);
        }
        let inputs: Vec<_> = from.map(|from| plan.wire_name(from)).collect();
        return (wire.node, format!("it never fired: items came on {}, but never together", inputs.join(" and ")));
    }
    (wire.node, format!("no item ever came on {}", plan.wire_name(wire)))
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
    fn dotted_keys_nest_in_order() {
        let mut results = Map::new();
        insert(&mut results, "poses.t_ct_world", json!(1));
        insert(&mut results, "icp", json!(2));
        insert(&mut results, "poses.t_a_b", json!(3));
        let text = serde_json::to_string(&results).unwrap();
        assert_eq!(text, r#"{"poses":{"t_ct_world":1,"t_a_b":3},"icp":2}"#);
    }
}
