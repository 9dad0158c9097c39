//! The tests of this crate, as one program.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod answers;
mod bones;
mod calibrations;
mod common;
mod compact;
mod gross;
mod measured;
mod one_target;
mod real;
mod surroundings;
mod traces;
