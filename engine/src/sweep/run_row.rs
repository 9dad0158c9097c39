//! One run of a sweep: what other runs have left already is played, the rest is computed.

use super::share::Left;
use crate::{
    part::{self, Part, Player},
    plan::{Plan, Policy},
    results::{Ended, Kept},
    run::{Failure, Replayed, RunError, RunOptions, RunReport, Substitutes, Whole, run_part},
};
use osteoflow_node::Registry;
use std::{collections::BTreeMap, sync::Arc};

/// Runs a plan of whose nodes some have left their items already; answers its report, and what the others have left where
/// they came to their end soundly.
pub(super) fn run(
    plan: &Plan,
    registry: &Registry,
    options: &RunOptions,
    shared: &[Option<Arc<Left>>],
) -> (Result<RunReport, RunError>, Vec<Option<Left>>) {
    let part = OfRun::new(plan, shared);
    let reduced = part.reduced();
    let replayed = Replayed { substitutes: part.players(), ..Replayed::default() };
    let mut left = Vec::new();
    let mut complete = |ended: Ended| {
        let ended = part.complete(ended);
        left = part.left(&ended);
        ended
    };
    let whole = Whole { plan, complete: &mut complete, about: None };
    let report = run_part(&reduced, registry, options, &(), replayed, None, Some(whole));
    (report, left)
}

struct OfRun<'a> {
    plan: &'a Plan,
    shared: &'a [Option<Arc<Left>>],
    parts: Vec<Part>,
    places: Vec<Option<usize>>,
}

impl<'a> OfRun<'a> {
    fn new(plan: &'a Plan, shared: &'a [Option<Arc<Left>>]) -> Self {
        let feeds = |index| {
            let mut links = part::outputs(plan, index).flat_map(|id| part::consumers(plan, id));
            links.any(|link| shared[link.to_node].is_none())
        };
        let part = |index: usize| match &shared[index] {
            None => Part::Computed,
            Some(_) if feeds(index) => Part::Played,
            Some(_) => Part::Left,
        };
        let parts: Vec<_> = (0..plan.nodes.len()).map(part).collect();
        let places = part::places(&parts);
        Self { plan, shared, parts, places }
    }

    /// What is played lies in memory already, so that it may wait on its wires however large it is.
    fn reduced(&self) -> Plan {
        let mut reduced = part::reduce(self.plan, &self.parts);
        let taking = self.parts.iter().filter(|part| **part != Part::Left);
        let played: Vec<_> = taking.map(|part| *part == Part::Played).collect();
        let links = reduced.links.iter_mut().filter(|link| played[link.from.node] && link.policy == Policy::Block);
        links.for_each(|link| link.max_bytes = u64::MAX);
        reduced
    }

    fn players(&self) -> Substitutes {
        let mut players = Substitutes::new();
        for (index, shared) in self.shared.iter().enumerate().filter(|(index, _)| self.parts[*index] == Part::Played) {
            let (Some(left), Some(place)) = (shared, self.places[index]) else { continue };
            let wanted = |id| part::consumers(self.plan, id).any(|link| self.parts[link.to_node] == Part::Computed);
            let ports = part::outputs(self.plan, index).zip(&left.outputs);
            let ports = ports.map(|(id, kept)| if wanted(id) { kept.items().to_vec() } else { Vec::new() }.into());
            players.insert(place, Box::new(Player { ports: ports.collect(), failure: None, pace: None }));
        }
        players
    }

    /// What a run of the whole graph would have left.
    fn complete(&self, part: Ended) -> Ended {
        let whole: Vec<usize> = (0..self.places.len()).filter(|index| self.places[*index].is_some()).collect();
        let moved = |failure: Failure| Failure { node: whole[failure.node], ..failure };
        let mut of_part: Vec<_> = part.outputs.into_iter().zip(part.nodes).map(Some).collect();
        let (mut outputs, mut nodes) = (Vec::new(), Vec::new());
        for (index, shared) in self.shared.iter().enumerate() {
            let left = match shared {
                Some(left) => Some((left.outputs.clone(), left.stats.clone())),
                None => self.places[index].and_then(|place| of_part[place].take()),
            };
            let (kept, stats): (Vec<Kept>, _) = left.expect("each node was computed in this run or in another");
            outputs.push(kept);
            nodes.push(stats);
        }
        let before = self.shared.iter().flatten().flat_map(|left| &left.warnings).cloned();
        let mut warnings: Vec<_> = before.chain(part.warnings).collect();
        let place: BTreeMap<&str, usize> =
            self.plan.nodes.iter().enumerate().map(|(k, node)| (&*node.name, k)).collect();
        warnings.sort_by_key(|warning| place.get(warning.node.as_str()).copied());
        let failures = part.failures.into_iter().map(moved).collect();
        Ended { outputs, nodes, warnings, failures, stall: part.stall.map(moved), ..part }
    }

    /// What each computed node has left, where it and all before it came to their end.
    fn left(&self, ended: &Ended) -> Vec<Option<Left>> {
        let cut_short = ended.interrupted || ended.stall.is_some();
        let mut unsound: Vec<bool> = (0..self.plan.nodes.len())
            .map(|index| cut_short || ended.failures.iter().any(|failure| failure.node == index))
            .collect();
        part::follow(self.plan, &mut unsound);
        let left = |(index, node): (usize, &crate::plan::PlanNode)| {
            (self.parts[index] == Part::Computed && !unsound[index]).then(|| Left {
                outputs: ended.outputs[index].clone(),
                stats: ended.nodes[index].clone(),
                warnings: ended.warnings.iter().filter(|warning| *warning.node == *node.name).cloned().collect(),
            })
        };
        self.plan.nodes.iter().enumerate().map(left).collect()
    }
}
