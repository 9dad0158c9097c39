//! Sinks to which no value came in a whole run: the run did not write or send what its graph says.

use super::{Finished, results::never_fired};
use crate::{
    plan::{Plan, PlanNode},
    runtime::{Sign, Warning},
};
use osteoflow_node::Role;

/// Rule of the sign that a sink, or a graph, got nothing.
const NOTHING_CAME: &str = "nothing_came";

/// Adds a sign and a warning for each sink to which no value came; returns the first. Without sinks and required results, the
/// graph is judged by the nodes whose outputs feed no other node, and only if nothing came to any of them.
///
/// An input that its node can do without is judged by the node, as long as another one brought a value. A sink may get nothing
/// where the graph says so: a wire of it is optional, or so is a stream upstream that the source does not have.
pub(super) fn note(plan: &Plan, run: &mut Finished) -> Option<(usize, Sign)> {
    let is_sink = |node: &PlanNode| node.outputs.is_empty() && node.inputs.iter().any(|input| !input.links.is_empty());
    let is_end = |node: &PlanNode| node.outputs.iter().all(|output| output.links.is_empty());
    let of = |is: &dyn Fn(&PlanNode) -> bool| (0..plan.nodes.len()).filter(|node| is(&plan.nodes[*node])).collect();
    let mut ends: Vec<usize> = of(&is_sink);
    if ends.is_empty() && plan.results.iter().all(|entry| entry.optional) {
        ends = of(&is_end);
        if !ends.iter().all(|node| is_unfed(plan, run, *node)) {
            return None;
        }
    }
    let found: Vec<_> = ends
        .into_iter()
        .filter(|node| is_unfed(plan, run, *node) && !may_be_unfed(plan, run, *node))
        .map(|node| (node, sign(plan, run, node)))
        .collect();
    for (_, sign) in &found {
        let Sign { node, item, reason, rule, .. } = sign.clone();
        run.ended.warnings.push(Warning { node, item, message: format!("{reason} [{rule}]") });
        run.ended.signs.push(sign.clone());
    }
    run.ended.warnings.sort_by_cached_key(|warning| plan.node(&warning.node));
    run.ended.signs.sort_by_cached_key(|sign| plan.node(&sign.node));
    found.into_iter().next()
}

/// Whether no value came to a node, or from a source.
fn is_unfed(plan: &Plan, run: &Finished, node: usize) -> bool {
    let stats = &run.ended.nodes[node];
    match plan.nodes[node].role {
        Role::Node => stats.items == stats.unfed,
        _ => run.outputs[node].iter().all(|wire| wire.n_values == 0),
    }
}

/// Whether the graph says that nothing may come to the node.
fn may_be_unfed(plan: &Plan, run: &Finished, node: usize) -> bool {
    if plan.nodes[node].inputs.iter().any(|input| input.may_stay_empty) {
        return true;
    }
    let upstream = plan.upstream(node);
    (0..plan.nodes.len()).filter(|node| upstream[*node]).any(|source| {
        let ports = plan.nodes[source].declared.iter().zip(plan.outputs(source));
        let mut unsent =
            ports.filter(|(port, id)| port.params["optional"] == true && run.outputs[source][id.port].n_values == 0);
        unsent.any(|(_, id)| source == node || plan.consumers(id).any(|link| upstream[link.to_node]))
    })
}

fn sign(plan: &Plan, run: &Finished, node: usize) -> Sign {
    let stats = &run.ended.nodes[node];
    let cause = match (&stats.last_empty, plan.nodes[node].role, stats.items) {
        (Some(empty), _, 1) => format!("its only item was empty, as node \"{}\" says: {}", empty.node, empty.reason),
        (Some(empty), _, n) => {
            format!("each of its {n} items was empty, the last one as node \"{}\" says: {}", empty.node, empty.reason)
        }
        (None, Role::Node, _) => never_fired(plan, run, node).1,
        (None, ..) => format!("no value ever came from it"),
    };
    let remedy = match plan.nodes[node].outputs.is_empty() {
        true => {
            "; if a run may end so, write optional = true beside the wire, as in { from = \"node.port\", optional = true }"
        }
        false => "",
    };
    let reason = format!("nothing came: {cause}{remedy}");
    Sign { node: plan.nodes[node].name.to_string(), rule: NOTHING_CAME.into(), reason, item: stats.items, n: 1 }
}
