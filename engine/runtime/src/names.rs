//! Nearest known names, and patterns over names.

pub mod glob;
pub mod nearest;
