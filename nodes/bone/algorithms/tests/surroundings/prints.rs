//! Measured scans of printed parts, put back on the table that they were cut from, beside other parts, and cropped by boxes of three sizes.

use crate::common::{data, stl};
use crate::compact::{cpu_ms, is_slow, random_pose};
use crate::measured::{rows, xyz};
use crate::real::target_of;
use nalgebra::{Isometry3, Matrix4, Point3, UnitQuaternion, Vector3};
use osteoflow_algorithms::coarse::{GlobalParams, global};
use osteoflow_algorithms::icp::{self, IcpParams, Method};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::tables::off_tables;
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::trust::{Answer, Case, Convergence, Registered, judge};
use osteoflow_geometry::{Cloud, isometry_from_matrix};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::{f64::consts::TAU, ops::ControlFlow};

/// Limit of the data's authors, RMS over the corners of the part, mm.
pub(crate) const RIGHT_MM: f64 = 10.0;

/// Angle between two pixels: a millimetre at the scans' distance.
const PIXEL: f64 = 1.0 / 230.0;

/// Least number that are right in boxes of each size.
const LEAST: [usize; 3] = [10, 17, 15];

const PARTS: [&str; 3] = ["Guitar", "Pendulum", "Square-Peg"];

/// A printed part, and its scans in their camera's frame.
pub(crate) struct Part {
    pub(crate) name: &'static str,
    pub(crate) target: Target,
    query: MeshQuery,
    /// Half the lengths of the box, and its middle.
    half: Vector3<f64>,
    middle: Point3<f64>,
    pub(crate) scans: Vec<Scan>,
}

pub(crate) struct Scan {
    pub(crate) points: Vec<Point3<f64>>,
    /// Part to scan, all that are right.
    pub(crate) truths: Vec<Isometry3<f64>>,
}

pub(crate) fn parts(test: &str) -> Vec<Part> {
    let scan = |name: &str, k: usize| {
        let points = xyz(&rows(&data(test, &format!("real/prints/{name}_{k}.xyz"))?, ""), 1.0);
        let json = std::fs::read_to_string(data(test, &format!("real/prints/{name}_{k}.json"))?).unwrap();
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        let number = |pose: &serde_json::Value, i: usize, j: usize| pose[i][j].as_f64().unwrap();
        let pose =
            |pose: &serde_json::Value| isometry_from_matrix(&Matrix4::from_fn(|i, j| number(pose, i, j))).unwrap();
        Some(Scan { points, truths: json["t_scan_part_mm"].as_array().unwrap().iter().map(pose).collect() })
    };
    let part = |name: &'static str| {
        let mesh = stl(&data(test, &format!("real/prints/{name}.stl"))?, "ct");
        let first = mesh.vertices()[0];
        let (low, high) = mesh.vertices().iter().fold((first, first), |(low, high), v| (low.inf(v), high.sup(v)));
        let scans = (1..=3).map_while(|k| scan(name, k)).collect();
        let (half, middle) = ((high - low) / 2.0, nalgebra::center(&low, &high));
        Some(Part { name, target: target_of(&mesh), query: MeshQuery::new(&mesh), half, middle, scans })
    };
    PARTS.into_iter().map_while(part).collect()
}

impl Part {
    fn corners(&self, scale: f64) -> impl Iterator<Item = Point3<f64>> {
        (0..8).map(move |k| {
            let sign = |axis: usize| if k >> axis & 1 == 0 { -scale } else { scale };
            self.middle + self.half.component_mul(&Vector3::from_fn(|axis, _| sign(axis)))
        })
    }

    /// RMS error over the corners, mm, of the nearest right pose.
    pub(crate) fn off_mm(&self, truths: &[Isometry3<f64>], t_part_scan: &Isometry3<f64>) -> f64 {
        let of = |truth: &Isometry3<f64>| {
            let off = t_part_scan * truth;
            (self.corners(1.0).map(|c| (off * c - c).norm_squared()).sum::<f64>() / 8.0).sqrt()
        };
        truths.iter().map(of).fold(f64::MAX, f64::min)
    }

    /// Directions from the part's middle up from the table that it may lie on, in the scan's frame: a flat part lies on its widest side.
    fn up(&self, scan: &Scan, rng: &mut ChaCha8Rng) -> (Vector3<f64>, f64) {
        let truth = &scan.truths[0];
        let camera = truth.inverse() * Point3::origin() - self.middle;
        let flat = self.half.imin();
        let is_flat = self.half[flat] < 0.4 * (self.half.sum() - self.half[flat] - self.half.max());
        let may = |k: &usize| if is_flat { *k == flat } else { camera[*k].abs() > 100.0 };
        let axes: Vec<usize> = (0..3).filter(may).collect();
        let axis = axes[rng.random_range(0..axes.len())];
        (truth * (Vector3::ith(axis, 1.0) * camera[axis].signum()), self.half[axis])
    }
}

