use super::{CachedAnswer, Enlargement, Failure, LinkStats, NodeStats, Warning};
use std::time::Duration;

/// What a run leaves in memory, but for the items that its taps have kept.
pub(crate) struct Ended {
    /// The user's wish to stop has cut it short.
    pub(crate) interrupted: bool,
    /// For each node, for each output, the number of its items.
    pub(crate) n_items: Vec<Vec<u64>>,
    /// In the order of the plan.
    pub(crate) failures: Vec<Failure>,
    /// Nothing could run any more, and this is why.
    pub(crate) stall: Option<Failure>,
    pub(crate) warnings: Vec<Warning>,
    pub(crate) nodes: Vec<NodeStats>,
    pub(crate) links: Vec<LinkStats>,
    pub(crate) enlargements: Vec<Enlargement>,
    pub(crate) elapsed: Duration,
    pub(crate) recalled: Vec<CachedAnswer>,
}
