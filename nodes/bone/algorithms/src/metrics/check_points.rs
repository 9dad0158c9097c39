use super::{PoseErrorReport, TreReport, pose_error, tre};
use crate::Refusal;
use nalgebra::{Isometry3, Matrix3, Point3};
use osteoflow_geometry::{Axes, NamedPoint, StampNs};
use serde::{Deserialize, Serialize};

/// Errors of a calibration at points of a check piece with known positions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CheckReport {
    /// Place of the piece: the points' names up to their last `_`, such as `working`.
    pub place: String,
    /// When the last of the points was read; 0 if that is not known.
    #[serde(default)]
    pub read_at_ns: StampNs,
    /// Mean distance of the points from the camera along its axis, mm.
    pub depth_mm: f64,
    /// Mean distance between transformed and known points, mm.
    pub mean_mm: f64,
    /// Standard deviation of the distances, over n - 1, mm; 0 for one point.
    pub sd_mm: f64,
    /// Smallest distance, mm.
    pub min_mm: f64,
    /// Largest distance, mm.
    pub max_mm: f64,
    /// Transformed minus known, along the camera's axes: a positive z is too far from the camera.
    pub error: TreReport,
    /// Error of the calibration at the points' centroid, if the true one is known.
    pub pose: Option<PoseErrorReport>,
}

/// Errors of `read` points (camera) against `known` points (world), transformed by `t_camera_world` (calibration and
/// localiser) and paired by name. `pose` is `t * inverse(t_true)` of the calibration, if known.
///
/// # Errors
/// [`Refusal`] if there is no point, one has no counterpart, or one is not finite.
///
/// # Source
/// Section 3.1 of the paper.
pub fn check_points(
    read: &[NamedPoint],
    known: &[NamedPoint],
    t_camera_world: &Isometry3<f64>,
    pose: Option<&Isometry3<f64>>,
) -> Result<CheckReport, Refusal> {
    let in_camera: Vec<NamedPoint> =
        known.iter().map(|p| NamedPoint { position: t_camera_world * p.position, ..p.clone() }).collect();
    let axes = Axes { frame: "camera".into(), centre: Point3::origin(), columns: Matrix3::identity() };
    let error = tre(&in_camera, read, &Isometry3::identity(), &axes)?;
    let norms = || error.points.iter().map(|p| p.norm);
    let n = error.n as f64;
    let mean_mm = norms().sum::<f64>() / n;
    let squares: f64 = norms().map(|e| (e - mean_mm).powi(2)).sum();
    let middle = Point3::from(read.iter().map(|p| p.position.coords).sum::<nalgebra::Vector3<f64>>() / n);
    let name = read.first().map_or("", |p| &*p.name);
    Ok(CheckReport {
        place: name.rsplit_once('_').map_or(name, |(place, _)| place).to_owned(),
        read_at_ns: read.iter().map(|p| p.stamp_ns).max().unwrap_or(0),
        depth_mm: middle.z,
        mean_mm,
        sd_mm: (squares / (n - 1.0).max(1.0)).sqrt(),
        min_mm: norms().fold(f64::INFINITY, f64::min),
        max_mm: norms().fold(0.0, f64::max),
        pose: pose.map(|pose| pose_error(pose, &middle)),
        error,
    })
}
