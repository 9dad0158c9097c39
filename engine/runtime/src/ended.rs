use crate::report::{Enlargement, Failure, LinkStats, NodeStats, Warning};
use std::time::Duration;

/// Outcome of a run, apart from the items that its taps have kept.
pub struct Ended {
    /// Whether a stop request cut the run short.
    pub interrupted: bool,
    /// Number of items, by node and output.
    pub n_items: Vec<Vec<u64>>,
    /// In the order of the plan.
    pub failures: Vec<Failure>,
    /// Why the run got stuck, if it did.
    pub stall: Option<Failure>,
    /// In the order of the plan.
    pub warnings: Vec<Warning>,
    /// Statistics, in the order of the plan.
    pub nodes: Vec<NodeStats>,
    /// Statistics, in the order of the plan.
    pub links: Vec<LinkStats>,
    /// Queues that were enlarged.
    pub enlargements: Vec<Enlargement>,
    /// Wall time of the run.
    pub elapsed: Duration,
}
