//! Stands in for `foxglove.rs` without the feature `viewer`: no views.

use osteoflow_geometry::{Frame, Planes, Pose, nalgebra::Point3};
use osteoflow_node::{Display, StampNs};

pub(crate) fn points_schema() -> Option<Display> {
    None
}

pub(crate) fn transform_schema() -> Option<Display> {
    None
}

pub(crate) fn poses_schema() -> Option<Display> {
    None
}

pub(crate) fn points(_: &Frame, _: StampNs, _: &[Point3<f64>]) -> Option<Vec<u8>> {
    None
}

pub(crate) fn transform(_: &Pose, _: StampNs) -> Option<Vec<u8>> {
    None
}

pub(crate) fn poses(_: &Planes, _: StampNs) -> Option<Vec<u8>> {
    None
}
