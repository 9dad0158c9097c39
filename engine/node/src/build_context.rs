use crate::{DeclaredPort, Join};
use std::sync::Arc;

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
}

impl BuildContext {
    /// A node outside any graph: seed 0, no declared outputs, no wires.
    pub fn detached(node: &str) -> Self {
        Self { node: node.into(), seed: 0, declared: Arc::from([]), joins: Vec::new() }
    }
}
