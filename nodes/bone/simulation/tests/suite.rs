//! The tests of this crate, as one program.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod common;
mod error_terms;
mod holes;
mod measured_noise;
mod mistakes;
mod phantom;
mod procedure;
mod rgb_spot;
mod shape_alone;
mod slide;
mod sweeps;
mod unseen;
