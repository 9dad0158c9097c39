//! What tests the camera's place on its marker where it is given, and not calibrated in the run.

use super::case::Case;
use super::predict::{PredictParams, carried, isotropic, rotated};
use super::residuals::{Residual, Residuals};
use crate::kabsch::centroid;
use crate::still_average::TakeMotion;
use nalgebra::{Isometry3, Matrix6, Point3, Vector6};

/// The name of its term in the predicted error.
pub(super) const HAND_EYE: &str = "camera on its marker, as given";

/// Points of the scan that are looked at, and how far from the surface, mm.
const MAX_POINTS: usize = 500;
const REACH_MM: f64 = 5.0;

/// Distance of a laser scan from the scan, mm, from which a detector of holes refuses it; where it is not told, it may be as large.
const MAX_APART_MM: f64 = 0.5;

/// Least such distance, mm: noise of both scans.
const MIN_APART_MM: f64 = 0.05;

/// Length over which a check piece or a stylus sees a turn, mm.
const SPAN_MM: f64 = 100.0;

/// What errors of a given matrix may do to the scan: covariance of a shift (mm) and a turn (rad) about a point, in the target's frame. `None`
/// if no camera's marker carried the scan, or the matrix was calibrated in the run.
///
/// A wrong matrix displaces what the camera sees as one body with the camera. While the camera rests against the bone all its scans are
/// displaced alike, and neither surface nor landmarks show it. Where the camera turned between the scan and a laser scan, both part; how far
/// they lie apart along the surface's normals then limits the error. A check piece, or a stylus, sees it where it is; of several the one
/// that sees the most counts.
///
/// # Source
/// The errors that a motion leaves open are those of hand-eye calibration: Tsai and Lenz 1989.
pub(super) fn untested_hand_eye(case: &Case<'_>, errors: &PredictParams) -> Option<(Matrix6<f64>, Point3<f64>)> {
    let Case { registered, takes, check, measured_tre_mm, tracking, is_calibrated, .. } = case;
    let t_target_source = registered.t_target_source;
    let pose = |take: &TakeMotion| Some(t_target_source * take.camera.as_ref()?.isometry());
    let camera = match takes.scan {
        Some(scan) => pose(scan),
        // A matrix was wired, and no motion.
        None => tracking.and(registered.source.viewpoint).map(|camera| t_target_source * camera),
    };
    let camera = camera.filter(|_| !is_calibrated)?;
    let points = registered.source.points();
    let mut information = isotropic(errors.hand_eye_mm, errors.hand_eye_deg).try_inverse()?;
    let near = Residuals::new(registered.target, points, t_target_source, REACH_MM, MAX_POINTS)?.near;
    let apart_mm = takes.apart_mm.unwrap_or(MAX_APART_MM).max(MIN_APART_MM);
    for other in takes.located.iter().filter_map(pose) {
        for residual in &near {
            let row = (along_normal(&camera, residual) - along_normal(&other, residual)) / apart_mm;
            information += row * row.transpose() / near.len() as f64;
        }
    }
    let centre = t_target_source * centroid(points);
    let left = rotated(&information.try_inverse()?, &camera.rotation);
    let mut information = carried(&left, &Point3::from(camera.translation.vector), &centre).try_inverse()?;
    let read = check.iter().filter(|reading| reading.read_at_ns >= registered.source.stamp_ns);
    let tests_mm = read.map(|reading| reading.mean_mm).chain(*measured_tre_mm);
    if let Some(mm) = tests_mm.max_by(f64::total_cmp) {
        let mm = mm.max(MIN_APART_MM);
        information += isotropic(mm / 3.0_f64.sqrt(), (mm / SPAN_MM).to_degrees()).try_inverse()?;
    }
    Some((information.try_inverse()?, centre))
}

/// By how much a shift and a turn in the camera's frame displace a point that this camera sees, along the surface's normal.
fn along_normal(camera: &Isometry3<f64>, Residual { point, normal, .. }: &Residual) -> Vector6<f64> {
    let (p, n) = (camera.inverse_transform_point(point), camera.inverse_transform_vector(normal));
    let turn = p.coords.cross(&n);
    Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z)
}

/// What is taken for granted of a matrix whose error is stated, and not left as unknown.
pub(super) fn stated_hand_eye(case: &Case<'_>, errors: &PredictParams) -> Option<String> {
    let (unknown, PredictParams { hand_eye_mm, hand_eye_deg, .. }) = (PredictParams::default(), errors);
    let is_stated = *hand_eye_mm < unknown.hand_eye_mm || *hand_eye_deg < unknown.hand_eye_deg;
    untested_hand_eye(case, errors).filter(|_| is_stated)?;
    Some(format!(
        "t_camera_camera_marker is as given, to {hand_eye_mm} mm and {hand_eye_deg} degrees as stated, and not inverted, of another camera or \
         in another unit: no residual of a camera that rests shows it; a stylus or a check piece does"
    ))
}
