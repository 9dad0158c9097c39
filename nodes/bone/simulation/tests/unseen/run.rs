//! A case registered and judged, and its true errors.

use super::Case;
use super::effect::{Effect, Field, moved, moved_planes, moved_points};
use super::faults::{Family, Part};
use super::sound::Measurements;
use crate::common::bench::target_of;
use osteoflow_algorithms::icp::{self, IcpFit, IcpParams, Method};
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::trust::{
    self, Answer, Convergence, MarkerPoses, PredictParams, Registered, RuleParams, Tracking, Verdict,
};
use osteoflow_algorithms::{coarse, metrics};
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_geometry::{Cloud, Mesh, NamedPoint, Planes, Points, SurgicalPlan};
use osteoflow_simulation::{CtParams, ct_surface};
use std::ops::ControlFlow;

/// Largest sound errors.
const MAX_TRE_MM: f64 = 1.5;
const MAX_OFFSET_MM: f64 = 1.5;
const MAX_TILT_DEG: f64 = 0.5;

/// What a registration is given, and the truth.
pub(super) struct Inputs {
    case: Case,
    target: Target,
    /// Frame `bone_marker`.
    source: Cloud,
    located: Vec<NamedPoint>,
    landmarks: Points,
    assessment: Points,
    planes: Planes,
    measured: Measurements,
    /// The bone's marker on the bone when the answer is used.
    t_ct_bone_marker: Isometry3<f64>,
}

/// True errors.
#[derive(Debug, Clone, Copy)]
pub(super) struct Errors {
    pub(super) tre_mm: f64,
    /// Mean displacement of the cuts.
    pub(super) cuts_mm: f64,
    pub(super) offset_mm: f64,
    pub(super) tilt_deg: f64,
}

impl Errors {
    pub(super) fn is_wrong(&self) -> bool {
        self.tre_mm > MAX_TRE_MM || self.offset_mm > MAX_OFFSET_MM || self.tilt_deg > MAX_TILT_DEG
    }
}

pub(super) struct Registration {
    pub(super) fit: IcpFit,
    pub(super) errors: Errors,
}

/// A judged case.
pub(super) struct Outcome {
    pub(super) family: Family,
    pub(super) seed: u64,
    pub(super) fault: String,
    /// Words, unit and size of every claim of the fault.
    pub(super) claims: Vec<(&'static [&'static str], &'static str, f64)>,
    /// None where nothing was registered.
    pub(super) judged: Option<(Errors, Verdict)>,
    pub(super) judge_ms: f64,
    pub(super) case_ms: f64,
}

/// CPU time of this thread so far, ms.
fn cpu_ms() -> f64 {
    let counted = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    counted.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).map_or(f64::NAN, |ns| ns / 1e6)
}

fn fields(case: &Case, of: fn(&Effect) -> Option<&Field>) -> Vec<(f64, &Field)> {
    case.fault.parts.iter().filter_map(|part| Some((part.size, of(&part.effect)?))).collect()
}

fn of_ct(effect: &Effect) -> Option<&Field> {
    if let Effect::Ct(field) = effect { Some(field) } else { None }
}

fn of_plan(effect: &Effect) -> Option<&Field> {
    if let Effect::Plan(field) = effect { Some(field) } else { None }
}

fn of_camera(effect: &Effect) -> Option<&Field> {
    if let Effect::Camera(field) = effect { Some(field) } else { None }
}

fn of_sweep(effect: &Effect) -> Option<&Field> {
    if let Effect::Sweep(field) = effect { Some(field) } else { None }
}

/// Outward unit normals of a mesh's vertices.
fn normals(mesh: &Mesh) -> Vec<Vector3<f64>> {
    let mut normals = vec![Vector3::zeros(); mesh.vertices().len()];
    for (k, face) in mesh.faces().iter().enumerate() {
        face.iter().for_each(|v| normals[*v as usize] += mesh.area_vector(k));
    }
    normals.into_iter().map(|n| n.try_normalize(0.0).unwrap_or_default()).collect()
}

