//! What makes a hand-eye calibration doubtful, or no calibration at all.

use super::misfit::misfit_mm;
use super::{HandEyeFit, HandEyeReport, Method, Pair, home, motions, solution};
use crate::Refusal;
use crate::calibrate::{
    inliers::is_at_one_end,
    misread::{AS_WANTED, FAR_BETTER, MISREADINGS, Undo},
};
use nalgebra::Isometry3;

/// A target that does not move is within this of its mean place, mm RMS: ten times what a tracker errs by.
pub(super) const TELLING_RMS_MM: f64 = 2.0;
/// Likewise, radians: 2 degrees, 2 mm at 60 mm.
const TELLING_RMS_RAD: f64 = 0.035;
/// Beyond this many times as much there is no calibration.
const REFUSED: f64 = 5.0;
/// Least share of the poses that agree. Of a target that was moved half-way only half do.
const LEAST_SHARE: f64 = 0.6;
/// A scale is a sign if it differs from 1 by more than this, and by four of its standard deviations: 0.7 mm at 350 mm.
const MOST_SCALE: f64 = 0.002;
const SCALE_SIGMAS: f64 = 4.0;
/// Largest error of the calibration (90 %), mm and radians: that alone would displace a cut beyond the limits of a verdict.
const MOST_ERROR_MM: f64 = 1.5;
const MOST_ERROR_RAD: f64 = 0.008_7;
/// A marker is no farther from its camera than this, mm, where the target is nearer to the tracker than half of it.
const FARTHEST_MARKER_MM: f64 = 300.0;
/// A camera keeps its target in view and sees it from many sides; of inverses the opposite holds by this factor.
const FAR_WIDER: f64 = 2.0;

impl HandEyeReport {
    /// Signs that a pose or a log is wrong: the rule and what to do, for pairs with these stamps.
    pub fn signs(&self, stamps_ns: &[i64]) -> Vec<(&'static str, String)> {
        let is_far = self.camera_mm > FARTHEST_MARKER_MM && self.target_mm < self.camera_mm / 2.0;
        let (error_mm, error_deg) = (self.error_90_mm, self.error_90_rad.to_degrees());
        let is_inverse = self.view_ratio > if is_far { 1.0 } else { FAR_WIDER };
        let signs = [
            self.is_scaled().then(|| ("hand_eye_scale", self.scale_words())),
            (!self.is_scaled() && self.is_beyond(1.0)).then(|| ("hand_eye_rms", self.rms_words())),
            self.outliers.first().map(|first| {
                let (n, n_all, stamp_ns) = (self.outliers.len(), self.n_all(), stamps_ns.get(*first).unwrap_or(&0));
                let (mm, deg) = (self.outlier_max_mm, self.outlier_max_rad.to_degrees());
                let (rule, cause) = if is_at_one_end(&self.outliers, n_all) {
                    ("hand_eye_moved", "they are all before or all after the others: was the target moved, or a marker knocked?")
                } else {
                    ("hand_eye_outliers", "are they flipped, as those of a flat board may be?")
                };
                (rule, format!("{n} of {n_all} poses are left out, first at {stamp_ns} ns: the target is up to {mm:.1} mm and {deg:.1} degrees from where the others have it; {cause}"))
            }),
            (is_far || is_inverse).then(|| ("hand_eye_arrangement", format!(
                "the camera would be {:.0} mm from its marker, and the target {:.0} mm from the tracker; probably {}",
                self.camera_mm, self.target_mm, arrangement(is_far != is_inverse, is_far, is_inverse)
            ))),
            (error_mm > MOST_ERROR_MM || self.error_90_rad > MOST_ERROR_RAD).then(|| ("hand_eye_open", format!(
                "the marker's place in the camera is known to {error_mm:.1} mm and {error_deg:.2} degrees (90 %), {MOST_ERROR_MM} mm and 0.5 degrees are \
                 allowed; take more poses, and turn the camera by 30 degrees or more about two axes"
            ))),
        ];
        signs.into_iter().flatten().collect()
    }

    fn n_all(&self) -> usize {
        self.n_poses + self.outliers.len()
    }

    /// Whether the target is farther from one place than the telling distance or angle, times a factor.
    fn is_beyond(&self, times: f64) -> bool {
        self.rms_mm > times * TELLING_RMS_MM || self.rms_rad > times * TELLING_RMS_RAD
    }

    fn is_scaled(&self) -> bool {
        (self.scale - 1.0).abs() > MOST_SCALE.max(SCALE_SIGMAS * self.scale_sd)
    }

