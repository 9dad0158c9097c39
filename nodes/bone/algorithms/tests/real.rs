//! The verdict on measured data with known answers, as the program is used on two files.
//!
//! Hip bones (CT against tracked ultrasound) and range scans (laser triangulation) of `shared/data/real`. Of every pair starts by shape
//! alone, starts beside the truth and the mirrored scan are judged; of the hip bones halves, too, with the sensor stated. With `SLOW_TESTS` there are as many as docs/method/real-data.md has,
//! and its tables are compared with them (`UPDATE=1` writes them); without, some of these.

mod page;

use crate::common::{data, stl};
use crate::measured::{centroid, ply, range_scans, rows, xyz};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use osteoflow_algorithms::coarse::{self, GlobalParams, GlobalReport};
use osteoflow_algorithms::icp::{self, IcpParams, Method};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::sensor::SensorKind;
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::trust::{self, Answer, Case, EvidenceParams, PredictParams, Registered, RuleParams, Verdict};
use osteoflow_algorithms::{normals, sample};
use osteoflow_geometry::{Cloud, Mesh, NamedPoint, SurfaceOrigin};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, UnitSphere};
use rustix::time::{ClockId, clock_gettime};
use std::ops::ControlFlow;
use std::sync::{Mutex, PoisonError};

/// A right pose of a hip bone, at the cloud's centroid: the protocol of its publication.
pub(crate) const HIP_RIGHT: (f64, f64) = (4.0, 5.0);

/// A right pose of a range scan: its points off by less on average, mm.
const RANGE_RIGHT_MM: f64 = 1.5;

/// How a registration starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Start {
    /// By shape alone.
    Shape,
    /// From the truth, turned about the centroid and shifted.
    Near { deg: f64, mm: f64 },
}

/// Uncertainty of the stated true poses, mm: the hips' frames meet through markers on the bones, the range scans' poses were found
/// by registration.
const HIP_TRUTH_MM: f64 = 2.0;
const RANGE_TRUTH_MM: f64 = 0.2;

/// A measured scan where it belongs, and what a right pose of it is.
struct Pair<'a> {
    name: &'a str,
    target: &'a Target,
    /// The scan at its true pose.
    placed: &'a [Point3<f64>],
    is_hip: bool,
}

/// What came of a registration.
struct Outcome {
    pair: String,
    start: Start,
    seed: u64,
    is_right: bool,
    is_mirrored: bool,
    /// Mean error of some of the scan's points, mm.
    error_mm: f64,
    off_deg: f64,
    /// Why there is no verdict, or the verdict.
    verdict: Result<Verdict, String>,
    /// By how much the true pose is uncertain, mm; none where the error has to be below the interval's end as it is.
    truth_mm: Option<f64>,
    /// Processor time of registration and verdict, s.
    cpu_s: f64,
}

impl Outcome {
    fn line(&self) -> String {
        let right = if self.is_right { "right" } else { "wrong" };
        let mirrored = if self.is_mirrored { ", mirrored" } else { "" };
        let what = format!("{}{mirrored} {:?} {}", self.pair, self.start, self.seed);
        let off = format!("{what:46} {right} {:6.2} mm {:6.2} deg {:4.1} s", self.error_mm, self.off_deg, self.cpu_s);
        let verdict = match &self.verdict {
            Ok(verdict) => verdict,
            Err(failure) => return format!("{off}  no answer: {failure}"),
        };
        let rules: Vec<String> = verdict.reasons.iter().map(|r| format!("{} {:?}", r.rule, r.answer)).collect();
        let interval = self.interval_mm().map(|[from, to]| format!("{from:.2} to {to:.2} mm")).unwrap_or_default();
        let error = verdict.measured.as_ref().map(|evidence| evidence.surface_error);
        format!("{off}  {:?} [{}] {interval} {error:.2?}", verdict.answer, rules.join(", "))
    }

    fn answer(&self) -> Option<Answer> {
        self.verdict.as_ref().ok().map(|verdict| verdict.answer)
    }

    fn interval_mm(&self) -> Option<[f64; 2]> {
        Some(self.verdict.as_ref().ok()?.predicted.as_ref()?.assessment.as_ref()?.interval_mm)
    }

    /// Whether the predicted interval, widened by the truth's own uncertainty, holds the error; without that, whether the error is below it.
    fn is_held(&self) -> bool {
        self.interval_mm().is_some_and(|[from, to]| match self.truth_mm {
            Some(truth_mm) => (from - truth_mm..=to + truth_mm).contains(&self.error_mm),
            None => self.error_mm <= to,
        })
    }
}

pub(crate) fn target_of(mesh: &Mesh) -> Target {
    let samples = sample::surface(mesh, 150_000, &mut ChaCha8Rng::seed_from_u64(1));
    let target = Target::new("ct", SurfaceOrigin::User, samples.points, Some(samples.normals.into())).unwrap();
    target.with_mesh(MeshQuery::new(mesh))
}

