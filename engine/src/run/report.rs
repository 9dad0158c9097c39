//! The report of a run.

use crate::{
    answer_cache::CachedAnswer,
    record::RecordError,
    repro::Saved,
    runtime::{
        BuildError, BuildFault, ContractStats, Enlargement, LatencyStats, LinkStats, NodeStats, Refusal, Warning,
    },
};
use std::time::Duration;

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// All results are available.
    Complete,
    /// A node failed, a result is missing, or the verdict on the results does not suffice.
    Refused(Refusal),
    /// The user stopped it.
    Interrupted,
}

impl Outcome {
    /// `complete`, `refused` or `interrupted`.
    pub fn status(&self) -> &'static str {
        match self {
            Self::Complete => "complete",
            Self::Refused(_) => "refused",
            Self::Interrupted => "interrupted",
        }
    }
}

/// Report of a run.
#[derive(Debug, Clone)]
pub struct RunReport {
    /// How it ended.
    pub outcome: Outcome,
    /// Content of `results.json`; [`Verdict::of`](super::Verdict::of) reads its verdict.
    pub results: serde_json::Value,
    /// Statistics of each node, in the order of the plan.
    pub nodes: Vec<NodeStats>,
    /// Statistics of each link, in the order of the plan.
    pub links: Vec<LinkStats>,
    /// Latency from each source to each sink, if [`RunOptions::latency`] is set.
    pub latencies: Vec<LatencyStats>,
    /// How the contracts of time were kept, in the order of the plan.
    pub contracts: Vec<ContractStats>,
    /// Enlarged queues, in the order in which they were enlarged.
    pub enlargements: Vec<Enlargement>,
    /// Warnings of nodes, in the order of the plan.
    pub warnings: Vec<Warning>,
    /// Time from the first step to the last.
    pub elapsed: Duration,
    /// Saved failed items, which can be run again alone.
    pub saved: Saved,
    /// Answers taken from the store, in the order of the plan.
    pub cached_answers: Vec<CachedAnswer>,
}

/// A run that could not start or whose files could not be written.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Nodes cannot be built from their parameters.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Build(Vec<BuildFault>),
    /// A failure was to be injected into a node that the graph does not have.
    #[error("{0}")]
    Inject(String),
    /// A file of the run cannot be written.
    #[error("cannot write {0}")]
    Files(String),
    /// The recording cannot be written.
    #[error(transparent)]
    Record(#[from] RecordError),
}

impl From<BuildError> for RunError {
    fn from(error: BuildError) -> Self {
        match error {
            BuildError::Build(faults) => Self::Build(faults),
            BuildError::Inject(why) => Self::Inject(why),
        }
    }
}
