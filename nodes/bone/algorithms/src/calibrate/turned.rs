//! Other poses in which the phantom's scan fits its CAD as well: a cube without its blocks looks the same from each corner.

use super::align::{Steps, align};
use super::pairs::{Faces, Scan, capped_rms_mm, distances, on_faces};
use super::parts::PhantomPart;
use crate::kabsch::centroid;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Largest angle between the normals of two faces, as its sine, that are taken for parallel.
const PARALLEL: f64 = 0.1;

/// Difference of the angles between two pairs of faces, as that of their cosines, up to which one pair may be the other.
const SAME_ANGLE: f64 = 0.02;

/// Maximum number of poses that are tried: a cube has 23.
const MAX_TURNS: usize = 60;

/// Turns by less are the fit itself, rad.
const MIN_TURN: f64 = 0.2;

/// Pairs farther apart are not used in the last steps, mm.
const LAST_MM: f64 = 0.5;

/// The turn of the phantom, about its own axes, in which its CAD fits the scan best of all others: rotation vector, rad, and
/// [`capped_rms_mm`] of the scan, mm; `None` without another.
pub(super) fn best_turned(
    faces: &Faces,
    scan: &Scan,
    parts: &[PhantomPart],
    t_phantom_camera: &Isometry3<f64>,
    max_mm: f64,
    cap_mm: f64,
) -> Option<([f64; 3], f64)> {
    let centre = centroid(&faces.points);
    let starts: Vec<UnitQuaternion<f64>> = turns(parts, &faces.directions());
    let steps = Steps { max_pair_mm: max_mm, first_mm: max_mm, last_mm: LAST_MM, n: 8 };
    let fits: Vec<Option<([f64; 3], f64)>> = starts
        .par_iter()
        .map(|turn| {
            let about = Translation3::from(centre.coords) * turn * Translation3::from(-centre.coords);
            let fit = align(faces, scan, &(about * t_phantom_camera), &steps, None)?;
            let found = (fit.t_phantom_camera * t_phantom_camera.inverse()).rotation;
            if found.angle() < MIN_TURN {
                return None;
            }
            let distances = distances(&on_faces(faces, scan, &fit.t_phantom_camera, max_mm));
            Some((found.scaled_axis().into(), capped_rms_mm(&distances, scan.points.len(), cap_mm)))
        })
        .collect();
    fits.into_iter().flatten().min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Rotations that take the two largest seen faces that are not parallel onto two others of the CAD.
fn turns(parts: &[PhantomPart], directions: &[Vector3<f64>]) -> Vec<UnitQuaternion<f64>> {
    let mut seen = parts.iter().map(|part| Vector3::from(part.normal));
    let Some(first) = seen.next() else { return Vec::new() };
    let Some(second) = seen.find(|normal| normal.cross(&first).norm() > PARALLEL) else { return Vec::new() };
    let frame = |a: &Vector3<f64>, b: &Vector3<f64>| {
        let across = a.cross(b).normalize();
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[*a, across.cross(a), across]))
    };
    let own = frame(&first, &second);
    let mut turns: Vec<UnitQuaternion<f64>> = Vec::new();
    for a in directions {
        for b in directions {
            let is_pair = a.cross(b).norm() > PARALLEL && (a.dot(b) - first.dot(&second)).abs() < SAME_ANGLE;
            if !is_pair || turns.len() == MAX_TURNS {
                continue;
            }
            let turn = UnitQuaternion::from_rotation_matrix(&(frame(a, b) * own.inverse()));
            if turn.angle() > MIN_TURN && turns.iter().all(|other| other.angle_to(&turn) > MIN_TURN) {
                turns.push(turn);
            }
        }
    }
    turns
}

impl Faces {
    /// The directions of its faces, without repetition: those of a body with planes alone, and some of a curved one.
    fn directions(&self) -> Vec<Vector3<f64>> {
        let mut directions: Vec<Vector3<f64>> = Vec::new();
        for normal in &self.normals {
            if directions.len() < 26 && directions.iter().all(|other| other.dot(normal) < 1.0 - SAME_ANGLE) {
                directions.push(*normal);
            }
        }
        directions
    }
}
