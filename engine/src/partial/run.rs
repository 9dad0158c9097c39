//! A partial run: plays the items of finished nodes and computes the others.

use super::{NodeMode, Player, reduce_in_memory, reduced_indices};
use crate::{
    options::RunOptions,
    plan::Plan,
    run::{Finished, FullRun, RunError, RunReport, WireItems, run_part},
    runtime::{Failure, NodeStats, Observer, Replayed, RunOutcome, Sign, Substitutes, Warning},
};
use osteoflow_node::{Body, Item, Registry};
use std::sync::Arc;

/// Items of a node from an earlier run.
pub(crate) struct FinishedNode {
    /// Every item of each output.
    pub(crate) outputs: Vec<WireItems>,
    pub(crate) stats: NodeStats,
    pub(crate) warnings: Vec<Warning>,
    pub(crate) signs: Vec<Sign>,
}

impl FinishedNode {
    /// Takes a node from a run of the whole plan.
    pub(crate) fn of(finished: &Finished, plan: &Plan, index: usize) -> Self {
        let of_node = finished.ended.warnings.iter().filter(|warning| *warning.node == *plan.nodes[index].name);
        Self {
            outputs: finished.outputs[index].clone(),
            stats: finished.ended.nodes[index].clone(),
            warnings: of_node.cloned().collect(),
            signs: finished.ended.signs.iter().filter(|sign| *sign.node == *plan.nodes[index].name).cloned().collect(),
        }
    }

    /// Size of its items in memory.
    pub(crate) fn n_bytes(&self) -> u64 {
        let body = |item: &Item| match &item.body {
            Body::Value(value) => value.n_bytes(),
            Body::Empty(_) => 0,
        };
        let items = self.outputs.iter().flat_map(|wire| &wire.items);
        (size_of::<Self>() + items.map(|item| size_of::<Item>() + body(item)).sum::<usize>()) as u64
    }
}

/// A plan with some finished nodes.
pub(crate) struct PartialRun<'a> {
    plan: &'a Plan,
    left: &'a [Option<Arc<FinishedNode>>],
    parts: Vec<NodeMode>,
    reduced_indices: Vec<Option<usize>>,
}

impl<'a> PartialRun<'a> {
    /// Computes the nodes that are not finished; a finished node is played if a computed node takes its items.
    pub(crate) fn new(plan: &'a Plan, left: &'a [Option<Arc<FinishedNode>>]) -> Self {
        let feeds =
            |index| plan.outputs(index).flat_map(|id| plan.consumers(id)).any(|link| left[link.to_node].is_none());
        let part = |index: usize| match &left[index] {
            None => NodeMode::Computed,
            Some(_) if feeds(index) => NodeMode::Played,
            Some(_) => NodeMode::LeftOut,
        };
        let parts: Vec<_> = (0..plan.nodes.len()).map(part).collect();
        let reduced_indices = reduced_indices(&parts);
        Self { plan, left, parts, reduced_indices }
    }

    /// Runs it and writes results of the whole plan; `finished` receives the result as of a run of the whole plan and
    /// may change it.
    ///
    /// # Errors
    /// As [`crate::run()`].
    pub(crate) fn run(
        &self,
        registry: &Registry,
        options: &RunOptions,
        observer: &dyn Observer,
        about: Option<serde_json::Value>,
        finished: &mut dyn FnMut(Finished) -> Finished,
    ) -> Result<RunReport, RunError> {
        let replayed = Replayed { substitutes: self.players(), ..Replayed::default() };
        let mut complete = |part| finished(self.complete(part));
        let whole = FullRun { plan: self.plan, complete: &mut complete, about };
        run_part(&reduce_in_memory(self.plan, &self.parts), registry, options, observer, replayed, None, Some(whole))
    }

    /// Players of the items that computed nodes take.
    fn players(&self) -> Substitutes {
        let mut players = Substitutes::new();
        for (index, left) in self.left.iter().enumerate().filter(|(index, _)| self.parts[*index] == NodeMode::Played) {
            let (Some(left), Some(reduced_index)) = (left, self.reduced_indices[index]) else { continue };
            let wanted = |id| self.plan.consumers(id).any(|link| self.parts[link.to_node] == NodeMode::Computed);
            let ports = self.plan.outputs(index).zip(&left.outputs);
            let ports = ports.map(|(id, kept)| if wanted(id) { kept.items.clone() } else { Vec::new() }.into());
            players.insert(reduced_index, Box::new(Player { ports: ports.collect(), failure: None, pace: None }));
        }
        players
    }

    /// Completes the result by the items of nodes that were not computed; links are not included.
    fn complete(&self, part: Finished) -> Finished {
        let Finished { ended: part, outputs: of_part, saved } = part;
        let whole: Vec<usize> =
            (0..self.reduced_indices.len()).filter(|index| self.reduced_indices[*index].is_some()).collect();
        let moved = |failure: Failure| Failure { node: whole[failure.node], ..failure };
        let mut of_part: Vec<_> = of_part.into_iter().zip(part.nodes).map(Some).collect();
        let (mut outputs, mut nodes) = (Vec::new(), Vec::new());
        for (index, left) in self.left.iter().enumerate() {
            let left = match left {
                Some(left) => Some((left.outputs.clone(), left.stats.clone())),
                None => self.reduced_indices[index].and_then(|reduced_index| of_part[reduced_index].take()),
            };
            let (kept, stats) = left.expect("each node was computed in this run or in another");
            outputs.push(kept);
            nodes.push(stats);
        }
        let before = self.left.iter().flatten().flat_map(|left| &left.warnings).cloned();
        let mut warnings: Vec<_> = before.chain(part.warnings).collect();
        warnings.sort_by_cached_key(|warning| self.plan.node(&warning.node));
        let mut signs: Vec<_> =
            self.left.iter().flatten().flat_map(|left| &left.signs).cloned().chain(part.signs).collect();
        signs.sort_by_cached_key(|sign| self.plan.node(&sign.node));
        let failures = part.failures.into_iter().map(moved).collect();
        let n_items = outputs.iter().map(|wires| wires.iter().map(|wire: &WireItems| wire.n_items).collect()).collect();
        let n_values =
            outputs.iter().map(|wires| wires.iter().map(|wire: &WireItems| wire.n_values).collect()).collect();
        let ended =
            RunOutcome { n_items, n_values, nodes, warnings, signs, failures, stall: part.stall.map(moved), ..part };
        Finished { ended, outputs, saved }
    }
}
