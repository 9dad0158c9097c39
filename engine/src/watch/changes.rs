//! Differences between two plans of a graph that affect what its nodes compute.

use super::{Memory, Stamps};
use crate::{
    names::shortened,
    plan::{Plan, PlanInput, PlanNode, Policy},
};
use serde_json::Value as Json;
use std::collections::BTreeSet;

/// Maximum length of a value in a change, in characters.
const MAX_CHARACTERS: usize = 40;

/// A direct change: a reason to recompute a node other than changes upstream of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change {
    /// The node; `graph` if it concerns all nodes.
    pub node: String,
    /// What has changed, such as `max_pair_distance_mm 5.0 -> 3.0`.
    pub why: Vec<String>,
}

/// A change of seed, which affects every node that draws.
pub(super) fn seed(before: u64, now: u64) -> Change {
    Change { node: "graph".into(), why: vec![format!("seed {before} -> {now}")] }
}

/// Changed nodes, by their index in the new plan.
pub(super) fn of(memory: &Memory, plan: &Plan, files: &Stamps) -> Vec<(usize, Change)> {
    let old = &memory.plan;
    let change = |(index, node): (usize, &PlanNode)| {
        let why = match old.node(&node.name) {
            None => vec!["new".into()],
            Some(before) => {
                let mut why = differences(old, &old.nodes[before], plan, node);
                let changed = node.files.iter().filter(|file| !files.agree(&memory.files, file));
                why.extend(changed.map(|file| format!("{} has changed", file.display())));
                why.extend(memory.unsound[before].then(|| "did not come to its end before".into()));
                why
            }
        };
        (!why.is_empty()).then(|| (index, Change { node: node.name.to_string(), why }))
    };
    plan.nodes.iter().enumerate().filter_map(change).collect()
}

/// Nodes of the old plan that are not in the new one.
pub(super) fn removed(old: &Plan, plan: &Plan) -> Vec<String> {
    let gone = old.nodes.iter().filter(|before| plan.nodes.iter().all(|node| node.name != before.name));
    gone.map(|node| node.name.to_string()).collect()
}

fn differences(old: &Plan, before: &PlanNode, plan: &Plan, node: &PlanNode) -> Vec<String> {
    let mut why = Vec::new();
    if before.kind != node.kind {
        // Another kind has other parameters.
        why.push(format!("kind {} -> {}", before.kind, node.kind));
    } else {
        params("", &before.params, &node.params, &mut why);
    }
    if before.plugin != node.plugin {
        why.push("the plugin of its kind has changed".into());
    }
    if before.on_error != node.on_error {
        why.push("on_error".into());
    }
    if before.place != node.place {
        why.push("where it fires".into());
    }
    let outputs = |node: &PlanNode| -> Vec<_> {
        node.outputs.iter().map(|output| (output.name.clone(), output.payload.name())).collect()
    };
    let declared = |node: &PlanNode| -> Vec<_> {
        node.declared.iter().map(|port| (port.name.clone(), port.payload.name, port.params.clone())).collect()
    };
    if outputs(before) != outputs(node) || declared(before) != declared(node) {
        why.push("out".into());
    }
    inputs(old, before, plan, node, &mut why);
    why
}

fn params(name: &str, before: &Json, now: &Json, why: &mut Vec<String>) {
    match (before, now) {
        _ if before == now => {}
        (Json::Object(before), Json::Object(now)) => {
            let keys: BTreeSet<_> = before.keys().chain(now.keys()).collect();
            for key in keys {
                let name = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                params(&name, before.get(key).unwrap_or(&Json::Null), now.get(key).unwrap_or(&Json::Null), why);
            }
        }
        _ => why.push(format!("{name} {} -> {}", format_value(before), format_value(now))),
    }
}

fn format_value(value: &Json) -> String {
    match value {
        Json::Null => "none".into(),
        Json::String(text) => shortened(text, MAX_CHARACTERS),
        other => shortened(&other.to_string(), MAX_CHARACTERS),
    }
}

fn inputs(old: &Plan, before: &PlanNode, plan: &Plan, node: &PlanNode, why: &mut Vec<String>) {
    for input in &node.inputs {
        let port = input.port.name;
        let Some(was) = before.inputs.iter().find(|input| input.port.name == port) else { continue };
        let (from, now) = (old.wires_of(was), plan.wires_of(input));
        if from != now {
            let told = |wire: Option<String>| wire.unwrap_or_else(|| "unwired".into());
            why.push(format!("in.{port} {} -> {}", told(from), told(now)));
        } else if was.port.join != input.port.join || policies(old, was) != policies(plan, input) {
            why.push(format!("in.{port}"));
        }
    }
}

/// What the wires may drop; the capacity of a wire that blocks has no effect on items.
fn policies(plan: &Plan, input: &PlanInput) -> Vec<(Policy, usize, u64)> {
    let links = input.links.iter().map(|link| &plan.links[*link]).filter(|link| link.policy != Policy::Block);
    links.map(|link| (link.policy, link.capacity, link.max_bytes)).collect()
}
