//! Priors of what may be wrong beside the pose.

use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::Deserialize;

/// What may be wrong beside the pose: standard deviations in a sound procedure, and how often more is wrong.
///
/// What the scan shows of a cause narrows its prior; what it does not show enters the predicted error as it is.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[schemars(extend("x-removed" = {
    "min_score": { "default": 3.3, "warning": "min_score is ignored: a cause is measured where the chance that it makes the answer wrong says so" },
    "min_camera_percent": { "default": 1.3, "warning": "min_camera_percent is ignored: a cause is measured where the chance that it makes the answer wrong says so" },
    "min_bend_mm": { "default": 0.3, "warning": "min_bend_mm is ignored: a cause is measured where the chance that it makes the answer wrong says so" },
}))]
pub struct NuisanceParams {
    /// Stretch of the CT along the bone or in all directions. 0.5: a spacing in DICOM is rounded to less, and a table that lags
    /// by half a slice in 100 is as much.
    #[param(0.5, 0.001..=100.0)]
    pub stretch_percent: f64,
    /// Shear of the CT's slices, as by a tilt of the gantry. 0.05: a helical CT is not tilted, and DICOM rounds a tilt
    /// (0018,1120) to 0.1 as a rule.
    #[param(0.05, 0.001..=90.0)]
    pub shear_deg: f64,
    /// Bend of the bone against the CT, at the ends of the scan against its middle. 0.01: 0.8 N at an arm of 100 mm on 100 mm
    /// of a fibula (17 GPa, 600 mm^4) that lies free.
    #[param(0.01, 0.001..=100.0)]
    pub bend_mm: f64,
    /// Twist of the bone against the CT, from the middle of the scan to its ends. 0.05: 0.1 N m on 50 mm of a fibula (5 GPa,
    /// 1200 mm^4).
    #[param(0.05, 0.001..=90.0)]
    pub twist_deg: f64,
    /// Offset of the CT's surface, as by a segmentation's threshold. 0.2: a quarter of a voxel of 0.8 mm, and what two
    /// segmentations of one CT differ by (RMS).
    #[param(0.2, 0.001..=100.0)]
    pub offset_mm: f64,
    /// Film on the bone: even, and growing along and around it. 0.1: a bone that was stripped and wiped; periosteum or blood is
    /// several times as much, a fault.
    #[param(0.1, 0.001..=100.0)]
    pub film_mm: f64,
    /// Displacement of a part of the bone across it. 0.02: a bone in one piece, as its bend.
    #[param(0.02, 0.001..=100.0)]
    pub step_mm: f64,
    /// Scale of the camera, scale and tilt of its depth, against the calibration. 0.1: a camera that was warm when it was
    /// calibrated; one that warms up later drifts by several times as much, a fault.
    #[param(0.1, 0.001..=100.0)]
    pub camera_percent: f64,
    /// Amplitude of an error of the camera's depth that is one wave over the scan; shorter waves have less in proportion. 0.1:
    /// a calibrated structured-light camera.
    #[param(0.1, 0.001..=100.0)]
    pub field_mm: f64,
    /// Any other distortion of the CT, as across the bone: each of six strains. 0.1: spacings of a reformat are rounded to
    /// less.
    #[param(0.1, 0.001..=100.0)]
    pub affine_percent: f64,
    /// Smooth error of the CT's surface: each of fourteen waves along and around the bone. 0.02: 0.07 in all (RMS), a tenth of
    /// a voxel; shorter errors are taken from the residuals.
    #[param(0.02, 0.001..=100.0)]
    pub smooth_mm: f64,
    /// Turn of the bone beyond the scan against the CT, about each axis. 0.05: as its twist.
    #[param(0.05, 0.001..=90.0)]
    pub beyond_deg: f64,
    /// Displacement of the plan against the surface, along each axis. 0.1: it is drawn on it, to a fraction of a voxel.
    #[param(0.1, 0.001..=100.0)]
    pub plan_mm: f64,
    /// Shift of a marker on its camera since the calibration or on the bone since the scan, along each axis. 0.05: a marker
    /// that is screwed; a knock shifts it by millimetres, a fault.
    #[param(0.05, 0.001..=100.0)]
    pub slip_mm: f64,
    /// Odds that a cause is at fault, as large as faults are. 0.0025: one in 400 for each, one in 20 for all; we know no
    /// statistics of such faults. Ten times as much doubts sound answers, a tenth trusts faults that the scan shows.
    #[param(0.0025, 0.0..=1.0)]
    pub fault_odds: f64,
}