/// The CT's surface of the bone, with the faults of CT and segmentation.
fn surface(case: &Case) -> Mesh {
    let sound = ct_surface(case.sound.subject.bone(), &CtParams::default(), case.sound.seed).unwrap();
    let profiles = || {
        case.fault.parts.iter().filter_map(|part| match &part.effect {
            Effect::Surface(profile) => Some((part.size, profile)),
            _ => None,
        })
    };
    let maps = fields(case, of_ct);
    if maps.is_empty() && profiles().next().is_none() {
        return sound;
    }
    let one = |(v, normal): (&Point3<f64>, Vector3<f64>)| {
        let off_mm: f64 = profiles().map(|(size, profile)| size * profile(v)).sum();
        moved(&(v + normal * off_mm), &maps)
    };
    let vertices: Vec<Point3<f64>> = sound.vertices().iter().zip(normals(&sound)).map(one).collect();
    Mesh::new(&sound.frame, sound.origin, vertices, sound.faces().to_vec()).unwrap()
}

/// The scan with what covers the bone, motion and the camera's faults, frame `camera`.
fn scan(case: &Case, measured: &Measurements) -> Vec<Point3<f64>> {
    let films = || {
        case.fault.parts.iter().filter_map(|part| match &part.effect {
            Effect::Film(profile) => Some((part.size, profile)),
            _ => None,
        })
    };
    let is_covered = films().next().is_some();
    let (sweeps, camera) = (fields(case, of_sweep), fields(case, of_camera));
    let t_ct_camera = &measured.t_ct_camera;
    let one = |seen: &Point3<f64>| {
        let mut point = *seen;
        if is_covered {
            let on_bone = case.sound.subject.surface.closest_point(&(t_ct_camera * seen)).unwrap();
            let film_mm: f64 = films().map(|(size, profile)| size * profile(&on_bone.point)).sum();
            point += t_ct_camera.inverse() * (on_bone.normal * film_mm);
        }
        moved(&moved(&point, &sweeps), &camera)
    };
    measured.scan.points().iter().map(one).collect()
}

impl Inputs {
    pub(super) fn of(case: Case) -> Self {
        let measured = case.sound.measured();
        let plan = &case.sound.subject.plan;
        let target = target_of(&surface(&case), case.sound.seed);
        let t_source_camera = measured.t_bone_marker_camera;
        let source = Cloud::new("camera", scan(&case, &measured)).unwrap().at(measured.scan.stamp_ns);
        let source = source.seen_from(Isometry3::identity()).transformed("bone_marker", &t_source_camera);
        let camera = fields(&case, of_camera);
        let seen = |p: &NamedPoint| NamedPoint::new(p.name.clone(), t_source_camera * moved(&p.position, &camera));
        let located = measured.holes.iter().map(seen).collect();
        let maps: Vec<_> = fields(&case, of_ct).into_iter().chain(fields(&case, of_plan)).collect();
        let slip = case.fault.parts.iter().fold(Isometry3::identity(), |slip, part| match &part.effect {
            Effect::Marker(shift, turn) => {
                slip * Isometry3::new(shift * part.size, turn.map(f64::to_radians) * part.size)
            }
            _ => slip,
        });
        let [landmarks, assessment] = [&plan.landmarks, &plan.assessment].map(|points| moved_points(points, &maps));
        let planes = moved_planes(&plan.planes, &maps);
        Self {
            target,
            source,
            located,
            landmarks,
            assessment,
            planes,
            t_ct_bone_marker: measured.t_ct_bone_marker * slip,
            measured,
            case,
        }
    }

    pub(super) fn has_the_bits_of(&self, other: &Self) -> bool {
        let surface = |taken: &Self| taken.target.mesh().unwrap().mesh().clone();
        surface(self) == surface(other)
            && self.source == other.source
            && self.located == other.located
            && (&self.landmarks, &self.assessment, &self.planes) == (&other.landmarks, &other.assessment, &other.planes)
            && self.t_ct_bone_marker == other.t_ct_bone_marker
    }

