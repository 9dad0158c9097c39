//! The rules of a verdict.

use super::attitude::attitude_assumption;
use super::checked::{check_reason, is_checked};
use super::contradiction::contradiction_reason;
use super::contrary::BETTER;
use super::convergence::{Convergence, convergence_reason};
use super::evidence::{Evidence, EvidenceParams, Registered, When, points_that_matter};
use super::extent::extent_reason;
use super::inside::inside_reason;
use super::limits::Limits;
use super::misfit::misfit_reason;
use super::motion::{MotionLimits, motion_signs};
use super::nuisance;
use super::planned::{OrderEvidence, landmark_order, plan_faults};
use super::predict::{Cut, PredictParams, Predicted, Tracking, Where, predict};
use super::predict_last::predict_last;
use super::slid::{slide_note, slide_reasons};
use super::stylus::{StylusErrors, stylus_reason};
use super::surface_error::CELL_MM;
use super::takes::Takes;
use super::verdict::Verdict;
use crate::coarse::{CLEAR, GlobalReport};
use crate::metrics::CheckReport;
use crate::section;
use crate::slide::SlideReport;
use crate::still_average::TakeMotion;
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{NamedPoint, Planes};
use osteoflow_verdict::{Answer, Reason};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Thresholds of the rules.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[schemars(extend("x-removed" = { "max_scale_error": {
    "default": 0.025,
    "warning": "max_scale_error is ignored: a stretch is measured along the bone, across it and in all directions (errors.nuisances)",
} }))]
pub struct RuleParams {
    /// Limits of a right answer.
    pub limits: Limits,
    /// Doubtful if the predicted chance of an error beyond the limits is larger. 0.05: between 0.02 and 0.08, the values fitted with
    /// one bone left out at a time.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_beyond_limits: f64,
    /// The error of scan and surface together over patches of some millimetres, as stated, mm (RMS): a misfit up to it is no sign
    /// against the registration; what it does to the answer is in the predicted error. None: `max_misfit_mm`. Usual values:
    /// structured light 0.03 to 0.1, laser triangulation 0.05 to 0.1, stereo 0.3, a stylus 0.3, tracked ultrasound 0.4 to 1, the
    /// segmentation of a CT 0.2 to 0.8.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub surface_error_mm: Option<f64>,
    /// Doubtful if the misfit, the mean residual of patches of 4 mm, is larger by more than 0.15 times the noise, mm, where no
    /// `surface_error_mm` is stated: surface and scan differ by more than a structured-light camera and a good segmentation do.
    /// 0.12: fitted likewise; half of a CT's voxel explains 0.05.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_misfit_mm: f64,
    /// Refused if the misfit of the patches inside the surface is larger, mm, beside the scan's noise and `surface_error_mm`: soft
    /// tissue lies outside, so this is another bone, its mirror image, or another place on it. 0.57: the half inside of 0.8 mm,
    /// by which seven groups' segmentations of one CT were off the bone (RMS; Soodmand 2018).
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_inward_misfit_mm: f64,
    /// Doubtful, or refused if it fits clearly better, if the registration by shape alone lies farther away, mm.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub max_shape_apart_mm: f64,
    /// Clearness from which a registration by shape alone is a contradiction where it does not fit better, and below which a
    /// registration that started from it is doubtful. 0.3: on real bones right answers had 0.4 and more, wrong ones 0.2 and less.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_shape_clearness: f64,
    /// Doubtful if a larger share of the scan lies inside the surface in whole patches of 4 mm, each by more than four times the
    /// noise and 0.3 mm. 0.1: outliers of a sensor are single points on both sides.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_inside: f64,
    /// Doubtful if a smaller share of the scan lies on the surface.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_on_surface: f64,
    /// Doubtful if the RMS residual of the landmarks is larger, mm, and the shape alone does not agree.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_fre_mm: f64,
    /// Doubtful if the mean error measured with the stylus is larger, mm; refused from three times that. Below it, doubtful where the
    /// predicted error and the stylus' own (`stylus`) explain it in less than one of 100 sound procedures.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_measured_tre_mm: f64,
    /// Stated errors of the stylus, against which its reading contradicts the predicted error.
    pub stylus: StylusErrors,
    /// Doubtful if the camera reads a check piece farther from where its marker has it, mean over its points, mm; refused from
    /// three times that. 0.8: four standard deviations above the mean of sound simulated procedures (0.35 mm, SD 0.12 mm, at
    /// most 0.72 mm of 100), and less than a knock of 1 mm leaves on average.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_check_mm: f64,
    /// Doubtful if all located landmarks lie farther from the planned ones, the same way, and nothing binds the plan to the surface,
    /// mm. 3: landmarks are aimed to 1 to 2 mm, and a cut that is off by 3 mm is twice beyond its limit.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_common_shift_mm: f64,
    /// By how much the tracker's poses may be late against the camera's scans, s: doubtful if a motion during a scan, a landmark or
    /// a touch then puts the answer beyond the limits. 0.1: two frames of a slow tracker (20 Hz), or an exposure that is stamped at
    /// its end.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub max_latency_s: f64,
    /// Doubtful, whatever the latency, if a marker moves by more over the samples before a scan, a landmark or a touch, and by more
    /// than noise explains, mm. 1: as much smears a scan by two thirds of a limit.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_moved_mm: f64,
}

