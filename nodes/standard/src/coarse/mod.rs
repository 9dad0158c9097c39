//! Coarse registration, where the fine one starts: every kind takes the same ports, and leaves unused what it does without.

pub mod global;
pub mod three_point;
