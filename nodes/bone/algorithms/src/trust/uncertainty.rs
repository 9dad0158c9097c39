//! Whether the residuals leave the answer uncertain.

use super::evidence::Evidence;
use super::hand_eye::HAND_EYE;
use super::predict::Predicted;
use super::rules::RuleParams;
use osteoflow_verdict::{Answer, Reason};

/// The sign that an error beyond the limits is likely, or that nothing holds the scan.
pub(super) fn spread_reason(predicted: Option<&Predicted>, evidence: &Evidence, rules: &RuleParams) -> Option<Reason> {
    let remedy = "scan a longer stretch, or one with more shape; clean the bone, or check the CT's segmentation";
    let Some(predicted) = predicted else {
        let which = evidence.pattern.map(|pattern| format!(": nothing holds the scan where it {}", pattern.words()));
        let reason = format!("the scan leaves a motion of the bone undetermined{}", which.unwrap_or_default());
        return Some(Reason::new("spread", Answer::Doubtful, reason, remedy));
    };
    let (spread_mm, unsettled_mm) = (evidence.spread_mm?, evidence.unsettled_mm.unwrap_or(0.0));
    // Of what is at fault beside the pose the cause is told.
    let sound = predicted.beyond_by.first().copied().unwrap_or(0.0);
    let percent = 100.0 * sound;
    let given_mm = predicted.terms.iter().find(|term| term.name == HAND_EYE).map_or(0.0, |term| term.tre_mm);
    if sound > rules.max_beyond_limits && given_mm > spread_mm.max(unsettled_mm) {
        return Some(Reason::new(
            "hand_eye",
            Answer::Doubtful,
            format!(
                "t_camera_camera_marker was given, not calibrated here, and nothing tests it to better than {given_mm:.1} mm (RMS) at the \
                 assessment points and cuts: a wrong one displaces all scans of a camera that rests alike"
            ),
            "touch the assessment points with a stylus, or read a check piece after the scan; and state the matrix's error, as its \
             calibration told it (errors.hand_eye_mm, errors.hand_eye_deg), or turn the camera about the bone between scan and landmarks and wire \
             their reports to located_report; of a calibration in the run, wire its report to calibration",
        ));
    }
    (sound > rules.max_beyond_limits).then(|| match unsettled_mm > spread_mm {
        true => Reason::new(
            "unsettled",
            Answer::Doubtful,
            format!(
                "the registration rests {unsettled_mm:.1} mm from where the scan fits best nearby: a chance of {percent:.0} % of \
                 an error beyond the limits"
            ),
            "use icp.point_to_plane, or landmarks located more exactly",
        ),
        false => Reason::new(
            "spread",
            Answer::Doubtful,
            format!(
                "the residuals leave the assessment points and cuts uncertain by {spread_mm:.2} mm (RMS): a chance of \
                 {percent:.0} % of an error beyond the limits{}",
                evidence.pattern.map(|p| format!("; least certain: the scan {}", p.words())).unwrap_or_default()
            ),
            remedy,
        ),
    })
}
