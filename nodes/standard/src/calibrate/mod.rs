//! The camera's place in its marker.

pub mod phantom_icp;
