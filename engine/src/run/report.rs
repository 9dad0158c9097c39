//! What a run answers.

use crate::{
    record::RecordError,
    repro::Saved,
    runtime::{
        BuildError, BuildFault, CachedAnswer, Enlargement, LatencyStats, LinkStats, NodeStats, Refusal, Warning,
    },
};
use std::{path::PathBuf, time::Duration};

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// All results are there.
    Complete,
    /// A node failed or a result did not come.
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

/// What a run did.
#[derive(Debug, Clone)]
pub struct RunReport {
    /// How it ended.
    pub outcome: Outcome,
    /// What `results.json` holds.
    pub results: serde_json::Value,
    /// Figures for each node, in the order of the plan.
    pub nodes: Vec<NodeStats>,
    /// Figures for each link, in the order of the plan.
    pub links: Vec<LinkStats>,
    /// From each source to each sink, where [`RunOptions::latency`] asks for it.
    pub latencies: Vec<LatencyStats>,
    /// Queues that were made longer, in the order in which it happened.
    pub enlargements: Vec<Enlargement>,
    /// What nodes said, in the order of the plan.
    pub warnings: Vec<Warning>,
    /// From the first step to the last.
    pub elapsed: Duration,
    /// The failed items that were saved, to be run again alone.
    pub saved: Saved,
    /// The answers that came from the store, in the order of the plan.
    pub recalled: Vec<CachedAnswer>,
}

/// A run that could not begin or whose files could not be written.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Nodes cannot be built from their parameters.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Build(Vec<BuildFault>),
    /// A failure was to be injected into a node that the graph does not have.
    #[error("{0}")]
    Inject(String),
    /// A file of the run cannot be written.
    #[error("cannot write {}: {source}", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
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
