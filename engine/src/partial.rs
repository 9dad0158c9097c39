//! Partial runs: which nodes are computed, which are played from available items, and the reduced plan.

mod player;
mod run;

pub(crate) use player::{Failing, Pace, Player};
pub(crate) use run::{FinishedNode, PartialRun};

use crate::plan::{Link, OutputId, Plan, Policy, ResultEntry};
use osteoflow_node::Role;

/// What a partial run does with a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NodeMode {
    /// It is built and fires.
    Computed,
    /// Its items are played instead.
    Played,
    /// It is left out: it is not needed, or has no items.
    LeftOut,
}

/// Index of each node in the reduced plan; `None` for nodes left out.
pub(crate) fn reduced_indices(parts: &[NodeMode]) -> Vec<Option<usize>> {
    let mut n = 0;
    let reduced_index = |part: &NodeMode| {
        (*part != NodeMode::LeftOut).then(|| {
            n += 1;
            n - 1
        })
    };
    parts.iter().map(reduced_index).collect()
}

/// Reduces the plan: played nodes lose their inputs, and nodes left out are removed.
pub(crate) fn reduce(plan: &Plan, parts: &[NodeMode]) -> Plan {
    let reduced_index = reduced_indices(parts);
    let (mut nodes, mut links) = (Vec::new(), Vec::new());
    for (index, node) in plan.nodes.iter().enumerate().filter(|(index, _)| parts[*index] != NodeMode::LeftOut) {
        let mut node = node.clone();
        node.outputs.iter_mut().for_each(|output| output.links.clear());
        match parts[index] {
            NodeMode::Computed => node.inputs.iter_mut().for_each(|input| input.links.clear()),
            _ => (node.inputs, node.role) = (Vec::new(), Role::Source),
        }
        nodes.push(node);
    }
    let moved = |id: OutputId| Some(OutputId { node: reduced_index[id.node]?, port: id.port });
    for (index, _) in plan.nodes.iter().enumerate().filter(|(index, _)| parts[*index] == NodeMode::Computed) {
        for link in plan.links_into(index) {
            let (Some(from), Some(to_node)) = (moved(link.from), reduced_index[index]) else { continue };
            nodes[from.node].outputs[from.port].links.push(links.len());
            nodes[to_node].inputs[link.to_port].links.push(links.len());
            links.push(Link { from, to_node, ..link.clone() });
        }
    }
    let mut reduced = Plan { nodes, links, ..plan.clone() };
    reduced.record = plan.record.iter().filter_map(|id| moved(*id)).collect();
    let results = plan.results.iter().filter_map(|entry| Some((entry, moved(entry.from)?)));
    reduced.results = results.map(|(entry, from)| ResultEntry { from, ..entry.clone() }).collect();
    reduced
}

/// Like [`reduce`], for played items that are in memory already: their wires are unbounded in bytes.
pub(crate) fn reduce_in_memory(plan: &Plan, parts: &[NodeMode]) -> Plan {
    let mut reduced = reduce(plan, parts);
    let played: Vec<_> =
        parts.iter().filter(|part| **part != NodeMode::LeftOut).map(|part| *part == NodeMode::Played).collect();
    let links = reduced.links.iter_mut().filter(|link| played[link.from.node] && link.policy == Policy::Block);
    links.for_each(|link| link.max_bytes = u64::MAX);
    reduced
}
