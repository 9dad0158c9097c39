//! What makes a pivot calibration doubtful.

use super::{PivotReport, TELLING_RMS_MM};
use crate::calibrate::one_end::is_at_one_end;

/// Nearest tip of a stylus to its marker, mm: the markers of a tracker are wider.
const NEAREST_TIP_MM: f64 = 20.0;
/// Poses whose tip and pivot are both nearer than these, mm, are in centimetres: a tip is farther from its marker, or a divot from the
/// tracker.
const NEAR_TIP_MM: f64 = 50.0;
const NEAR_PIVOT_MM: f64 = 250.0;
/// Largest drift of the tip, mm: more than a divot's play.
const MOST_DRIFT_MM: f64 = 0.75;
/// Largest error of the tip (90 %), mm.
const MOST_ERROR_MM: f64 = 1.0;
/// Some pose of thousands is beyond the gate by chance: one, or up to this share, no farther than so many times the farthest of the
/// others, is no sign.
const STRAY_SHARE: f64 = 0.01;
const STRAY_FARTHER: f64 = 2.0;
/// More than this share of outliers at one end is a slip.
const SLIP_SHARE: f64 = 0.05;

impl PivotReport {
    /// Signs that a pose or the log is wrong: the rule and what to do, for poses with these stamps.
    pub fn signs(&self, stamps_ns: &[i64]) -> Vec<(&'static str, String)> {
        let mut signs = Vec::new();
        let (tip_mm, pivot_mm) = (self.tip_mm(), self.pivot_mm());
        if tip_mm < NEAREST_TIP_MM || tip_mm < NEAR_TIP_MM && pivot_mm < NEAR_PIVOT_MM {
            signs.push(("pivot_unit", format!(
                "the tip is {tip_mm:.2} mm from its marker and {pivot_mm:.1} mm from the tracker, nearer than a stylus in its divot is; are the \
                 poses in metres or centimetres? give them in mm"
            )));
        } else if tip_mm > pivot_mm {
            signs.push(("pivot_inverses", format!(
                "the tip is {tip_mm:.0} mm from its marker, and {pivot_mm:.0} mm from the tracker; are the poses inverses? give the marker in the \
                 tracker's frame"
            )));
        }
        if self.rms_mm > TELLING_RMS_MM {
            signs.push((
                "pivot_rms",
                format!(
                    "the tip is {:.2} mm RMS from one place, {TELLING_RMS_MM} mm is allowed; was it kept in one divot?",
                    self.rms_mm
                ),
            ));
        }
        if self.drift_mm > MOST_DRIFT_MM {
            signs.push(("pivot_slipped", format!(
                "the tip drifts by {:.2} mm from the first to the last third of the poses, {MOST_DRIFT_MM} mm is allowed; did it slip?",
                self.drift_mm
            )));
        }
        signs.extend(self.outlier_sign(stamps_ns));
        // NaN and infinity are open, too.
        if !(self.error_90_mm <= MOST_ERROR_MM) {
            signs.push(("pivot_open", format!(
                "the tip is known to {:.1} mm (90 %), {MOST_ERROR_MM} mm is allowed; tilt the stylus by 30 degrees or more in all directions, and \
                 for longer", self.error_90_mm
            )));
        }
        signs
    }

    fn outlier_sign(&self, stamps_ns: &[i64]) -> Option<(&'static str, String)> {
        let first = *self.outliers.first()?;
        let is_rare = self.n_outliers as f64 <= (STRAY_SHARE * self.n_poses as f64).max(1.0);
        if is_rare && self.outlier_max_mm < STRAY_FARTHER * self.max_mm {
            return None;
        }
        let said = format!(
            "{} of {} poses are left out: their tip is up to {:.2} mm from the pivot, where the others are within {:.2} mm, first at {} ns",
            self.n_outliers,
            self.n_poses,
            self.outlier_max_mm,
            self.max_mm,
            stamps_ns.get(first).copied().unwrap_or_default()
        );
        let is_slip =
            is_at_one_end(&self.outliers, self.n_poses) && self.n_outliers as f64 > SLIP_SHARE * self.n_poses as f64;
        Some(if is_slip {
            ("pivot_slipped", format!("{said}; did it slip there, or had it not arrived?"))
        } else {
            ("pivot_outliers", format!("{said}; are poses of the marker flipped?"))
        })
    }

    pub(super) fn tip_mm(&self) -> f64 {
        self.tip.iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    pub(super) fn pivot_mm(&self) -> f64 {
        self.pivot.iter().map(|x| x * x).sum::<f64>().sqrt()
    }
}
