//! Runs a typed graph of nodes: check, plan, run, record and replay; no bone, point or frame is named in it.
//!
//! The modules form layers: each imports lower layers only, which `tests/arrows` checks. From the lowest up:
//!
//! | Layer | Modules |
//! |---|---|
//! | a crate of its own | `osteoflow_runtime`: runs a [`plan`], catches [`panics`], finds similar [`names`]; knows no file |
//! | faults and hashes | [`fault`], [`hash`] |
//! | file contents | `graph` (a graph file as a tree), [`recording`] (what a recording holds) |
//! | cache | [`store`] |
//! | nodes in processes of their own | `process` (messages and shared memory) |
//! | options of a run | `options` |
//! | what a run uses | [`plugin`], `answer_cache` (answers of the store instead of firings) |
//! | input and output | [`check()`], `record`, [`repro`] |
//! | whole tasks on files | [`ages`], [`run()`], [`validate`], [`diff`], [`recover`], [`schema`] |
//! | repeated runs | `partial`, [`inputs`], [`replay()`], [`watch`], [`sweep`] |
//!
//! A graph that is checked and run:
#![doc = concat!("```\n", include_str!("../examples/run_a_graph.rs"), "```")]

pub mod ages;
mod answer_cache;
pub mod check;
mod cpu_time;
pub mod diff;
pub mod fault;
mod graph;
pub mod hash;
pub mod inputs;
mod options;
mod partial;
pub mod plugin;
mod process;
pub mod record;
pub mod recording;
pub mod recover;
pub mod replay;
pub mod repro;
pub mod run;
pub mod schema;
mod shown_paths;
pub mod store;
pub mod sweep;
pub mod temporary;
pub mod validate;
pub mod watch;

pub use check::{Checked, CheckedFile, Module, check, check_file, check_recorded, check_text};
pub use fault::{Fault, Faults, Severity};
pub use osteoflow_container::{durable, irregular, regular};
pub use osteoflow_runtime::{activity, names, panics, plan};
pub use recording::Recording;
pub use recording::provenance::Provenance;
pub use replay::{ReplayOptions, ReplayReport, replay};
pub use run::{Event, Observer, Outcome, Refusal, RunError, RunOptions, RunReport, run};
pub use shown_paths::replace as replace_path;

use osteoflow_runtime as runtime;

#[cfg(test)]
mod tests {
    pub(crate) mod plan_builder;
}