impl Default for RuleParams {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            max_beyond_limits: 0.05,
            surface_error_mm: None,
            max_misfit_mm: 0.12,
            max_inward_misfit_mm: 0.57,
            max_shape_apart_mm: 1.5,
            min_shape_clearness: CLEAR,
            max_inside: 0.1,
            min_on_surface: 0.35,
            max_fre_mm: 3.0,
            max_measured_tre_mm: 2.5,
            stylus: StylusErrors::default(),
            max_check_mm: 0.8,
            max_common_shift_mm: 3.0,
            max_latency_s: 0.1,
            max_moved_mm: 1.0,
        }
    }
}

/// A registration with everything that is known beside it. What is not known is empty or none.
#[derive(Debug, Clone)]
pub struct Case<'a> {
    /// The registered scan.
    pub registered: Registered<'a>,
    /// How the registration ended.
    pub icp: Option<&'a Convergence>,
    /// The planned landmarks.
    pub landmarks: &'a [NamedPoint],
    /// The landmarks as located.
    pub located: &'a [NamedPoint],
    /// The planned assessment points.
    pub assessment: &'a [NamedPoint],
    /// The planned cuts; none where cuts are of no concern.
    pub planes: Option<&'a Planes>,
    /// Where the markers were.
    pub tracking: Option<&'a Tracking>,
    /// Mean error measured with a stylus, mm.
    pub measured_tre_mm: Option<f64>,
    /// The slide profile about the registration.
    pub slide: Option<&'a SlideReport>,
    /// Readings of a check piece.
    pub check: &'a [CheckReport],
    /// How the markers moved while something was measured.
    pub takes: Takes<'a>,
    /// The registration by shape alone that it started from, if it did.
    pub start: Option<&'a GlobalReport>,
    /// Signs found elsewhere.
    pub reasons: &'a [Reason],
    /// What was taken for granted elsewhere, one sentence each.
    pub assumptions: &'a [&'a str],
}

impl<'a> Case<'a> {
    /// A registration with nothing beside it.
    pub fn new(registered: Registered<'a>) -> Self {
        Self {
            registered,
            icp: None,
            landmarks: &[],
            located: &[],
            assessment: &[],
            planes: None,
            tracking: None,
            measured_tre_mm: None,
            slide: None,
            check: &[],
            takes: Takes::default(),
            start: None,
            reasons: &[],
            assumptions: &[],
        }
    }
}

