//! Verdicts on results.

mod loosened;
pub mod registration;
