//! The tests of this crate, as one program; `allocations` counts what its process allocates and stays alone.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod check;
mod plugin_host;
mod plugins;
mod recordings;
