//! Scans of any shape, registered by shape alone: measured ones, and views and crops of bones and of made bodies. With `SLOW_TESTS` all of
//! them from many poses; `OSTEOFLOW_CASES` takes those whose names have one of these words, separated by commas.

use crate::common::{data, stl};
use crate::measured::{centroid, ply, range_scans, rows, xyz};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use osteoflow_algorithms::coarse::{CLEAR, GlobalParams, global};
use osteoflow_algorithms::icp::{self, IcpParams, Method};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::target::Target;
use osteoflow_algorithms::{normals, sample};
use osteoflow_geometry::{Cloud, Mesh, SurfaceOrigin};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, UnitSphere};
use std::f64::consts::{PI, TAU};
use std::ops::ControlFlow;

/// A scan where it belongs, and what a right pose of it is.
pub(crate) struct Case {
    pub(crate) name: String,
    pub(crate) target: Target,
    pub(crate) placed: Vec<Point3<f64>>,
    pub(crate) camera: Option<Point3<f64>>,
    /// The first so many points are of the bone, the others of its surroundings.
    pub(crate) n_bone: usize,
    /// Maximum error at the bone's centroid, mm, and angle, degrees.
    pub(crate) right: (f64, f64),
}

impl Case {
    /// The scan at a random pose, and that pose.
    fn moved(&self, seed: u64) -> (Cloud, Isometry3<f64>) {
        let t = random_pose(&self.placed, seed);
        let cloud = Cloud::new("scan", self.placed.iter().map(|p| t * p).collect::<Vec<_>>()).unwrap();
        let with_camera = |camera: Point3<f64>| cloud.clone().seen_from(Isometry3::from((t * camera).coords));
        (self.camera.map_or_else(|| cloud.clone(), with_camera), t)
    }

    /// Registers the scan from `n` poses.
    pub(crate) fn counted(&self, n: u64) -> Counted {
        let mut counted = Counted { n, ..Counted::default() };
        // Makes what is kept with the surface, which is no part of the time of one scan.
        self.target.prepare();
        let few = Cloud::new("scan", self.placed[..200].to_vec()).unwrap();
        let _ = global(&self.target, &few, &GlobalParams::default());
        for seed in 0..n {
            let (cloud, t_scan_truth) = self.moved(seed);
            let before = cpu_ms();
            let fit = global(&self.target, &cloud, &GlobalParams::default());
            counted.cpu_ms += cpu_ms().zip(before).map_or(f64::NAN, |(after, before)| after - before);
            let (is_right, is_clear, what) = match fit {
                Ok(fit) => {
                    let coarse = fit.t_target_source * t_scan_truth;
                    // What touches a bone draws a registration with all points off it: there the search itself is counted.
                    let is_bone_alone = self.n_bone == self.placed.len();
                    let end = if is_bone_alone {
                        self.registered(&cloud, &fit.t_target_source) * t_scan_truth
                    } else {
                        coarse
                    };
                    let centre = centroid(&self.placed[..self.n_bone]);
                    let (mm, deg) = ((end * centre - centre).norm(), end.rotation.angle().to_degrees());
                    let is_right = mm < self.right.0 && deg < self.right.1;
                    let what = format!(
                        "#{seed} {mm:.1} mm {deg:.0} deg, clearness {:.2}, left {:.3} mm, {:.3} mm at the truth",
                        fit.report.clearness,
                        left_mm(&self.target, &self.placed, &coarse),
                        left_mm(&self.target, &self.placed, &Isometry3::identity())
                    );
                    (is_right, fit.report.clearness >= CLEAR, what)
                }
                Err(error) => (false, false, error.to_string()),
            };
            counted.right += u64::from(is_right);
            counted.clear += u64::from(is_right && is_clear);
            counted.wrong_and_clear += u64::from(!is_right && is_clear);
            counted.wrong.extend((!is_right).then_some(what));
        }
        counted.print(self);
        counted
    }

    fn registered(&self, cloud: &Cloud, start: &Isometry3<f64>) -> Isometry3<f64> {
        let go_on = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
        let fit = icp::register(Method::PointToPlane, &self.target, cloud, start, &IcpParams::default(), go_on);
        fit.map_or(*start, |fit| fit.t_target_source)
    }
}

