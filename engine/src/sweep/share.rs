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

/// Keys of a plan's nodes, in order. The key of a node in a cycle is decided by the whole cycle.
pub(super) fn keys(plan: &Plan, files: &Stamps) -> Vec<Digest> {
    let cycles = plan.cycles();
    let mut keys: Vec<Option<Digest>> = vec![None; plan.nodes.len()];
    while keys.contains(&None) {
        for first in 0..plan.nodes.len() {
            let cycle: Vec<usize> = (0..plan.nodes.len()).filter(|node| cycles[*node] == first).collect();
            let upstream = cycle.iter().flat_map(|node| plan.links_into(*node)).map(|link| link.from.node);
            let is_known = upstream.filter(|from| cycles[*from] != first).all(|from| keys[from].is_some());
            if !is_known || cycle.first().is_none_or(|node| keys[*node].is_some()) {
                continue;
            }
            let of_nodes: Vec<_> = cycle.iter().map(|node| own_key(plan, *node, files, &keys)).collect();
            let whole = of_nodes.iter().fold(Key::of("cycle"), |key, own| key.digest("node", *own)).done().digest();
            for (node, own) in cycle.iter().zip(of_nodes) {
                let in_cycle = || Key::of("cycle_node").digest("node", own).digest("cycle", whole).done().digest();
                keys[*node] = Some(if cycle.len() == 1 { own } else { in_cycle() });
            }
        }
    }
    keys.into_iter().flatten().collect()
}

/// The key of a node by what is known of its upstream; a producer without a key is in the same cycle and goes by its name.
fn own_key(plan: &Plan, index: usize, files: &Stamps, keys: &[Option<Digest>]) -> Digest {
    let node = &plan.nodes[index];
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
        for link in input.links.iter().map(|link| &plan.links[*link]) {
            let from = &plan.nodes[link.from.node];
            key = match keys[link.from.node] {
                Some(upstream) => key.digest("from", upstream),
                None => key.text("within", &from.name),
            };
            key = key.text("port", &from.outputs[link.from.port].name);
            if link.policy != Policy::Block {
                let policy = json!([link.policy.to_string(), link.capacity, link.max_bytes]);
                key = key.json("policy", &policy);
            }
        }
    }
    key.done().digest()
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
    /// Number of the run that took or left its items last.
    used: u64,
}

/// Nodes that several runs share, with their items so far. They are released after the last run that shares them, or, where more
/// runs may be asked for, when newer ones need the memory.
#[derive(Default)]
pub(super) struct Shared {
    nodes: BTreeMap<Digest, SharedNode>,
    /// Memory for nodes that no known run shares.
    max_bytes: u64,
    n_ended: u64,
}

