//! Runs a typed graph of nodes: check, plan, run, record and replay; no bone, point or frame is named in it.

pub mod check;
pub mod draw;
pub mod fault;
mod graph;
pub mod plan;

pub use check::{Checked, check, check_recorded, check_text};
pub use fault::{Fault, Faults};
