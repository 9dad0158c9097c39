//! What the part of a scan that lies on the surface says.

use super::by_shape::has_surroundings;
use super::evidence::Evidence;
use super::rules::RuleParams;
use crate::coarse::CROP;
use osteoflow_verdict::{Answer, Reason};

/// Share of the scan on surface that faces away from the camera which raises no sign.
const MAX_FACING_AWAY: f64 = 0.2;

/// The sign that little of the scan lies on the surface.
pub(super) fn on_surface_reason(evidence: &Evidence, rules: &RuleParams) -> Option<Reason> {
    (evidence.on_surface < rules.min_on_surface).then(|| {
        let share = 100.0 * evidence.on_surface;
        if has_surroundings(evidence) {
            let reason = format!(
                "surroundings such as skin or drape are in the scan: only {share:.0} % of it lies on the surface"
            );
            return Reason::new("on_surface", Answer::Doubtful, reason, CROP);
        }
        let reason =
            format!("only {share:.0} % of the scan lies on the surface; likely cause: tissue, or a wide region");
        Reason::new("on_surface", Answer::Doubtful, reason, "clean the bone and crop the scan closer")
    })
}

/// The sign that the scan lies on surface that the camera cannot have seen.
pub(super) fn facing_away_reason(evidence: &Evidence) -> Option<Reason> {
    let share = evidence.facing_away.filter(|share| *share > MAX_FACING_AWAY)?;
    let reason = format!(
        "{:.0} % of the scan lies on surface that faces away from the camera; likely cause: a camera stated \
         on the wrong side, an inverted transform or a mirrored CT",
        100.0 * share
    );
    let remedy =
        "check where the camera was (register: --camera), and that scan and CT are of the same bone, side and patient";
    Some(Reason::new("facing_away", Answer::Refused, reason, remedy))
}
