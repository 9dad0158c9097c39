//! Why poses have no place of the target in common.

use super::agreeing::misfit_mm;
use super::signs::{MOST_RMS_MM, MOST_RMS_RAD, TELLING_RMS_MM, TELLING_RMS_RAD};
use super::{HandEyeFit, HandEyeReport, Pair, home, motions, solution};
use crate::Refusal;
use crate::calibrate::misread::MISREADINGS;
use crate::calibrate::one_end::is_at_one_end;
use nalgebra::Isometry3;

/// Another reading explains poses that it fits this many times better. Noise makes both fit alike.
pub(super) const FAR_BETTER: f64 = 5.0;
/// Least share of the poses that agree. Of a target that was moved half-way only half do.
const LEAST_SHARE: f64 = 0.6;

impl HandEyeFit {
    /// Refuses a fit that leaves too much of the poses unexplained, by the cause if one is found.
    pub(super) fn check(&self, pairs: &[Pair]) -> Result<(), Refusal> {
        let HandEyeReport { rms_mm, rms_rad, scaled_rms_mm, ref outliers, n_poses, .. } = self.report;
        let is_apart = (n_poses as f64) < LEAST_SHARE * pairs.len() as f64;
        let is_scale = self.report.is_scaled() && scaled_rms_mm < TELLING_RMS_MM && rms_rad < TELLING_RMS_RAD;
        if !is_apart && (is_scale || rms_mm <= TELLING_RMS_MM && rms_rad <= TELLING_RMS_RAD) {
            return if rms_mm > MOST_RMS_MM { Err(Refusal::of(self.report.scale_words())) } else { Ok(()) };
        }
        if let Some(cause) = explanation(pairs, self) {
            return Err(Refusal::of(cause));
        }
        let rest = format!("the target is {rms_mm:.1} mm and {:.1} degrees RMS from one place", rms_rad.to_degrees());
        if is_apart {
            let n = pairs.len();
            let cause = if is_at_one_end(outliers, n) {
                "the others are all before or all after them: the target was moved, or a marker knocked; cut the logs there"
            } else {
                "was the target moved, or are poses of different times paired? are poses of the board flipped?"
            };
            return Err(Refusal::of(format!("{rest} with the {n_poses} of {n} poses that agree; {cause}")));
        }
        if rms_mm > MOST_RMS_MM || rms_rad > MOST_RMS_RAD {
            return Err(Refusal::of(format!(
                "{rest}; was it moved, is its length in another unit, or are poses of different times paired?"
            )));
        }
        Ok(())
    }
}

/// A reading of the poses with which the target is in one place.
fn explanation(pairs: &[Pair], fit: &HandEyeFit) -> Option<String> {
    let is_mm = misfit_mm(pairs);
    let explains = |other: &[Pair]| {
        let mm = misfit_mm(other);
        (mm < TELLING_RMS_MM && FAR_BETTER * mm < is_mm).then_some(mm)
    };
    let with = |undo: fn(&Isometry3<f64>) -> Isometry3<f64>, marker: bool, target: bool| -> Vec<Pair> {
        pairs.iter().map(|(m, t)| (if marker { undo(m) } else { *m }, if target { undo(t) } else { *t })).collect()
    };
    let inverted = with(Isometry3::inverse, false, true);
    if let Some(mm) = explains(&inverted) {
        let other = solution(super::Method::ParkMartin, &motions(&inverted))?;
        let is_far = other.translation.vector.norm() > home(&inverted, &other).0.norm();
        let cause = match (is_far, fit.report.is_view_inverse(1.0)) {
            (false, false) => {
                "the camera is on a stand and sees a target on the marker; calibrate it in the hand, before a target that does not move"
            }
            (true, false) => "the poses of the marker are inverses; give the marker in the tracker's frame",
            (false, true) => "the poses of the target are inverses; give the target in the camera's frame",
            (true, true) => {
                "the camera is on a stand, sees a target on the marker, and the poses of both are inverses; calibrate it in the hand"
            }
        };
        return Some(format!(
            "the target is within {mm:.2} mm of one place if the poses of the marker or of the target are inverted, and within {is_mm:.1} \
             mm as they are: {cause}"
        ));
    }
    MISREADINGS.iter().find_map(|(words, undo)| {
        let logs = [("the marker", true, false), ("the target", false, true), ("both", true, true)];
        let (log, mm) = logs.into_iter().find_map(|(log, marker, target)| Some((log, explains(&with(*undo, marker, target))?)))?;
        Some(format!(
            "the poses of {log} {words}: undone, the target is within {mm:.2} mm of one place, and within {is_mm:.1} mm as they are; \
             export them as x, y, z in mm and x, y, z, w of a right-handed frame"
        ))
    })
}
