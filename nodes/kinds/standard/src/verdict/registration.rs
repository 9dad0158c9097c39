//! The kind `verdict.registration`.

use super::loosened::loosened;
use crate::transform::points::in_one_list;
use osteoflow_algorithms::calibrate::PhantomReport;
use osteoflow_algorithms::coarse::GlobalReport;
use osteoflow_algorithms::hole::HoleReport;
use osteoflow_algorithms::metrics::{CheckReport, TreReport};
use osteoflow_algorithms::slide::SlideReport;
use osteoflow_algorithms::still_average::TakeMotion;
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::trust::{
    self, Case, Convergence, EvidenceParams, MarkerPoses, PlanReport, PredictParams, Reason, Registered, RuleParams,
    Takes, Tracking, Verdict,
};
use osteoflow_geometry::{
    Cloud, NamedPoint, Plane, Planes, Points, Pose, SurfaceKey,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::{
    Context, Describe, Emit, Inputs, NodeError, Outputs, Value, function, params, schemars::JsonSchema,
    serde::Deserialize,
};
use osteoflow_payloads::Json;

/// Judges a registration: trusted, doubtful or refused, with reasons, assumptions and the predicted error.
///
/// It looks for signs against the registration in the scan and its residuals, in a second registration by shape alone,
/// in the landmarks, in the plan and in the calibration. It never changes the pose. If it is wired to `verdict` in
/// `[results]`, a refused answer ends the run without poses and planes. docs/method/trust.md says what each rule
/// noticed and what it missed.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "verdict.registration"
in   = { source = "to_bone.cloud", target = "ct_surface.target", t_target_source = "icp.t_target_source", icp = "icp.report", plan = "plan.report", surface = "bone.report", landmarks = "plan.landmarks", located = { from = "hole.point", n = 3 }, assessment = "plan.assessment", planes = "plan.planes", followed = "planes_last.planes", known = "planes_last.known", calibration = "calibration.report", t_camera_camera_marker = "calibration.t_camera_camera_marker", t_camera_phantom_marker = "calibration.t_camera_phantom_marker", measured = "tre_measured.report", take_motion = "to_bone.take_motion", located_motion = { from = "to_bone_laser.take_motion", n = 3 } }
"#,
    literature = [
        "Gelfand et al. 2003",
        "Censi 2007",
        "Fitzpatrick, West and Maurer 1998",
        "White 1980",
        "Moghari and Abolmaesumi 2009",
    ]
)]
pub struct Registration;

/// Parameters of [`Registration`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// What is examined beside the residuals.
    pub examine: EvidenceParams,
    /// Thresholds of the rules.
    pub rules: RuleParams,
    /// Stated errors of the devices, for the predicted error.
    pub errors: PredictParams,
    /// Whether the landmarks lie on the surface. false: they are fiducials, such as screws, rings or skin markers, with the
    /// error `rules.landmarks.fiducial_mm`; their distance from the surface is no sign.
    #[param(true)]
    pub on_surface: bool,
    /// Whether the assessment points lie on the surface. false: they are targets, such as a tumour or screws; their distance
    /// from the surface is no sign.
    #[param(true)]
    pub assessment_on_surface: bool,
    /// Largest distance of a planned plane's origin from the surface; beyond it a warning says that plan and bone probably do
    /// not belong together. 50: the middle of a cut is inside the bone, and the widest, at the knee, is 90 mm wide.
    #[param(50.0, 0.0..=10_000.0)]
    pub max_plane_distance_mm: f64,
}

impl Params {
    /// Warnings about planned planes that are far from the bone.
    fn far_planes(&self, planes: &Planes, target: &Target) -> Vec<String> {
        let limit_mm = self.max_plane_distance_mm;
        let far = planes.planes.iter().filter(|plane| {
            let origin = plane.isometry().map(|t| Point3::from(t.translation.vector));
            origin.is_some_and(|origin| target.nearest(&origin, limit_mm).is_none())
        });
        let message = |plane: &Plane| {
            format!(
                "plane \"{}\" is more than {limit_mm} mm from the bone's surface; is the plan of another bone, in RAS or in \
                 another unit?",
                plane.name
            )
        };
        far.map(message).collect()
    }
}

