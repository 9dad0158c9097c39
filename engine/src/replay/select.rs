//! What of a graph is computed anew and what is played from the recording.

use crate::plan::{Link, OutputId, Plan, PlanNode};
use osteoflow_node::Role;
use std::collections::BTreeSet;

/// What a replay does with each node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// It is built and fires.
    Computed,
    /// Its recorded items are played in its place.
    Played,
    /// Nothing that is wanted needs it, or nothing of it was recorded.
    Left,
}

/// Every node but the sources is computed; a source whose wires were not recorded is run, where `runs` allows it.
///
/// # Errors
/// A wire of a source that is needed and was not recorded.
pub(super) fn all(
    plan: &Plan,
    recorded: &BTreeSet<OutputId>,
    runs: impl Fn(usize) -> bool,
) -> Result<Vec<Part>, OutputId> {
    let part = |(index, node): (usize, &PlanNode)| {
        if node.role == Role::Node {
            return Ok(Part::Computed);
        }
        let missing = outputs(plan, index).find(|id| !recorded.contains(id));
        match missing {
            None => Ok(Part::Played),
            Some(_) if runs(index) => Ok(Part::Computed),
            // A port that leads nowhere is not missed.
            Some(_) if outputs(plan, index).all(|id| recorded.contains(&id) || !is_used(plan, id)) => Ok(Part::Played),
            Some(wire) => Err(wire),
        }
    };
    plan.nodes.iter().enumerate().map(part).collect()
}

/// The node and all that follows from it are computed. What enters these from elsewhere is played; what of it was not
/// recorded is computed too, from the nearest recorded wires upstream.
///
/// # Errors
/// A wire of a source that is needed and was not recorded.
pub(super) fn from(
    plan: &Plan,
    recorded: &BTreeSet<OutputId>,
    node: usize,
    runs: impl Fn(usize) -> bool,
) -> Result<Vec<Part>, OutputId> {
    let mut computed = vec![false; plan.nodes.len()];
    computed[node] = true;
    // The nodes stand in topological order.
    for index in node..plan.nodes.len() {
        computed[index] = computed[index] || sources_of(plan, index).any(|id| computed[id.node]);
    }
    for index in (0..plan.nodes.len()).rev().filter(|index| *index != node) {
        let needed = || outputs(plan, index).filter(|id| consumers(plan, *id).any(|link| computed[link.to_node]));
        let Some(wire) = (!computed[index]).then(needed).and_then(|mut ids| ids.find(|id| !recorded.contains(id)))
        else {
            continue;
        };
        if plan.nodes[index].role != Role::Node && !runs(index) {
            return Err(wire);
        }
        computed[index] = true;
    }
    let part = |index: usize| match computed[index] {
        true => Part::Computed,
        false if outputs(plan, index).any(|id| recorded.contains(&id)) => Part::Played,
        false => Part::Left,
    };
    Ok((0..plan.nodes.len()).map(part).collect())
}

/// The plan of what takes part: what is played has no inputs any more, what is left is gone.
pub(super) fn reduce(plan: &Plan, parts: &[Part]) -> Plan {
    let mut place = vec![None; plan.nodes.len()];
    let (mut nodes, mut links) = (Vec::new(), Vec::new());
    for (index, node) in plan.nodes.iter().enumerate().filter(|(index, _)| parts[*index] != Part::Left) {
        place[index] = Some(nodes.len());
        let mut node = node.clone();
        node.outputs.iter_mut().for_each(|output| output.links.clear());
        match parts[index] {
            Part::Computed => node.inputs.iter_mut().for_each(|input| input.link = None),
            _ => (node.inputs, node.role) = (Vec::new(), Role::Source),
        }
        nodes.push(node);
    }
    let moved = |id: OutputId| Some(OutputId { node: place[id.node]?, port: id.port });
    for (index, _) in plan.nodes.iter().enumerate().filter(|(index, _)| parts[*index] == Part::Computed) {
        for input in &plan.nodes[index].inputs {
            let Some(link) = input.link.map(|link| &plan.links[link]) else { continue };
            let (Some(from), Some(to_node)) = (moved(link.from), place[index]) else { continue };
            nodes[from.node].outputs[from.port].links.push(links.len());
            nodes[to_node].inputs[link.to_port].link = Some(links.len());
            links.push(Link { from, to_node, ..link.clone() });
        }
    }
    let mut reduced = Plan { nodes, links, ..plan.clone() };
    reduced.record = plan.record.iter().filter_map(|id| moved(*id)).collect();
    let results = plan.results.iter().filter_map(|entry| Some((entry, moved(entry.from)?)));
    reduced.results = results.map(|(entry, from)| crate::plan::ResultEntry { from, ..entry.clone() }).collect();
    reduced
}

/// The node's outputs.
pub(super) fn outputs(plan: &Plan, node: usize) -> impl Iterator<Item = OutputId> {
    (0..plan.nodes[node].outputs.len()).map(move |port| OutputId { node, port })
}

/// The links that an output feeds.
pub(super) fn consumers(plan: &Plan, id: OutputId) -> impl Iterator<Item = &Link> {
    plan.nodes[id.node].outputs[id.port].links.iter().map(|link| &plan.links[*link])
}

fn sources_of(plan: &Plan, node: usize) -> impl Iterator<Item = OutputId> + '_ {
    plan.nodes[node].inputs.iter().filter_map(|input| Some(plan.links[input.link?].from))
}

fn is_used(plan: &Plan, id: OutputId) -> bool {
    consumers(plan, id).next().is_some() || plan.results.iter().any(|entry| entry.from == id)
}