/// RMS distance of a scan from the surface, moved from where it belongs, with distances limited to 2 mm.
pub(crate) fn left_mm(target: &Target, placed: &[Point3<f64>], by: &Isometry3<f64>) -> f64 {
    let normals = target.normals().unwrap();
    let squares = placed.iter().map(|p| {
        let moved = by * p;
        let near = target.nearest(&moved, 2.0);
        near.map_or(2.0, |(k, _)| (moved - target.points()[k]).dot(&normals[k]).abs()).powi(2)
    });
    (squares.sum::<f64>() / placed.len() as f64).sqrt()
}

/// A pose of points about their centroid: turned by up to 180 degrees and shifted by up to 500 mm along each axis.
pub(crate) fn random_pose(points: &[Point3<f64>], seed: u64) -> Isometry3<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(1000 + seed);
    let centre = centroid(points).coords;
    let axis: [f64; 3] = UnitSphere.sample(&mut rng);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(axis) * rng.random_range(0.0..PI));
    let shift = Vector3::from_fn(|_, _| rng.random_range(-500.0..500.0));
    Translation3::from(centre + shift) * turn * Translation3::from(-centre)
}

/// What became of a scan.
#[derive(Default)]
pub(crate) struct Counted {
    pub(crate) n: u64,
    pub(crate) right: u64,
    /// Of the right ones.
    clear: u64,
    pub(crate) wrong_and_clear: u64,
    wrong: Vec<String>,
    cpu_ms: f64,
}

impl Counted {
    pub(crate) const HEAD: &'static str = "| scan | points | n | right | of these clear | wrong and clear | CPU, ms | wrong |\n\
                                | --- | --- | --- | --- | --- | --- | --- | --- |";

    fn print(&self, case: &Case) {
        let Self { n, right, clear, wrong_and_clear, wrong, cpu_ms } = self;
        println!(
            "| {} | {} | {n} | {right} | {clear} | {wrong_and_clear} | {:.0} | {} |",
            case.name,
            case.placed.len(),
            cpu_ms / *n as f64,
            wrong.join("; ")
        );
    }
}

/// CPU time of this thread so far, ms; none where the system does not count it.
pub(crate) fn cpu_ms() -> Option<f64> {
    let counted = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(counted.split(' ').next()?.parse::<f64>().ok()? / 1e6)
}

/// RMS distance of points from their centroid, mm.
pub(crate) fn radius_mm(points: &[Point3<f64>]) -> f64 {
    let middle = centroid(points);
    (points.iter().map(|p| (p - middle).norm_squared()).sum::<f64>() / points.len() as f64).sqrt()
}

pub(crate) fn target_of(mesh: &Mesh) -> Target {
    let samples = sample::surface(mesh, 150_000, &mut ChaCha8Rng::seed_from_u64(1));
    Target::new("ct", SurfaceOrigin::User, samples.points, Some(samples.normals.into())).unwrap()
}

/// What a camera at 600 mm sees of a mesh within a ball, with depth noise, and where the camera is.
pub(crate) struct View<'a> {
    pub(crate) mesh: &'a Mesh,
    pub(crate) query: &'a MeshQuery,
    pub(crate) way: Vector3<f64>,
    pub(crate) ball: Option<(Point3<f64>, f64)>,
    pub(crate) noise_mm: f64,
}

impl View<'_> {
    pub(crate) fn seen(&self, seed: u64) -> (Vec<Point3<f64>>, Point3<f64>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let samples = sample::surface(self.mesh, 300_000, &mut rng);
        let middle = self.ball.map_or_else(|| centroid(&samples.points), |(centre, _)| centre);
        let camera = middle + self.way.normalize() * 600.0;
        let depth = Normal::new(0.0, self.noise_mm).unwrap();
        let is_within = |p: &Point3<f64>| self.ball.is_none_or(|(centre, radius)| (p - centre).norm() <= radius);
        let mut seen = Vec::new();
        for (p, normal) in samples.points.iter().zip(&samples.normals).filter(|(p, _)| is_within(p)) {
            let to = (camera - p).normalize();
            if normal.dot(&to) > 0.25 && self.query.cast_ray(&(p + (to + normal) * 0.05), &to).is_none() {
                seen.push(p + to * depth.sample(&mut rng));
            }
        }
        let step = (seen.len() / 20_000).max(1);
        (seen.into_iter().step_by(step).collect(), camera)
    }
}

