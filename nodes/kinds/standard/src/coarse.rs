//! Coarse registration, which gives the fine one its start. All kinds have the same ports; some leave a few unused.

pub mod global;
pub mod three_point;