    /// Point-to-plane from the landmarks, with the default parameters as in graphs/fibula.toml.
    pub(super) fn registered(&self) -> Option<Registration> {
        let start = coarse::three_point(&self.landmarks.points, &self.located).ok()?.t_target_source;
        let go_on = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
        let (method, params) = (Method::PointToPlane, IcpParams::default());
        let fit = icp::register(method, &self.target, &self.source, &start, &params, go_on).ok()?;
        let errors = self.errors(&fit.t_target_source);
        Some(Registration { fit, errors })
    }

    /// Where planned points and planes come to be on the bone, against where they were meant to be.
    fn errors(&self, t_target_source: &Isometry3<f64>) -> Errors {
        let t_bone_planned = self.t_ct_bone_marker * t_target_source.inverse();
        let SurgicalPlan { assessment, planes, axes, .. } = &self.case.sound.subject.plan;
        let pairs = assessment.points.iter().zip(self.assessment.points.iter());
        let off_mm = pairs.map(|(meant, planned)| (t_bone_planned * planned.position - meant.position).norm());
        let achieved = self.planes.transformed(&planes.frame, &t_bone_planned);
        let bone = self.case.sound.subject.bone();
        let cuts = metrics::cuts(planes, &achieved, axes.as_ref().unwrap(), Some(bone)).unwrap().cuts;
        let most = |of: &dyn Fn(&metrics::CutReport) -> f64| cuts.iter().map(of).fold(0.0, f64::max);
        Errors {
            tre_mm: off_mm.sum::<f64>() / assessment.points.len() as f64,
            cuts_mm: cuts.iter().filter_map(|cut| cut.moved_mm).sum::<f64>() / cuts.len() as f64,
            offset_mm: most(&|cut| cut.offset_mm.abs()),
            tilt_deg: most(&|cut| cut.tilt_rad.to_degrees()),
        }
    }

    fn verdict(&self, fit: &IcpFit) -> Verdict {
        let (t_target_source, ended) = (&fit.t_target_source, Convergence::from(&fit.report));
        let carried = |p: &NamedPoint| NamedPoint { position: t_target_source * p.position, ..p.clone() };
        let carried: Vec<NamedPoint> = self.located.iter().map(carried).collect();
        let poses = MarkerPoses {
            t_target_camera: t_target_source * self.measured.t_bone_marker_camera,
            t_camera_camera_marker: self.measured.t_camera_camera_marker,
            t_camera_phantom_marker: Some(self.measured.t_camera_phantom_marker),
        };
        let tracking = Tracking::new(&poses, None);
        let registered = Registered { target: &self.target, source: &self.source, t_target_source, at: &[] };
        let case = trust::Case {
            icp: Some(&ended),
            landmarks: &self.landmarks.points,
            located: &self.located,
            carried: &carried,
            assessment: &self.assessment.points,
            planes: Some(&self.planes),
            is_calibrated: true,
            tracking: Some(&tracking),
            ..trust::Case::new(registered)
        };
        let rules = RuleParams { attitude_stated: true, ..RuleParams::default() };
        trust::judge(&case, &Default::default(), &rules, &PredictParams::default())
    }

    pub(super) fn judged(&self) -> Outcome {
        let from_ms = cpu_ms();
        let answered = self.registered();
        let before_ms = cpu_ms();
        let judged = answered.map(|answer| (answer.errors, self.verdict(&answer.fit)));
        let until_ms = cpu_ms();
        let parts = &self.case.fault.parts;
        let name = |part: &Part| format!("{} {:.3}", part.name, part.size);
        let claims = parts.iter().flat_map(|part| {
            part.claims.iter().map(|claim| (claim.words, claim.unit, claim.per_size * part.size.abs()))
        });
        Outcome {
            family: self.case.family,
            seed: self.case.sound.seed,
            fault: parts.iter().map(name).collect::<Vec<_>>().join(", "),
            claims: claims.collect(),
            judged,
            judge_ms: until_ms - before_ms,
            case_ms: until_ms - from_ms,
        }
    }
}

