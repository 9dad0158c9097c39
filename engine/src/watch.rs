//! Runs a graph again and again as it changes: what has not changed keeps its items, and the rest is computed from them.
//!
//! A run is a function of its inputs, so a node whose kind, parameters, files and wiring are what they were, and before
//! which nothing has changed, would give the items that it gave; a rerun plays them to the nodes that have changed and to
//! all that follows from those. What it leaves in `results.json` is bit for bit what a run of the whole graph would leave.
//! Wires whose policy may lose items and nodes that take from the clock are no such functions, here as in any run.
//!
//! Every item of every wire of the last run is kept in memory for it.

mod changes;
mod files;
#[cfg(test)]
mod tests;

pub use changes::Change;
pub use files::Stamps;

use crate::{
    part::{self, Part, Player},
    plan::{Plan, Policy},
    results::{Ended, Kept},
    run::{
        Failure, LinkStats, NodeStats, Observer, Replayed, RunError, RunOptions, RunReport, Substitutes, Warning,
        Whole, run_part,
    },
};
use osteoflow_node::{Body, Item, Registry, Role};
use serde_json::json;
use std::{collections::BTreeMap, path::PathBuf};

/// A graph that is run again and again.
#[derive(Default)]
pub struct Session {
    memory: Option<Memory>,
}

/// What the last run has left.
struct Memory {
    plan: Plan,
    /// The files that parameters name, as they were before the run.
    files: Stamps,
    /// Where it left its files.
    out_dir: Option<PathBuf>,
    /// For each node, for each output, every item.
    outputs: Vec<Vec<Kept>>,
    /// For each node, whether it failed or was interrupted.
    unsound: Vec<bool>,
    nodes: Vec<NodeStats>,
    links: Vec<LinkStats>,
    warnings: Vec<Warning>,
}

/// What the next run is going to do.
pub struct Next {
    plan: Plan,
    files: Stamps,
    parts: Vec<Part>,
    changes: Vec<Change>,
    removed: Vec<String>,
    differs: bool,
}

impl Session {
    /// What a run of this plan has to do. The files that its parameters name are looked at now: what becomes of them later
    /// is for the run after.
    pub fn next(&self, plan: Plan) -> Next {
        let files = Stamps::of_plan(&plan);
        let n_nodes = plan.nodes.len();
        let Some(memory) = &self.memory else {
            let parts = vec![Part::Computed; n_nodes];
            return Next { plan, files, parts, changes: Vec::new(), removed: Vec::new(), differs: true };
        };
        let seed = (memory.plan.seed != plan.seed).then(|| changes::seed(memory.plan.seed, plan.seed));
        let mut computed = vec![seed.is_some(); n_nodes];
        let mut changes: Vec<_> = seed.into_iter().collect();
        for (index, change) in changes::of(memory, &plan, &files) {
            computed[index] = true;
            changes.push(change);
        }
        part::follow(&plan, &mut computed);
        let differs = computed.contains(&true) || memory.plan.resolved != plan.resolved;
        if differs {
            // What a node without outputs does lies outside the graph, such as a file in the folder of each run.
            let silent = plan.nodes.iter().map(|node| node.outputs.is_empty());
            computed.iter_mut().zip(silent).for_each(|(computed, silent)| *computed |= silent);
        }
        let feeds = |index| {
            let mut links = part::outputs(&plan, index).flat_map(|id| part::consumers(&plan, id));
            links.any(|link| computed[link.to_node])
        };
        let part = |index: usize| match computed[index] {
            true => Part::Computed,
            false if feeds(index) => Part::Played,
            false => Part::Left,
        };
        let parts = (0..n_nodes).map(part).collect();
        let removed = changes::removed(&memory.plan, &plan);
        Next { plan, files, parts, changes, removed, differs }
    }

