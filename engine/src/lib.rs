//! Runs a typed graph of nodes: check, plan, run, record and replay; no bone, point or frame is named in it.

pub mod plan;
