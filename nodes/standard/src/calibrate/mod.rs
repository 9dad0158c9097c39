//! The camera's place in its marker, and the stylus' tip in its own.

pub mod phantom_icp;
pub mod stylus_pivot;
