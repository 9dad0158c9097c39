//! The tests of this crate, as one program.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod built;
mod damage;
mod mcap_crate;
mod writer;
