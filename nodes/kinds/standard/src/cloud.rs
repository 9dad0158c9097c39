//! Operations on clouds: downsampling, normals, merging.

pub mod downsample;
pub mod from_points;
pub mod merge;
pub mod normals;

use osteoflow_geometry::Cloud;
use osteoflow_node::{Inputs, Outputs};

/// A cloud.
#[derive(Inputs)]
pub struct In {
    /// The cloud.
    cloud: Cloud,
}

/// A cloud made of another.
#[derive(Outputs)]
pub struct Out {
    /// The points that remain; of `cloud.normals`, those with a normal.
    #[port(frame = "cloud")]
    cloud: Cloud,
}
