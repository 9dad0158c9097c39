//! The long axis of the bone where the scan lies.

use super::surface::Scene;
use crate::axes::largest_first;
use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};

/// Reciprocal of the minimum share of the points that must lie near the surface.
pub(super) const MIN_NEAR_PART: usize = 4;

/// Normals steeper to the scan's long axis than this cosine are of an end of the bone.
const END: f64 = 0.5;

/// Minimum ratio of length to width of a scan whose own long axis tells the ends of the bone.
const MIN_ELONGATION: f64 = 1.5;

/// A line along the bone.
#[derive(Debug, Clone)]
pub(super) struct LongAxis {
    /// Unit vector; its largest component is positive.
    pub(super) along: Vector3<f64>,
    /// The point of the axis beside the scan's centroid.
    pub(super) middle: Point3<f64>,
    /// RMS distance of the surface from the axis, mm.
    pub(super) radius_mm: f64,
}

impl LongAxis {
    /// The direction that is least along the normals of the surface where the scan lies, through the point that their lines
    /// pass closest. `None` if too few points lie near the surface.
    ///
    /// Source: the translation that leaves a cylinder on itself, Gelfand and Guibas 2004.
    pub(super) fn new(seen: &Scene<'_>, pose: &Isometry3<f64>) -> Option<Self> {
        let beside = seen.all_beside(&seen.points, pose);
        let near: Vec<(Point3<f64>, Vector3<f64>)> = seen
            .points
            .iter()
            .zip(&beside)
            .filter_map(|(p, b)| b.map(|b| (pose * p - b.normal * b.signed_mm, b.normal)))
            .collect();
        if near.len() * MIN_NEAR_PART < seen.n() {
            return None;
        }
        let n = near.len() as f64;
        let mean: Vector3<f64> = near.iter().map(|(p, _)| p.coords).sum::<Vector3<f64>>() / n;
        let scatter: Matrix3<f64> = near.iter().map(|(p, _)| (p.coords - mean) * (p.coords - mean).transpose()).sum();
        let (long, spread) = largest_first(&scatter);
        let is_long = spread[0] > MIN_ELONGATION * MIN_ELONGATION * spread[1];
        let is_end = |normal: &Vector3<f64>| is_long && normal.dot(&long[0]).abs() > END;
        let sides: Vec<&(Point3<f64>, Vector3<f64>)> = near.iter().filter(|(_, normal)| !is_end(normal)).collect();
        let normals: Matrix3<f64> = sides.iter().map(|(_, normal)| normal * normal.transpose()).sum();
        let (directions, _) = largest_first(&normals);
        let along = directions[2];
        let along = if along[along.iamax()] < 0.0 { -along } else { along };

        // The point closest to all lines along the normals, across the axis.
        let (mut h, mut b) = (along * along.transpose() * n, along * along.dot(&mean) * n);
        for (p, normal) in &sides {
            let Some(line) = (normal - along * normal.dot(&along)).try_normalize(1e-6) else { continue };
            let across = Matrix3::identity() - along * along.transpose() - line * line.transpose();
            h += across;
            b += across * p.coords;
        }
        let middle = Point3::from(h.try_inverse()? * b);
        let off = |p: &Point3<f64>| (p - middle - along * (p - middle).dot(&along)).norm_squared();
        let radius_mm = (sides.iter().map(|(p, _)| off(p)).sum::<f64>() / sides.len().max(1) as f64).sqrt();
        (radius_mm.is_finite() && radius_mm > 0.0).then_some(Self { along, middle, radius_mm })
    }

    /// A pose moved along the axis and about it.
    pub(super) fn moved(&self, pose: &Isometry3<f64>, along_mm: f64, turn_rad: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::new(self.along * turn_rad);
        let shift = self.middle - turn * self.middle + self.along * along_mm;
        Isometry3::from_parts(shift.into(), turn) * pose
    }

    /// How far along the axis (mm) and about it (rad) a pose lies from another: the shift of the scan's centroid, and the twist
    /// of the rotation.
    pub(super) fn offset(&self, seen: &Scene<'_>, from: &Isometry3<f64>, pose: &Isometry3<f64>) -> [f64; 2] {
        let along_mm = (pose * seen.centroid - from * seen.centroid).dot(&self.along);
        let turn = pose.rotation * from.rotation.inverse();
        let half = f64::atan2(turn.vector().dot(&self.along), turn.scalar());
        let turn_rad = 2.0 * half;
        let tau = std::f64::consts::TAU;
        [along_mm, turn_rad - tau * (turn_rad / tau).round()]
    }
}
