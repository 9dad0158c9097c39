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
    partial::{self, FinishedNode, PartialRun},
    plan::{Link, Plan, PlanNode},
    run::{Finished, RunError, RunReport},
    runtime::{LinkStats, Observer, RunOptions},
};
use osteoflow_node::{Body, Item, Registry, Role};
use serde_json::json;
use std::{collections::BTreeMap, path::PathBuf, sync::Arc};

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
    /// For each node.
    left: Vec<Arc<FinishedNode>>,
    /// For each node, whether it failed or was interrupted.
    unsound: Vec<bool>,
    links: Vec<LinkStats>,
}

/// What the next run is going to do.
pub struct Next {
    plan: Plan,
    files: Stamps,
    /// For each node what it has left, where that stands.
    left: Vec<Option<Arc<FinishedNode>>>,
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
            return Next {
                plan,
                files,
                left: vec![None; n_nodes],
                changes: Vec::new(),
                removed: Vec::new(),
                differs: true,
            };
        };
        let seed = (memory.plan.seed != plan.seed).then(|| changes::seed(memory.plan.seed, plan.seed));
        let mut computed = vec![seed.is_some(); n_nodes];
        let mut changes: Vec<_> = seed.into_iter().collect();
        for (index, change) in changes::of(memory, &plan, &files) {
            computed[index] = true;
            changes.push(change);
        }
        partial::follow(&plan, &mut computed);
        let differs = computed.contains(&true) || memory.plan.resolved != plan.resolved;
        if differs {
            // What a node without outputs does lies outside the graph, such as a file in the folder of each run.
            let silent = plan.nodes.iter().map(|node| node.outputs.is_empty());
            computed.iter_mut().zip(silent).for_each(|(computed, silent)| *computed |= silent);
        }
        let left = |(node, computed): (&PlanNode, bool)| memory.left_of(&node.name).filter(|_| !computed).cloned();
        let left = plan.nodes.iter().zip(computed).map(left).collect();
        let removed = changes::removed(&memory.plan, &plan);
        Next { plan, files, left, changes, removed, differs }
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
        let mut memory = None;
        let mut see = |mut finished: Finished| {
            finished.ended.links = next.links(last.as_ref(), finished.ended.links);
            memory = Some(next.remembered(&finished, options.out_dir.clone()));
            finished
        };
        let report = PartialRun::new(&next.plan, &next.left).run(registry, &options, observer, about, &mut see);
        self.memory = memory.or(last);
        report
    }

    /// The bytes that all kept items have, as their payloads count them; of what travels on several wires, for each.
    pub fn n_bytes(&self) -> usize {
        let left = self.memory.iter().flat_map(|memory| &memory.left);
        let items = left.flat_map(|left| &left.outputs).flat_map(|wire| &wire.items);
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
        self.left.iter().all(Option::is_none)
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
        self.named(Option::is_none)
    }

    /// The nodes whose items are those of the last run, in the order of the plan.
    pub fn kept(&self) -> Vec<&str> {
        self.named(Option::is_some)
    }

    fn named(&self, which: fn(&Option<Arc<FinishedNode>>) -> bool) -> Vec<&str> {
        let nodes = self.plan.nodes.iter().zip(&self.left);
        nodes.filter(|(_, left)| which(left)).map(|(node, _)| &*node.name).collect()
    }

    /// What the wires of the whole graph have carried: of those that were not run, what the last run says.
    fn links(&self, last: Option<&Memory>, part: Vec<LinkStats>) -> Vec<LinkStats> {
        let before = last.map(|last| last.links.clone()).unwrap_or_default();
        let links = before.into_iter().chain(part);
        let mut links: BTreeMap<_, _> = links.map(|link| ((link.from.clone(), link.to.clone()), link)).collect();
        let of_link = |link: &Link| {
            let to = &self.plan.nodes[link.to_node];
            let to = format!("{}.{}", to.name, to.inputs[link.to_port].port.name);
            links.remove(&(self.plan.wire_name(link.from), to))
        };
        self.plan.links.iter().filter_map(of_link).collect()
    }

    fn remembered(&self, finished: &Finished, out_dir: Option<PathBuf>) -> Memory {
        let ended = &finished.ended;
        let cut_short = ended.interrupted || ended.stall.is_some();
        let unsound = |index: usize| {
            let failed = ended.failures.iter().any(|failure| failure.node == index);
            failed || (cut_short && self.left[index].is_none())
        };
        let left = |index: usize| {
            self.left[index].clone().unwrap_or_else(|| FinishedNode::of(finished, &self.plan, index).into())
        };
        Memory {
            plan: self.plan.clone(),
            files: self.files.clone(),
            out_dir,
            left: (0..self.plan.nodes.len()).map(left).collect(),
            unsound: (0..self.plan.nodes.len()).map(unsound).collect(),
            links: ended.links.clone(),
        }
    }

    /// The first live source: what it gives comes only once, and never to its end.
    pub fn live_source(&self) -> Option<&str> {
        self.plan.nodes.iter().find(|node| node.role == Role::LiveSource).map(|node| &*node.name)
    }
}

impl Memory {
    fn left_of(&self, node: &str) -> Option<&Arc<FinishedNode>> {
        let place = self.plan.nodes.iter().position(|before| *before.name == *node)?;
        Some(&self.left[place])
    }
}