/// A depth camera's error over its image, mm: waves of some pixels and more, and noise of single pixels.
struct Depth {
    waves: Vec<(f64, f64, f64)>,
    bias_mm: f64,
    pixel: Normal<f64>,
}

impl Depth {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let mut wave = || {
            let (way, length) = (rng.random_range(0.0..TAU), rng.random_range(8.0..60.0));
            (way.cos() * TAU / length, way.sin() * TAU / length, rng.random_range(0.0..TAU))
        };
        let waves = (0..24).map(|_| wave()).collect();
        Self { waves, bias_mm: rng.random_range(-0.7..0.7), pixel: Normal::new(0.0, 0.3).unwrap() }
    }

    fn error_mm(&self, i: i32, j: i32, rng: &mut ChaCha8Rng) -> f64 {
        let sum: f64 = self.waves.iter().map(|(x, y, at)| (x * f64::from(i) + y * f64::from(j) + at).sin()).sum();
        // Of 24 sines the standard deviation is 3.5.
        self.bias_mm + 0.2 * sum + self.pixel.sample(rng)
    }
}

/// A scan among what is around the part, in a box of so many times its size, at a random pose; and where it belongs.
pub(crate) fn scene(
    parts: &[Part],
    part: usize,
    scan: usize,
    size: f64,
    seed: u64,
) -> (Vec<Point3<f64>>, Vec<Isometry3<f64>>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed * 97 + 10 * part as u64 + scan as u64);
    let (own, of) = (&parts[part], &parts[part].scans[scan]);
    let truth = of.truths[0];
    let (up, height) = own.up(of, &mut rng);
    let foot = truth * own.middle - up * height;
    // Beside it up to three other scans, turned by up to 40 degrees about the table's normal so that the camera sees what was seen.
    let (mut beside, mut solids) = (Vec::new(), vec![(part, truth)]);
    let n_beside = rng.random_range(0..4);
    for _ in 0..n_beside {
        let (p, s) = (rng.random_range(0..parts.len()), rng.random_range(0..3));
        let (other, seen) = (&parts[p], &parts[p].scans[s]);
        let (other_up, other_height) = other.up(seen, &mut rng);
        let turn = UnitQuaternion::rotation_between(&other_up, &up).unwrap_or_default();
        let turn = UnitQuaternion::from_scaled_axis(up * rng.random_range(-0.7..0.7)) * turn;
        let their = seen.truths[0];
        let centre = turn * (their * other.middle);
        // Out from the part until the boxes are apart.
        let (x, angle) = ((truth * Vector3::ith(own.half.imax(), 1.0)).normalize(), rng.random_range(0.0..TAU));
        let way = (x - up * up.dot(&x)).normalize();
        let way = UnitQuaternion::from_scaled_axis(up * angle) * way;
        let width = |part: &Part, pose: &dyn Fn(Vector3<f64>) -> Vector3<f64>, along: &Vector3<f64>| -> f64 {
            (0..3).map(|k| pose(Vector3::ith(k, part.half[k])).dot(along).abs()).sum()
        };
        // Boxes are apart as soon as one direction parts them.
        let (a, b) = (|v: Vector3<f64>| truth * v, |v: Vector3<f64>| turn * (their * v));
        let axes: Vec<Vector3<f64>> = (0..3).flat_map(|k| [a(Vector3::ith(k, 1.0)), b(Vector3::ith(k, 1.0))]).collect();
        let needed = |axis: &Vector3<f64>| {
            let along = way.dot(axis).abs();
            if along < 0.05 { f64::MAX } else { (width(own, &a, axis) + width(other, &b, axis)) / along }
        };
        let gap = rng.random_range(2.0..25.0);
        let distance = axes.iter().map(needed).fold(f64::MAX, f64::min) + gap;
        let to = foot + up * other_height + way * distance;
        let shift = to - centre;
        let motion = Isometry3::from_parts(shift.into(), turn);
        solids.push((p, motion * their));
        beside.extend(seen.points.iter().map(|p| motion * p));
    }
    let into = truth.inverse();
    let crop = |p: &Point3<f64>| {
        let local = into * p - own.middle;
        (0..3).all(|k| local[k].abs() <= size * own.half[k])
    };
    let pixel = |p: &Point3<f64>| ((p.x / p.z / PIXEL).round() as i32, (p.y / p.z / PIXEL).round() as i32);
    let mut points: Vec<Point3<f64>> = of.points.iter().chain(&beside).copied().filter(|p| crop(p)).collect();
    let depth = Depth::new(&mut rng);
    let corners: Vec<(i32, i32)> = own.corners(2.0).map(|c| pixel(&(truth * c))).collect();
    let range = |of: fn(&(i32, i32)) -> i32| {
        let all = || corners.iter().map(of);
        all().min().unwrap().max(-160)..=all().max().unwrap().min(160)
    };
    for (i, j) in range(|c| c.0).flat_map(|i| range(|c| c.1).map(move |j| (i, j))) {
        let ray = -Vector3::new(f64::from(i) * PIXEL, f64::from(j) * PIXEL, 1.0);
        let length = foot.coords.dot(&up) / ray.dot(&up);
        let at = Point3::from(ray * (length + depth.error_mm(i, j, &mut rng) / ray.norm()));
        let is_hidden = |(p, pose): &(usize, Isometry3<f64>)| {
            let into = pose.inverse();
            parts[*p].query.cast_ray(&(into * Point3::origin()), &(into * ray)).is_some()
        };
        if length > 0.0 && crop(&at) && !solids.iter().any(is_hidden) {
            points.push(at);
        }
    }
    // As a camera writes them, row by row.
    points.sort_by_key(pixel);
    let pose = random_pose(&points, seed);
    (points.iter().map(|p| pose * p).collect(), of.truths.iter().map(|truth| pose * truth).collect())
}

