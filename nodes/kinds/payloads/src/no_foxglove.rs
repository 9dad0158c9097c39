//! Stands in for `foxglove.rs` without the feature `viewer`: no views.

use osteoflow_geometry::{Frame, Image, Mesh, Planes, Points, Pose, nalgebra::Point3};
use osteoflow_node::{Display, DisplayContext, StampNs};

pub(crate) fn points_schema() -> Option<Display> {
    None
}

pub(crate) fn image_schema() -> Option<Display> {
    None
}

pub(crate) fn image(_: &Image, _: StampNs) -> Option<Vec<u8>> {
    None
}

pub(crate) fn transform_schema() -> Option<Display> {
    None
}

pub(crate) fn scene_schema() -> Option<Display> {
    None
}

pub(crate) fn points(_: &Frame, _: StampNs, _: &[Point3<f64>]) -> Option<Vec<u8>> {
    None
}

pub(crate) fn transform(_: &Pose, _: &DisplayContext<'_>) -> Option<Vec<u8>> {
    None
}

pub(crate) fn mesh(_: &Mesh, _: &DisplayContext<'_>) -> Option<Vec<u8>> {
    None
}

#[cfg(feature = "algorithms")]
pub(crate) fn surface_points(
    _: &Frame,
    _: &[Point3<f64>],
    _: Option<&[osteoflow_geometry::nalgebra::Vector3<f64>]>,
    _: &DisplayContext<'_>,
) -> Option<Vec<u8>> {
    None
}

pub(crate) fn no_planes() -> Option<Vec<u8>> {
    None
}

pub(crate) fn planes(_: &Planes, _: &DisplayContext<'_>) -> Option<Vec<u8>> {
    None
}

pub(crate) fn named_points(_: &Points, _: &DisplayContext<'_>) -> Option<Vec<u8>> {
    None
}

pub(crate) fn centre(_: &[Point3<f64>]) -> Option<[f64; 3]> {
    None
}
