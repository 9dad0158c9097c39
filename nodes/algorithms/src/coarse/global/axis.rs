//! Long axes of scan and bone.

use super::GlobalError;
use super::descent::{Placed, Points};
use super::near_map::NearMap;
use crate::kabsch::centroid;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_geometry::Cloud;

/// Minimum number of points that tell the shape of a scan.
const MIN_POINTS: usize = 200;

/// Minimum ratio of length to width of a scan whose long axis can be laid along the bone.
const MIN_ELONGATION: f64 = 1.5;

/// Distance of the centroid of one face of a shaft from the shaft's axis, as a share of its mean radius.
const FACE_OFFSET: f64 = 0.6;

/// The scan's centroid, long axis and the side from which it was seen.
pub(super) struct Scan {
    pub(super) middle: Point3<f64>,
    /// The camera's place, if known.
    pub(super) camera: Option<Point3<f64>>,
    along: Vector3<f64>,
    outward: Vector3<f64>,
    pub(super) half_length_mm: f64,
}

impl Scan {
    pub(super) fn new(source: &Cloud) -> Result<Self, GlobalError> {
        let points = source.points();
        if points.len() < MIN_POINTS {
            return Err(GlobalError::TooFew { n: points.len(), needed: MIN_POINTS });
        }
        let (middle, axes, spread) = principal(points);
        let elongation = (spread[0] / spread[1].max(f64::MIN_POSITIVE)).sqrt();
        if elongation < MIN_ELONGATION {
            return Err(GlobalError::NoDirection { elongation, needed: MIN_ELONGATION });
        }
        let along = axes[0];
        let across = |v: Vector3<f64>| (v - along * v.dot(&along)).try_normalize(1e-6);
        let camera = source.viewpoint.map(|t| t * Point3::origin());
        let seen = camera.and_then(|camera| across(camera - middle));
        // The way it bulges: points far out to both sides lie lower.
        let bulge: f64 = points.iter().map(|p| (p - middle).dot(&axes[1]).powi(2) * (p - middle).dot(&axes[2])).sum();
        let outward = seen.or_else(|| across(axes[2] * if bulge > 0.0 { -1.0 } else { 1.0 }));
        let outward = outward.ok_or(GlobalError::NoDirection { elongation, needed: MIN_ELONGATION })?;
        let heights = points.iter().map(|p| (p - middle).dot(&along));
        let (min, max) = heights.fold((f64::MAX, f64::MIN), |(a, b), h| (a.min(h), b.max(h)));
        Ok(Self { middle, camera, along, outward, half_length_mm: (max - min) / 2.0 })
    }

    /// About `n` points about the centroid, evenly through their order.
    pub(super) fn thinned(&self, points: &[Point3<f64>], n: usize) -> Vec<Vector3<f64>> {
        points.iter().step_by(points.len().div_ceil(n).max(1)).map(|p| p - self.middle).collect()
    }

    /// Points about the centroid with the camera.
    pub(super) fn seen<'a>(&self, points: &'a [Vector3<f64>]) -> Points<'a> {
        Points { points, camera: self.camera.map(|camera| camera - self.middle) }
    }

    /// The motion that takes the scan onto the target.
    pub(super) fn motion_of(&self, map: &NearMap, placed: &Placed) -> Isometry3<f64> {
        let to = map.centre().coords + placed.translation.vector;
        Isometry3::from_parts((to - placed.rotation * self.middle.coords).into(), placed.rotation)
    }
}

/// Centroid, axes and variances of points, the longest first.
fn principal(points: &[Point3<f64>]) -> (Point3<f64>, [Vector3<f64>; 3], [f64; 3]) {
    let middle = centroid(points);
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
    let eigen = (scatter / points.len().max(1) as f64).symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[j].total_cmp(&eigen.eigenvalues[i]).then(i.cmp(&j)));
    (middle, order.map(|k| eigen.eigenvectors.column(k).into_owned()), order.map(|k| eigen.eigenvalues[k]))
}

/// A position on the bone's centre line where a scan's centroid may lie, about the map's centre.
pub(super) struct Station {
    middle: Vector3<f64>,
    along: Vector3<f64>,
    /// Perpendicular to the bone: turns are counted from it.
    side: Vector3<f64>,
    radius_mm: f64,
}

impl Station {
    /// Turns from `n_turns` on are with the scan reversed end for end.
    pub(super) fn place(&self, scan: &Scan, turn: usize, n_turns: usize) -> Placed {
        let along = if turn < n_turns { self.along } else { -self.along };
        let angle = (turn % n_turns) as f64 / n_turns as f64 * std::f64::consts::TAU;
        let outward = self.side * angle.cos() + self.along.cross(&self.side) * angle.sin();
        let axes = |z: &Vector3<f64>, x: &Vector3<f64>| Rotation3::from_basis_unchecked(&[*x, z.cross(x), *z]);
        let turned = axes(&along, &outward) * axes(&scan.along, &scan.outward).inverse();
        let middle = self.middle + outward * (FACE_OFFSET * self.radius_mm);
        Placed::from_parts(middle.into(), UnitQuaternion::from_rotation_matrix(&turned))
    }
}

/// Positions along the bone at which at least half of the scan lies on it.
pub(super) fn stations(map: &NearMap, half_length_mm: f64, slide_mm: f64) -> Vec<Station> {
    let points: Vec<Point3<f64>> = map.samples().iter().step_by(4).map(|s| Point3::from(s.point)).collect();
    let (middle, axes, _) = principal(&points);
    let height = |p: &Point3<f64>| (p - middle).dot(&axes[0]);
    let (min, max) = points.iter().map(height).fold((f64::MAX, f64::MIN), |(a, b), h| (a.min(h), b.max(h)));
    let n = ((max - min) / slide_mm).ceil() as usize + 1;
    (0..n)
        .filter_map(|k| {
            let at = min + k as f64 * slide_mm;
            let near: Vec<Point3<f64>> =
                points.iter().filter(|p| (height(p) - at).abs() <= half_length_mm).copied().collect();
            if near.len() < 10 {
                return None;
            }
            let (local, local_axes, _) = principal(&near);
            // A piece as short as wide has no axis; use that of the bone.
            let bend = local_axes[0].dot(&axes[0]);
            let along = if bend.abs() > 0.8 { local_axes[0] * bend.signum() } else { axes[0] };
            let side = (axes[1] - along * axes[1].dot(&along)).try_normalize(1e-6)?;
            let from_line = |p: &Point3<f64>| (p - local - along * (p - local).dot(&along)).norm();
            let radius_mm = near.iter().map(from_line).sum::<f64>() / near.len() as f64;
            let centre = local + along * ((middle - local).dot(&along) + at);
            Some(Station { middle: centre.coords, along, side, radius_mm })
        })
        .collect()
}