fn random_motion(rng: &mut ChaCha8Rng, deg: f64, mm: f64) -> Isometry3<f64> {
    let axis: [f64; 3] = UnitSphere.sample(rng);
    let way: [f64; 3] = UnitSphere.sample(rng);
    Isometry3::new(Vector3::from(way) * mm, Vector3::from(axis) * deg.to_radians())
}

impl Pair<'_> {
    /// Turns and shifts the scan, registers it and judges the answer.
    fn registered(&self, start: Start, seed: u64) -> Outcome {
        let Self { target, placed, is_hip, .. } = *self;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let centre = centroid(placed);
        let about =
            |motion: Isometry3<f64>| Translation3::from(centre.coords) * motion * Translation3::from(-centre.coords);
        let (deg, mm) = (rng.random_range(0.0..180.0), rng.random_range(0.0..500.0));
        let t_scan_truth = about(random_motion(&mut rng, deg, mm));
        let cloud = Cloud::new("scan", placed.iter().map(|p| t_scan_truth * p).collect::<Vec<_>>()).unwrap();
        let from_s = cpu_s();
        let mut outcome = Outcome {
            pair: self.name.to_owned(),
            start,
            seed,
            is_right: false,
            is_mirrored: false,
            error_mm: f64::NAN,
            off_deg: f64::NAN,
            verdict: Err(String::new()),
            truth_mm: match (target.sensor(), is_hip) {
                (Some(_), _) => None,
                (None, true) => Some(HIP_TRUTH_MM),
                (None, false) => Some(RANGE_TRUTH_MM),
            },
            cpu_s: 0.0,
        };
        let mut report: Option<GlobalReport> = None;
        let init = match start {
            Start::Shape => match coarse::global(target, &cloud, &GlobalParams::default()) {
                Ok(fit) => {
                    report = Some(fit.report);
                    fit.t_target_source
                }
                Err(error) => return Outcome { verdict: Err(error.to_string()), ..outcome },
            },
            Start::Near { deg, mm } => about(random_motion(&mut rng, deg, mm)) * t_scan_truth.inverse(),
        };
        let observer = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
        let fit = icp::register(Method::PointToPlane, target, &cloud, &init, &IcpParams::default(), observer);
        let fit = match fit {
            Ok(fit) => fit,
            Err(error) => return Outcome { verdict: Err(error.to_string()), ..outcome },
        };
        let off = fit.t_target_source * t_scan_truth;
        let some: Vec<Point3<f64>> = placed.iter().step_by(placed.len() / 20).copied().collect();
        outcome.error_mm = some.iter().map(|p| (off * p - p).norm()).sum::<f64>() / some.len() as f64;
        outcome.off_deg = off.rotation.angle().to_degrees();
        outcome.is_right = match is_hip {
            true => (off * centre - centre).norm() < HIP_RIGHT.0 && outcome.off_deg < HIP_RIGHT.1,
            false => outcome.error_mm < RANGE_RIGHT_MM,
        };
        // The error is predicted at points of the scan, as there is no plan.
        let on_surface = |p: &Point3<f64>| target.points()[target.nearest(&(off * p), f64::INFINITY).unwrap().0];
        let assessment: Vec<NamedPoint> =
            some.iter().enumerate().map(|(k, p)| NamedPoint::new(format!("S{k}"), on_surface(p))).collect();
        let case = Case {
            assessment: &assessment,
            start: report.as_ref(),
            ..Case::new(Registered { target, source: &cloud, t_target_source: &fit.t_target_source, at: &[] })
        };
        let (examine, errors) = (EvidenceParams::default(), PredictParams::default());
        outcome.verdict = Ok(trust::judge(&case, &examine, &RuleParams::default(), &errors));
        outcome.cpu_s = cpu_s() - from_s;
        outcome
    }

    /// The same of the scan's mirror image.
    fn mirrored(&self, start: Start, seed: u64) -> Outcome {
        let centre = centroid(self.placed);
        let image: Vec<Point3<f64>> = self.placed.iter().map(|p| Point3::new(2.0 * centre.x - p.x, p.y, p.z)).collect();
        let outcome = Pair { placed: &image, ..*self }.registered(start, seed);
        Outcome { is_mirrored: true, is_right: false, ..outcome }
    }
}

/// Held by the one test that runs, as the processor time is the process'.
static ALONE: Mutex<()> = Mutex::new(());

/// Processor time of this process, s.
fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

fn is_slow() -> bool {
    std::env::var_os("SLOW_TESTS").is_some()
}

const NEAR: Start = Start::Near { deg: 8.0, mm: 8.0 };

/// Starts of each kind for a pair.
fn seeds(n: u64) -> std::ops::Range<u64> {
    0..if is_slow() { n } else { 1 }
}

/// The hip bones, and their files.
const HIPS: [(&str, &str); 3] = [
    ("left femur of specimen 00", "specimen00_left_femur"),
    ("pelvis of specimen 00", "specimen00_pelvis"),
    ("right femur of specimen 01", "specimen01_right_femur"),
];

