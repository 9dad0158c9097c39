use crate::{
    activity::{self, Doing, Name},
    panics,
    report::{ContractStats, Enlargement, Failure, LinkStats, NodeStats, Warning},
    sign::Sign,
};
use osteoflow_node::Built;
use std::time::Duration;

/// Outcome of a run, apart from the items that its taps have kept.
pub struct RunOutcome {
    /// Whether a stop request cut the run short.
    pub interrupted: bool,
    /// Number of items, by node and output.
    pub n_items: Vec<Vec<u64>>,
    /// Number of items that are values, by node and output.
    pub n_values: Vec<Vec<u64>>,
    /// In the order of the plan.
    pub failures: Vec<Failure>,
    /// Why the run got stuck, if it did.
    pub stall: Option<Failure>,
    /// In the order of the plan.
    pub warnings: Vec<Warning>,
    /// In the order of the plan.
    pub signs: Vec<Sign>,
    /// Statistics, in the order of the plan.
    pub nodes: Vec<NodeStats>,
    /// Statistics, in the order of the plan.
    pub links: Vec<LinkStats>,
    /// How the contracts of time were kept, in the order of the plan.
    pub contracts: Vec<ContractStats>,
    /// Queues that were enlarged.
    pub enlargements: Vec<Enlargement>,
    /// Wall time of the run.
    pub elapsed: Duration,
    /// The nodes, to be dropped once the files of the run have been written.
    pub retired: Retired,
}

/// The nodes of a run that has ended. They are destroyed when this is dropped: a node that crashes in its destructor must
/// not cost the results.
#[derive(Default)]
pub struct Retired(Vec<(Name, Built)>);

impl Retired {
    pub(crate) fn new(nodes: impl Iterator<Item = (Name, Option<Built>)>) -> Self {
        Self(nodes.filter_map(|(name, built)| Some((name, built?))).collect())
    }
}

impl Drop for Retired {
    fn drop(&mut self) {
        for (name, built) in self.0.drain(..) {
            discard(name, Doing::Closing, built);
        }
    }
}

/// Drops the node; a panic in its destructor is ignored.
pub(crate) fn discard<T>(name: Name, doing: Doing, built: T) {
    let _under = activity::begin(name, doing, 0);
    if let Err(panic) = panics::catch(move || drop(built)) {
        tracing::warn!("a node that had ended {panic}");
    }
}
