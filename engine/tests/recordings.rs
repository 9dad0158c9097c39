//! Reading recordings: digests, validation, differences and recovery of damaged files.

mod damaged;
mod diff;
mod digest;
mod recover;
mod rewrite;
mod schema;
mod toy;
mod validate;
