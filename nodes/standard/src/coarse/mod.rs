//! Coarse registration, where the fine one starts.

pub mod three_point;
