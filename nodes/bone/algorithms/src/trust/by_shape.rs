//! What a registration by shape alone says: of the scan, of its mirror image, and as a start.

use super::contrary::{BETTER, not_among};
use super::evidence::{Evidence, N_EXAMINED, Registered, SEARCH_MM};
use super::rules::RuleParams;
use super::{Residual, Residuals};
use crate::coarse::{CROP, GlobalParams, GlobalReport, RunnerUp, global_by};
use crate::target::Side;
use nalgebra::Point3;
use osteoflow_verdict::{Answer, Reason};

/// The sign that by its shape alone the scan fits elsewhere better; or as well, and clearly or where no landmark tells the place.
pub(super) fn shape_reason(evidence: &Evidence, rules: &RuleParams, is_placed: bool) -> Option<Reason> {
    let shape = evidence.shape.as_ref().filter(|shape| shape.apart_mm > rules.max_shape_apart_mm)?;
    let mm = shape.apart_mm;
    if shape.is_better() {
        let reason = format!(
            "by its shape alone the scan fits better {mm:.0} mm away ({:.0} % of it on the surface, against {:.0} %); likely \
             cause: landmarks exchanged, or a start at the wrong place",
            100.0 * shape.support,
            100.0 * shape.judged_support
        );
        let remedy = "check the landmarks or the start (register: try without --init), and that plan, CT and scan are of one bone";
        return Some(Reason::new("shape", Answer::Refused, reason, remedy));
    }
    let is_clear = shape.clearness >= rules.min_shape_clearness;
    let is_as_good = shape.support + BETTER > shape.judged_support;
    (is_as_good && (is_clear || !is_placed)).then(|| {
        let landmarks = if is_placed { "" } else { ", and no landmarks tell which place is right" };
        let reason = format!("by its shape alone the scan fits as well {mm:.0} mm away{landmarks}");
        Reason::new(
            "shape",
            Answer::Doubtful,
            reason,
            "scan a longer stretch, or one with more shape, or locate landmarks",
        )
    })
}

/// Distance from the surface of a tenth of the scan beyond which surroundings are in it, mm: another bone, a wrong place on it and
/// tissue leave less.
const SURROUNDINGS_MM: f64 = 5.0;

/// Clearness below which two places among surroundings are equally good.
const ANY_PLACE: f64 = 0.02;

/// Share of the scan's mirror image on the surface above which nothing else is in the scan.
const WHOLE: f64 = 0.9;

/// Whether much of the scan is far from the surface, and of its mirror image, too.
pub(super) fn has_surroundings(evidence: &Evidence) -> bool {
    let is_image_whole = evidence.shape.as_ref().and_then(|shape| shape.mirrored_support).is_some_and(|on| on > WHOLE);
    evidence.p90_mm.is_none_or(|mm| mm > SURROUNDINGS_MM) && !is_image_whole
}

/// The sign in a start by shape alone that another place would have served as well. `is_planned` says whether it matters, on a surface
/// that looks the same from several sides, which of them the scan is of.
pub(super) fn start_reason(
    start: &GlobalReport,
    min_clearness: f64,
    has_surroundings: bool,
    is_planned: bool,
) -> Option<Reason> {
    let is_as_good = |twin: &&RunnerUp| 1.0 - start.score_mm / twin.score_mm.max(f64::MIN_POSITIVE) < min_clearness;
    let twin = start.twin.as_ref().filter(|_| is_planned).filter(is_as_good);
    let other = start.runner_up.as_ref().filter(|_| start.clearness < min_clearness).or(twin)?;
    let place = |[x, y, z]: &[f64; 3]| format!("({x:.0}, {y:.0}, {z:.0})");
    let reason = format!(
        "it started by shape alone, and the scan fits nearly as well {:.0} mm and {:.0} degrees away, with its middle at {} mm \
         instead of {} mm ({:.2} mm RMS against {:.2} mm)",
        other.shift_mm,
        other.turn_rad.to_degrees(),
        place(&other.middle_mm),
        place(&start.middle_mm),
        other.score_mm,
        start.score_mm,
    );
    let remedy = "start from landmarks or from a known pose, or scan a longer stretch, or one with more shape";
    if has_surroundings {
        let reason = format!(
            "surroundings such as skin or drape are in the scan, of which a tenth lies more than {SURROUNDINGS_MM:.0} mm from the surface: \
             {reason}"
        );
        let remedy = format!("{CROP}; else start from landmarks or from a known pose");
        return Some(Reason::new("start", Answer::Doubtful, reason, &remedy));
    }
    Some(Reason::new("start", Answer::Doubtful, reason, remedy))
}

/// What is assumed where the surface looks the same from several sides.
pub(super) fn twin_assumption(start: &GlobalReport) -> Option<String> {
    start.twin.as_ref().map(|twin| {
        format!(
            "it does not matter which of the sides that look alike was scanned: the surface is the same {:.0} mm and {:.0} degrees away, by a \
             symmetry of it; landmarks tell them apart",
            twin.shift_mm,
            twin.turn_rad.to_degrees()
        )
    })
}

