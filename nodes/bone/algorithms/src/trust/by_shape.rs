//! What a registration by shape alone says: of the scan, of its mirror image, and as a start.

use super::contrary::BETTER;
use super::evidence::Evidence;
use super::rules::RuleParams;
use crate::coarse::GlobalReport;
use osteoflow_verdict::{Answer, Reason};

/// The sign that by its shape alone the scan fits elsewhere better, or as well and clearly.
pub(super) fn shape_reason(evidence: &Evidence, rules: &RuleParams) -> Option<Reason> {
    let shape = evidence.shape.as_ref().filter(|shape| shape.apart_mm > rules.max_shape_apart_mm)?;
    let mm = shape.apart_mm;
    if shape.is_better() {
        let reason = format!(
            "by its shape alone the scan fits better {mm:.0} mm away ({:.0} % of it on the surface, against {:.0} %); likely \
             cause: landmarks exchanged or at the wrong place",
            100.0 * shape.support,
            100.0 * shape.judged_support
        );
        let remedy = "check the landmarks, and that plan and CT are of this bone";
        return Some(Reason::new("shape", Answer::Refused, reason, remedy));
    }
    let is_as_good = shape.clearness >= rules.min_shape_clearness && shape.support + BETTER > shape.judged_support;
    is_as_good.then(|| {
        let reason = format!("by its shape alone the scan fits as well {mm:.0} mm away");
        Reason::new("shape", Answer::Doubtful, reason, "scan a longer stretch, or one with more shape")
    })
}

/// Distance from the surface of a tenth of the scan beyond which surroundings are in it, mm: another bone, a wrong place on it and
/// tissue leave less.
const SURROUNDINGS_MM: f64 = 5.0;

/// Whether much of the scan is far from the surface.
pub(super) fn has_surroundings(evidence: &Evidence) -> bool {
    evidence.p90_mm.is_none_or(|mm| mm > SURROUNDINGS_MM)
}

/// The sign in a start by shape alone that another place would have served as well.
pub(super) fn start_reason(start: &GlobalReport, min_clearness: f64, has_surroundings: bool) -> Option<Reason> {
    let other = start.runner_up.as_ref().filter(|_| start.clearness < min_clearness)?;
    let place = |[x, y, z]: &[f64; 3]| format!("({x:.0}, {y:.0}, {z:.0})");
    let mut reason = format!(
        "it started by shape alone, and the scan fits nearly as well {:.0} mm and {:.0} degrees away, with its middle at {} mm \
         instead of {} mm ({:.2} mm RMS against {:.2} mm)",
        other.shift_mm,
        other.turn_rad.to_degrees(),
        place(&other.middle_mm),
        place(&start.middle_mm),
        other.score_mm,
        start.score_mm,
    );
    let mut remedy = "start from landmarks or from a known pose, or scan a longer stretch, or one with more shape";
    if has_surroundings {
        reason += &format!(
            "; likely cause: surroundings in the scan, of which a tenth lies more than {SURROUNDINGS_MM:.0} mm from the surface"
        );
        remedy = "crop the scan to the bone (crop.box, or draw a region on the page of osteoflow view); else start from landmarks or \
                  from a known pose";
    }
    Some(Reason::new("start", Answer::Doubtful, reason, remedy))
}

/// The sign that the scan's mirror image fits better.
pub(super) fn mirror_reason(evidence: &Evidence) -> Option<Reason> {
    let shape = evidence.shape.as_ref()?;
    let mirrored = shape.mirrored_support?;
    let best = shape.support.max(shape.judged_support);
    shape.is_mirror_better().then(|| {
        let reason = format!(
            "the scan's mirror image fits better ({:.0} % of it on the surface, against {:.0} %); likely cause: a mirrored CT, or \
             the other leg",
            100.0 * mirrored,
            100.0 * best
        );
        Reason::new("mirrored", Answer::Refused, reason, "check the side, and that the CT was not flipped on export")
    })
}
