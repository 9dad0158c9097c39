//! The surface that moves.

use crate::kabsch::centroid;
use crate::morton;
use crate::normals;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Cloud;

/// The points of a scan, mm, with their normals and the position of the camera where known.
///
/// Made from a slice of points or from a [`Cloud`] with its normals and viewpoint. With a camera, points pair only with the
/// side of the target that faces it: otherwise a scan that starts some millimetres deep in a thin bone could pair with the
/// far side. A cloud merged from several views has no viewpoint, and pairs with all of the target.
#[derive(Debug, Clone, Copy)]
pub struct Source<'a> {
    pub(super) points: &'a [Point3<f64>],
    pub(super) normals: Option<&'a [Vector3<f64>]>,
    pub(super) camera: Option<Point3<f64>>,
}

impl<'a> Source<'a> {
    /// Points taken by a camera at `camera`, mm, in the points' frame.
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
pub(super) struct PreparedSource {
    pub(super) centroid: Point3<f64>,
    pub(super) points: Vec<Vector3<f64>>,
    pub(super) normals: Option<Vec<Vector3<f64>>>,
    /// RMS distance of the points from the centroid, mm.
    pub(super) lever_arm_mm: f64,
}

impl PreparedSource {
    /// Sorts finite points, with their normals, given or estimated, if they are needed.
    pub(super) fn new(source: &Source<'_>, with_normals: bool) -> Self {
        let order = morton::order(source.points);
        let sorted: Vec<Point3<f64>> = order.iter().map(|&i| source.points[i as usize]).collect();
        let centroid = centroid(&sorted);
        let points: Vec<Vector3<f64>> = sorted.iter().map(|p| p - centroid).collect();
        let squares: f64 = points.iter().map(Vector3::norm_squared).sum();
        // Points in one place have no lever arm; any length does, as no turn moves them.
        let lever_arm_mm = Some((squares / points.len() as f64).sqrt()).filter(|l| *l > 0.0).unwrap_or(1.0);
        let normals = with_normals.then(|| match source.normals {
            Some(normals) => order.iter().map(|&i| normals[i as usize]).collect(),
            None => normals::without_side(&points),
        });
        Self { centroid, points, normals, lever_arm_mm }
    }

    /// Every n-th point, about the same centroid.
    pub(super) fn every(&self, n: usize) -> Self {
        let points = self.points.iter().copied().step_by(n).collect();
        let normals = self.normals.as_ref().map(|normals| normals.iter().copied().step_by(n).collect());
        Self { points, normals, ..*self }
    }
}
