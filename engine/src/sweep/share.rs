//! Sharing between runs of a sweep: nodes that would give the same items in several runs.
//!
//! A run is a function of its inputs: the items of a node are determined by its name, kind, program, parameters and the
//! files they name, the run's seed, the joins of its ports, and the nodes upstream. The node's key is the digest of all
//! that. Nodes of two runs with equal keys give the same items, which are computed once.

use crate::{
    hash::Digest,
    partial::FinishedNode,
    plan::{Plan, Policy},
    store::Key,
    watch::Stamps,
};
use serde_json::json;
use std::{collections::BTreeMap, sync::Arc};

/// Keys of a plan's nodes, in order.
pub(super) fn keys(plan: &Plan, files: &Stamps) -> Vec<Digest> {
    let mut keys: Vec<Digest> = Vec::with_capacity(plan.nodes.len());
    for node in &plan.nodes {
        let mut key = Key::of("node")
            .text("name", &node.name)
            .text("kind", &node.kind)
            .text("plugin", node.plugin.as_deref().unwrap_or_default())
            .number("seed", plan.seed)
            .json("params", &node.params)
            .text("on_error", &format!("{:?}", node.on_error))
            .text("place", &format!("{:?}", node.place));
        for port in node.declared.iter() {
            key = key.text("out", &port.name).text("type", port.payload.name).json("params", &port.params);
        }
        for output in &node.outputs {
            key = key.text("frames", &format!("{} {:?}", output.name, output.frames));
        }
        for file in &node.files {
            key = key.text("file", &file.to_string_lossy()).text("stamp", files.get(file).unwrap_or_default());
        }
        for input in &node.inputs {
            key = key.text("in", input.port.name).text("join", &format!("{:?}", input.port.join));
            if let Some(link) = input.link.map(|link| &plan.links[link]) {
                let port = &plan.nodes[link.from.node].outputs[link.from.port].name;
                key = key.digest("from", keys[link.from.node]).text("port", port);
                if link.policy != Policy::Block {
                    let policy = json!([link.policy.to_string(), link.capacity, link.max_bytes]);
                    key = key.json("policy", &policy);
                }
            }
        }
        keys.push(key.done().digest());
    }
    keys
}

/// State of a key that several runs share.
enum State {
    /// Not computed yet.
    Open,
    /// A run is computing it.
    UnderWay,
    /// Its items are available.
    Done(Arc<FinishedNode>),
}

struct SharedNode {
    /// Number of runs to come that share it.
    n_users: usize,
    state: State,
}

/// Nodes that several runs share, with their items so far; released after the last run that shares them.
#[derive(Default)]
pub(super) struct Shared(BTreeMap<Digest, SharedNode>);

impl Shared {
    /// Collects the keys of the runs to come; a key of only one run is not shared.
    pub(super) fn of<'a>(runs: impl Iterator<Item = &'a [Digest]>) -> Self {
        let mut entries: BTreeMap<Digest, SharedNode> = BTreeMap::new();
        for key in runs.flatten() {
            entries.entry(*key).or_insert(SharedNode { n_users: 0, state: State::Open }).n_users += 1;
        }
        entries.retain(|_, entry| entry.n_users > 1);
        Self(entries)
    }

    /// Whether a run can start without computing a node that another run is computing.
    pub(super) fn is_free(&self, keys: &[Digest]) -> bool {
        !keys.iter().any(|key| matches!(self.0.get(key), Some(SharedNode { state: State::UnderWay, .. })))
    }

    /// Starts a run: returns its available items by node, and marks its other shared nodes as being computed.
    pub(super) fn begin(&mut self, keys: &[Digest]) -> Vec<Option<Arc<FinishedNode>>> {
        let take = |key| match self.0.get_mut(key) {
            Some(SharedNode { state: State::Done(left), .. }) => Some(left.clone()),
            Some(entry) => {
                entry.state = State::UnderWay;
                None
            }
            None => None,
        };
        keys.iter().map(take).collect()
    }

    /// Ends a run: takes the items of the nodes that it computed without failure.
    pub(super) fn end(&mut self, keys: &[Digest], mut left: Vec<Option<FinishedNode>>) {
        for (index, key) in keys.iter().enumerate() {
            let Some(entry) = self.0.get_mut(key) else { continue };
            entry.n_users -= 1;
            if entry.n_users == 0 {
                self.0.remove(key);
            } else if matches!(entry.state, State::UnderWay) {
                let left = left.get_mut(index).and_then(Option::take);
                entry.state = left.map_or(State::Open, |left| State::Done(Arc::new(left)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::NodeStats;

    fn key(n: u8) -> Digest {
        Digest([n; 32])
    }

    fn left() -> FinishedNode {
        let none = std::time::Duration::ZERO;
        let (name, busy, p50, p95, p99) = (String::new(), none, none, none, none);
        let stats = NodeStats { name, items: 0, skipped: 0, failed: 0, busy, cpu: None, wall: none, p50, p95, p99 };
        FinishedNode { outputs: Vec::new(), stats, warnings: Vec::new() }
    }

    #[test]
    fn nodes_shared_by_two_runs_are_computed_once_and_released_after_the_last() {
        let runs = [[key(1), key(2)], [key(1), key(3)]];
        let mut shared = Shared::of(runs.iter().map(|run| &run[..]));
        assert_eq!(shared.0.len(), 1, "only what both have");
        assert!(shared.begin(&runs[0]).iter().all(Option::is_none));
        assert!(!shared.is_free(&runs[1]), "the first run is computing it");
        shared.end(&runs[0], vec![Some(left()), Some(left())]);
        assert!(shared.is_free(&runs[1]));
        let found = shared.begin(&runs[1]);
        assert!(found[0].is_some() && found[1].is_none());
        shared.end(&runs[1], vec![None, Some(left())]);
        assert!(shared.0.is_empty(), "nobody will ask for it any more");
    }

    #[test]
    fn failed_nodes_are_computed_again_by_the_next_run() {
        let runs = [[key(1)], [key(1)], [key(1)]];
        let mut shared = Shared::of(runs.iter().map(|run| &run[..]));
        shared.begin(&runs[0]);
        shared.end(&runs[0], vec![None]);
        assert!(shared.is_free(&runs[1]), "free to be computed again");
        assert!(shared.begin(&runs[1])[0].is_none());
    }
}