/// Names surroundings first, where they hide the bone from a search by shape or leave little of the scan on it: what else is wrong
/// with the answer follows from it. Where little is on the bone and another place is as good, nothing speaks for this one, and it is refused.
pub(super) fn name_surroundings_first(reasons: &mut [Reason], has_surroundings: bool, start: Option<&GlobalReport>) {
    if !has_surroundings {
        return;
    }
    let is_refused = reasons.iter().any(|reason| reason.answer == Answer::Refused);
    let at = |rule: &str| reasons.iter().position(|reason| reason.rule == rule);
    let is_any_place = at("on_surface").is_some() && start.is_some_and(|start| start.clearness < ANY_PLACE);
    let start = at("start");
    let Some(first) = start.or_else(|| at("on_surface")) else { return };
    if (is_refused || is_any_place) && start.is_some() {
        reasons[first].answer = Answer::Refused;
    }
    reasons[..=first].rotate_right(1);
}

/// The sign that the scan's mirror image fits as well, beside a cause that explains the residuals by the CT or the camera: neither image
/// fits, and the surface is hardly of this bone.
pub(super) fn another_bone_reason(evidence: &Evidence) -> Option<Reason> {
    let shape = evidence.shape.as_ref().filter(|shape| !shape.is_mirror_better())?;
    let (best, mirrored) = (shape.support.max(shape.judged_support), shape.mirrored_support?);
    (mirrored > best - BETTER).then(|| {
        let reason = format!(
            "the scan's mirror image fits as well ({:.0} % of it on the surface, against {:.0} %); likely cause: another bone or another \
             patient, a mirrored CT, or the other leg, rather than what would explain the rest",
            100.0 * mirrored,
            100.0 * best
        );
        let remedy = "check that scan and CT are of the same bone, side and patient";
        Reason::new("another_bone", Answer::Doubtful, reason, remedy)
    })
}

/// The sign that few points, or a coarse sensor, do not tell the scan from its mirror image. A coarse sensor's error excuses much of a mirror
/// image, so that one is doubted which fits better at all; of few points, one that fits as well.
pub(super) fn side_reason(evidence: &Evidence, is_sparse: bool) -> Option<Reason> {
    let shape = evidence.shape.as_ref().filter(|shape| !shape.is_mirror_better())?;
    let (best, mirrored) = (shape.support.max(shape.judged_support), shape.mirrored_support?);
    let (than, what, remedy) = match is_sparse {
        true => (
            best - BETTER,
            "so few points do not tell the scan from its mirror image, which fits the surface as well",
            "touch more points, and some across the bone; or start from four landmarks that do not lie in a plane",
        ),
        false => (
            best + shape.mirrored_margin_sd.unwrap_or(0.0),
            "within the error of this sensor the scan's mirror image fits better than the scan",
            "check the side; scan more of the bone, or start from four landmarks that do not lie in a plane",
        ),
    };
    (mirrored > than).then(|| Reason::new("mirrored", Answer::Doubtful, what, remedy))
}

/// A search by shape that leaves more than this asks about the camera, mm: a fine scan leaves less at its place. Without the camera less
/// than this share of it is left, and more than this share of the surface faces away from the camera.
const POOR_MM: f64 = 0.5;
const LEFT: f64 = 0.5;
const AWAY: f64 = 0.8;

/// The sign that the camera lies on the far side of the scan: without it the scan fits, where that camera would not see it.
pub(super) fn camera_reason(registered: &Registered<'_>, by_shape: &GlobalReport) -> Option<Reason> {
    let Registered { target, source, .. } = *registered;
    let camera = source.viewpoint? * Point3::origin();
    if target.side() != Side::Outward || by_shape.score_mm < POOR_MM {
        return None;
    }
    let mut unseen = source.clone();
    unseen.viewpoint = None;
    let fit = global_by(target, &unseen, &GlobalParams::default(), not_among(by_shape.searched)).ok()?;
    let near = Residuals::new(target, source.points(), &fit.t_target_source, SEARCH_MM, N_EXAMINED)?.near;
    let away = |camera: &Point3<f64>| {
        let is_away = |near: &&Residual| near.normal.dot(&(fit.t_target_source * camera - near.point)) < 0.0;
        near.iter().filter(is_away).count() as f64 / near.len().max(1) as f64
    };
    let (share, without_mm, with_mm) = (away(&camera), fit.report.score_mm, by_shape.score_mm);
    (without_mm < LEFT * with_mm && share > AWAY).then(|| {
        let text = |p: &Point3<f64>| format!("{},{},{}", p.x, p.y, p.z);
        let reason = format!(
            "the camera, stated at {} mm, lies on the far side of the scan: {:.0} % of the scanned surface faces away from it. Without it the \
             scan fits ({without_mm:.2} mm RMS, against {with_mm:.2} mm); likely cause: a wrong sign, or other coordinates than the scan's",
            text(&camera),
            100.0 * share
        );
        let places = [Point3::origin(), Point3::origin() - camera.coords];
        let near_side = places.iter().find(|place| away(place) < 1.0 - AWAY);
        let other = near_side.map_or_else(String::new, |place| format!(", such as {},", text(place)));
        let remedy = format!("state where it was{other} or leave it out (register: --camera; in a graph: scan.camera)");
        Reason::new("camera", Answer::Refused, reason, remedy)
    })
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
        let remedy = "take the CT of the side that was scanned; if it is, it or its surface was flipped on export, such as by negating x alone: \
                      export it again";
        Reason::new("mirrored", Answer::Refused, reason, remedy)
    })
}
