//! Runs a [`Plan`](plan::Plan): fires its nodes and moves items along its links. This crate reads and writes no files:
//! items, firings, drops and failures leave it through [`Tap`]s.
//!
//! The graph is a Kahn network. Every link is a bounded queue; a node fires when its ports join and its outputs have
//! room, so that no worker blocks inside a send and one worker can run any graph. Results and recorded wires are the
//! same for any number of workers.
//!
//! It is a crate of its own because it is the only part of the engine that every item passes through: it alone is
//! compiled for speed.

pub mod activity;
mod channel;
mod histogram;
mod inject;
mod join;
mod latency;
mod messages;
pub mod names;
mod outcome;
pub mod panics;
pub mod plan;
mod report;
mod runtime;
mod scheduler;
mod sign;
mod sync;
mod tap;

pub use histogram::Spread;
pub use inject::{Injected, Injection, planned_failure};
pub use latency::{Latency, LatencyStats};
pub use outcome::RunOutcome;
pub use report::{
    BuildError, BuildFault, ContractKind, ContractStats, Enlargement, Event, Failure, LinkStats, NodeStats, Observer,
    Refusal, Warning,
};
pub use runtime::{AnswerCache, CpuClock, RunSettings, Runtime, emission_fault, refusal, stamp_or_zero};
pub use sign::Sign;
pub use sync::on_workers;
pub use tap::{Failed, Replayed, Substitutes, Tap};