/// A closed body about the origin with seeded bumps: `power` 2 is an ellipsoid, more a box.
pub(crate) fn body(seed: u64, radii_mm: [f64; 3], bumps_mm: f64, power: f64) -> Mesh {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut wave = || {
        let way: [f64; 3] = UnitSphere.sample(&mut rng);
        let k: f64 = rng.random_range(2.0..9.0);
        (Vector3::from(way) * k, rng.random_range(0.0..TAU), bumps_mm / k.sqrt() * rng.random_range(0.3..1.0))
    };
    let waves: Vec<(Vector3<f64>, f64, f64)> = (0..24).map(|_| wave()).collect();
    let at = |way: Vector3<f64>| {
        let sum: f64 = (0..3).map(|k| (way[k].abs() / radii_mm[k]).powf(power)).sum();
        let bump: f64 = waves.iter().map(|(wave, phase, mm)| mm * (wave.dot(&way) + phase).sin()).sum();
        Point3::from(way * (sum.powf(-1.0 / power) + bump))
    };
    let (rings, around) = (120_u32, 240_u32);
    let mut vertices = vec![at(Vector3::z()), at(-Vector3::z())];
    for (i, j) in (1..rings).flat_map(|i| (0..around).map(move |j| (i, j))) {
        let (tilt, turn) = (f64::from(i) / f64::from(rings) * PI, f64::from(j) / f64::from(around) * TAU);
        vertices.push(at(Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos())));
    }
    let index = |i: u32, j: u32| 2 + (i - 1) * around + j % around;
    let mut faces = Vec::new();
    for j in 0..around {
        faces.push([0, index(1, j), index(1, j + 1)]);
        faces.push([1, index(rings - 1, j + 1), index(rings - 1, j)]);
        for i in 1..rings - 1 {
            faces.push([index(i, j), index(i + 1, j), index(i + 1, j + 1)]);
            faces.push([index(i, j), index(i + 1, j + 1), index(i, j + 1)]);
        }
    }
    Mesh::new("ct", SurfaceOrigin::Exact, vertices, faces).unwrap()
}

pub(crate) const HIPS: [&str; 3] = ["specimen00_left_femur", "specimen00_pelvis", "specimen01_right_femur"];

/// Hip bones from CT and their tracked ultrasound.
fn hips(test: &str) -> Vec<Case> {
    let case = |name: &str| {
        let mesh = stl(&data(test, &format!("real/hip/preoperative_{name}.stl"))?, "ct");
        let placed = xyz(&rows(&data(test, &format!("real/hip/intraoperative_{name}.xyz"))?, ""), 1.0);
        Some(Case {
            name: name.into(),
            target: target_of(&mesh),
            n_bone: placed.len(),
            placed,
            camera: None,
            right: (4.0, 5.0),
        })
    };
    HIPS.into_iter().filter_map(case).collect()
}

/// Range scans of a bunny on its model and on each other.
fn ranges(test: &str) -> Vec<Case> {
    let Some(conf) = data(test, "real/range/bun.conf") else { return Vec::new() };
    let folder = conf.parent().unwrap();
    let scans = range_scans(&conf);
    let (vertices, faces) = ply(&folder.join("bun_zipper.ply"));
    let model = target_of(&Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap());
    let mut all = Vec::new();
    let mut add = |name: String, target: &Target, placed: &[Point3<f64>], right| {
        all.push(Case {
            name,
            target: target.clone(),
            n_bone: placed.len(),
            placed: placed.to_vec(),
            camera: None,
            right,
        });
    };
    for (name, placed) in &scans {
        add(format!("{name} on the model"), &model, placed, (1.5, 2.0));
    }
    for [a, b] in [[0, 1], [1, 0], [1, 2], [2, 1], [0, 2]] {
        let ((name, placed), (other, on)) = (&scans[a], &scans[b]);
        let normals = normals::of_surface(on).unwrap();
        let target = Target::new("ct", SurfaceOrigin::User, on.clone(), Some(normals.into())).unwrap();
        // These overlap in part.
        add(format!("{name} on {other}"), &target, placed, (2.0, 2.5));
    }
    all
}

