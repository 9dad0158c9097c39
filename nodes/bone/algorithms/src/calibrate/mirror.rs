//! The mirror image of a scan.

use super::align::{Steps, align};
use super::pairs::{Faces, Scan, capped_rms_mm, distances, on_faces};
use crate::kabsch::centroid;
use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Planes of reflection through the line of sight: of a cube seen corner on, each symmetry is within 15 degrees.
const N_PLANES: usize = 6;

/// Pairs farther apart are not used in the last steps, mm: beyond a camera's noise, within the height of a block.
const LAST_MM: f64 = 0.5;

/// The smallest [`capped_rms_mm`] of the scan's mirror image, mm, registered from the fitted and the nominal pose; `None`
/// without a fit.
pub(super) fn mirrored_mm(
    faces: &Faces,
    scan: &Scan,
    t_phantom_camera: &Isometry3<f64>,
    t_phantom_camera_nominal: &Isometry3<f64>,
    max_mm: f64,
    cap_mm: f64,
) -> Option<f64> {
    let sight = Unit::try_new(centroid(&scan.points).coords, 1e-9)?;
    let across = Unit::try_new(sight.cross(&Vector3::y()), 1e-9)?;
    // Through the line of sight, about which the scan stays in place; and as a reader flips an axis.
    let turned = |k: usize| {
        UnitQuaternion::from_axis_angle(&sight, k as f64 * std::f64::consts::PI / N_PLANES as f64) * across.into_inner()
    };
    let mut starts: Vec<(Vector3<f64>, &Isometry3<f64>)> =
        (0..N_PLANES).map(|k| (turned(k), t_phantom_camera)).collect();
    starts.extend([Vector3::x(), Vector3::y()].map(|axis| (axis, t_phantom_camera_nominal)));
    let steps = Steps { max_pair_mm: max_mm, first_mm: max_mm, last_mm: LAST_MM, n: 8 };
    let misfits: Vec<Option<f64>> = starts
        .par_iter()
        .map(|(axis, start)| {
            let flip = |v: &Vector3<f64>| v - axis * (2.0 * v.dot(axis));
            let image = Scan {
                points: scan.points.iter().map(|p| Point3::from(flip(&p.coords))).collect(),
                normals: scan.normals.iter().map(flip).collect(),
            };
            let fit = align(faces, &image, start, &steps, None)?;
            let distances = distances(&on_faces(faces, &image, &fit.t_phantom_camera, max_mm));
            Some(capped_rms_mm(&distances, image.points.len(), cap_mm))
        })
        .collect();
    misfits.into_iter().flatten().min_by(f64::total_cmp)
}