    fn rms_words(&self) -> String {
        let (n, n_all, mm, deg) = (self.n_poses, self.n_all(), self.outlier_max_mm, self.outlier_max_rad.to_degrees());
        let cause = match (self.outliers.first(), self.outliers.last()) {
            (Some(first), Some(last)) if is_at_one_end(&self.outliers, n_all) => format!(
                "in those from {first} to {last} it is up to {mm:.1} mm and {deg:.1} degrees off: the target was moved, or a marker knocked; cut the \
                 logs there"
            ),
            _ => "was it moved, are poses of different times paired, or poses of the board flipped?".into(),
        };
        let (mm, deg) = (self.rms_mm, self.rms_rad.to_degrees());
        format!("{n} of {n_all} poses have the target {mm:.1} mm and {deg:.1} degrees RMS from one place; {cause}")
    }

    fn scale_words(&self) -> String {
        let Self { scale, scale_sd, scaled_rms_mm, scaled_off_mm, rms_mm, .. } = self;
        format!(
            "the target's lengths are {scale:.4} +- {scale_sd:.4} times those of the tracker, and leave {scaled_rms_mm:.2} mm RMS instead of \
             {rms_mm:.2} mm; multiply the size of the board by {:.4}, and give both logs in mm (in scale 1, which is given, the camera is \
             {scaled_off_mm:.1} mm off)",
            1.0 / scale
        )
    }
}

impl HandEyeFit {
    /// Refuses a fit that leaves too much of the poses unexplained, by the cause if one is found.
    pub(super) fn check(&self, pairs: &[Pair]) -> Result<(), Refusal> {
        let report = &self.report;
        let is_apart = (report.n_poses as f64) < LEAST_SHARE * pairs.len() as f64;
        let is_scale = report.is_scaled() && report.scaled_rms_mm < TELLING_RMS_MM && report.rms_rad < TELLING_RMS_RAD;
        if !is_apart && !report.is_beyond(if is_scale { REFUSED } else { 1.0 }) {
            return Ok(());
        }
        let cause = if is_scale && !is_apart { Some(report.scale_words()) } else { self.explanation(pairs) };
        match cause {
            Some(cause) => Err(Refusal::of(cause)),
            None if is_apart || report.is_beyond(REFUSED) => Err(Refusal::of(report.rms_words())),
            None => Ok(()),
        }
    }

    /// A reading of the poses with which the target is in one place.
    fn explanation(&self, pairs: &[Pair]) -> Option<String> {
        let (all_mm, rms_mm) = (misfit_mm(pairs), self.report.rms_mm);
        let read = |undo: Undo, marker: bool, target: bool| -> Option<(f64, Vec<Pair>)> {
            let undo = |is_so: bool, t: &Isometry3<f64>| if is_so { undo(t) } else { *t };
            let other: Vec<Pair> = pairs.iter().map(|(m, t)| (undo(marker, m), undo(target, t))).collect();
            let mm = misfit_mm(&other);
            (mm < TELLING_RMS_MM && FAR_BETTER * mm < all_mm).then_some((mm, other))
        };
        let (mm, words) = if let Some((mm, other)) = read(Isometry3::inverse, false, true) {
            let fit = solution(Method::ParkMartin, &motions(&other))?;
            let is_far = fit.translation.vector.norm() > home(&other, &fit).translation.vector.norm();
            let is_inverse = self.report.view_ratio > 1.0;
            (
                mm,
                format!(
                    "if the poses of the marker or of the target are inverted: {}",
                    arrangement(is_far == is_inverse, is_far, is_inverse)
                ),
            )
        } else {
            MISREADINGS.iter().find_map(|(words, undo)| {
                let logs = [("the marker", true, false), ("the target", false, true), ("both", true, true)];
                let found = logs.map(|(log, marker, target)| Some((read(*undo, marker, target)?.0, log)));
                let logs: Vec<&str> = found.iter().flatten().map(|(_, log)| *log).collect();
                Some((
                    found.iter().flatten().next()?.0,
                    format!("if undone: the poses of {} {words}; {AS_WANTED}", logs.join(" or of ")),
                ))
            })?
        };
        Some(format!("the target is {rms_mm:.1} mm RMS from one place, and within {mm:.2} mm {words}"))
    }
}

/// What a camera that is no camera in the hand probably is, or which logs are inverses.
fn arrangement(is_on_stand: bool, is_marker_inverse: bool, is_target_inverse: bool) -> String {
    let words = [
        (is_on_stand, "the camera is on a stand and the target on the marker"),
        (is_marker_inverse, "the poses of the marker are inverses"),
        (is_target_inverse, "the poses of the target are inverses"),
    ];
    let words: Vec<&str> = words.into_iter().filter_map(|(is_so, words)| is_so.then_some(words)).collect();
    format!(
        "{}; give the marker in the tracker's frame, the target in the camera's, and the camera in the hand",
        words.join(", and ")
    )
}
