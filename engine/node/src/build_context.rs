use crate::{DeclaredPort, Join};
use std::{sync::Arc, time::Duration};

/// The parts of the graph that a node may know when it is built.
#[derive(Debug, Clone)]
pub struct BuildContext {
    /// The node's full name.
    pub node: Arc<str>,
    /// The run's seed.
    pub seed: u64,
    /// The outputs that the graph declares for the node by `out`.
    pub declared: Arc<[DeclaredPort]>,
    /// The joins of the inputs, in the order of the kind's ports; empty outside a graph.
    pub joins: Vec<Join>,
    /// Where it fires.
    pub place: Place,
}

/// Where a node fires.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Place {
    /// Whether in a process of its own; unset: as the command has it.
    pub process: Option<bool>,
    /// The time limit of a firing, after which its process is stopped.
    pub stop_after: Option<Duration>,
    /// Whether its process may fire nodes of other runs of the same command, before and after; unset: it may.
    pub pool: Option<bool>,
}

impl BuildContext {
    /// A node outside any graph: seed 0, no declared outputs, no wires, in this process.
    pub fn detached(node: &str) -> Self {
        Self { node: node.into(), seed: 0, declared: Arc::from([]), joins: Vec::new(), place: Place::default() }
    }
}
