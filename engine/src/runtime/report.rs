//! What a run takes, and what it says of itself.

use super::Injection;
use crate::{plan::Location, store::Store};
use osteoflow_node::StampNs;
use std::{
    fmt,
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};

/// How to run a graph and what to leave.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// How many threads run nodes; with 1 all nodes run on the calling thread.
    pub workers: usize,
    /// For testing: a seed by which threads are delayed, woken without reason and given nodes in another order; the
    /// results do not depend on it.
    pub shuffle: Option<u64>,
    /// Where `run.mcap`, `results.json` and `manifest.json` go; created if need be. `None` leaves nothing.
    pub out_dir: Option<PathBuf>,
    /// Whether the plan's recorded wires are written to `run.mcap`.
    pub record: bool,
    /// Whether the time from each source to each sink is measured; every firing is then timed by itself.
    pub latency: bool,
    /// Constants that `results.json` begins with, by dotted key.
    pub fixed_results: Vec<(String, serde_json::Value)>,
    /// Set from outside, it stops the sources; what is under way is finished.
    pub cancelled: Arc<AtomicBool>,
    /// What the command says of itself and the machine, for the manifest.
    pub command: serde_json::Value,
    /// Firings that are made to fail, for testing how a graph fails.
    pub inject: Vec<Injection>,
    /// Where answers of kinds that are worth it are kept from one run to the next, and looked up before such a node
    /// fires. The results and recorded wires are the same with and without; `None` computes everything.
    pub store: Option<Arc<Store>>,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self {
            workers: 1,
            shuffle: None,
            out_dir: None,
            record: false,
            latency: false,
            fixed_results: Vec::new(),
            cancelled: Arc::default(),
            command: serde_json::Value::Null,
            inject: Vec::new(),
            store: None,
        }
    }
}

/// Is told of what happens while it happens, from whatever thread it happens on.
pub trait Observer: Sync {
    /// Something happened; returns at once, for a node waits.
    fn event(&self, event: &Event<'_>);
}

/// Observes nothing.
impl Observer for () {
    fn event(&self, _: &Event<'_>) {}
}

/// What can happen in a run.
#[derive(Debug)]
pub enum Event<'a> {
    /// The node's first activation begins.
    Started {
        /// The node.
        node: &'a str,
    },
    /// The node fired, or the source answered.
    Fired {
        /// The node.
        node: &'a str,
        /// The number of the activation, from 0.
        item: u64,
        /// Its stamp; for a source how far it has come.
        stamp_ns: StampNs,
    },
    /// An activation was skipped because an input had no value.
    Skipped {
        /// The node.
        node: &'a str,
        /// The number of the activation, from 0.
        item: u64,
        /// Why.
        reason: &'a str,
    },
    /// The node has something to say.
    Warned(&'a Warning),
    /// The node failed.
    Failed(&'a Refusal),
    /// A queue was enlarged, because nothing could run while it was full.
    Enlarged(&'a Enlargement),
    /// The node will not fire again.
    Ended {
        /// The node.
        node: &'a str,
    },
}

/// Something a node wanted the user to know.
#[derive(Debug, Clone, PartialEq)]
pub struct Warning {
    /// The node.
    pub node: String,
    /// The number of the activation, from 0.
    pub item: u64,
    /// What it said.
    pub message: String,
}

/// A queue that was made longer.
#[derive(Debug, Clone, PartialEq)]
pub struct Enlargement {
    /// The producing wire, `node.port`.
    pub from: String,
    /// The consuming port, `node.port`.
    pub to: String,
    /// How many items it held.
    pub before: usize,
    /// How many it holds now.
    pub after: usize,
}

/// Why a run has no results.
#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    /// The node at the root of it.
    pub node: String,
    /// Its kind.
    pub kind: String,
    /// The number of its activation, where one can be named.
    pub item: Option<u64>,
    /// Where the node stands in the graph file.
    pub location: Location,
    /// What it said.
    pub reason: String,
    /// Whether it panicked.
    pub panicked: bool,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: node \"{}\"", self.location.file.display(), self.location.line, self.node)?;
        if let Some(item) = self.item {
            write!(f, ", item {item}")?;
        }
        write!(f, ": {}", self.reason)
    }
}

/// A node's figures.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeStats {
    /// Its name.
    pub name: String,
    /// Activations, the skipped ones included; for a source its answers.
    pub items: u64,
    /// Activations skipped because an input had no value.
    pub skipped: u64,
    /// Activations that failed.
    pub failed: u64,
    /// Time spent in it, all in all; what the engine does for a firing, below a microsecond, may be counted in.
    pub busy: Duration,
    /// Half of its firings took no longer; as all percentiles, up to 3 % more than the exact one.
    pub p50: Duration,
    /// 95 of 100 firings took no longer.
    pub p95: Duration,
    /// 99 of 100 firings took no longer.
    pub p99: Duration,
}

/// A link's figures.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkStats {
    /// The producing wire, `node.port`.
    pub from: String,
    /// The consuming port, `node.port`.
    pub to: String,
    /// Items put on it; equals received + dropped at the end of a run.
    pub sent: u64,
    /// Items taken from it.
    pub received: u64,
    /// Items dropped by its policy.
    pub dropped: u64,
    /// Items of its wire that a live source gave later than it had promised; they are empties.
    pub late: u64,
    /// Items taken from it that had no partner to fire with.
    pub unmatched: u64,
    /// The most items that ever waited.
    pub highest_fill: usize,
    /// How many may wait, at the end of the run.
    pub capacity: usize,
}

/// A run that cannot begin.
#[derive(Debug)]
pub(crate) enum BuildError {
    /// Nodes cannot be built from their parameters.
    Build(Vec<BuildFault>),
    /// A failure was to be injected into a node that the graph does not have.
    Inject(String),
}

/// A node that cannot be built.
#[derive(Debug, Clone, PartialEq)]
pub struct BuildFault {
    /// The node.
    pub node: String,
    /// Where its table begins.
    pub location: Location,
    /// The parameter at fault; empty if it is several.
    pub parameter: String,
    /// What was expected, what was found, what to write instead.
    pub message: String,
}

impl fmt::Display for BuildFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: node \"{}\": ", self.location.file.display(), self.location.line, self.node)?;
        match self.parameter.as_str() {
            "" => f.write_str(&self.message),
            parameter => write!(f, "parameter \"{parameter}\": {}", self.message),
        }
    }
}

/// A node's failure, by its index.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Failure {
    pub(crate) node: usize,
    pub(crate) item: u64,
    pub(crate) reason: String,
    pub(crate) panicked: bool,
    /// Whether the node went on with the next item.
    pub(crate) skipped: bool,
}
