//! What makes a hand-eye calibration doubtful, or no calibration at all.

use super::misfit::misfit_mm;
use super::{HandEyeFit, HandEyeReport, Method, Pair, motions, placed, solution};
use crate::Refusal;
use crate::calibrate::{inliers::is_at_one_end, misread::MISREADINGS};
use nalgebra::Isometry3;

/// A target that does not move is within this of its mean place, mm RMS: ten times what a tracker errs by.
pub(super) const TELLING_RMS_MM: f64 = 2.0;
/// Likewise, radians: 2 degrees, 2 mm at 60 mm.
const TELLING_RMS_RAD: f64 = 0.035;
/// Beyond this many times as much there is no calibration.
const REFUSED: f64 = 5.0;
/// Another reading explains poses that it fits this many times better. Noise makes both fit alike.
pub(super) const FAR_BETTER: f64 = 5.0;
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
        let arrangement = match (is_far, self.view_ratio > if is_far { 1.0 } else { FAR_WIDER }) {
            (false, false) => "",
            (true, false) => "the camera is on a stand and the target on a marker whose poses are inverses",
            (true, true) => "the poses of both logs are inverses, or marker and target are exchanged",
            (false, true) => {
                "the camera is on a stand, the target on the marker, and the poses of the target are inverses"
            }
        };
        let signs = [
            self.is_scaled().then(|| ("hand_eye_scale", self.scale_words())),
            (!self.is_scaled() && self.is_beyond(1.0)).then(|| ("hand_eye_rms", self.rms_words())),
            self.outliers.first().map(|first| {
                let (n, n_all, stamp_ns) = (self.outliers.len(), self.n_all(), stamps_ns.get(*first).unwrap_or(&0));
                let (mm, deg) = (self.outlier_max_mm, self.outlier_max_rad.to_degrees());
                // One flipped station may be at the end as well.
                let (rule, cause) = if is_at_one_end(&self.outliers, n_all) && n > n_all / 8 {
                    ("hand_eye_moved", "they are all before or all after the others: was the target moved, or a marker knocked?")
                } else {
                    ("hand_eye_outliers", "are they flipped, as those of a flat board may be?")
                };
                (rule, format!("{n} of {n_all} poses are left out, first at {stamp_ns} ns: the target is up to {mm:.1} mm and {deg:.1} degrees from where the others have it; {cause}"))
            }),
            (!arrangement.is_empty()).then(|| ("hand_eye_arrangement", format!(
                "the camera would be {:.0} mm from its marker, and the target {:.0} mm from the tracker; probably {arrangement}; give the marker in the \
                 tracker's frame, the target in the camera's, and the camera in the hand",
                self.camera_mm, self.target_mm
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

    /// Whether the target is farther from one place than so many times what is telling.
    fn is_beyond(&self, times: f64) -> bool {
        self.rms_mm > times * TELLING_RMS_MM || self.rms_rad > times * TELLING_RMS_RAD
    }

    fn is_scaled(&self) -> bool {
        (self.scale - 1.0).abs() > MOST_SCALE.max(SCALE_SIGMAS * self.scale_sd)
    }

    fn rms_words(&self) -> String {
        format!(
            "the target is {:.1} mm and {:.1} degrees RMS from one place, with {} of {} poses; was it moved, are poses of different times \
             paired, or poses of the board flipped?",
            self.rms_mm,
            self.rms_rad.to_degrees(),
            self.n_poses,
            self.n_all()
        )
    }

    fn scale_words(&self) -> String {
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
        let is_moved = is_apart && is_at_one_end(&report.outliers, pairs.len());
        match cause {
            Some(cause) => Err(Refusal::of(cause)),
            None if is_moved => Err(Refusal::of(format!(
                "{} of {} poses agree, and the others are all before or all after them: the target was moved, or a marker knocked; cut \
                 the logs there",
                report.n_poses,
                pairs.len()
            ))),
            None if is_apart || report.is_beyond(REFUSED) => Err(Refusal::of(report.rms_words())),
            None => Ok(()),
        }
    }

    /// A reading of the poses with which the target is in one place.
    fn explanation(&self, pairs: &[Pair]) -> Option<String> {
        let (is_mm, rms_mm) = (misfit_mm(pairs), self.report.rms_mm);
        let explains = |other: &[Pair]| {
            let mm = misfit_mm(other);
            (mm < TELLING_RMS_MM && FAR_BETTER * mm < is_mm).then_some(mm)
        };
        let with = |undo: fn(&Isometry3<f64>) -> Isometry3<f64>, marker: bool, target: bool| -> Vec<Pair> {
            pairs.iter().map(|(m, t)| (if marker { undo(m) } else { *m }, if target { undo(t) } else { *t })).collect()
        };
        let inverted = with(Isometry3::inverse, false, true);
        if let Some(mm) = explains(&inverted) {
            let other = solution(Method::ParkMartin, &motions(&inverted))?;
            let is_far = other.translation.vector.norm() > placed(&inverted, &other).1.translation.vector.norm();
            let cause = match (is_far, self.report.view_ratio > 1.0) {
                (false, false) => {
                    "the camera is on a stand, the target on the marker; calibrate it in the hand, before a target that does not move"
                }
                (true, false) => "the poses of the marker are inverses; give the marker in the tracker's frame",
                (false, true) => "the poses of the target are inverses; give the target in the camera's frame",
                (true, true) => {
                    "the camera is on a stand, the target on the marker, and the poses of both are inverses; calibrate it in the hand"
                }
            };
            return Some(format!(
                "the target is {rms_mm:.1} mm RMS from one place, and within {mm:.2} mm if the poses of the marker or of the target are \
                 inverted: {cause}"
            ));
        }
        MISREADINGS.iter().find_map(|(words, undo)| {
            let logs = [("the marker", true, false), ("the target", false, true), ("both", true, true)];
            let found = logs.map(|(log, marker, target)| Some((log, explains(&with(*undo, marker, target))?)));
            let logs: Vec<&str> = found.iter().flatten().map(|(log, _)| *log).collect();
            let mm = found.iter().flatten().next()?.1;
            Some(format!(
                "the target is {rms_mm:.1} mm RMS from one place, and within {mm:.2} mm if undone: the poses of {} {words}; export them as x, y, \
                 z in mm and x, y, z, w of a right-handed frame",
                logs.join(" or of ")
            ))
        })
    }
}