/// The half of a hip bone's scan about one of its points, twenty times, with the sensor stated.
fn halves() -> Vec<Outcome> {
    let mut all = Vec::new();
    for (name, file) in HIPS {
        let Some(path) = data("hips", &format!("real/hip/preoperative_{file}.stl")) else { return all };
        let cloud = data("hips", &format!("real/hip/intraoperative_{file}.xyz")).unwrap();
        let target = target_of(&stl(&path, "ct")).for_sensor(Some(SensorKind::Ultrasound.sensor()));
        let placed = xyz(&rows(&cloud, ""), 1.0);
        let name = format!("half of the {name}");
        for seed in seeds(20) {
            let middle = placed[ChaCha8Rng::seed_from_u64(seed).random_range(0..placed.len())];
            let mut half = placed.clone();
            half.sort_by(|a, b| (a - middle).norm().total_cmp(&(b - middle).norm()));
            half.truncate(placed.len() / 2);
            let pair = Pair { name: &name, target: &target, placed: &half, is_hip: true };
            all.push(pair.registered(NEAR, seed));
            all.push(pair.mirrored(NEAR, seed));
        }
    }
    all
}

fn hips() -> Vec<Outcome> {
    let mut all = Vec::new();
    for (name, file) in HIPS {
        let Some(path) = data("hips", &format!("real/hip/preoperative_{file}.stl")) else { return all };
        let cloud = data("hips", &format!("real/hip/intraoperative_{file}.xyz")).unwrap();
        let (target, placed) = (target_of(&stl(&path, "ct")), xyz(&rows(&cloud, ""), 1.0));
        let pair = Pair { name, target: &target, placed: &placed, is_hip: true };
        for seed in seeds(7) {
            all.extend([Start::Shape, NEAR].map(|start| pair.registered(start, seed)));
            all.push(pair.mirrored(Start::Shape, seed));
        }
    }
    all
}

fn ranges() -> Vec<Outcome> {
    let mut all = Vec::new();
    let Some(conf) = data("ranges", "real/range/bun.conf") else { return all };
    let folder = conf.parent().unwrap();
    let (vertices, faces) = ply(&folder.join("bun_zipper.ply"));
    let model = target_of(&Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap());
    let scans = range_scans(&conf);
    for (name, placed) in &scans {
        let pair = Pair { name: &format!("{name} on model"), target: &model, placed, is_hip: false };
        for seed in seeds(5) {
            all.extend([Start::Shape, NEAR].map(|start| pair.registered(start, seed)));
            all.push(pair.mirrored(NEAR, seed));
        }
    }
    for [a, b] in [[0, 1], [1, 0], [1, 2], [2, 1]] {
        let ((name, placed), (other, on)) = (&scans[a], &scans[b]);
        let normals = normals::of_surface(on).unwrap();
        let target = Target::new("ct", SurfaceOrigin::User, on.clone(), Some(normals.into())).unwrap();
        let name = format!("{name} on {other}");
        let pair = Pair { name: &name, target: &target, placed, is_hip: false };
        for seed in seeds(3) {
            all.extend([Start::Shape, NEAR].map(|start| pair.registered(start, seed)));
            all.push(pair.mirrored(NEAR, seed));
        }
    }
    all
}

/// Nine in ten right poses are given, no wrong one is trusted, nor a mirrored one, and the intervals hold.
fn check(table: &str, all: &[Outcome]) {
    all.iter().for_each(|outcome| println!("{}", outcome.line()));
    let n = |is: &dyn Fn(&Outcome) -> bool| all.iter().filter(|outcome| is(outcome)).count();
    let right = n(&|o| o.is_right);
    let given = n(&|o| o.is_right && matches!(o.answer(), Some(Answer::Trusted | Answer::Doubtful)));
    let held = n(&|o| o.is_right && o.is_held());
    println!("{right} right, of these {given} given and {held} within their interval; {} wrong", all.len() - right);
    assert!(10 * given >= 9 * right, "{given} of {right} right poses are given");
    assert!(10 * held >= 9 * right, "{held} of {right} errors are within their interval");
    for outcome in all.iter().filter(|o| !o.is_right) {
        assert_ne!(outcome.answer(), Some(Answer::Trusted), "{}", outcome.line());
    }
    page::compare(table, all);
}

#[test]
fn right_poses_of_hip_bones_are_given_and_wrong_and_mirrored_ones_never_trusted() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let all = hips();
    check("hips", &all);
    // A pelvis is nearly its own mirror image, a femur is not.
    for outcome in all.iter().filter(|o| o.is_mirrored && o.pair.contains("femur")) {
        assert_eq!(outcome.answer(), Some(Answer::Refused), "{}", outcome.line());
    }
}

#[test]
fn errors_of_halves_of_hip_bones_are_below_what_is_predicted_of_a_stated_sensor() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    check("halves", &halves());
}

#[test]
fn right_poses_of_range_scans_are_given_and_wrong_and_mirrored_ones_never_trusted() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let all = ranges();
    check("ranges", &all);
    for outcome in all.iter().filter(|o| o.is_mirrored) {
        assert_eq!(outcome.answer(), Some(Answer::Refused), "{}", outcome.line());
    }
}
