//! Selects the nodes to compute and the wires to play.

use crate::{
    partial::NodeMode,
    plan::{OutputId, Plan, PlanNode},
};
use osteoflow_node::Role;
use std::collections::BTreeSet;

/// Computes every node except the sources; a source whose wires were not recorded is run if `runs` allows it.
///
/// # Errors
/// A wire of a source that is needed and was not recorded.
pub(super) fn all(
    plan: &Plan,
    recorded: &BTreeSet<OutputId>,
    runs: impl Fn(usize) -> bool,
) -> Result<Vec<NodeMode>, OutputId> {
    let part = |(index, node): (usize, &PlanNode)| {
        if node.role == Role::Node {
            return Ok(NodeMode::Computed);
        }
        let missing = plan.outputs(index).find(|id| !recorded.contains(id));
        match missing {
            None => Ok(NodeMode::Played),
            Some(_) if runs(index) => Ok(NodeMode::Computed),
            // An output without consumers is not missed.
            Some(_) if plan.outputs(index).all(|id| recorded.contains(&id) || !is_used(plan, id)) => {
                Ok(NodeMode::Played)
            }
            Some(wire) => Err(wire),
        }
    };
    plan.nodes.iter().enumerate().map(part).collect()
}

/// Computes the node and all nodes downstream. Other inputs of these are played; where they were not recorded, they are
/// computed from the nearest recorded wires upstream.
///
/// # Errors
/// A wire of a source that is needed and was not recorded.
pub(super) fn from(
    plan: &Plan,
    recorded: &BTreeSet<OutputId>,
    node: usize,
    runs: impl Fn(usize) -> bool,
) -> Result<Vec<NodeMode>, OutputId> {
    let mut computed = vec![false; plan.nodes.len()];
    computed[node] = true;
    plan.mark_downstream(&mut computed);
    let is_missing = |computed: &[bool], index: usize| {
        let needed = plan.outputs(index).filter(|id| plan.consumers(*id).any(|link| computed[link.to_node]));
        (!computed[index]).then_some(needed)?.find(|id| !recorded.contains(id))
    };
    // Again from the end after each node: it may be fed by a later one, in a cycle.
    while let Some((index, wire)) =
        (0..plan.nodes.len()).rev().find_map(|index| Some((index, is_missing(&computed, index)?)))
    {
        if plan.nodes[index].role != Role::Node && !runs(index) {
            return Err(wire);
        }
        computed[index] = true;
    }
    let part = |index: usize| match computed[index] {
        true => NodeMode::Computed,
        false if plan.outputs(index).any(|id| recorded.contains(&id)) => NodeMode::Played,
        false => NodeMode::LeftOut,
    };
    Ok((0..plan.nodes.len()).map(part).collect())
}

/// Whether a node or a result takes the output.
pub(super) fn is_used(plan: &Plan, id: OutputId) -> bool {
    plan.consumers(id).next().is_some() || plan.results.iter().any(|entry| entry.from == id)
}
