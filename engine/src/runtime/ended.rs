use super::{CachedAnswer, Enlargement, Failure, LinkStats, NodeStats, Warning};
use std::time::Duration;

/// Outcome of a run, apart from the items that its taps have kept.
pub(crate) struct Ended {
    /// Whether a stop request cut the run short.
    pub(crate) interrupted: bool,
    /// Number of items, by node and output.
    pub(crate) n_items: Vec<Vec<u64>>,
    /// In the order of the plan.
    pub(crate) failures: Vec<Failure>,
    /// Why the run got stuck, if it did.
    pub(crate) stall: Option<Failure>,
    pub(crate) warnings: Vec<Warning>,
    pub(crate) nodes: Vec<NodeStats>,
    pub(crate) links: Vec<LinkStats>,
    pub(crate) enlargements: Vec<Enlargement>,
    pub(crate) elapsed: Duration,
    pub(crate) cached_answers: Vec<CachedAnswer>,
}
