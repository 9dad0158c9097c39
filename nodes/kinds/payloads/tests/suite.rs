//! The tests of this crate, as one program.
#![cfg(feature = "algorithms")]
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod far;
mod layout;
