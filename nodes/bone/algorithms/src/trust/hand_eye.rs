//! What tests the camera's place on its marker where it is given, and not calibrated in the run.

use super::case::Case;
use super::predict::{PredictParams, carried, isotropic};
use super::residuals::Residuals;
use crate::kabsch::centroid;
use crate::still_average::BonePose;
use nalgebra::{Isometry3, Matrix3x6, Matrix6, Point3, RowVector6};

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
/// if the scan was not carried by the camera's marker, or the matrix was calibrated in the run.
///
/// A wrong matrix displaces what the camera sees as one body with the camera. While the camera rests against the bone all its scans are
/// displaced alike, and neither surface nor landmarks show it. Where the camera turned between the scan and a laser scan, both part; how far
/// they lie apart along the surface's normals then limits the error. A check piece, or a stylus, sees it where it is.
///
/// # Source
/// The errors that a motion leaves open are those of hand-eye calibration: Tsai and Lenz 1989.
pub(super) fn untested_hand_eye(case: &Case<'_>, errors: &PredictParams) -> Option<(Matrix6<f64>, Point3<f64>)> {
    let takes = &case.takes;
    let scan = takes.scan.filter(|take| take.markers.iter().any(|motion| motion.marker == "camera"))?;
    if case.tracking.is_some_and(|tracking| !tracking.is_given) {
        return None;
    }
    let t_target_source = case.registered.t_target_source;
    let pose = |camera: &BonePose| t_target_source * camera.isometry();
    let camera = pose(scan.camera.as_ref()?);
    let points = case.registered.source.points();
    let stated = isotropic(errors.hand_eye_mm, errors.hand_eye_deg);
    let mut information = stated.try_inverse().unwrap_or_else(|| Matrix6::identity() * 1e12);
    let near = Residuals::new(case.registered.target, points, t_target_source, REACH_MM, MAX_POINTS)?.near;
    let apart_mm = takes.apart_mm.unwrap_or(MAX_APART_MM).max(MIN_APART_MM);
    for other in takes.located.iter().filter_map(|take| take.camera.as_ref()).map(pose) {
        for at in &near {
            let lever = displaced(&camera, &at.point) - displaced(&other, &at.point);
            let row: RowVector6<f64> = at.normal.transpose() * lever / apart_mm;
            information += row.transpose() * row / near.len() as f64;
        }
    }
    let mut turn = Matrix6::zeros();
    let rotation = camera.rotation.to_rotation_matrix().into_inner();
    turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    let left = turn * information.try_inverse()? * turn.transpose();
    let centre = t_target_source * centroid(points);
    let read = case.check.iter().filter(|reading| reading.read_at_ns >= case.registered.source.stamp_ns);
    let seen_mm = read.map(|reading| reading.mean_mm).chain(case.measured_tre_mm).min_by(f64::total_cmp);
    let mut information = carried(&left, &Point3::from(camera.translation.vector), &centre).try_inverse()?;
    let seen = seen_mm.map(|mm| isotropic(mm / 3.0_f64.sqrt(), (mm / SPAN_MM).to_degrees()));
    information += seen.and_then(|seen| seen.try_inverse()).unwrap_or_else(Matrix6::zeros);
    Some((information.try_inverse()?, centre))
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

/// What a shift and a turn in the camera's frame do to a point that a camera at this pose sees.
fn displaced(camera: &Isometry3<f64>, p: &Point3<f64>) -> Matrix3x6<f64> {
    let rotation = camera.rotation.to_rotation_matrix().into_inner();
    let mut lever = Matrix3x6::zeros();
    lever.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    let arm = p.coords - camera.translation.vector;
    lever.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-arm.cross_matrix() * rotation));
    lever
}
