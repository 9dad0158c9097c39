//! Every fault of a graph has its exact text; a good graph has its exact plan. `UPDATE=1` writes the texts anew.

#![allow(missing_docs, reason = "a test has no readers of its docs")]
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod alone;
mod damage;
mod golden;
mod modules;
mod plans;
mod toy;
