//! What moves.

use crate::kabsch::centroid;
use crate::morton;
use crate::normals;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Cloud;

/// What moves: the points of a scan, mm; their normals, where known; and where the camera that took it stood, where known.
///
/// Made from a slice of points or from a [`Cloud`], whose normals and viewpoint it takes. With a camera, points pair only
/// with the side of the target that faces it: a scan that starts some millimetres deep in a thin bone would else be drawn
/// to the far side. A cloud merged from several views has no viewpoint, and pairs with all of the target.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    pub(super) points: &'a [Point3<f64>],
    pub(super) normals: Option<&'a [Vector3<f64>]>,
    pub(super) camera: Option<Point3<f64>>,
}

impl<'a> Source<'a> {
    /// Points taken by a camera that stood at `camera`, mm, in the points' frame.
    pub fn seen_from(points: &'a [Point3<f64>], camera: Point3<f64>) -> Self {
        Self { points, normals: None, camera: Some(camera) }
    }

    /// With unit normals, one for each point, of either sign.
    pub fn with_normals(self, normals: &'a [Vector3<f64>]) -> Self {
        Self { normals: Some(normals), ..self }
    }
}

impl<'a> From<&'a [Point3<f64>]> for Source<'a> {
    fn from(points: &'a [Point3<f64>]) -> Self {
        Self { points, normals: None, camera: None }
    }
}

impl<'a> From<&'a Vec<Point3<f64>>> for Source<'a> {
    fn from(points: &'a Vec<Point3<f64>>) -> Self {
        Self::from(points.as_slice())
    }
}

impl<'a> From<&'a Cloud> for Source<'a> {
    fn from(cloud: &'a Cloud) -> Self {
        let camera = cloud.viewpoint.map(|v| v.translation.vector.into());
        Self { points: cloud.points(), normals: cloud.normals(), camera }
    }
}

/// Source points about their centroid, along a space-filling curve.
#[derive(Clone)]
pub(super) struct Prepared {
    pub(super) centre: Point3<f64>,
    pub(super) arms: Vec<Vector3<f64>>,
    pub(super) normals: Option<Vec<Vector3<f64>>>,
    /// RMS distance of the points from the centroid, mm.
    pub(super) lever_arm_mm: f64,
}

impl Prepared {
    /// Orders finite points; with their normals, given or estimated, if these are needed.
    pub(super) fn new(source: &Source<'_>, with_normals: bool) -> Self {
        let order = morton::order(source.points);
        let points: Vec<Point3<f64>> = order.iter().map(|&i| source.points[i as usize]).collect();
        let centre = centroid(&points);
        let arms: Vec<Vector3<f64>> = points.iter().map(|p| p - centre).collect();
        let squares: f64 = arms.iter().map(Vector3::norm_squared).sum();
        // Points in one place have no lever arm; any length does, as no turn moves them.
        let lever_arm_mm = Some((squares / arms.len() as f64).sqrt()).filter(|l| *l > 0.0).unwrap_or(1.0);
        let normals = with_normals.then(|| match source.normals {
            Some(normals) => order.iter().map(|&i| normals[i as usize]).collect(),
            None => normals::without_side(&arms),
        });
        Self { centre, arms, normals, lever_arm_mm }
    }

    /// Every n-th of the points, about the same centroid.
    pub(super) fn every(&self, n: usize) -> Self {
        let arms = self.arms.iter().copied().step_by(n).collect();
        let normals = self.normals.as_ref().map(|normals| normals.iter().copied().step_by(n).collect());
        Self { arms, normals, ..*self }
    }
}