/// Inputs of [`Registration`].
#[derive(Inputs)]
pub struct In {
    /// The scan that was registered.
    source: Cloud,
    /// The CT surface.
    #[port(join = "once", frame = "t_target_source.to")]
    target: Target,
    /// The registration.
    #[port(to = "target", from = "source")]
    t_target_source: Pose,
    /// The report of the registration, of any kind: its `converged`, `remaining_mm` and `stop_reason` are used if it has them.
    icp: Option<Value>,
    /// The report of the CT surface: each text of its `assumptions` becomes one of the verdict, and its `sha256` or
    /// `frame_of_reference_uid` is compared with the plan's.
    #[port(join = "once")]
    surface: Option<Json>,
    /// The report of a registration by shape alone that the ICP started from: if that was unclear, the answer is doubtful.
    start: Option<GlobalReport>,
    /// The slide profile about the registration.
    slide: Option<SlideReport>,
    /// The report of the plan. If it does not bind the plan to this surface, landmarks that are all off the same way make the
    /// answer doubtful.
    #[port(join = "once")]
    plan: Option<Json>,
    /// The planned landmarks.
    #[port(join = "once", frame = "target")]
    landmarks: Option<Points>,
    /// The landmarks as located.
    #[port(join = "collect", n = 3)]
    located: Vec<Option<Points>>,
    /// The reports of how they were located: `scan_residual_mm`, the distance of each laser scan from the scan, tests a
    /// `t_camera_camera_marker` that is given.
    #[port(join = "collect", n = 3)]
    located_report: Vec<Option<HoleReport>>,
    /// The planned assessment points: the error is predicted there.
    #[port(join = "once", frame = "target")]
    assessment: Option<Points>,
    /// The planned cuts: the error is predicted in the middle of the bone.
    #[port(join = "once", frame = "target")]
    planes: Option<Planes>,
    /// The cuts at the end of the recording; the verdict waits for them or the wire's end. If they are unknown, the answer is
    /// doubtful.
    #[port(join = "once")]
    followed: Option<Planes>,
    /// The last known ones, for the output `planes`. Unwired: those of `followed`.
    #[port(join = "once")]
    known: Option<Planes>,
    /// The report of the calibration.
    #[port(join = "once")]
    calibration: Option<PhantomReport>,
    /// Where the camera sits on its marker: the calibration's, or given. A given one is tested by the camera's turns between the scan and the landmarks.
    #[port(join = "once")]
    t_camera_camera_marker: Option<Pose>,
    /// Where the camera saw the phantom's marker.
    #[port(join = "once")]
    t_camera_phantom_marker: Option<Pose>,
    /// The error measured with a stylus; the verdict waits for it or the wire's end.
    #[port(join = "once")]
    measured: Option<TreReport>,
    /// Readings of a check piece, all until the wire ends. One at the scan or later shows whether the camera's marker still
    /// sits as calibrated.
    #[port(join = "collect")]
    check: Vec<Option<CheckReport>>,
    /// How the markers moved while the scan was taken, from `transform.to_bone_marker`.
    take_motion: Option<TakeMotion>,
    /// How the markers moved while the landmarks were located.
    #[port(join = "collect", n = 3)]
    located_motion: Vec<Option<TakeMotion>>,
    /// How the markers moved while the stylus touched the points of `measured`, from `transform.points_to_bone_marker`, all
    /// until the wire ends.
    #[port(join = "collect")]
    touched_motion: Vec<Option<TakeMotion>>,
}

/// Outputs of [`Registration`].
#[derive(Outputs)]
pub struct Out {
    /// The verdict.
    verdict: Verdict,
    /// The last planes that are known, with their stamp; empty if the verdict does not hold for them, because nothing has tested the
    /// attitude of the bone's marker.
    #[port(frame = "followed")]
    planes: Emit<Planes>,
}