impl Outcome {
    pub(super) fn answer(&self) -> Answer {
        self.judged.as_ref().map_or(Answer::Refused, |(_, verdict)| verdict.answer)
    }

    pub(super) fn is_wrong(&self) -> bool {
        self.judged.as_ref().is_none_or(|(errors, _)| errors.is_wrong())
    }

    /// Whether one of the first three printed assumptions names the fault's family, with a critical size of 0.3 to 1 times
    /// the true one.
    pub(super) fn is_covered(&self) -> bool {
        let Some((_, verdict)) = &self.judged else { return false };
        verdict.assumptions.iter().take(3).flat_map(|text| sizes(text)).any(|(what, size, unit)| {
            let is_covered = |(words, of, true_size): &(&[&str], &str, f64)| {
                *of == unit && words.iter().any(|word| what.contains(word)) && (0.3..=1.0).contains(&(size / true_size))
            };
            self.claims.iter().any(is_covered)
        })
    }

    pub(super) fn line(&self) -> String {
        let what = format!("{:?} {:016x} [{}]", self.family, self.seed, self.fault);
        let Some((errors, verdict)) = &self.judged else { return format!("{what} not registered") };
        let is = if errors.is_wrong() { "wrong" } else { "right" };
        let Errors { tre_mm, cuts_mm, offset_mm, tilt_deg } = errors;
        let covered = if self.is_wrong() && self.is_covered() { ", covered" } else { "" };
        let rules: Vec<&str> = verdict.reasons.iter().map(|reason| &*reason.rule).collect();
        let first: Vec<&String> = verdict.assumptions.iter().take(3).collect();
        let of = verdict.predicted.as_ref();
        let [points, cuts] = [of.and_then(|p| p.assessment.as_ref()), of.and_then(|p| p.all_cuts.as_ref())]
            .map(|set| set.map_or("none".to_owned(), |set| format!("{:.2?}", set.interval_mm)));
        format!(
            "{what} {is}, TRE {tre_mm:.2}, cuts {cuts_mm:.2} mm, offset {offset_mm:.2} mm, \
             tilt {tilt_deg:.2} deg: {:?} by {rules:?}{covered}; \
             predicted {points}, cuts {cuts}; {first:?}; {:.0} of {:.0} ms",
            verdict.answer, self.judge_ms, self.case_ms
        )
    }
}

/// What an assumption is about, without what would follow.
pub(super) fn named(text: &str) -> &str {
    text.split(':').next().unwrap_or(text)
}

/// The critical sizes that a printed assumption has, each with what it is of.
pub(super) fn sizes(text: &str) -> Vec<(&str, f64, &str)> {
    let parts = text.split([':', ';', ',']).flat_map(|part| part.split(" or "));
    let all: Vec<(&str, f64, &str)> =
        parts.filter_map(|part| critical(part).map(|(size, unit)| (part, size, unit))).collect();
    match all[..] {
        // What it is of is said before.
        [(_, size, unit)] => vec![(text, size, unit)],
        _ => all,
    }
}

/// The critical size that a printed assumption has: the number after "more than" or a word like that, with its unit.
pub(super) fn critical(text: &str) -> Option<(f64, &str)> {
    let words: Vec<&str> = text.split_whitespace().collect();
    words.windows(3).find_map(|three| {
        let size = three[1].parse().ok()?;
        let unit = three[2].trim_end_matches([',', '.', ';', ')']);
        (["than", "above", "over", "exceeds"].contains(&three[0]) && ["mm", "%", "degrees"].contains(&unit))
            .then_some((size, unit))
    })
}