    /// Runs what has to be computed, and leaves results and manifest of the whole graph; a recording only where every node
    /// is computed.
    ///
    /// # Errors
    /// As [`crate::run()`]; what was kept then stays.
    pub fn run(
        &mut self,
        next: Next,
        registry: &Registry,
        options: &RunOptions,
        observer: &dyn Observer,
    ) -> Result<RunReport, RunError> {
        let mut options = options.clone();
        if !next.is_whole() {
            // A part is no recording of a run, and no source has given what is played.
            (options.record, options.latency) = (false, false);
        }
        let last = self.memory.take();
        let about = last.as_ref().map(|last| {
            let after = last.out_dir.as_ref().map(|dir| dir.display().to_string());
            json!({ "kept": next.kept(), "computed": next.computed(), "after": after })
        });
        let reduced = next.reduced();
        let replayed = Replayed { substitutes: next.players(last.as_ref()), ..Replayed::default() };
        let mut memory = None;
        let mut complete = |ended: Ended| {
            let ended = next.complete(last.as_ref(), ended);
            memory = Some(next.remembered(&ended, options.out_dir.clone()));
            ended
        };
        let whole = Whole { plan: &next.plan, complete: &mut complete, about };
        let report = run_part(&reduced, registry, &options, observer, replayed, None, Some(whole));
        self.memory = memory.or(last);
        report
    }

    /// The bytes that all kept items have, as their payloads count them; of what travels on several wires, for each.
    pub fn n_bytes(&self) -> usize {
        let items = self.memory.iter().flat_map(|memory| &memory.outputs).flatten().flat_map(Kept::items);
        let n_bytes = |item: &Item| match &item.body {
            Body::Value(value) => size_of::<Item>() + value.n_bytes(),
            Body::Empty(_) => size_of::<Item>(),
        };
        items.map(n_bytes).sum()
    }
}

impl Next {
    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The files that parameters name, as they were when the plan was looked at.
    pub fn files(&self) -> &Stamps {
        &self.files
    }

    /// Whether a run would give what the last one gave: of the graph nothing has changed but its text.
    pub fn is_nothing(&self) -> bool {
        !self.differs
    }

    /// Whether every node is computed.
    pub fn is_whole(&self) -> bool {
        self.parts.iter().all(|part| *part == Part::Computed)
    }

    /// What has changed itself: the seed, then nodes in the order of the plan; nothing before the first run.
    pub fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// Nodes that the graph has no more.
    pub fn removed(&self) -> &[String] {
        &self.removed
    }

    /// The nodes that are computed, in the order of the plan.
    pub fn computed(&self) -> Vec<&str> {
        self.named(|part| part == Part::Computed)
    }

    /// The nodes whose items are those of the last run, in the order of the plan.
    pub fn kept(&self) -> Vec<&str> {
        self.named(|part| part != Part::Computed)
    }

    fn named(&self, which: impl Fn(Part) -> bool) -> Vec<&str> {
        let nodes = self.plan.nodes.iter().zip(&self.parts);
        nodes.filter(|(_, part)| which(**part)).map(|(node, _)| &*node.name).collect()
    }

    /// What runs. What is played lies in memory already, so that it may wait on its wires however large it is.
    fn reduced(&self) -> Plan {
        let mut reduced = part::reduce(&self.plan, &self.parts);
        let played: Vec<_> =
            self.parts.iter().filter(|part| **part != Part::Left).map(|p| *p == Part::Played).collect();
        let links = reduced.links.iter_mut().filter(|link| played[link.from.node] && link.policy == Policy::Block);
        links.for_each(|link| link.max_bytes = u64::MAX);
        reduced
    }

