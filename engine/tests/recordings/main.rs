//! Reading recordings: digests, validation, differences and recovery of damaged files.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod damaged;
mod diff;
mod digest;
mod recover;
mod rewrite;
mod schema;
mod toy;
mod validate;