impl Shared {
    /// Collects the keys of the runs to come; a key of only one run is not shared.
    pub(super) fn of<'a>(runs: impl Iterator<Item = &'a [Digest]>) -> Self {
        let mut shared = Self::default();
        shared.expect(runs);
        shared.nodes.retain(|_, entry| entry.n_users > 1);
        shared
    }

    /// Keeps nodes for runs that are not known yet.
    pub(super) fn kept(max_bytes: u64) -> Self {
        Self { max_bytes, ..Self::default() }
    }

    /// Adds runs to come.
    pub(super) fn expect<'a>(&mut self, runs: impl Iterator<Item = &'a [Digest]>) {
        for key in runs.flatten() {
            let entry = self.nodes.entry(*key).or_insert(SharedNode { n_users: 0, state: State::Open, used: 0 });
            entry.n_users += 1;
        }
    }

    /// Forgets runs to come, none of which is under way.
    pub(super) fn expect_none(&mut self) {
        self.nodes.retain(|_, entry| {
            entry.n_users = 0;
            matches!(entry.state, State::Done(_))
        });
    }

    /// Whether a run can start without computing a node that another run is computing.
    pub(super) fn is_free(&self, keys: &[Digest]) -> bool {
        !keys.iter().any(|key| matches!(self.nodes.get(key), Some(SharedNode { state: State::UnderWay, .. })))
    }

    /// Starts a run: returns its available items by node, and marks its other shared nodes as being computed.
    pub(super) fn begin(&mut self, keys: &[Digest]) -> Vec<Option<Arc<FinishedNode>>> {
        let take = |key| match self.nodes.get_mut(key) {
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
        self.n_ended += 1;
        for (index, key) in keys.iter().enumerate() {
            let Some(entry) = self.nodes.get_mut(key) else { continue };
            (entry.n_users, entry.used) = (entry.n_users - 1, self.n_ended);
            let is_kept = entry.n_users > 0 || self.max_bytes > 0;
            if is_kept && matches!(entry.state, State::UnderWay) {
                let left = left.get_mut(index).and_then(Option::take);
                entry.state = left.map_or(State::Open, |left| State::Done(Arc::new(left)));
            }
            if !is_kept || entry.n_users == 0 && !matches!(entry.state, State::Done(_)) {
                self.nodes.remove(key);
            }
        }
        self.release();
    }

    /// Releases the nodes used longest ago that no known run shares, until the others fit into the memory for them.
    fn release(&mut self) {
        let unused = |entry: &SharedNode| match &entry.state {
            State::Done(left) if entry.n_users == 0 => Some(left.n_bytes()),
            _ => None,
        };
        let mut nodes: Vec<_> =
            self.nodes.iter().filter_map(|(key, entry)| Some((entry.used, *key, unused(entry)?))).collect();
        nodes.sort_unstable_by(|a, b| b.cmp(a));
        let mut n_bytes = 0;
        for (_, key, size) in nodes {
            n_bytes += size;
            if n_bytes > self.max_bytes {
                self.nodes.remove(&key);
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
        let (cpu, last_empty) = (None, None);
        let stats = NodeStats {
            name,
            items: 0,
            skipped: 0,
            failed: 0,
            unfed: 0,
            last_empty,
            busy,
            cpu,
            wall: none,
            p50,
            p95,
            p99,
        };
        FinishedNode { outputs: Vec::new(), stats, warnings: Vec::new(), signs: Vec::new() }
    }

    #[test]
    fn nodes_shared_by_two_runs_are_computed_once_and_released_after_the_last() {
        let runs = [[key(1), key(2)], [key(1), key(3)]];
        let mut shared = Shared::of(runs.iter().map(|run| &run[..]));
        assert_eq!(shared.nodes.len(), 1, "only what both have");
        assert!(shared.begin(&runs[0]).iter().all(Option::is_none));
        assert!(!shared.is_free(&runs[1]), "the first run is computing it");
        shared.end(&runs[0], vec![Some(left()), Some(left())]);
        assert!(shared.is_free(&runs[1]));
        let found = shared.begin(&runs[1]);
        assert!(found[0].is_some() && found[1].is_none());
        shared.end(&runs[1], vec![None, Some(left())]);
        assert!(shared.nodes.is_empty(), "nobody will ask for it any more");
    }

    #[test]
    fn nodes_are_kept_for_runs_that_are_not_known_yet_as_far_as_there_is_memory() {
        let size = left().n_bytes();
        let mut shared = Shared::kept(2 * size);
        for n in 1..=3 {
            let keys = [key(n)];
            shared.expect([&keys[..]].into_iter());
            assert!(shared.begin(&keys)[0].is_none());
            shared.end(&keys, vec![Some(left())]);
        }
        let keys = [key(1), key(2), key(3)];
        shared.expect([&keys[..]].into_iter());
        let kept: Vec<_> = shared.begin(&keys).iter().map(Option::is_some).collect();
        assert_eq!(kept, [false, true, true], "the oldest was released");
        shared.end(&keys, vec![None, None, None]);
        assert_eq!(shared.nodes.len(), 2, "what failed is not kept");
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
