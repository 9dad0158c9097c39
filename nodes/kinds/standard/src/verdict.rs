//! Verdicts on results.

pub mod registration;
