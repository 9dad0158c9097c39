//! The verdict on a registration: the signs in each kind of evidence, put together.

use super::assumptions::assumptions;
use super::attitude::{marker_place_reason, untested_attitude};
use super::by_shape::{
    another_bone_reason, camera_reason, has_surroundings, mirror_reason, name_surroundings_first, shape_reason,
    side_reason, start_reason, twin_assumption,
};
use super::case::Case;
use super::chance::{chance_of_being_wrong, signs};
use super::checked::check_reason;
use super::contradiction::contradiction_reason;
use super::convergence::convergence_reason;
use super::cut::planned_cuts;
use super::evidence::{Evidence, EvidenceParams, Examined, Registered, When, points_that_matter};
use super::extent::extent_reason;
use super::hand_eye::{HAND_EYE, stated_hand_eye, untested_hand_eye};
use super::inside::inside_reason;
use super::landmarks::{Compared, LandmarkErrors, landmarks_contradict};
use super::misfit::{limits_reason, misfit_reason, sensor_assumption, sensor_reason};
use super::motion::{MotionLimits, motion_signs};
use super::nuisance::{self, Nuisance, Nuisances};
use super::on_surface::{facing_away_reason, on_surface_reason};
use super::planned::{OrderEvidence, landmark_order, order_reason, plan_faults};
use super::predict::{PredictParams, Predicted, SCAN_MOTION, Where, predict};
use super::predict_last::predict_last;
use super::rules::RuleParams;
use super::size::size_reason;
use super::slid::slide_reasons;
use super::smear::Smear;
use super::spread::Spread;
use super::stylus::stylus_reason;
use super::uncertainty::spread_reason;
use super::verdict::Verdict;
use crate::coarse::{self, GlobalReport};
use crate::kabsch::kabsch;
use crate::sensor::Sensor;
use crate::still_average::TakeMotion;
use crate::tables::off_tables;
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::NamedPoint;
use osteoflow_verdict::{Answer, Reason};

/// Landmarks exclude a mirror image if it leaves them by more than this many standard deviations (RMS).
const TELLS_SIDE: f64 = 4.0;

/// The rules on scan and surface.
const DATA: [&str; 8] =
    ["misfit", "inward_misfit", "inside", "spread", "unsettled", "shape", "on_surface", "facing_away"];

/// The verdict on a registration.
pub fn judge(case: &Case<'_>, examine: &EvidenceParams, rules: &RuleParams, errors: &PredictParams) -> Verdict {
    let rest = off_tables(case.registered.target, case.registered.source);
    let source = rest.as_ref().unwrap_or(case.registered.source);
    let cuts = planned_cuts(case.registered.target, case.planes);
    let assessed: Vec<Point3<f64>> = case.assessment.iter().map(|p| p.position).collect();
    let at: Vec<Point3<f64>> = assessed.iter().copied().chain(cuts.iter().map(|cut| cut.middle.position)).collect();
    let case = &Case { registered: Registered { at: &at, source, ..case.registered }, ..case.clone() };
    let limited = if assessed.is_empty() { points_that_matter(&case.registered) } else { assessed };
    let place = Where { points: case.assessment, cuts: &cuts, limited: &limited };
    let order = landmark_order(case.landmarks, case.located);
    let sensor = case.registered.target.sensor();
    let limits = sensor.and_then(|sensor| limits_reason(sensor, &rules.limits)).into_iter().collect();
    let (rules, errors) = match sensor {
        Some(sensor) => (&rules.of(sensor), &errors.of(sensor)),
        None => (rules, errors),
    };
    let judging = Judging { case, place, order, examine, rules, errors };

    let (takes, scan) = (judging.of_takes(), judging.of_scan());
    let reasons = [case.reasons.to_vec(), judging.of_plan_and_readings(), takes.reasons, scan.reasons, limits].concat();
    let assumed = assumptions(case, rules, scan.predicted.is_some(), &scan.unseen);
    let devices = scan.predicted.as_ref().and_then(|predicted| predicted.devices_assumption(errors));
    let last = scan.predicted.as_ref().and_then(|predicted| predicted.last.as_ref()?.note());
    let sensor = sensor.and_then(|sensor| sensor_assumption(sensor, &rules.limits));
    let twin = case.start.filter(|_| at.is_empty()).and_then(twin_assumption);
    let given = stated_hand_eye(case, errors);
    let assumed = given
        .into_iter()
        .chain(sensor)
        .chain(twin)
        .chain(assumed)
        .chain(takes.assumptions)
        .chain(takes.trust_ends.clone())
        .chain(devices)
        .chain(last)
        .collect();
    let trust_ends = takes.trust_ends;
    let signs = signs(scan.measured.as_ref(), scan.beyond_limits, &reasons, rules);
    let chance_of_being_wrong = Some(chance_of_being_wrong(&signs));
    Verdict {
        trust_ends,
        chance_of_being_wrong,
        signs,
        ..Verdict::new(reasons, assumed, scan.predicted, scan.measured, scan.nuisances)
    }
}

