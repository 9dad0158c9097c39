//! Runs a typed graph of nodes: check, plan, run, record and replay; no bone, point or frame is named in it.

mod channel;
pub mod check;
mod codec;
pub mod container;
pub mod diff;
pub mod digest;
pub mod draw;
pub mod fault;
mod graph;
mod join;
mod manifest;
mod numbers;
mod part;
pub mod plan;
pub mod plugin;
pub mod record;
pub mod recording;
pub mod recover;
pub mod replay;
pub mod repro;
mod results;
pub mod run;
pub mod schema;
mod stamp;
pub mod store;
pub mod sweep;
mod sync;
#[cfg(test)]
mod toy;
pub mod validate;
pub mod watch;

pub use check::{Checked, CheckedFile, Module, check, check_file, check_recorded, check_text};
pub use fault::{Fault, Faults};
pub use recording::Recording;
pub use replay::{ReplayOptions, ReplayReport, replay};
pub use run::{Event, Observer, Outcome, Refusal, RunError, RunOptions, RunReport, run};
