//! Recordings read back: digests, checks, differences, and what is saved from damaged files.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod damaged;
mod diff;
mod digest;
mod recover;
mod rewrite;
mod schema;
mod toy;
mod validate;