/// The verdict on a registration.
pub fn judge(case: &Case<'_>, examine: &EvidenceParams, rules: &RuleParams, errors: &PredictParams) -> Verdict {
    let mut reasons = case.reasons.to_vec();
    let cuts = cuts(case);
    let at: Vec<Point3<f64>> =
        case.assessment.iter().chain(cuts.iter().map(|cut| &cut.middle)).map(|p| p.position).collect();
    let registered = Registered { at: &at, ..case.registered };
    reasons.extend(plan_reasons(case));
    reasons.extend(extent_reason(registered.source));
    reasons.extend(case.slide.map(slide_reasons).unwrap_or_default());
    reasons.extend(check_reason(case.check, registered.source.stamp_ns, rules.max_check_mm));
    let order = landmark_order(case.landmarks, case.located);
    reasons.extend(order.as_ref().and_then(order_reason));
    let stylus = |predicted: Option<&Predicted>| {
        stylus_reason(case.measured_tre_mm, predicted, rules.max_measured_tre_mm, &rules.stylus)
    };
    let assessed: Vec<Point3<f64>> = case.assessment.iter().map(|p| p.position).collect();
    let limited = if assessed.is_empty() { points_that_matter(&registered) } else { assessed };
    let place = Where { points: case.assessment, cuts: &cuts, limited: &limited };
    let RuleParams { max_latency_s, max_moved_mm, ref limits, .. } = *rules;
    let motion_limits = MotionLimits { max_latency_s, max_moved_mm, limits };
    let Takes { scan, located, touched, .. } = case.takes;
    let takes: Vec<TakeMotion> = scan.into_iter().chain(located).chain(touched).cloned().collect();
    let motion = motion_signs(&takes, registered.t_target_source, &place, &motion_limits);
    reasons.extend(motion.reason);
    reasons.extend(contradiction_reason(&takes, errors));
    let planned: Vec<NamedPoint> = case.landmarks.iter().chain(case.assessment).cloned().collect();
    let t_target_source = registered.t_target_source;
    let attitude = attitude_assumption(&case.takes, &planned, case.located, case.measured_tre_mm, t_target_source);
    let assumed = |is_predicted: bool, unseen: &[(bool, String)]| -> Vec<String> {
        let own = [motion.assumption.clone(), attitude.clone()];
        assumptions(case, rules, is_predicted, unseen).into_iter().chain(own.into_iter().flatten()).collect()
    };
    let start = |has_surroundings: bool| {
        case.start.and_then(|start| start_reason(start, rules.min_shape_clearness, has_surroundings))
    };
    let Some(mut examined) = Evidence::examine(&registered, examine) else {
        reasons.extend(stylus(None));
        reasons.extend(start(false));
        reasons.extend(case.icp.and_then(|ended| convergence_reason(ended, None)));
        let text = "the surface has no normals or the scan too few points, so nothing could be examined";
        reasons.push(Reason::new("unexamined", Answer::Doubtful, text, "prepare the surface with normals"));
        return Verdict::new(reasons, assumed(false, &[]), None, None, Vec::new());
    };
    let (evidence, spread, to_settled) = (&examined.evidence, examined.spread.as_ref(), examined.to_settled);
    reasons.extend(start(evidence.p90_mm.is_none_or(|mm| mm > SURROUNDINGS_MM)));
    reasons.extend(case.icp.and_then(|ended| convergence_reason(ended, evidence.unsettled_mm)));
    let nuisances = [evidence.surface_error.cell_mm(), CELL_MM].into_iter().find_map(|cell_mm| {
        nuisance::examine(&registered, &place, evidence.noise_mm, cell_mm, &rules.limits, &errors.nuisances)
    });
    reasons.extend(nuisances.as_ref().and_then(|nuisances| nuisances.reason.clone()));
    let deformation = nuisances.as_ref().and_then(|nuisances| nuisances.deformation.as_ref());
    let predicted = spread.map(|spread| {
        let to_settled = to_settled.unwrap_or_else(Isometry3::identity);
        predict(spread, &to_settled, deformation, case.tracking, &place, &rules.limits, errors)
    });
    reasons.extend(stylus(predicted.as_ref()));
    reasons.extend(spread_reason(predicted.as_ref(), evidence, rules));
    reasons.extend(data_reasons(evidence, order.as_ref(), rules));
    let is_raised = reasons.iter().any(|reason| DATA.contains(&reason.rule.as_str()));
    if examine.mirror == When::Always || (examine.mirror == When::IfRaised && is_raised) {
        examined.examine_mirrored(&registered);
        reasons.extend(mirror_reason(&examined.evidence));
    }
    // The error is told where points or cuts are planned.
    let predicted = predicted.filter(|_| !at.is_empty());
    let mut predicted = predicted;
    if let Some(predicted) = &mut predicted {
        predicted.last = predict_last(predicted, &cuts, &case.takes, case.planes, t_target_source, errors);
    }
    let last = predicted.as_ref().and_then(|predicted| predicted.last.as_ref()?.note());
    let (nuisances, unseen) = nuisances.map(|nuisances| (nuisances.list, nuisances.assumptions)).unwrap_or_default();
    let assumptions = assumed(predicted.is_some(), &unseen).into_iter().chain(last).collect();
    Verdict::new(reasons, assumptions, predicted, Some(examined.evidence), nuisances)
}