/// What the markers' motions say.
struct OfTakes {
    reasons: Vec<Reason>,
    assumptions: Vec<String>,
    /// Why the planes are trusted at the scan alone, if they are.
    trust_ends: Option<String>,
}

/// What scan and surface say.
#[derive(Default)]
struct OfScan {
    reasons: Vec<Reason>,
    predicted: Option<Predicted>,
    /// The predicted chance of an error beyond the limits, also where no error is told.
    beyond_limits: Option<f64>,
    measured: Option<Evidence>,
    nuisances: Vec<Nuisance>,
    /// The causes that the data do not limit, each with whether it is of camera or markers.
    unseen: Vec<(bool, String)>,
}

/// A case with the places that matter, and how it is judged.
struct Judging<'a> {
    case: &'a Case<'a>,
    place: Where<'a>,
    order: Option<OrderEvidence>,
    examine: &'a EvidenceParams,
    rules: &'a RuleParams,
    errors: &'a PredictParams,
}

impl Judging<'_> {
    /// The signs in the plan, the landmarks, the scan's extent, the slide profile and the check piece.
    fn of_plan_and_readings(&self) -> Vec<Reason> {
        let Case { registered, landmarks, assessment, planes, .. } = *self.case;
        let on_surface = if self.case.on_surface { landmarks } else { &[] };
        let assessment = if self.case.assessment_on_surface { assessment } else { &[] };
        let points: Vec<NamedPoint> = on_surface.iter().chain(assessment).cloned().collect();
        let mut reasons = registered.target.mesh().map(|mesh| plan_faults(mesh, &points, planes)).unwrap_or_default();
        reasons.extend(extent_reason(registered.source, registered.target.points(), self.case.start.is_some()));
        reasons.extend(self.case.slide.map(slide_reasons).unwrap_or_default());
        reasons.extend(check_reason(self.case.check, registered.source.stamp_ns, self.rules.max_check_mm));
        reasons.extend(self.order.as_ref().and_then(order_reason));
        reasons
    }

    /// The signs in the markers' poses, and what is taken for granted about them.
    fn of_takes(&self) -> OfTakes {
        let Case { registered, landmarks, assessment, takes, .. } = *self.case;
        let RuleParams { max_latency_s, max_moved_mm, ref limits, .. } = *self.rules;
        let all: Vec<TakeMotion> = takes.scan.into_iter().chain(takes.located).chain(takes.touched).cloned().collect();
        let motion_limits = MotionLimits { max_latency_s, max_moved_mm, limits };
        let motion = motion_signs(&all, registered.t_target_source, &self.place, &motion_limits);
        let planned: Vec<NamedPoint> = landmarks.iter().chain(assessment).cloned().collect();
        let attitude = untested_attitude(self.case, self.place.cuts, &planned, self.rules);
        let (attitude, trust_ends) =
            attitude.map_or((None, None), |untested| (Some(untested.assumption), untested.beyond));
        let place = marker_place_reason(self.case);
        OfTakes {
            reasons: motion.reason.into_iter().chain(contradiction_reason(&all, self.errors)).chain(place).collect(),
            assumptions: motion.assumptions.into_iter().chain(attitude).collect(),
            trust_ends,
        }
    }

    /// The signs in scan and surface, and the predicted error.
    fn of_scan(&self) -> OfScan {
        let registered = &self.case.registered;
        let Some(mut examined) = Evidence::examine(registered, self.examine, self.case.start) else {
            return self.unexamined();
        };
        let nuisances = self.nuisances(examined.sensor_mm);
        let smear = self.case.takes.scan.and_then(|take| Smear::new(take, registered, &self.place, self.rules));
        let predicted = self.predicted(&examined, nuisances.as_ref(), smear.as_ref());
        let known = nuisances.as_ref().zip(predicted.as_ref()).map(|(n, p)| n.known(p, &self.place, self.rules));
        let (found, nuisances, mut unseen) = known.map(|n| (n.reason, n.list, n.assumptions)).unwrap_or_default();
        let mut reasons = self.of_end(&examined.evidence);
        let cause = found.as_ref().map(|found| found.rule.clone());
        reasons.extend(found);
        reasons.extend(self.stylus(predicted.as_ref()));
        let smeared = smear.as_ref().zip(predicted.as_ref()).and_then(|(smear, p)| smear.reason(p, self.rules));
        let assumption = smear.as_ref().filter(|_| smeared.is_none()).and_then(|s| s.assumption(&self.rules.limits));
        unseen.extend(assumption.map(|text| (false, text)));
        match smeared {
            // What the motion explains is not told as another uncertainty.
            Some(smeared) => reasons.push(smeared),
            None => reasons.extend(spread_reason(predicted.as_ref(), &examined.evidence, self.rules)),
        }
        let is_placed = !self.case.located.is_empty();
        reasons.extend(data_reasons(&examined.evidence, self.rules, is_placed));
        reasons.extend(self.landmarks(examined.spread.as_ref()));
        let is_sparse = coarse::is_sparse(registered.source.points());
        let is_coarse = registered.target.sensor().is_some_and(Sensor::is_coarse);
        let is_side_open = (is_sparse || is_coarse) && !self.is_side_told();
        let is_due = self.is_mirror_due(&reasons, cause.is_some() || is_side_open);
        let by_shape = examined.by_shape.as_ref().filter(|_| is_due);
        let camera = by_shape.and_then(|report| camera_reason(registered, report));
        if is_due && camera.is_none() {
            examined.examine_mirrored(registered);
            // A gross mistake is named before the cause that would explain it.
            let at = cause.as_ref().and_then(|cause| reasons.iter().position(|reason| reason.rule == *cause));
            if let Some((at, another)) = at.zip(another_bone_reason(&examined.evidence)) {
                reasons.insert(at, another);
            }
            reasons.extend(side_reason(&examined.evidence, is_sparse).filter(|_| is_side_open));
        }
        let mirror = mirror_reason(&examined.evidence);
        mirror.into_iter().for_each(|mirror| reasons.insert(0, mirror));
        name_surroundings_first(&mut reasons, has_surroundings(&examined.evidence), self.case.start);
        // What else is wrong follows from these.
        let size = size_reason(registered, &examined.evidence);
        [camera, size].into_iter().flatten().for_each(|first| reasons.insert(0, first));
        let beyond_limits = predicted.as_ref().map(|predicted| predicted.beyond_limits);
        // The error is told where points or cuts are planned.
        let mut predicted = predicted.filter(|_| !registered.at.is_empty());
        if let Some(predicted) = &mut predicted {
            let Case { takes, planes, .. } = self.case;
            predicted.last =
                predict_last(predicted, self.place.cuts, takes, *planes, registered.t_target_source, self.errors);
        }
        OfScan { reasons, predicted, beyond_limits, measured: Some(examined.evidence), nuisances, unseen }
    }

    /// What is said of a scan that cannot be examined.
    fn unexamined(&self) -> OfScan {
        let text = "the surface has no normals, so nothing could be examined";
        let unexamined = Reason::new("unexamined", Answer::Doubtful, text, "prepare the surface with normals");
        let start = self.case.start.and_then(|start| self.start(start, false));
        let converged = self.case.icp.and_then(|ended| convergence_reason(ended, None));
        let reasons = [self.stylus(None), start, converged, self.landmarks(None), Some(unexamined)]
            .into_iter()
            .flatten()
            .collect();
        OfScan { reasons, ..OfScan::default() }
    }

    /// The signs in where the registration started and ended.
    fn of_end(&self, evidence: &Evidence) -> Vec<Reason> {
        let start = |start| self.start(start, has_surroundings(evidence));
        let converged = |ended| convergence_reason(ended, evidence.unsettled_mm);
        let (start, converged) = (self.case.start.and_then(start), self.case.icp.and_then(converged));
        start.into_iter().chain(converged).collect()
    }

    fn start(&self, start: &GlobalReport, has_surroundings: bool) -> Option<Reason> {
        let is_planned = !self.case.registered.at.is_empty();
        start_reason(start, self.rules.min_shape_clearness, has_surroundings, is_planned)
    }

    fn stylus(&self, predicted: Option<&Predicted>) -> Option<Reason> {
        let RuleParams { max_measured_tre_mm, stylus, .. } = self.rules;
        stylus_reason(self.case.measured_tre_mm, predicted, *max_measured_tre_mm, stylus)
    }

    /// The sign in landmarks against the surface; none where they are exchanged, which says more.
    fn landmarks(&self, spread: Option<&Spread>) -> Option<Reason> {
        let Case { landmarks: planned, carried, on_surface, .. } = *self.case;
        let LandmarkErrors { landmark_mm, fiducial_mm } = self.rules.landmarks;
        let (word, sd_mm) = if on_surface { ("landmark", landmark_mm) } else { ("fiducial", fiducial_mm) };
        let spread = spread.map(|spread| spread.clone().widened(self.errors.ct_bias_mm));
        let is_exchanged = self.order.as_ref().and_then(order_reason).is_some();
        let registered = &self.case.registered;
        let scan: Vec<Point3<f64>> =
            registered.source.points().iter().map(|p| registered.t_target_source * p).collect();
        let compared = Compared { planned, carried, word, sd_mm, scan: &scan };
        landmarks_contradict(&compared, spread.as_ref()).filter(|_| !is_exchanged)
    }

    /// What may be wrong beside the pose.
    fn nuisances(&self, sensor_mm: f64) -> Option<Nuisances> {
        let (registered, priors) = (&self.case.registered, &self.errors.nuisances);
        let has_markers = self.case.tracking.is_some();
        nuisance::examine(registered, &self.place, sensor_mm, has_markers, self.rules, priors)
    }

    fn predicted(
        &self,
        examined: &Examined,
        nuisances: Option<&Nuisances>,
        smear: Option<&Smear>,
    ) -> Option<Predicted> {
        let motion = smear.map(|smear| (SCAN_MOTION, smear.pose.0, smear.pose.1));
        let given = untested_hand_eye(self.case, self.errors).map(|(covariance, about)| (HAND_EYE, covariance, about));
        let others: Vec<_> = motion.into_iter().chain(given).collect();
        let deformation = nuisances.map(Nuisances::deformation);
        let to_settled = examined.to_settled.unwrap_or_else(Isometry3::identity);
        let (tracking, limits) = (self.case.tracking, &self.rules.limits);
        let spread = examined.spread.as_ref()?;
        Some(predict(spread, &to_settled, deformation.as_ref(), tracking, &others, &self.place, limits, self.errors))
    }

    /// Whether the landmarks tell the scan from its mirror image: mirrored, they would lie off by more than their errors.
    fn is_side_told(&self) -> bool {
        let Case { landmarks, carried, on_surface, .. } = *self.case;
        let of = |p: &NamedPoint| carried.iter().find(|q| q.name == p.name).map(|q| (p.position, q.position));
        let (planned, located): (Vec<_>, Vec<_>) = landmarks.iter().filter_map(of).unzip();
        let image: Vec<Point3<f64>> = located.iter().map(|p| Point3::new(-p.x, p.y, p.z)).collect();
        let LandmarkErrors { landmark_mm, fiducial_mm } = self.rules.landmarks;
        let sd_mm = if on_surface { landmark_mm } else { fiducial_mm };
        kabsch(&planned, &image).is_ok_and(|t| coarse::rms(&t, &planned, &image) > TELLS_SIDE * sd_mm)
    }

    /// Whether the scan's mirror image is registered, too.
    fn is_mirror_due(&self, reasons: &[Reason], has_cause: bool) -> bool {
        let is_of_data = |reason: &Reason| DATA.contains(&reason.rule.as_str());
        match self.examine.mirror {
            When::Always => true,
            When::IfRaised => has_cause || self.case.reasons.iter().chain(reasons).any(is_of_data),
            When::Never => false,
        }
    }
}

/// The signs in the residuals, and in the registration by shape alone. `is_placed` says whether landmarks tell where on the bone the scan is.
fn data_reasons(evidence: &Evidence, rules: &RuleParams, is_placed: bool) -> Vec<Reason> {
    let signs = [
        sensor_reason(evidence),
        misfit_reason(evidence, rules),
        inside_reason(&evidence.inside_patches, evidence.noise_mm, rules.max_inside),
        on_surface_reason(evidence, rules),
        facing_away_reason(evidence),
        shape_reason(evidence, rules, is_placed),
    ];
    signs.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests;