/// Whether the registration after the search is right, the verdict, and the CPU time of the search, ms.
fn outcome(parts: &[Part], part: usize, scan: usize, size: f64, seed: u64) -> (bool, Answer, f64) {
    let (points, truths) = scene(parts, part, scan, size, seed);
    let (own, cloud) = (&parts[part], Cloud::new("scan", points).unwrap());
    let about = format!("{}_{}, {size}, {seed}, {} points", own.name, scan + 1, cloud.len());
    let from_ms = cpu_ms();
    let fit = global(&own.target, &cloud, &GlobalParams::default()).unwrap();
    let search_ms = cpu_ms().zip(from_ms).map_or(f64::NAN, |(after, before)| after - before);
    // As the node does.
    let rest = off_tables(&own.target, &cloud);
    let source = rest.as_ref().unwrap_or(&cloud);
    let (params, go_on) = (IcpParams::default(), &mut |_: &icp::IcpStep| ControlFlow::Continue(()));
    let end = icp::register(Method::PointToPlane, &own.target, source, &fit.t_target_source, &params, go_on).unwrap();
    let ended = Convergence::from(&end.report);
    let registered = Registered { target: &own.target, source: &cloud, t_target_source: &end.t_target_source, at: &[] };
    let case = Case { icp: Some(&ended), start: Some(&fit.report), ..Case::new(registered) };
    let verdict = judge(&case, &Default::default(), &Default::default(), &Default::default());
    let [found_mm, mm] = [&fit.t_target_source, &end.t_target_source].map(|t| own.off_mm(&truths, t));
    let rules: Vec<&str> = verdict.reasons.iter().map(|reason| &*reason.rule).collect();
    println!(
        "{about}, {} left out: search {found_mm:.1} mm, {search_ms:.0} ms; end {mm:.1} mm, {:?} by {rules:?}",
        cloud.len() - source.len(),
        verdict.answer
    );
    (mm < RIGHT_MM, verdict.answer, search_ms)
}

/// Registers scans on their table: with `SLOW_TESTS` all with the seeds that played no part in any choice, else two.
#[test]
fn parts_on_a_table_are_found_and_never_wrong_and_trusted() {
    let parts = parts("parts_on_a_table_are_found_and_never_wrong_and_trusted");
    if parts.len() < PARTS.len() {
        return;
    }
    // CPU times are those of the calls.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let seeds = if is_slow() { 1..3 } else { 0..1 };
    // Size of the box, least number that are right of 18.
    for (size, least) in [(1.0, LEAST[0]), (1.2, LEAST[1]), (1.4, LEAST[2])] {
        let all = seeds.clone().flat_map(|seed| (0..9).map(move |k| (k / 3, k % 3, seed)));
        let is_wanted = |(part, scan, _): &(usize, usize, u64)| is_slow() || (size > 1.1 && (*part, *scan) == (1, 1));
        let outcomes: Vec<(bool, Answer, f64)> = one_thread
            .install(|| all.filter(is_wanted).map(|(p, s, seed)| outcome(&parts, p, s, size, seed)).collect());
        let n = |right: bool, answer: Answer| outcomes.iter().filter(|o| o.0 == right && o.1 == answer).count();
        let counts =
            [true, false].map(|right| [Answer::Trusted, Answer::Doubtful, Answer::Refused].map(|a| n(right, a)));
        let n_right: usize = counts[0].iter().sum();
        println!(
            "| {size} | {} | {n_right} | {counts:?} (right and wrong: trusted, doubtful, refused)",
            outcomes.len()
        );
        assert_eq!(counts[1][0], 0, "wrong and trusted in boxes of {size}");
        let least = if is_slow() { least } else { outcomes.len() };
        assert!(n_right >= least, "{n_right} of {} are right in boxes of {size}", outcomes.len());
    }
}
