//! Clouds made thinner, given normals, put together.

pub mod downsample;
pub mod from_points;
pub mod merge;
pub mod normals;
