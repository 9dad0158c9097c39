//! Reruns a graph as it changes: unchanged nodes keep their items, and the rest is computed from them.
//!
//! A run is a function of its inputs. A node whose kind, parameters, files and wiring are unchanged, and with nothing
//! changed upstream, would give the same items again; a rerun plays them to the changed nodes and everything
//! downstream. Its `results.json` is bit for bit that of a run of the whole graph. The exceptions, as in any run, are
//! wires whose policy may drop items and nodes that read the clock.
//!
//! Every item of every wire of the last run is kept in memory for this.

mod changes;
mod files;
#[cfg(test)]
mod tests;

pub use changes::Change;
pub use files::Stamps;

use crate::{
    options::RunOptions,
    partial::{FinishedNode, PartialRun},
    plan::{Plan, PlanNode},
    run::{Finished, RunError, RunReport},
    runtime::{LinkStats, Observer},
};
use osteoflow_node::{Body, Item, Registry, Role};
use serde_json::json;
use std::{collections::BTreeMap, path::PathBuf, sync::Arc};

/// A graph that is run repeatedly.
#[derive(Default)]
pub struct Session {
    memory: Option<Memory>,
}

/// State of the last run.
struct Memory {
    plan: Plan,
    /// The parameters' files, as they were before the run.
    files: Stamps,
    /// Output folder of the run.
    out_dir: Option<PathBuf>,
    /// Items of each node.
    left: Vec<Arc<FinishedNode>>,
    /// Whether each node failed or was interrupted.
    unsound: Vec<bool>,
    links: Vec<LinkStats>,
}

/// The next run.
pub struct Next {
    /// Its plan.
    pub plan: Plan,
    /// Stamps of the parameters' files, taken when this was created.
    pub files: Stamps,
    /// Items of each node that need not be computed again.
    left: Vec<Option<Arc<FinishedNode>>>,
    /// Direct changes: the seed, then nodes in the order of the plan; empty before the first run.
    pub changes: Vec<Change>,
    /// Nodes removed from the graph.
    pub removed: Vec<String>,
    /// Whether a run would give the same as the last one: nothing but the graph's text has changed.
    pub is_unchanged: bool,
}

impl Session {
    /// Determines what a run of this plan has to compute. The stamps of its parameters' files are taken now; later
    /// changes are left to the run after.
    pub fn next(&self, plan: Plan) -> Next {
        let files = Stamps::of_plan(&plan);
        let n_nodes = plan.nodes.len();
        let Some(memory) = &self.memory else {
            let (left, changes, removed) = (vec![None; n_nodes], Vec::new(), Vec::new());
            return Next { plan, files, left, changes, removed, is_unchanged: false };
        };
        let seed = (memory.plan.seed != plan.seed).then(|| changes::seed(memory.plan.seed, plan.seed));
        let mut computed = vec![seed.is_some(); n_nodes];
        let mut changes: Vec<_> = seed.into_iter().collect();
        for (index, change) in changes::of(memory, &plan, &files) {
            computed[index] = true;
            changes.push(change);
        }
        plan.mark_downstream(&mut computed);
        let differs = computed.contains(&true) || memory.plan.resolved != plan.resolved;
        if differs {
            // A node without outputs has effects outside the graph, such as a file in each run's folder.
            let silent = plan.nodes.iter().map(|node| node.outputs.is_empty());
            computed.iter_mut().zip(silent).for_each(|(computed, silent)| *computed |= silent);
        }
        let left = |(node, computed): (&PlanNode, bool)| memory.left_of(&node.name).filter(|_| !computed).cloned();
        let left = plan.nodes.iter().zip(computed).map(left).collect();
        let removed = changes::removed(&memory.plan, &plan);
        Next { plan, files, left, changes, removed, is_unchanged: !differs }
    }

    /// Computes the nodes of `next` and writes results and manifest of the whole graph; writes a recording only if
    /// every node is computed.
    ///
    /// # Errors
    /// See [`crate::run()`]; the state of the session is then unchanged.
    pub fn run(
        &mut self,
        next: Next,
        registry: &Registry,
        options: &RunOptions,
        observer: &dyn Observer,
    ) -> Result<RunReport, RunError> {
        let mut options = options.clone();
        if !next.is_whole() {
            // A partial run is not recorded: no source produced the played items.
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

    /// Size of all kept items in bytes, as their payloads count them; items on several wires count for each.
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
    /// Whether every node is computed.
    pub fn is_whole(&self) -> bool {
        self.left.iter().all(Option::is_none)
    }

    /// Computed nodes, in the order of the plan.
    pub fn computed(&self) -> Vec<&str> {
        self.named(Option::is_none)
    }

    /// Nodes that keep the items of the last run, in the order of the plan.
    pub fn kept(&self) -> Vec<&str> {
        self.named(Option::is_some)
    }

    fn named(&self, which: fn(&Option<Arc<FinishedNode>>) -> bool) -> Vec<&str> {
        let nodes = self.plan.nodes.iter().zip(&self.left);
        nodes.filter(|(_, left)| which(left)).map(|(node, _)| &*node.name).collect()
    }

    /// Link statistics of the whole graph; those of links that did not run are from the last run.
    fn links(&self, last: Option<&Memory>, part: Vec<LinkStats>) -> Vec<LinkStats> {
        let before = last.map(|last| last.links.clone()).unwrap_or_default();
        let links = before.into_iter().chain(part);
        let mut links: BTreeMap<_, _> = links.map(|link| ((link.from.clone(), link.to.clone()), link)).collect();
        self.plan.links.iter().filter_map(|link| links.remove(&self.plan.link_names(link))).collect()
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

    /// The first live source. Its items cannot be produced again.
    pub fn live_source(&self) -> Option<&str> {
        self.plan.nodes.iter().find(|node| node.role == Role::LiveSource).map(|node| &*node.name)
    }
}

impl Memory {
    fn left_of(&self, node: &str) -> Option<&Arc<FinishedNode>> {
        Some(&self.left[self.plan.node(node)?])
    }
}
