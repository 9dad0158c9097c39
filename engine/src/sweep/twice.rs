//! Runs that are computed twice, which finds kinds whose answers are not decided by inputs, parameters and seed.

use super::{Done, Run, Spec, table::at_path};
use crate::{partial::FinishedNode, plan::Plan, recording::codec};
use osteoflow_node::{Item, PortPayload, Registry};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A node that answered otherwise the second time, though all that it was given was the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unsteady {
    /// The node.
    pub node: String,
    /// Its kind.
    pub kind: String,
    /// By how much the columns of the sweep differ, where they do.
    pub columns: BTreeMap<String, f64>,
}

/// The runs that are computed twice: a share of them, and the first run with each kind. They are counted repeat by repeat, so that
/// all shards, a resumed sweep and one with more repeats choose the same.
pub(super) fn chosen(runs: &[Run], n_repeats: usize, share: f64) -> BTreeSet<usize> {
    let Some(every) = every(share) else { return BTreeSet::new() };
    let mut kinds = BTreeSet::new();
    let mut is_first = |run: &Run| run.plan.nodes.iter().filter(|node| kinds.insert(node.kind.clone())).count() > 0;
    let by_repeat = (0..n_repeats).flat_map(|repeat| (repeat..runs.len()).step_by(n_repeats)).enumerate();
    by_repeat.filter_map(|(at, run)| (is_first(&runs[run]) || at.is_multiple_of(every)).then_some(run)).collect()
}

/// One run in this many is computed twice; `None` if none is.
pub(super) fn every(share: f64) -> Option<usize> {
    (share > 0.0).then(|| (1.0 / share).round().max(1.0) as usize)
}

/// The nodes that gave other items in the second run than in the first, though nothing upstream did; none that declares itself
/// unsteady. `None` for a node that did not end in one of the runs.
pub(super) fn compare(
    plan: &Plan,
    registry: &Registry,
    first: &[Option<&FinishedNode>],
    second: &[Option<FinishedNode>],
) -> Vec<usize> {
    let cycles = plan.cycles();
    let pairs = first.iter().zip(second);
    // A node that did not end differs from the first item on.
    let differs: Vec<Option<usize>> = pairs
        .map(|(first, second)| first.zip(second.as_ref()).map_or(Some(0), |(a, b)| first_difference(a, b)))
        .collect();
    let is_unsteady = |index: &usize| {
        let Some(item) = differs[*index] else { return false };
        let upstream = plan.upstream(*index);
        let comes_from = |other: usize| match differs[other] {
            // In a cycle all nodes follow each other: the one that differs at the earliest item differs by itself.
            Some(earlier) if cycles[other] == cycles[*index] => (earlier, other) < (item, *index),
            differs => differs.is_some(),
        };
        let is_declared = || registry.kind(&plan.nodes[*index].kind).is_some_and(|kind| kind.description.unsteady);
        let ended = first[*index].is_some() && second[*index].is_some();
        ended && !(0..plan.nodes.len()).any(|other| upstream[other] && comes_from(other)) && !is_declared()
    };
    (0..plan.nodes.len()).filter(is_unsteady).collect()
}

/// The number of the first item in which a node's outputs differ.
fn first_difference(first: &FinishedNode, second: &FinishedNode) -> Option<usize> {
    let outputs = first.outputs.iter().zip(&second.outputs);
    let of_wires = outputs.filter_map(|(first, second)| {
        let n_items = first.items.len().min(second.items.len());
        let same = first.items.iter().zip(&second.items).take_while(|(a, b)| bytes(a) == bytes(b)).count();
        (same < n_items || first.items.len() != second.items.len()).then_some(same)
    });
    of_wires.min()
}

fn bytes(item: &Item) -> Vec<u8> {
    codec::parts_on(PortPayload::Any, item).slices().flatten().copied().collect()
}

/// What is said of the nodes, with the differences of the sweep's columns.
pub(super) fn unsteady(spec: &Spec, plan: &Plan, nodes: &[usize], first: &Done, second: &Done) -> Vec<Unsteady> {
    let number = |done: &Done, path: &str| at_path(&done.results, path).and_then(serde_json::Value::as_f64);
    let difference = |path: &str| Some((number(second, path)? - number(first, path)?).abs());
    let columns = spec.columns.iter().filter(|column| !column.is_time());
    let columns = columns.filter_map(|column| Some((column.name.clone(), difference(&column.path)?)));
    let columns: BTreeMap<_, _> = columns.filter(|(_, difference)| *difference > 0.0).collect();
    let node = |index: &usize| {
        let node = &plan.nodes[*index];
        Unsteady { node: node.name.to_string(), kind: node.kind.to_string(), columns: columns.clone() }
    };
    nodes.iter().map(node).collect()
}