/// The rules on scan and surface.
const DATA: [&str; 8] =
    ["misfit", "inward_misfit", "inside", "spread", "unsettled", "shape", "on_surface", "facing_away"];

/// The planned cuts, each with the middle of the bone in it.
fn cuts(case: &Case<'_>) -> Vec<Cut> {
    let mesh = case.registered.target.mesh();
    let planes = case.planes.map(|planes| &*planes.planes).unwrap_or_default();
    let middle = |plane: &osteoflow_geometry::Plane| {
        let t = plane.isometry()?;
        let on_bone = mesh.and_then(|mesh| section::middle(mesh.mesh(), t, None));
        let position = on_bone.unwrap_or_else(|| t * Point3::origin());
        Some(Cut { middle: NamedPoint::new(plane.name.clone(), position), normal: t * Vector3::z() })
    };
    planes.iter().filter_map(middle).collect()
}

fn plan_reasons(case: &Case<'_>) -> Vec<Reason> {
    let Some(mesh) = case.registered.target.mesh() else { return Vec::new() };
    let points: Vec<NamedPoint> = case.landmarks.iter().chain(case.assessment).cloned().collect();
    plan_faults(mesh, &points, case.planes)
}

fn order_reason(order: &OrderEvidence) -> Option<Reason> {
    let OrderEvidence { fre_mm, best_other_fre_mm, best_other } = order;
    (best_other_fre_mm < fre_mm).then(|| {
        let reason = format!(
            "the landmarks fit better in another order: {} by {best_other_fre_mm:.1} mm (RMS), as named {fre_mm:.1} mm",
            best_other.join(", ")
        );
        let remedy = "check which landmark each scan shows; two were probably exchanged";
        Reason::new("landmark_order", Answer::Doubtful, reason, remedy)
    })
}

fn data_reasons(evidence: &Evidence, order: Option<&OrderEvidence>, rules: &RuleParams) -> Vec<Reason> {
    let mut reasons: Vec<Reason> =
        [misfit_reason(evidence, rules), inside_reason(&evidence.inside_patches, evidence.noise_mm, rules.max_inside)]
            .into_iter()
            .flatten()
            .collect();
    let mut add = |rule: &str, answer: Answer, reason: String, remedy: &str| {
        reasons.push(Reason::new(rule, answer, reason, remedy));
    };
    let another = "check that scan and CT are of the same bone, side and patient";
    if evidence.on_surface < rules.min_on_surface {
        let share = 100.0 * evidence.on_surface;
        let reason =
            format!("only {share:.0} % of the scan lies on the surface; likely cause: tissue, or a wide region");
        add("on_surface", Answer::Doubtful, reason, "clean the bone and crop the scan closer");
    }
    if let Some(share) = evidence.facing_away.filter(|share| *share > 0.2) {
        let reason = format!(
            "{:.0} % of the scan lies on surface that faces away from the camera; likely cause: an inverted transform or a \
             mirrored CT",
            100.0 * share
        );
        add("facing_away", Answer::Refused, reason, another);
    }
    if let Some(shape) = evidence.shape.as_ref().filter(|shape| shape.apart_mm > rules.max_shape_apart_mm) {
        let mm = shape.apart_mm;
        if shape.is_better() {
            let reason = format!(
                "by its shape alone the scan fits better {mm:.0} mm away ({:.0} % of it on the surface, against {:.0} %); likely \
                 cause: landmarks exchanged or at the wrong place",
                100.0 * shape.support,
                100.0 * shape.judged_support
            );
            add("shape", Answer::Refused, reason, "check the landmarks, and that plan and CT are of this bone");
        } else if shape.clearness >= rules.min_shape_clearness && shape.support + BETTER > shape.judged_support {
            let reason = format!("by its shape alone the scan fits as well {mm:.0} mm away");
            add("shape", Answer::Doubtful, reason, "scan a longer stretch, or one with more shape");
        }
        if let Some(order) = order.filter(|order| order.fre_mm > rules.max_fre_mm) {
            let reason = format!("the landmarks miss the planned ones by {:.1} mm (RMS)", order.fre_mm);
            add("landmarks", Answer::Doubtful, reason, "locate the landmarks again");
        }
    }
    reasons
}

