//! Distances of scan points from the surface, and their robust cost.

use crate::downsample::thinned;
use crate::kabsch::centroid;
use crate::target::{Side, Target};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::Cloud;

/// Number of scan points by which places are compared.
const N_COMPARED: usize = 2500;

/// Stride through these points for the fits of a profile.
const PROFILE_EVERY: usize = 5;

/// Points are paired within this distance, mm.
pub(super) const REACH_MM: f64 = 4.0;

/// Cosine between a normal and the direction to the camera below which a point lies on the far side of the bone.
const FAR_SIDE: f64 = -0.2;

/// Residuals count up to this many standard deviations inside the surface and outside it, where soft tissue lies.
const INSIDE_SIGMAS: f64 = 5.0;
const OUTSIDE_SIGMAS: f64 = 2.5;

/// A quarter of a Gaussian's absolute values are below this many standard deviations.
const QUARTER_SIGMAS: f64 = 0.318_639_363_964_375_15;

/// A scan before a surface with normals.
pub(super) struct Scene<'a> {
    pub(super) target: &'a Target,
    pub(super) source: &'a Cloud,
    normals: &'a [Vector3<f64>],
    /// Scan points, evenly through their order, which the start does not change.
    pub(super) points: Vec<Point3<f64>>,
    pub(super) centroid: Point3<f64>,
    pub(super) camera: Option<Point3<f64>>,
}

/// The surface beside a scan point.
#[derive(Clone, Copy)]
pub(super) struct Beside {
    pub(super) normal: Vector3<f64>,
    /// Distance along the normal, mm: positive outside.
    pub(super) signed_mm: f64,
}

impl<'a> Scene<'a> {
    /// The target must have normals.
    pub(super) fn new(target: &'a Target, source: &'a Cloud) -> Self {
        let points = thinned(source.points(), N_COMPARED);
        let camera = source.viewpoint.filter(|_| target.side() == Side::Outward).map(|t| t * Point3::origin());
        let normals = target.normals().unwrap_or_default();
        Self { target, source, normals, centroid: centroid(&points), points, camera }
    }

    pub(super) fn n(&self) -> usize {
        self.points.len()
    }

    /// The points that a profile is fitted with.
    pub(super) fn few(&self) -> Vec<Point3<f64>> {
        self.points.iter().step_by(PROFILE_EVERY).copied().collect()
    }

    /// The surface beside a moved point, if it is within reach on the side that faces the camera.
    pub(super) fn beside(&self, moved: &Point3<f64>, camera: Option<&Point3<f64>>) -> Option<Beside> {
        let (index, _) = self.target.nearest(moved, REACH_MM)?;
        let normal = *self.normals.get(index)?;
        let is_far = |camera: &Point3<f64>| normal.dot(&(camera - moved)) < FAR_SIDE * (camera - moved).norm();
        let signed_mm = (moved - self.target.points()[index]).dot(&normal);
        (!camera.is_some_and(is_far)).then_some(Beside { normal, signed_mm })
    }

    /// The surface beside each of `points` at a pose.
    pub(super) fn all_beside(&self, points: &[Point3<f64>], pose: &Isometry3<f64>) -> Vec<Option<Beside>> {
        let camera = self.camera.map(|camera| pose * camera);
        points.iter().map(|p| self.beside(&(pose * p), camera.as_ref())).collect()
    }

    /// Number of points within reach.
    pub(super) fn n_near(&self, pose: &Isometry3<f64>) -> usize {
        self.points.iter().filter(|p| self.target.nearest(&(pose * **p), REACH_MM).is_some()).count()
    }

    /// Robust standard deviation of the residuals, mm, from the better quarter, which tissue does not reach.
    pub(super) fn scale_mm(&self, pose: &Isometry3<f64>) -> f64 {
        let beside = self.all_beside(&self.points, pose);
        let mut sizes: Vec<f64> = beside.iter().map(|b| b.map_or(f64::INFINITY, |b| b.signed_mm.abs())).collect();
        let k = sizes.len() / 4;
        let quarter = *sizes.select_nth_unstable_by(k, f64::total_cmp).1;
        if quarter.is_finite() { quarter / QUARTER_SIGMAS } else { REACH_MM }
    }

    /// Robust costs of all points at a pose, mm².
    pub(super) fn costs(&self, pose: &Isometry3<f64>, loss: &Loss) -> Vec<f64> {
        loss.costs(&self.all_beside(&self.points, pose))
    }

    /// RMS distance between the scan at two poses, mm.
    pub(super) fn apart_mm(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let probes = self.points.iter().step_by((self.n() / 64).max(1));
        let (n, squares) = probes.fold((0, 0.0), |(n, sum), p| (n + 1, sum + (a * p - b * p).norm_squared()));
        (squares / f64::from(n.max(1))).sqrt()
    }
}

/// Squared residuals, limited inside the surface and closer outside it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Loss {
    inside_mm: f64,
    outside_mm: f64,
}

impl Loss {
    pub(super) fn new(sigma_mm: f64) -> Self {
        Self { inside_mm: INSIDE_SIGMAS * sigma_mm, outside_mm: OUTSIDE_SIGMAS * sigma_mm }
    }

    /// Alike on both sides.
    pub(super) fn within(limit_mm: f64) -> Self {
        Self { inside_mm: limit_mm, outside_mm: limit_mm }
    }

    fn limit_mm(&self, signed_mm: f64) -> f64 {
        if signed_mm < 0.0 { self.inside_mm } else { self.outside_mm }
    }

    /// Costs of points beside the surface, mm².
    pub(super) fn costs(&self, beside: &[Option<Beside>]) -> Vec<f64> {
        beside.iter().map(|b| self.cost(b.map(|b| b.signed_mm))).collect()
    }

    /// Cost of a residual, mm²; a point without a surface beside it counts as far outside.
    pub(super) fn cost(&self, signed_mm: Option<f64>) -> f64 {
        let Some(signed_mm) = signed_mm else { return self.outside_mm * self.outside_mm };
        signed_mm.abs().min(self.limit_mm(signed_mm)).powi(2)
    }

    /// Weight of a residual in a step: falls to zero at the limit, so that no pair jumps.
    pub(super) fn weight(&self, signed_mm: f64) -> f64 {
        let u = (signed_mm / self.limit_mm(signed_mm)).powi(2);
        if u < 1.0 { (1.0 - u) * (1.0 - u) } else { 0.0 }
    }
}
