//! What a range of a recording does not change.

use super::{ReplayError, ReplayOptions, select};
use crate::{
    graph::written::sets,
    partial::NodeMode,
    plan::{OutputId, Plan},
    recording::Recording,
};
use osteoflow_node::{Join, Registry, Role, StampNs};
use std::{collections::BTreeSet, sync::Arc};

/// Plays the computed nodes that a range of the recording does not change, by name: those that gave one answer for the whole
/// run or had given all before `start`, such as a calibration or a registration. From the items of a part they could not be
/// computed. A node that `--set` changes, or one after it, is computed.
pub(super) fn play_what_does_not_change(
    plan: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    registry: &Registry,
    recorded: &BTreeSet<OutputId>,
    parts: &mut [NodeMode],
) -> Result<BTreeSet<Arc<str>>, ReplayError> {
    let mut unchanged = BTreeSet::new();
    if (changes.start.is_none() && changes.end.is_none()) || changes.graph.is_some() || changes.from.is_some() {
        return Ok(unchanged);
    }
    let stamps = |id: OutputId| -> Result<Vec<StampNs>, ReplayError> {
        Ok(recording.items(&plan.wire_name(id), registry)?.iter().map(|item| item.stamp_ns).collect())
    };
    let mut first_ns = None;
    for id in recorded.iter().filter(|id| parts[id.node] == NodeMode::Played) {
        first_ns = first_ns.into_iter().chain(stamps(*id)?.into_iter().filter(|stamp_ns| *stamp_ns > 0)).min();
    }
    let start_ns = changes.start.map_or(StampNs::MIN, |start| start.stamp(first_ns.unwrap_or(0)));
    let mut changed: Vec<_> =
        plan.nodes.iter().map(|node| changes.sets.iter().any(|set| sets(set, &node.name))).collect();
    plan.mark_downstream(&mut changed);
    for (index, node) in plan.nodes.iter().enumerate() {
        let used: Vec<_> = plan.outputs(index).filter(|id| select::is_used(plan, *id)).collect();
        let is_computed = parts[index] == NodeMode::Computed && node.role == Role::Node && !changed[index];
        if !is_computed || used.is_empty() || !used.iter().all(|id| recorded.contains(id)) {
            continue;
        }
        // What nothing but a result takes is decided by what has consumers.
        let consumed: Vec<_> = used.iter().copied().filter(|id| plan.consumers(*id).next().is_some()).collect();
        let (mut n_items, mut is_stream) = (0, false);
        for id in if consumed.is_empty() { used } else { consumed } {
            let stamps = stamps(id)?;
            n_items += stamps.len();
            let is_whole = stamps.len() == 1
                || stamps.iter().all(|stamp_ns| *stamp_ns < start_ns)
                || is_taken(plan, id, |join| {
                    matches!(join, Join::Once | Join::Collect { n: Some(_) } | Join::CollectEvery { .. })
                });
            is_stream |= !is_whole;
        }
        if n_items > 0 && !is_stream {
            parts[index] = NodeMode::Played;
            unchanged.insert(node.name.clone());
        }
    }
    // A cycle is played or computed as a whole.
    let cycles = plan.cycles();
    for index in 0..plan.nodes.len() {
        let is_split = |other: &usize| cycles[*other] == cycles[index] && parts[*other] == NodeMode::Computed;
        if unchanged.contains(&plan.nodes[index].name) && (0..plan.nodes.len()).any(|other| is_split(&other)) {
            parts[index] = NodeMode::Computed;
            unchanged.remove(&plan.nodes[index].name);
        }
    }
    Ok(unchanged)
}

/// Whether every consumer of the output takes one item for the whole run.
pub(super) fn is_constant(plan: &Plan, id: OutputId) -> bool {
    is_taken(plan, id, |join| *join == Join::Once)
}

/// Whether the output has consumers, all of which take it so.
fn is_taken(plan: &Plan, id: OutputId, so: impl Fn(&Join) -> bool) -> bool {
    let mut links = plan.consumers(id).peekable();
    links.peek().is_some() && links.all(|link| so(&plan.nodes[link.to_node].inputs[link.to_port].port.join))
}
