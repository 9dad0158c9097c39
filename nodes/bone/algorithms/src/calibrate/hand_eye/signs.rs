//! What makes a hand-eye calibration doubtful.

use super::HandEyeReport;
use crate::calibrate::one_end::is_at_one_end;

/// A target that does not move is within this of its mean place, mm RMS: ten times what a tracker errs by.
pub(super) const TELLING_RMS_MM: f64 = 2.0;
/// Likewise, radians: 2 degrees, 2 mm at 60 mm.
pub(super) const TELLING_RMS_RAD: f64 = 0.035;
/// Largest RMS distance of the target from one place, mm: no camera errs by it.
pub(super) const MOST_RMS_MM: f64 = 10.0;
/// Likewise, radians: 10 degrees.
pub(super) const MOST_RMS_RAD: f64 = 0.175;
/// A scale is a sign if it differs from 1 by more than this, and by four of its standard deviations: 0.7 mm at 350 mm.
const MOST_SCALE: f64 = 0.002;
const SCALE_SIGMAS: f64 = 4.0;
/// Largest error of the calibration (90 %), mm and radians: that alone would displace a cut beyond the limits of a verdict.
const MOST_ERROR_MM: f64 = 1.5;
const MOST_ERROR_RAD: f64 = 0.008_7;
/// A marker is no farther from its camera than this, mm, where the target is nearer to the tracker than half of it.
const FARTHEST_MARKER_MM: f64 = 300.0;
/// A camera keeps its target in view, and sees it from many sides; poses of which the opposite holds by this factor are inverses.
const FAR_LESS: f64 = 2.0;

impl HandEyeReport {
    /// Signs that a pose or a log is wrong: the rule and what to do, for pairs with these stamps.
    pub fn signs(&self, stamps_ns: &[i64]) -> Vec<(&'static str, String)> {
        let mut signs = Vec::new();
        if self.is_scaled() {
            signs.push(("hand_eye_scale", self.scale_words()));
        } else if self.rms_mm > TELLING_RMS_MM || self.rms_rad > TELLING_RMS_RAD {
            signs.push(("hand_eye_rms", format!(
                "the target is {:.1} mm and {:.1} degrees RMS from one place, {TELLING_RMS_MM} mm and {:.0} degrees are allowed; was it moved, \
                 or are poses of different times paired?",
                self.rms_mm, self.rms_rad.to_degrees(), TELLING_RMS_RAD.to_degrees()
            )));
        }
        signs.extend(self.outlier_sign(stamps_ns));
        let is_far = self.is_camera_far();
        let arrangement = match (is_far, self.is_view_inverse(if is_far { 1.0 } else { FAR_LESS })) {
            (false, false) => None,
            (true, false) => Some(
                "the camera is on a stand and the target on a marker whose poses are inverses, or marker and target are exchanged",
            ),
            (true, true) => Some("the poses of both logs are inverses, or marker and target are exchanged"),
            (false, true) => {
                Some("the poses of the target are inverses, and the camera is on a stand with the target on the marker")
            }
        };
        if let Some(words) = arrangement {
            signs.push(("hand_eye_arrangement", format!(
                "the camera would be {:.0} mm from its marker, and the target {:.0} mm from the tracker; the camera sees the target within {:.0} \
                 degrees (RMS), and from sides that differ by {:.0}: probably {words}; give the marker in the tracker's frame, the target in the \
                 camera's, and the camera in the hand",
                self.camera_mm, self.target_mm, self.target_wander_rad.to_degrees(), self.camera_wander_rad.to_degrees()
            )));
        }
        // NaN and infinity are open, too.
        if !(self.error_90_mm <= MOST_ERROR_MM && self.error_90_rad <= MOST_ERROR_RAD) {
            signs.push(("hand_eye_open", format!(
                "the marker's place in the camera is known to {:.1} mm and {:.2} degrees (90 %), {MOST_ERROR_MM} mm and {:.1} degrees are allowed; \
                 take more poses, and turn the camera by 30 degrees or more about two axes",
                self.error_90_mm, self.error_90_rad.to_degrees(), MOST_ERROR_RAD.to_degrees()
            )));
        }
        signs
    }

    fn outlier_sign(&self, stamps_ns: &[i64]) -> Option<(&'static str, String)> {
        let first = *self.outliers.first()?;
        let (n, n_all) = (self.outliers.len(), self.outliers.len() + self.n_poses);
        let said = format!(
            "{n} of {n_all} poses are left out: the target is up to {:.1} mm and {:.1} degrees from where the others have it, first at {} ns",
            self.outlier_max_mm,
            self.outlier_max_rad.to_degrees(),
            stamps_ns.get(first).copied().unwrap_or_default()
        );
        // One station may be flipped at the end as well.
        Some(if is_at_one_end(&self.outliers, n_all) && n > n_all / 8 {
            (
                "hand_eye_moved",
                format!(
                    "{said}; they are all before or all after the others: was the target moved, or a marker knocked?"
                ),
            )
        } else {
            ("hand_eye_outliers", format!("{said}; are they flipped, as those of a flat board may be?"))
        })
    }

    pub(super) fn is_scaled(&self) -> bool {
        (self.scale - 1.0).abs() > MOST_SCALE.max(SCALE_SIGMAS * self.scale_sd)
    }

    pub(super) fn scale_words(&self) -> String {
        format!(
            "the target's lengths are {:.4} +- {:.4} times those of the tracker, and leave {:.2} mm RMS instead of {:.2} mm; multiply the size \
             of the board by {:.4}, and give both logs in mm (in scale 1, which is given, the camera is {:.1} mm off)",
            self.scale,
            self.scale_sd,
            self.scaled_rms_mm,
            self.rms_mm,
            1.0 / self.scale,
            self.scaled_off_mm
        )
    }

    fn is_camera_far(&self) -> bool {
        self.camera_mm > FARTHEST_MARKER_MM && self.target_mm < self.camera_mm / 2.0
    }

    pub(super) fn is_view_inverse(&self, factor: f64) -> bool {
        self.target_wander_rad > factor * self.camera_wander_rad
    }
}
