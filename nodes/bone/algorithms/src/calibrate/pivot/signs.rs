//! What makes a pivot calibration doubtful, or no calibration at all.

use super::{Fit, GATE, MAX_CONDITION, PivotReport};
use crate::Refusal;
use crate::calibrate::{
    inliers::is_at_one_end,
    misread::{AS_WANTED, FAR_BETTER, MISREADINGS},
};
use nalgebra::{Isometry3, Vector3};

/// An RMS residual beyond this is a sign, mm: a tip in its divot stays within the divot's play and the tracker's noise.
const TELLING_RMS_MM: f64 = 1.0;
/// Largest RMS residual, mm: twice the play of the widest divot, and beyond any tracker's noise.
const MOST_RMS_MM: f64 = 5.0;
/// A tip is no farther from its marker, mm: half a metre of stylus.
const FARTHEST_TIP_MM: f64 = 500.0;
/// Nearest tip of a stylus to its marker, mm: the markers of a tracker are wider.
const NEAREST_TIP_MM: f64 = 20.0;
/// Poses whose tip and pivot are both nearer than these, mm, are in centimetres.
const NEAR_MM: [f64; 2] = [50.0, 250.0];
/// Largest drift of the tip, mm: more than a divot's play.
const MOST_DRIFT_MM: f64 = 0.75;
/// Largest error of the tip (90 %), mm.
const MOST_ERROR_MM: f64 = 1.0;

impl PivotReport {
    /// Signs that a pose or the log is wrong: the rule and what to do, for poses with these stamps.
    pub fn signs(&self, stamps_ns: &[i64]) -> Vec<(&'static str, String)> {
        let Self { rms_mm, drift_mm, error_90_mm, n_outliers, outlier_max_mm, max_mm, n_poses, .. } = *self;
        let (tip_mm, pivot_mm) = (Vector3::from(self.tip).norm(), Vector3::from(self.pivot).norm());
        let is_unit = tip_mm < NEAREST_TIP_MM || tip_mm < NEAR_MM[0] && pivot_mm < NEAR_MM[1];
        let signs = [
            is_unit.then(|| ("pivot_unit", format!(
                "the tip is {tip_mm:.2} mm from its marker and {pivot_mm:.1} mm from the tracker, nearer than a stylus in its divot is; are the \
                 poses in metres or centimetres? give them in mm"
            ))),
            (!is_unit && tip_mm > pivot_mm).then(|| ("pivot_inverses", format!(
                "the tip is {tip_mm:.0} mm from its marker, and {pivot_mm:.0} mm from the tracker; are the poses inverses? give the marker in the \
                 tracker's frame"
            ))),
            // Noise alone differs from pose to pose.
            (rms_mm > TELLING_RMS_MM && 2.0 * self.n_effective < (n_poses - n_outliers) as f64).then(|| ("pivot_rms", format!(
                "the tip is {rms_mm:.2} mm RMS from one place, {TELLING_RMS_MM} mm is allowed; was it kept in one divot?"
            ))),
            (drift_mm > MOST_DRIFT_MM).then(|| ("pivot_slipped", format!(
                "the tip drifts by {drift_mm:.2} mm from the first to the last third of the poses, {MOST_DRIFT_MM} mm is allowed; did it slip?"
            ))),
            self.outliers.first().map(|first| {
                let (rule, cause) = if is_at_one_end(&self.outliers, n_poses) {
                    ("pivot_slipped", "did it slip there, or had it not arrived?")
                } else {
                    ("pivot_outliers", "are poses of the marker flipped, or was the tip elsewhere?")
                };
                let stamp_ns = stamps_ns.get(*first).unwrap_or(&0);
                (rule, format!(
                    "{n_outliers} of {n_poses} poses are left out, first at {stamp_ns} ns: their tip is up to {outlier_max_mm:.2} mm from the pivot, where \
                     the others are within {max_mm:.2} mm; {cause}"
                ))
            }),
            (error_90_mm > MOST_ERROR_MM).then(|| ("pivot_open", format!(
                "the tip is known to {error_90_mm:.1} mm (90 %), {MOST_ERROR_MM} mm is allowed; tilt the stylus by 30 degrees or more in all \
                 directions, and for longer"
            ))),
        ];
        signs.into_iter().flatten().collect()
    }

    /// Refuses what no stylus gives.
    pub(super) fn check(&self, poses: &[Isometry3<f64>]) -> Result<(), Refusal> {
        let (tip_mm, pivot_mm, rms_mm) =
            (Vector3::from(self.tip).norm(), Vector3::from(self.pivot).norm(), self.rms_mm);
        if rms_mm > MOST_RMS_MM {
            let cause = misread(poses, rms_mm).unwrap_or_else(|| "was it kept in one divot?".into());
            return Err(Refusal::of(format!(
                "the tip is {rms_mm:.1} mm RMS from one place, {MOST_RMS_MM} mm is allowed; {cause}"
            )));
        }
        if tip_mm > FARTHEST_TIP_MM {
            return Err(Refusal::of(format!(
                "the tip is {tip_mm:.0} mm from its marker, {FARTHEST_TIP_MM} mm is allowed, and {pivot_mm:.0} mm from the tracker; are the \
                 poses inverses, or in another unit? give the marker in the tracker's frame, in mm"
            )));
        }
        Ok(())
    }
}

/// Another reading of the poses whose tip is in one place.
fn misread(poses: &[Isometry3<f64>], rms_mm: f64) -> Option<String> {
    MISREADINGS.iter().find_map(|(words, undo)| {
        let undone: Vec<Isometry3<f64>> = poses.iter().map(undo).collect();
        let fit = Fit::of(&undone).ok().filter(|fit| fit.condition <= MAX_CONDITION)?;
        let mm = GATE.judged_mm(&undone.iter().map(|t| fit.residual(t).norm()).collect::<Vec<_>>());
        (mm < MOST_RMS_MM && FAR_BETTER * mm < rms_mm)
            .then(|| format!("the poses {words}: undone, the tip is within {mm:.2} mm of one place; {AS_WANTED}"))
    })
}