/// Whole views, and views of balls of three sizes, of a surface, every other one with a known camera.
fn views(name: &str, mesh: &Mesh) -> Vec<Case> {
    let (target, query) = (target_of(mesh), MeshQuery::new(mesh));
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let size_mm = radius_mm(target.points());
    let mut all = Vec::new();
    for (share, k) in [f64::INFINITY, 0.8, 0.5, 0.3].into_iter().flat_map(|share| [(share, 0), (share, 1)]) {
        let way: [f64; 3] = UnitSphere.sample(&mut rng);
        let at = rng.random_range(0..target.points().len());
        let ball = share.is_finite().then(|| (target.points()[at], share * size_mm));
        // Of a part, what is there is seen from outside.
        let outward = ball.map_or_else(Vector3::zeros, |_| target.normals().unwrap()[at] * 2.5);
        let view = View { mesh, query: &query, way: Vector3::from(way) + outward, ball, noise_mm: 0.002 * size_mm };
        let (placed, camera) = view.seen(k);
        let part = if ball.is_some() { format!("{share} of its size") } else { "whole".into() };
        let name = format!("{name}, {part}, {k}");
        let camera = (k == 0).then_some(camera);
        if placed.len() >= 300 {
            all.push(Case {
                name,
                target: target.clone(),
                n_bone: placed.len(),
                placed,
                camera,
                right: (0.02 * size_mm, 3.0),
            });
        }
    }
    all
}

/// Made bodies: of a skull's, a vertebra's and a mouse skull's size, and with large bumps.
fn bodies() -> Vec<(&'static str, Mesh)> {
    vec![
        ("skull", body(1, [70.0, 90.0, 65.0], 2.0, 2.0)),
        ("block", body(2, [30.0, 40.0, 20.0], 0.8, 4.0)),
        ("mouse", body(3, [6.0, 11.0, 5.0], 0.3, 2.3)),
        ("potato", body(4, [40.0, 55.0, 35.0], 4.0, 2.0)),
    ]
}

pub(crate) fn is_slow() -> bool {
    std::env::var_os("SLOW_TESTS").is_some()
}

/// Registers all cases that are wanted, on one thread so that CPU times are those of the calls: 97 of 100 are right, and no wrong one is
/// clear.
fn check(cases: &[Case], n: u64) {
    let words = std::env::var("OSTEOFLOW_CASES").unwrap_or_default();
    let is_wanted = |case: &&Case| words.split(',').any(|word| case.name.contains(word));
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    println!("{}", Counted::HEAD);
    let counted: Vec<Counted> =
        one_thread.install(|| cases.iter().filter(is_wanted).map(|case| case.counted(n)).collect());
    let sum = |of: fn(&Counted) -> u64| counted.iter().map(of).sum::<u64>();
    let (n, right) = (sum(|c| c.n), sum(|c| c.right));
    println!("{right} of {n} right, {} of these clear", sum(|c| c.clear));
    assert!(100 * right >= 97 * n, "{right} of {n} are right");
    assert_eq!(sum(|c| c.wrong_and_clear), 0, "wrong and clear");
}

#[test]
fn hip_bones_and_range_scans_are_found_from_any_pose() {
    let test = "hip_bones_and_range_scans_are_found_from_any_pose";
    let cases: Vec<Case> = hips(test).into_iter().chain(ranges(test)).collect();
    check(&cases, if is_slow() { 25 } else { 1 });
}

#[test]
fn views_and_crops_of_any_shape_are_found_from_any_pose() {
    let test = "views_and_crops_of_any_shape_are_found_from_any_pose";
    let mut meshes = bodies();
    if is_slow() {
        let names = HIPS.map(|name| (name, format!("real/hip/preoperative_{name}.stl")));
        let bones =
            ["TLEM2_CT_fibula_r", "MC22_fibula_r", "myosim_jaw"].map(|name| (name, format!("bones/{name}.stl")));
        let all = names.into_iter().chain(bones);
        meshes.extend(all.filter_map(|(name, file)| Some((name, stl(&data(test, &file)?, "ct")))));
    } else {
        meshes.truncate(2);
    }
    let cases: Vec<Case> = meshes.iter().flat_map(|(name, mesh)| views(name, mesh)).collect();
    check(&cases, if is_slow() { 3 } else { 1 });
}
