//! Events and statistics of a run.

use crate::{histogram::Spread, plan::Location};
use osteoflow_node::{Empty, ParamError, StampNs};
use std::{fmt, sync::Arc, time::Duration};

/// Receives the events of a run as they happen, on any thread.
pub trait Observer: Sync {
    /// Handles an event; must return at once, because a node waits for it.
    fn event(&self, event: &Event<'_>);
}

/// Ignores all events.
impl Observer for () {
    fn event(&self, _: &Event<'_>) {}
}

/// An event of a run.
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
        /// Number of the activation, from 0.
        item: u64,
        /// Its stamp; for a source, the stamp that it has reached.
        stamp_ns: StampNs,
    },
    /// An activation was skipped because an input had no value.
    Skipped {
        /// The node.
        node: &'a str,
        /// Number of the activation, from 0.
        item: u64,
    },
    /// The node warned.
    Warned(&'a Warning),
    /// A live source is silent now, or its stamps jump; the warning that says so has been given as well.
    Urgent(&'a Warning),
    /// The node failed.
    Failed(&'a Refusal),
    /// The node will not fire again.
    Ended {
        /// The node.
        node: &'a str,
    },
}

/// A node's message for the user.
#[derive(Debug, Clone, PartialEq)]
pub struct Warning {
    /// The node.
    pub node: String,
    /// Number of the activation, from 0.
    pub item: u64,
    /// The message.
    pub message: String,
}

/// An enlarged queue.
#[derive(Debug, Clone, PartialEq)]
pub struct Enlargement {
    /// The producing wire, `node.port`.
    pub from: String,
    /// The consuming port, `node.port`.
    pub to: String,
    /// Capacity before.
    pub before: usize,
    /// Capacity now.
    pub after: usize,
}

/// Why a run has no results.
#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    /// The node that caused it.
    pub node: String,
    /// Its kind.
    pub kind: String,
    /// Number of its activation, where one can be named.
    pub item: Option<u64>,
    /// Position of the node in the graph file.
    pub location: Location,
    /// The message.
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

/// Statistics of a node.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeStats {
    /// Its name.
    pub name: String,
    /// Activations, including skipped ones; for a source, its answers.
    pub items: u64,
    /// Activations skipped because an input had no value.
    pub skipped: u64,
    /// Activations that failed.
    pub failed: u64,
    /// Activations to which no input brought a value, including skipped ones.
    pub unfed: u64,
    /// Why the last of these brought none.
    pub last_empty: Option<Arc<Empty>>,
    /// Total time of its firings; may include the engine's own work for a firing, which is below a microsecond.
    pub busy: Duration,
    /// Processor time of its firings, where the run measures it.
    pub cpu: Option<Duration>,
    /// From the beginning of its first activation to its end.
    pub wall: Duration,
    /// Median duration of its firings; like all percentiles, up to 3 % above the exact one.
    pub p50: Duration,
    /// 95th percentile.
    pub p95: Duration,
    /// 99th percentile.
    pub p99: Duration,
}

/// Statistics of a link.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkStats {
    /// The producing wire, `node.port`.
    pub from: String,
    /// The consuming port, `node.port`.
    pub to: String,
    /// Items sent; equals received + dropped at the end of a run.
    pub sent: u64,
    /// Items received.
    pub received: u64,
    /// Items dropped by its policy.
    pub dropped: u64,
    /// Items of its wire that a live source gave later than promised; they are empties.
    pub late: u64,
    /// Items received that had no partner to fire with.
    pub unmatched: u64,
    /// Largest number of waiting items.
    pub highest_fill: usize,
    /// Capacity at the end of the run.
    pub capacity: usize,
}

/// How a contract of time was kept.
#[derive(Debug, Clone, PartialEq)]
pub struct ContractStats {
    /// The node.
    pub node: String,
    /// What it is about: the input or the wire `node.port`, or the node.
    pub on: String,
    /// What was asked.
    pub kind: ContractKind,
    /// The maximum.
    pub limit_ns: StampNs,
    /// Number of values, firings or gaps.
    pub n: u64,
    /// Number of those that broke it.
    pub n_broken: u64,
    /// The activation or item that broke it first.
    pub first: Option<u64>,
    /// The ages, durations or gaps. In a replay the ages are those by stamps, but for values that were too old by arrival, and
    /// only durations that were too long are known.
    pub spread: Spread,
}

/// What a contract of time asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ContractKind {
    /// The maximum age of an input's values.
    MaxAge,
    /// The maximum duration of a firing.
    Deadline,
    /// The longest silence of a wire.
    Silence,
}

impl ContractKind {
    /// `age`, `firing` or `silence`.
    pub fn name(self) -> &'static str {
        match self {
            Self::MaxAge => "age",
            Self::Deadline => "firing",
            Self::Silence => "silence",
        }
    }
}

impl ContractStats {
    /// The sign that it was broken, which a replay gives again: without what was measured.
    pub fn broken(&self) -> Option<Warning> {
        let Self { node, on, limit_ns, n, n_broken, .. } = self;
        let (item, limit) = (self.first?, crate::join::span((*limit_ns).into()));
        let (rule, what) = match self.kind {
            ContractKind::MaxAge => ("max_age", format!("{n_broken} of {n} values were older than {limit}")),
            ContractKind::Deadline => {
                ("missed_deadline", format!("{n_broken} of {n} firings took longer than {limit}"))
            }
            ContractKind::Silence => ("silent_wire", format!("nothing came for {limit} or longer, {n_broken} times")),
        };
        let message = format!("{on}: {what}, the first at item {item} [{rule}]");
        Some(Warning { node: node.clone(), item, message })
    }
}

/// A run that cannot start.
#[derive(Debug)]
pub enum BuildError {
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
    /// Where the faulty parameter or the table that it is missing in is set, otherwise where the node's table begins.
    pub location: Location,
    /// The faulty parameter, what was expected, what was found, and what to write instead.
    pub error: ParamError,
}

impl fmt::Display for BuildFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { node, location, error } = self;
        write!(f, "{}:{}: {}", location.file.display(), location.line, error.in_node(node))
    }
}

/// A node's failure, by its index.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Index into the plan.
    pub node: usize,
    /// Number of the activation, from 0.
    pub item: u64,
    /// The message.
    pub reason: String,
    /// Whether it panicked.
    pub panicked: bool,
    /// Whether the node went on with the next item.
    pub skipped: bool,
    /// Whether the run is refused, whatever depends on the node.
    pub refuses: bool,
}

impl Failure {
    /// An error that ends the node.
    pub(crate) fn error(node: usize, item: u64, reason: String) -> Self {
        Self { node, item, reason, panicked: false, skipped: false, refuses: false }
    }

    /// A contract of time that was broken, by which the graph refuses the run.
    pub(crate) fn of_contract(node: usize, item: u64, reason: &str) -> Self {
        let reason = format!("{reason}, and otherwise = \"refuse\"");
        Self { refuses: true, ..Self::error(node, item, reason) }
    }
}
