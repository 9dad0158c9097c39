//! The thresholds of the rules.

use super::landmarks::LandmarkErrors;
use super::limits::Limits;
use super::stylus::StylusErrors;
use crate::coarse::CLEAR;
use crate::sensor::Sensor;
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_SQRT_2;

/// Least share on the surface of a scan of a coarse sensor: what its error excuses on the surface tells another shape by what is off it.
const MIN_ON_COARSE: f64 = 0.8;

/// Thresholds of the rules.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[schemars(extend("x-removed" = {
    "surface_error_mm": {
        "default": null,
        "warning": "surface_error_mm is ignored: the surface states the sensor and its errors (sensor of surface.prepare)",
    },
    "max_scale_error": {
        "default": 0.025,
        "warning": "max_scale_error is ignored: a stretch is measured along the bone, across it and in all directions (errors.nuisances)",
    },
    "max_fre_mm": {
        "default": 3.0,
        "warning": "max_fre_mm is ignored: landmarks are compared with the surface by their stated errors (rules.landmarks)",
    },
}))]
pub struct RuleParams {
    /// Limits of a right answer.
    pub limits: Limits,
    /// Doubtful if the predicted chance of an error beyond the limits is larger. 0.1: nine in ten, as the intervals; 36 of 40
    /// simulated sound scans from any side and of any part of a fibula are then trusted.
    #[param(0.1, 0.0..=1.0)]
    pub max_beyond_limits: f64,
    /// Doubtful if the misfit, the mean residual of patches of 4 mm, is larger by more than 0.15 times the noise or the stated
    /// sensor's, whichever is larger; an error of camera and segmentation is in the predicted error, another bone is not. 0.2:
    /// two segmentations of one CT differ by 0.21, a shaft from its mirror image by 0.25.
    #[param(0.2, 0.0..=100.0)]
    pub max_misfit_mm: f64,
    /// Refused if the misfit of the patches inside the surface is larger, beside the scan's noise and the stated sensor's
    /// error: soft tissue lies outside, so this is another bone, its mirror image, or another place. 0.57: the half inside of
    /// 0.8, by which seven groups' segmentations of one CT were off the bone (RMS; Soodmand 2018).
    #[param(0.57, 0.0..=100.0)]
    pub max_inward_misfit_mm: f64,
    /// Doubtful if the registration by shape alone lies farther away, or refused if that fits clearly better.
    #[param(1.5, 0.0..=1000.0)]
    pub max_shape_apart_mm: f64,
    /// Clearness from which a registration by shape alone contradicts without fitting better, and below which a registration
    /// that started from it is doubtful. 0.3: on real bones right answers had at least 0.4, wrong ones at most 0.2.
    #[param(CLEAR, 0.0..=1.0)]
    pub min_shape_clearness: f64,
    /// Doubtful if a larger share of the scan lies inside the surface in whole patches of 4 mm, each by more than four times
    /// the noise and 0.3 mm. 0.1: outliers of a sensor are single points on both sides.
    #[param(0.1, 0.0..=1.0)]
    pub max_inside: f64,
    /// Doubtful if a smaller share of the scan lies on the surface.
    #[param(0.35, 0.0..=1.0)]
    pub min_on_surface: f64,
    /// Doubtful if the mean error measured with the stylus is larger; refused from three times that. Below it, doubtful if the
    /// predicted error and the stylus' own (`stylus`) explain it in less than one of 100 sound procedures.
    #[param(2.5, 0.0..=100.0)]
    pub max_measured_tre_mm: f64,
    /// Stated errors of the stylus, against which its reading contradicts the predicted error.
    pub stylus: StylusErrors,
    /// Stated errors of landmarks and fiducials, against which they contradict the surface or each other.
    pub landmarks: LandmarkErrors,
    /// Doubtful if the camera reads a check piece farther from its place by marker, mean over its points; refused from three
    /// times that. 0.8: four standard deviations above the mean of sound simulated procedures (0.35, SD 0.12, at most 0.72 of
    /// 100), and less than a knock of 1 mm leaves on average.
    #[param(0.8, 0.0..=100.0)]
    pub max_check_mm: f64,
    /// Doubtful if all located landmarks lie farther from the planned ones, the same way, and nothing binds the plan to the
    /// surface. 3: landmarks are aimed to 1 to 2 mm, and a cut that is off by 3 mm is twice beyond its limit.
    #[param(3.0, 0.0..=100.0)]
    pub max_common_shift_mm: f64,
    /// By how much the tracker's poses may be late against the scans: doubtful if a motion during a scan, a landmark or a touch
    /// then puts the answer beyond the limits. 0.1: two frames of a slow tracker (20 Hz), or an exposure that is stamped at its
    /// end.
    #[param(0.1, 0.0..=10.0)]
    pub max_latency_s: f64,
    /// Doubtful, whatever the latency, if a marker moves by more, and by more than noise explains, over the samples before a
    /// scan, a landmark or a touch. 1: this smears a scan by two thirds of a limit.
    #[param(1.0, 0.0..=100.0)]
    pub max_moved_mm: f64,
    /// Whether the attitude of the bone's marker is known to be read as it was written, as of a tracker tested before. false:
    /// unless a turn of the bone between the scan and its landmarks tests it, trust ends at the planes of the scan.
    pub attitude_stated: bool,
    /// Time that a scan takes if neither its points nor `duration_s` of `transform.to_world` say it: the markers' motion in it
    /// shears the scan. 2: longer than structured light takes (0.1 to 1), and a line swept by hand over 100 mm at 50 mm/s.
    #[param(2.0, 0.0..=60.0)]
    pub assumed_scan_s: f64,
}

impl RuleParams {
    /// With the errors of a sensor that is stated: no registration is expected to be more exact than its scan.
    pub(super) fn of(&self, sensor: &Sensor) -> Self {
        let Limits { max_tre_mm, max_offset_mm, .. } = self.limits;
        let attains_mm = sensor.attains_mm();
        let limits = Limits {
            max_tre_mm: max_tre_mm.max(attains_mm),
            max_offset_mm: max_offset_mm.max(attains_mm),
            ..self.limits.clone()
        };
        Self {
            limits,
            max_misfit_mm: self.max_misfit_mm.max(sensor.patch_mm),
            max_inward_misfit_mm: match self.max_inward_misfit_mm {
                0.0 => 0.0,
                mm => mm.max(sensor.patch_mm * FRAC_1_SQRT_2),
            },
            max_inside: self.max_inside + sensor.outliers,
            min_on_surface: match sensor.is_coarse() {
                true => self.min_on_surface.max(MIN_ON_COARSE),
                false => self.min_on_surface,
            },
            max_shape_apart_mm: self.max_shape_apart_mm.max(attains_mm),
            ..self.clone()
        }
    }
}