    /// What plays the kept items that computed nodes take.
    fn players(&self, last: Option<&Memory>) -> Substitutes {
        let places = part::places(&self.parts);
        let mut players = Substitutes::new();
        for (index, node) in self.plan.nodes.iter().enumerate().filter(|(index, _)| self.parts[*index] == Part::Played)
        {
            let (Some(place), Some(kept)) = (places[index], last.and_then(|last| last.outputs_of(&node.name))) else {
                continue;
            };
            let wanted = |id| part::consumers(&self.plan, id).any(|link| self.parts[link.to_node] == Part::Computed);
            let ports = part::outputs(&self.plan, index).zip(kept);
            let ports = ports.map(|(id, kept)| if wanted(id) { kept.items().to_vec() } else { Vec::new() }.into());
            players.insert(place, Box::new(Player { ports: ports.collect(), failure: None, pace: None }));
        }
        players
    }

    /// What a run of the whole graph would have left: of what was not computed, what the last run has left.
    fn complete(&self, last: Option<&Memory>, part: Ended) -> Ended {
        let Some(last) = last else { return part };
        let places = part::places(&self.parts);
        let whole: Vec<usize> = (0..places.len()).filter(|index| places[*index].is_some()).collect();
        let moved = |failure: Failure| Failure { node: whole[failure.node], ..failure };
        let mut of_part: Vec<_> = part.outputs.into_iter().zip(part.nodes).map(Some).collect();
        let (mut outputs, mut nodes) = (Vec::new(), Vec::new());
        for (index, node) in self.plan.nodes.iter().enumerate() {
            let computed = places[index].filter(|_| self.parts[index] == Part::Computed);
            let left = match computed {
                Some(place) => of_part[place].take(),
                None => last.place_of(&node.name).map(|place| (last.outputs[place].clone(), last.nodes[place].clone())),
            };
            let (kept, stats) = left.expect("each node was computed now or before");
            outputs.push(kept);
            nodes.push(stats);
        }
        let links = last.links.iter().cloned().chain(part.links);
        let mut links: BTreeMap<_, _> = links.map(|link| ((link.from.clone(), link.to.clone()), link)).collect();
        let links = self.plan.links.iter().filter_map(|link| {
            let to = &self.plan.nodes[link.to_node];
            links
                .remove(&(self.plan.wire_name(link.from), format!("{}.{}", to.name, to.inputs[link.to_port].port.name)))
        });
        let kept = self.kept();
        let warned_before = last.warnings.iter().filter(|warning| kept.contains(&warning.node.as_str())).cloned();
        let mut warnings: Vec<_> = warned_before.chain(part.warnings).collect();
        warnings.sort_by_key(|warning| self.plan.nodes.iter().position(|node| *node.name == *warning.node));
        Ended {
            outputs,
            nodes,
            links: links.collect(),
            failures: part.failures.into_iter().map(moved).collect(),
            stall: part.stall.map(moved),
            warnings,
            ..part
        }
    }

    fn remembered(&self, ended: &Ended, out_dir: Option<PathBuf>) -> Memory {
        let cut_short = ended.interrupted || ended.stall.is_some();
        let unsound = |index: usize| {
            let failed = ended.failures.iter().any(|failure| failure.node == index);
            failed || (cut_short && self.parts[index] == Part::Computed)
        };
        Memory {
            plan: self.plan.clone(),
            files: self.files.clone(),
            out_dir,
            outputs: ended.outputs.clone(),
            unsound: (0..self.plan.nodes.len()).map(unsound).collect(),
            nodes: ended.nodes.clone(),
            links: ended.links.clone(),
            warnings: ended.warnings.clone(),
        }
    }

    /// The first live source: what it gives comes only once, and never to its end.
    pub fn live_source(&self) -> Option<&str> {
        self.plan.nodes.iter().find(|node| node.role == Role::LiveSource).map(|node| &*node.name)
    }
}

impl Memory {
    fn place_of(&self, node: &str) -> Option<usize> {
        self.plan.nodes.iter().position(|before| *before.name == *node)
    }

    fn outputs_of(&self, node: &str) -> Option<&[Kept]> {
        self.place_of(node).map(|place| &*self.outputs[place])
    }
}
