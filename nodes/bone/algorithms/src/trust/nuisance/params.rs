//! Priors of what may be wrong beside the pose.

use super::cause::Cause;
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::Deserialize;

/// What may be wrong beside the pose in a sound procedure, as standard deviations, and when it counts as measured.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct NuisanceParams {
    /// Standardised score from which a cause is measured; below it is bounded or unseen. 3.3: the level of false alarms over all causes. The
    /// largest score of 58 simulated sound scans with the measured errors of scanners is 3.4, and below 2.9 in 95 % of them.
    #[param(3.3, 0.0..=1000.0)]
    pub min_score: f64,
    /// Stretch of the CT along the bone, across it, or in all directions, percent. 0.5: a spacing in DICOM is rounded to less, and
    /// a table that lags by half a slice in 100 is as much.
    #[param(0.5, 0.001..=100.0)]
    pub stretch_percent: f64,
    /// Shear of the CT's slices, as by a tilt of the gantry, degrees. 0.1: scanners state a tilt to as much, and it is corrected or
    /// it is many degrees.
    #[param(0.1, 0.001..=90.0)]
    pub shear_deg: f64,
    /// Bend of the bone against the CT, mm at the ends of the scan against its middle. 0.02: what 1.6 N at an arm of 100 mm bend 100 mm
    /// of a fibula (17 GPa, 600 mm^4), which lies free.
    #[param(0.02, 0.001..=100.0)]
    pub bend_mm: f64,
    /// Twist of the bone against the CT, degrees from the middle of the scan to its ends. 0.1: a fibula without load.
    #[param(0.1, 0.001..=90.0)]
    pub twist_deg: f64,
    /// Offset of the CT's surface, as by a segmentation's threshold, mm. 0.2: a quarter of a voxel of 0.8 mm.
    #[param(0.2, 0.001..=100.0)]
    pub offset_mm: f64,
    /// Film on the bone, mm. 0.3: what remains after cleaning.
    #[param(0.3, 0.001..=100.0)]
    pub film_mm: f64,
    /// Displacement of a part of the bone across it, mm. 0.02: a bone in one piece, as its bend.
    #[param(0.02, 0.001..=100.0)]
    pub step_mm: f64,
    /// Scale of the camera and of its depth against the calibration, percent. 0.2: the drift of a structured-light camera that
    /// warms up.
    #[param(0.2, 0.001..=100.0)]
    pub camera_percent: f64,
    /// Scale of the camera from which it is reported, percent. 1.3: simulated estimates scatter by 0.3 %, so that 2 %
    /// is noticed; less may as well be a stretch of the CT, which moves the cuts less.
    #[param(1.3, 0.0..=100.0)]
    pub min_camera_percent: f64,
    /// Bend from which it is reported, mm. 0.3: less is an error of the camera's depth.
    #[param(0.3, 0.0..=100.0)]
    pub min_bend_mm: f64,
    /// Amplitude of the error of the camera's depth that is one wave over the scan, mm; a shorter wave has less in proportion to its
    /// length. 0.1: a calibrated structured-light camera.
    #[param(0.1, 0.001..=100.0)]
    pub field_mm: f64,
}

impl NuisanceParams {
    /// Prior standard deviation of a cause's parameters.
    pub(super) fn prior(&self, cause: Cause) -> f64 {
        match cause {
            Cause::Along | Cause::Growth | Cause::Across => self.stretch_percent / 100.0,
            Cause::Shear => self.shear_deg.to_radians(),
            Cause::Bend => self.bend_mm,
            Cause::Twist => self.twist_deg.to_radians(),
            Cause::Offset => self.offset_mm,
            Cause::FilmAlong | Cause::FilmAround | Cause::Film => self.film_mm,
            Cause::Step { .. } => self.step_mm,
            Cause::CameraScale | Cause::CameraDepth => self.camera_percent / 100.0,
        }
    }

    /// The least size of a cause that is told.
    pub(super) fn least(&self, cause: Cause) -> f64 {
        match cause {
            Cause::CameraScale => self.min_camera_percent / 100.0,
            Cause::Bend => self.min_bend_mm,
            _ => 0.0,
        }
    }
}
