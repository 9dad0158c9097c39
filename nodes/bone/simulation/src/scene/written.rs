//! Clouds as the camera's program wrote them: their unit, the scale and handedness of the phantom's, and their labels.

use super::{Scene, WORKING};
use crate::SimulationError;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Cloud, CloudError, NamedPoint, Points, Region};
use std::sync::Arc;

impl Scene<'_> {
    /// The phantom's scan in the camera's unit, with its own scale and handedness.
    pub(super) fn phantom_as_written(&self, cloud: Cloud) -> Result<Cloud, CloudError> {
        let phantom = &self.params.phantom;
        let scale = self.params.camera.unit_factor * phantom.scan_scale;
        scaled(cloud, &Vector3::new(if phantom.scan_mirrored { -scale } else { scale }, scale, scale))
    }

    /// The factors of the coordinates at the bone: the camera's unit, and its scale since the calibration.
    fn factors_at_bone(&self) -> Vector3<f64> {
        let camera = &self.params.camera;
        let scale = camera.unit_factor * (1.0 + camera.scale_percent / 100.0);
        Vector3::new(scale, scale, scale * (1.0 + camera.depth_percent / 100.0))
    }

    /// A cloud of the bone in the camera's unit and scale.
    pub(super) fn bone_as_written(&self, cloud: Cloud) -> Result<Cloud, CloudError> {
        scaled(cloud, &self.factors_at_bone())
    }

    /// The region of interest, drawn on the cloud as written.
    pub(super) fn region_as_written(&self, region: Region) -> Region {
        let corner = |at: &Point3<f64>| Point3::from(at.coords.component_mul(&self.factors_at_bone()));
        Region { min: corner(&region.min), max: corner(&region.max), ..region }
    }

    /// The check piece's holes as read from a cloud as written, at the calibration or at the bone.
    pub(super) fn holes_as_written(&self, holes: Points) -> Points {
        let is_at_bone = holes.points.first().is_some_and(|hole| hole.name.starts_with(WORKING));
        let unit = Vector3::repeat(self.params.camera.unit_factor);
        let factors = if is_at_bone { self.factors_at_bone() } else { unit };
        let position = |hole: &NamedPoint| hole.position.coords.component_mul(&factors).into();
        let one = |hole: &NamedPoint| NamedPoint { position: position(hole), ..hole.clone() };
        Points { points: holes.points.iter().map(one).collect(), ..holes }
    }

    /// The label that the laser scan of a mark is given.
    pub(super) fn label(&self, mark: &Arc<str>) -> Arc<str> {
        let swap = &self.params.laser.swap;
        let at = swap.iter().position(|name| **name == **mark);
        at.map_or_else(|| mark.clone(), |at| swap[(at + 1) % swap.len()].as_str().into())
    }

    /// Refuses exchanged labels that are no marks, or fewer than two.
    pub(super) fn check_labels(&self) -> Result<(), SimulationError> {
        let swap = &self.params.laser.swap;
        let is_twice = |at: usize, name: &String| swap[..at].contains(name);
        let is_bad = |(at, name): (usize, &String)| is_twice(at, name) || self.laser_marks.get(name).is_none();
        if swap.is_empty() || (swap.len() > 1 && !swap.iter().enumerate().any(is_bad)) {
            return Ok(());
        }
        let marks = self.laser_marks.points.iter().map(|mark| &*mark.name).collect::<Vec<_>>().join(", ");
        Err(SimulationError::Unsuitable(format!(
            "laser.swap is {swap:?}, but must be two or more different marks of the laser ({marks}), or empty"
        )))
    }
}

/// The cloud with each coordinate multiplied; itself if by 1.
fn scaled(cloud: Cloud, factors: &Vector3<f64>) -> Result<Cloud, CloudError> {
    if *factors == Vector3::repeat(1.0) {
        return Ok(cloud);
    }
    let points: Vec<Point3<f64>> =
        cloud.points().iter().map(|p| Point3::from(p.coords.component_mul(factors))).collect();
    let mut scaled = Cloud::new(&cloud.frame, points)?.at(cloud.stamp_ns);
    for (name, values) in cloud.extras() {
        scaled = scaled.with_extra(name.clone(), values.clone())?;
    }
    (scaled.viewpoint, scaled.label) = (cloud.viewpoint, cloud.label);
    Ok(scaled)
}
