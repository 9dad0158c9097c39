//! The accuracy of a phantom's pose.

use super::shown::PhantomShown;
use crate::icp::IcpReport;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// Pose of the phantom in the camera's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PhantomFit {
    /// Takes phantom coordinates to camera coordinates.
    pub t_camera_phantom: Isometry3<f64>,
    /// Accuracy of the pose.
    pub report: PhantomReport,
}

/// Accuracy of a phantom's pose, its effect on a bone at the working distance, and what may contradict the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhantomReport {
    /// Scan points.
    pub n_points: usize,
    /// Points that pair with a face in the last step.
    pub n_pairs: usize,
    /// Noise of the scan: standard deviation of its points across the planes fitted to their neighbours, mm. From the scan
    /// alone; smooth errors of the camera are not in it.
    pub noise_mm: f64,
    /// RMS distance of the used points from their faces, mm.
    pub rms_mm: f64,
    /// Median absolute distance from the CAD's faces, of the points within `max_pair_distance_mm` of them, mm.
    pub median_mm: f64,
    /// 95th percentile of these distances, mm.
    pub p95_mm: f64,
    /// RMS distance of the nearest four fifths of the points from the CAD's faces, mm. Noise alone gives 0.66 `noise_mm`.
    pub near_rms_mm: f64,
    /// RMS distance of all points from the CAD's faces, each counted as at most `3 max_rms_mm`, mm.
    pub capped_rms_mm: f64,
    /// The least `capped_rms_mm` of the scan's mirror image, registered from a few starts, mm. As small as that of the scan
    /// only where the seen faces are their own mirror image; none if no start led to a fit.
    pub mirrored_rms_mm: Option<f64>,
    /// Share of the points within `max_pair_distance_mm` that lie farther than `3 max_rms_mm` from the CAD's faces.
    pub off_share: f64,
    /// Scale of the scan, estimated together with its pose: 1 if right, above 1 if the scan is too large. None if the seen
    /// faces do not determine it.
    pub scale: Option<f64>,
    /// Standard deviation of the scale predicted from the residuals.
    pub scale_sd: Option<f64>,
    /// Correction of the nominal pose: RMS movement of the phantom's points, mm.
    pub moved_mm: f64,
    /// Distance by which the correction moves the camera relative to the phantom, mm.
    pub moved_at_camera_mm: f64,
    /// Angle between the nominal pose and the fit, rad.
    pub moved_rad: f64,
    /// Predicted covariance of `t_camera_phantom` in the camera's frame: of a small shift (mm) and turn (rad) of the phantom
    /// about `centre_mm`, rows and columns x, y, z of the shift, then of the turn. Of the scan alone: errors of the markers
    /// and of the print are not in it.
    pub covariance: [[f64; 6]; 6],
    /// Centroid of the points that were used, in the camera's frame, mm.
    pub centre_mm: [f64; 3],
    /// Standard deviation of the rotation predicted from the residuals, rad; see [`phantom_icp`](super::phantom_icp()).
    pub rotation_sd_rad: f64,
    /// Standard deviation of the position of the centroid of the seen points, mm.
    pub translation_sd_mm: f64,
    /// The working distance, mm.
    pub working_distance_mm: f64,
    /// Predicted error of a point at the working distance in front of the camera, RMS over three directions, mm; see
    /// [`phantom_icp`](super::phantom_icp()). Of the scan alone: the placement of the markers and the print, which are not
    /// in it, cause most of a calibration's error.
    pub error_at_working_distance_mm: f64,
    /// Error that 0.1 degree would cause there, mm: 0.35 mm at 200 mm.
    pub error_of_tenth_degree_mm: f64,
    /// What the scan shows of the phantom's parts, and where it contradicts them.
    #[serde(default)]
    pub shown: PhantomShown,
    /// What the scan leaves open, one sentence each.
    #[serde(default)]
    pub notes: Vec<String>,
    /// Report of the registration.
    pub icp: IcpReport,
}
