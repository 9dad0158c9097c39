//! Sinks to which no value came in a whole run: it did not write or send what its graph says.

use super::{Finished, results::never_fired};
use crate::{
    plan::{Plan, PlanNode},
    runtime::{Sign, Warning},
};
use osteoflow_node::Role;

/// Rule of the sign that no value came to a sink, or to a graph.
pub(crate) const NOTHING_CAME: &str = "nothing_came";

/// Adds a sign and a warning for each sink to which no value came; returns the first. A graph without sinks and required results
/// is judged by the nodes whose outputs feed no other node, and only if nothing came to any of them.
///
/// An input that its node can do without is judged by the node, as long as another one brought a value. Nothing need come of an
/// optional stream that a source does not have.
pub(super) fn note(plan: &Plan, run: &mut Finished) -> Option<(usize, Sign)> {
    let is_sink = |node: &PlanNode| node.outputs.is_empty() && node.inputs.iter().any(|input| !input.links.is_empty());
    let is_end = |node: &PlanNode| node.outputs.iter().all(|output| output.links.is_empty());
    let has_sinks = plan.nodes.iter().any(is_sink);
    let by_ends = !has_sinks && plan.results.iter().all(|entry| entry.optional);
    let is_judged = |node: &PlanNode| if by_ends { is_end(node) } else { is_sink(node) };
    let judged: Vec<_> = (0..plan.nodes.len()).filter(|node| is_judged(&plan.nodes[*node])).collect();
    let mut unfed: Vec<_> = judged.iter().copied().filter(|node| is_unfed(plan, run, *node)).collect();
    if by_ends && unfed.len() < judged.len() {
        return None;
    }
    unfed.retain(|node| !lacks_optional_stream(plan, run, *node));
    for sign in unfed.iter().map(|node| sign(plan, run, *node)).collect::<Vec<_>>() {
        let (node, message) = (sign.node.clone(), format!("{} [{NOTHING_CAME}]", sign.reason));
        run.ended.warnings.push(Warning { node, item: sign.item, message });
        run.ended.signs.push(sign);
    }
    run.ended.warnings.sort_by_cached_key(|warning| plan.node(&warning.node));
    run.ended.signs.sort_by_cached_key(|sign| plan.node(&sign.node));
    unfed.first().map(|node| (*node, sign(plan, run, *node)))
}

/// Whether no value came to a node, or from a source.
fn is_unfed(plan: &Plan, run: &Finished, node: usize) -> bool {
    let stats = &run.ended.nodes[node];
    match plan.nodes[node].role {
        Role::Node => stats.items == stats.unfed,
        _ => run.outputs[node].iter().all(|wire| wire.n_values == 0),
    }
}

/// Whether a node follows from an output of a source that the graph declares optional, and on which no value came.
fn lacks_optional_stream(plan: &Plan, run: &Finished, node: usize) -> bool {
    let upstream = plan.upstream(node);
    plan.all_outputs().filter(|id| upstream[id.node]).any(|id| {
        let declared = plan.nodes[id.node].declared.get(id.port);
        declared.is_some_and(|port| port.params["optional"] == true)
            && run.outputs[id.node][id.port].n_values == 0
            && (id.node == node || plan.consumers(id).any(|link| upstream[link.to_node]))
    })
}

fn sign(plan: &Plan, run: &Finished, node: usize) -> Sign {
    let stats = &run.ended.nodes[node];
    let cause = match (&stats.last_empty, plan.nodes[node].role) {
        (Some(empty), _) => {
            let n = stats.items;
            let items =
                if n == 1 { "the only item was empty" } else { &format!("all {n} items were empty, the last one") };
            format!("{items} since node \"{}\" gave none: {}", empty.node, empty.reason)
        }
        (None, Role::Node) => never_fired(plan, run, node).1,
        (None, _) => "no value ever came from it".into(),
    };
    let (node, reason) = (stats.name.clone(), format!("nothing came: {cause}"));
    Sign { node, rule: NOTHING_CAME.into(), reason, item: stats.items, n: 1 }
}