#[function("verdict.registration")]
impl Registration {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let t_target_source = i.t_target_source.expect(&i.target.frame, &i.source.frame)?;
        let located: Vec<Points> = i.located.iter().flatten().cloned().collect();
        let located = (!located.is_empty()).then(|| in_one_list(&located)).transpose()?;
        let named = |points: &Option<Points>| -> Vec<NamedPoint> {
            points.as_ref().map(|points| points.points.to_vec()).unwrap_or_default()
        };
        let tracking = i.source.viewpoint.zip(i.t_camera_camera_marker.as_ref()).map(|(viewpoint, camera_marker)| {
            let poses = MarkerPoses {
                t_target_camera: t_target_source * viewpoint,
                t_camera_camera_marker: camera_marker.isometry,
                t_camera_phantom_marker: i.t_camera_phantom_marker.as_ref().map(|pose| pose.isometry),
            };
            Tracking::new(&poses, i.calibration.as_ref())
        });
        let (landmarks, assessment) = (named(&i.landmarks), named(&i.assessment));
        let carried = located.as_ref().map(|located| carried(located, &i.source, &t_target_source));
        let plan = i.plan.as_ref().map(|report| {
            let carried = carried.clone().transpose()?;
            let (key, max_mm) = (surface_key(i.surface.as_ref()), params.rules.max_common_shift_mm);
            let report = PlanReport::deserialize(&*report.0);
            let report = report.map_err(|error| NodeError::new(format!("plan is no report of a plan: {error}")))?;
            let carried = carried.unwrap_or_default();
            Ok::<_, NodeError>(trust::plan_binding(&report, &key, &i.target, &landmarks, &carried, max_mm))
        });
        let plan = plan.transpose()?.unwrap_or_default();
        let located = named(&located);
        let carried = carried.and_then(Result::ok).unwrap_or_default();
        let mut signs: Vec<Reason> = i.followed.as_ref().and_then(trust::planes_lost).into_iter().collect();
        signs.extend(plan.reasons);
        let check: Vec<CheckReport> = i.check.into_iter().flatten().collect();
        let ended = i.icp.map(|report| Convergence::deserialize(report.to_result()).unwrap_or_default());
        let assumed =
            i.surface.as_ref().and_then(|report| report.0.get("assumptions")).and_then(|list| list.as_array());
        let Params { examine, rules, errors, .. } = params;
        let laxer = loosened(rules, examine);
        let assumed = assumed.into_iter().flatten().filter_map(|text| text.as_str());
        let untested: Vec<&str> = plan.untested.as_deref().into_iter().collect();
        let assumed: Vec<&str> = plan.notes.iter().map(String::as_str).chain(assumed).chain(laxer.as_deref()).collect();
        let located_motion: Vec<TakeMotion> = i.located_motion.into_iter().flatten().collect();
        // Touches that measured nothing do not matter.
        let touched_motion: Vec<TakeMotion> =
            i.touched_motion.into_iter().flatten().filter(|_| i.measured.is_some()).collect();
        let apart_mm = i.located_report.iter().flatten().map(|report| report.scan_residual_mm);
        let takes = Takes {
            scan: i.take_motion.as_ref(),
            located: &located_motion,
            touched: &touched_motion,
            apart_mm: apart_mm.max_by(f64::total_cmp),
            last: i.followed.as_ref(),
        };
        let case = Case {
            registered: Registered { target: &i.target, source: &i.source, t_target_source: &t_target_source, at: &[] },
            icp: ended.as_ref(),
            landmarks: &landmarks,
            located: &located,
            carried: &carried,
            on_surface: params.on_surface,
            assessment: &assessment,
            assessment_on_surface: params.assessment_on_surface,
            planes: i.planes.as_ref(),
            is_calibrated: i.calibration.is_some() || i.t_camera_phantom_marker.is_some(),
            tracking: tracking.as_ref(),
            measured_tre_mm: i.measured.as_ref().map(|report| report.mean_abs.norm),
            slide: i.slide.as_ref(),
            check: &check,
            takes,
            start: i.start.as_ref(),
            reasons: &signs,
            untested: &untested,
            assumptions: &assumed,
        };
        trust::room_note(&case.registered).into_iter().for_each(|note| ctx.warn(note));
        let verdict = trust::judge(&case, examine, rules, errors);
        if let Some(planes) = i.planes.as_ref().filter(|_| !verdict.reasons.iter().any(|reason| reason.rule == "plan"))
        {
            params.far_planes(planes, &i.target).into_iter().for_each(|warning| ctx.warn(warning));
        }
        let planes = match (&verdict.trust_ends, i.known.or(i.followed)) {
            (Some(why), _) => {
                ctx.sign("attitude_untested", why);
                Emit::Empty(why.clone())
            }
            (None, Some(planes)) => Emit::Value(planes),
            (None, None) => Emit::Empty("no planes were followed".into()),
        };
        Ok(Out { verdict, planes })
    }
}

/// Located landmarks as the registration carries them.
fn carried(located: &Points, source: &Cloud, t_target_source: &Isometry3<f64>) -> Result<Vec<NamedPoint>, NodeError> {
    located.frame.expect(&source.frame, "the located landmarks")?;
    let carried = |p: &NamedPoint| NamedPoint { position: t_target_source * p.position, ..p.clone() };
    Ok(located.points.iter().map(carried).collect())
}

/// What a surface's report has to identify it.
fn surface_key(report: Option<&Json>) -> SurfaceKey {
    let text = |key: &str| report?.0.get(key)?.as_str().map(str::to_owned);
    SurfaceKey {
        sha256: text("sha256"),
        frame_of_reference_uid: text("frame_of_reference_uid"),
        ..SurfaceKey::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::SurfaceOrigin;

    #[test]
    fn a_plane_far_from_the_bone_is_named() {
        let points: Vec<Point3<f64>> = (0..100).map(|k| Point3::new(0.0, 0.0, f64::from(k))).collect();
        let target = Target::new("ct", SurfaceOrigin::User, points, None).expect("a target");
        let plane = |name: &str, x: f64| Plane::new(name, Isometry3::translation(x, 0.0, 50.0));
        let planes = Planes::new("ct", vec![plane("distal", 49.0), plane("proximal", -51.0)]);
        let said = Params::default().far_planes(&planes, &target);
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].starts_with("plane \"proximal\" is more than 50 mm from the bone's surface"), "{}", said[0]);
    }
}
