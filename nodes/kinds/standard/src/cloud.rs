//! Operations on clouds: downsampling, normals, merging.

pub mod downsample;
pub mod from_points;
pub mod merge;
pub mod normals;
