use crate::{DeclaredPort, Join};
use std::sync::Arc;

/// Where a node is built: what of the graph it may know before it fires.
#[derive(Debug, Clone)]
pub struct Site {
    /// The node's full name.
    pub node: Arc<str>,
    /// The run's seed.
    pub seed: u64,
    /// The outputs that the graph declared for it by `out`.
    pub declared: Arc<[DeclaredPort]>,
    /// How its inputs join, in the order of the kind's ports; empty where nobody has wired it.
    pub joins: Vec<Join>,
}

impl Site {
    /// A place outside any run: seed 0, nothing declared, nothing wired.
    pub fn alone(node: &str) -> Self {
        Self { node: node.into(), seed: 0, declared: Arc::from([]), joins: Vec::new() }
    }
}
