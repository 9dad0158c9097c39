//! Errors of the landmarks that a surgeon marks.

pub mod ruled;