fn spread_reason(predicted: Option<&Predicted>, evidence: &Evidence, rules: &RuleParams) -> Option<Reason> {
    let remedy = "scan a longer stretch, or one with more shape; clean the bone, or check the CT's segmentation";
    let Some(predicted) = predicted else {
        let which = evidence.pattern.map(|pattern| format!(": nothing holds the scan where it {}", pattern.words()));
        let reason = format!("the scan leaves a motion of the bone undetermined{}", which.unwrap_or_default());
        return Some(Reason::new("spread", Answer::Doubtful, reason, remedy));
    };
    let (spread_mm, unsettled_mm) = (evidence.spread_mm?, evidence.unsettled_mm.unwrap_or(0.0));
    let percent = 100.0 * predicted.beyond_limits;
    (predicted.beyond_limits > rules.max_beyond_limits).then(|| match unsettled_mm > spread_mm {
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

/// Distance from the surface of a tenth of the scan beyond which surroundings are in it, mm: another bone, a wrong place on it and
/// tissue leave less.
const SURROUNDINGS_MM: f64 = 5.0;

/// A start by shape alone that another place would have served as well; `has_surroundings` says whether much of the scan is far
/// from the surface.
fn start_reason(start: &GlobalReport, min_clearness: f64, has_surroundings: bool) -> Option<Reason> {
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

fn mirror_reason(evidence: &Evidence) -> Option<Reason> {
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

/// What is taken for granted: one list for every way to a verdict. `is_predicted` says whether the verdict states an error;
/// `unseen` are the causes that the data do not limit, each with whether it is of the camera.
fn assumptions(case: &Case<'_>, rules: &RuleParams, is_predicted: bool, unseen: &[(bool, String)]) -> Vec<String> {
    let is_checked = is_checked(case.check, case.registered.source.stamp_ns, rules.max_check_mm);
    let left = unseen.iter().filter(|(is_of_camera, _)| !(is_checked && *is_of_camera));
    let mut all: Vec<&str> = left.map(|(_, text)| text.as_str()).collect();
    if case.tracking.is_some() {
        if !is_checked {
            all.push(
                "the camera marker has not moved on its camera since the calibration, and the camera measures lengths as it did then; \
                 a check piece read after the scan would show it (metrics.check_points)",
            );
        }
        all.push("the bone marker has not moved on the bone since the scan");
    }
    if unseen.is_empty() {
        all.push("the CT shows the bone at its true size, and its surface is not swollen or shrunk as a whole");
    }
    all.extend(case.assumptions);
    let is_planned = !case.assessment.is_empty() || case.planes.is_some();
    if case.tracking.is_none() && !is_planned {
        all.push("no plan or calibration was given, so only the scan and the surface were examined");
    }
    if case.registered.source.viewpoint.is_none() {
        all.push(
            "the scan does not say where the camera was, so it was not examined whether it lies on the side that the camera saw",
        );
    }
    if case.icp.is_none_or(|ended| ended.converged.is_none()) {
        all.push("the registration converged; no report says whether it did");
    }
    if case.measured_tre_mm.is_none() {
        all.push(match (is_predicted, is_planned) {
            (true, _) => "no point on the bone was measured with a stylus, so the error is predicted, not measured",
            (false, true) => "no point on the bone was measured with a stylus, and the error could not be predicted",
            (false, false) => {
                "no point on the bone was measured with a stylus and none is planned, so the error is neither measured nor predicted"
            }
        });
    }
    let note = case.slide.and_then(slide_note);
    all.into_iter().map(str::to_owned).chain(note).collect()
}

#[cfg(test)]
mod tests;
