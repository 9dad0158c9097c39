//! Scans of bones among what else a camera sees, registered by shape alone without cropping. With `SLOW_TESTS` all of them;
//! `OSTEOFLOW_CASES` takes the bones whose names have one of these words, separated by commas.

pub(crate) mod hips;
pub(crate) mod prints;

use crate::common::{data, stl};
use crate::compact::{Case, Counted, View, body, is_slow, radius_mm, target_of};
use crate::measured::centroid;
use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_algorithms::sample;
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::Mesh;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, UnitSphere};
use std::f64::consts::{PI, TAU};

/// What lies around the bone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Around {
    /// A plane behind the bone.
    Table,
    /// Two flaps along the bone, with a gap between them.
    Skin,
    /// A side of another bone beside it.
    Bone,
    /// A tube and a ball.
    Tube,
    /// A wavy sheet with a hole, through which the bone is seen.
    Drape,
    /// Two bent strips of metal that touch the bone's edges.
    Retractors,
    /// Four fingers across the bone's end, touching it.
    Hand,
    /// A block and two jaws that hold the bone.
    Vice,
}

/// Those that the search was made with, and the others.
const SEEN: [Around; 4] = [Around::Table, Around::Skin, Around::Bone, Around::Tube];
const HELD_OUT: [Around; 4] = [Around::Drape, Around::Retractors, Around::Hand, Around::Vice];

/// A scan's middle and directions: along it, across it and towards the camera; half its length and its width, mm.
pub(crate) struct Frame {
    middle: Point3<f64>,
    axes: Matrix3<f64>,
    half: [f64; 2],
}

impl Frame {
    fn new(points: &[Point3<f64>], towards: &Vector3<f64>) -> Self {
        let middle = centroid(points);
        let scatter: Matrix3<f64> = points.iter().map(|p| (p - middle) * (p - middle).transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        let longest = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let w = towards.normalize();
        let u = (longest - w * w.dot(&longest)).normalize();
        let axes = Matrix3::from_columns(&[u, w.cross(&u), w]);
        let half = [0, 1].map(|k| points.iter().map(|p| (p - middle).dot(&axes.column(k)).abs()).fold(0.0, f64::max));
        Self { middle, axes, half }
    }

    fn at(&self, u: f64, v: f64, w: f64) -> Point3<f64> {
        self.middle + self.axes * Vector3::new(u, v, w)
    }
}

/// `n` points of what lies around a scan.
fn around(kind: Around, frame: &Frame, other: &Mesh, n: usize, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let [length, width] = frame.half;
    let [a, b, c, d] = [(); 4].map(|()| rng.random::<f64>());
    let waves: Vec<[f64; 4]> = (0..5).map(|_| [(); 4].map(|()| rng.random())).collect();
    let size = length.max(width);
    let beside_bone = (kind == Around::Bone).then(|| {
        let samples = sample::surface(other, 60_000, rng);
        let middle = centroid(&samples.points);
        let way = Vector3::from(UnitSphere.sample(rng));
        let side: Vec<Point3<f64>> =
            samples.points.iter().zip(&samples.normals).filter(|(_, n)| n.dot(&way) > 0.2).map(|(p, _)| *p).collect();
        let own = Frame::new(&side, &way);
        (side, middle, own)
    });
    let mut one = || -> Point3<f64> {
        let [u, v, w] = [(); 3].map(|()| rng.random::<f64>());
        match kind {
            Around::Table => {
                let (x, y) = ((u - 0.4) * 2.4 * size, (v - 0.5) * 2.2 * size);
                frame.at(x, y, -30.0 - 50.0 * a + 0.3 * ((b - 0.5) * x + (c - 0.5) * y))
            }
            Around::Skin => {
                let side = if w < 0.5 { -1.0 } else { 1.0 };
                let beside = width * (0.9 + 0.3 * a) + 40.0 * v;
                frame.at(
                    (2.2 * u - 1.1) * length,
                    side * beside,
                    2.0 + 6.0 * b - 0.01 * (beside - width).powi(2) + 8.0 * (c - 0.5) * u,
                )
            }
            Around::Bone => {
                let (side, middle, own) = beside_bone.as_ref().unwrap();
                let p = side[(u * side.len() as f64) as usize % side.len()] - middle;
                let local = own.axes.transpose() * p;
                let turn = 0.6 * (a - 0.5);
                let (x, y) = (local.x * turn.cos() - local.y * turn.sin(), local.x * turn.sin() + local.y * turn.cos());
                frame.at(x + (b - 0.5) * length, y + width + own.half[1] + 5.0 + 15.0 * c, local.z - 10.0 * d)
            }
            Around::Tube => {
                let (sin, cos) = (PI * v).sin_cos();
                if w < 0.5 {
                    let radius = 5.0 + 8.0 * a;
                    frame.at((2.4 * u - 1.2) * length, width + radius + 8.0 + 10.0 * b + radius * cos, radius * sin)
                } else {
                    let radius = 12.0 + 15.0 * c;
                    let tilt = (2.0 * u - 1.0).acos();
                    let way = Vector3::new(tilt.sin() * cos, tilt.cos(), tilt.sin() * sin) * radius;
                    frame.at(way.x + (d - 0.5) * length, way.y - width - radius - 6.0, way.z)
                }
            }
            Around::Drape => {
                let mut at = [(2.0 * u - 1.0) * 1.6 * size, (2.0 * v - 1.0) * 1.6 * size];
                // The hole.
                while (at[0] / (1.1 * length)).powi(2) + (at[1] / (1.3 * width + 4.0)).powi(2) < 1.0 {
                    at = [
                        (2.0 * rng.random::<f64>() - 1.0) * 1.6 * size,
                        (2.0 * rng.random::<f64>() - 1.0) * 1.6 * size,
                    ];
                }
                let height: f64 = waves
                    .iter()
                    .map(|[p, q, r, s]| {
                        (4.0 + 4.0 * p) * ((at[0] * (q - 0.5) + at[1] * (r - 0.5)) / (6.0 + 20.0 * s) + TAU * s).sin()
                    })
                    .sum();
                frame.at(at[0], at[1], 6.0 - 12.0 * a + height)
            }
            Around::Retractors => {
                let side = if w < 0.5 { -1.0 } else { 1.0 };
                // A blade down beside the bone, and its handle outwards.
                let (x, s) = ((u - 0.5) * (12.0 + 10.0 * a) + side * (b - 0.5) * length, 90.0 * v);
                let (y, z) = if s < 25.0 {
                    (1.0 + 2.0 * c, s - 18.0)
                } else {
                    (1.0 + 2.0 * c + (s - 25.0), 7.0 + 0.2 * (s - 25.0) * d)
                };
                frame.at(x, side * (width + y), z)
            }
            Around::Hand => {
                let finger = (4.0 * w).floor();
                let (turn, radius) = (PI * u, 6.0 + 2.0 * a);
                let along = (0.4 + 0.3 * b) * length + (2.1 * radius) * (finger - 1.5);
                let y = (v - 0.5) * (50.0 + 2.0 * width) + 10.0 * (c - 0.5);
                frame.at(along + radius * turn.cos() + 0.1 * y, y, 4.0 + radius * turn.sin() - 0.004 * y * y)
            }
            Around::Vice => {
                let (x, jaw) = ((u - 0.5) * 0.6 * length + (a - 0.5) * length, 30.0 + 30.0 * b);
                match (3.0 * w) as u32 {
                    0 => frame.at(x, (2.0 * v - 1.0) * (width + jaw), -12.0 - 10.0 * c),
                    1 => frame.at(x, width + 1.0 + jaw * v, 3.0 * d),
                    _ => frame.at(x, -width - 1.0 - jaw * v, 3.0 * d),
                }
            }
        }
    };
    (0..n).map(|_| one()).collect()
}

/// A bone, and the other one that lies beside it where a second bone is seen.
struct Scene {
    name: &'static str,
    mesh: Mesh,
    query: MeshQuery,
    other: Mesh,
    /// Radii of the balls that are seen, as shares of the bone's.
    shares: [f64; 2],
}

impl Scene {
    /// A view of a part of the bone with this share of points around it; every other one with a known camera.
    fn case(&self, target: &Target, kind: Around, share: f64, seed: u64) -> Case {
        let mut rng = ChaCha8Rng::seed_from_u64(seed * 31 + 5);
        let size_mm = radius_mm(target.points());
        let (placed, camera, towards) = loop {
            let at = rng.random_range(0..target.points().len());
            let radius = rng.random_range(self.shares[0]..self.shares[1]) * size_mm;
            let way = Vector3::from(UnitSphere.sample(&mut rng)) + target.normals().unwrap()[at] * 2.0;
            let ball = Some((target.points()[at], radius));
            let (placed, camera) = View { mesh: &self.mesh, query: &self.query, way, ball, noise_mm: 0.1 }.seen(seed);
            if placed.len() > 1000 {
                break (placed, camera, way);
            }
        };
        let step = placed.len().div_ceil(8000);
        let mut placed: Vec<Point3<f64>> = placed.into_iter().step_by(step).collect();
        let n_bone = placed.len();
        let frame = Frame::new(&placed, &towards);
        let n = (share / (1.0 - share) * n_bone as f64) as usize;
        let noise = Normal::new(0.0, 0.1).unwrap();
        for p in around(kind, &frame, &self.other, n, &mut rng) {
            placed.push(p + Vector3::from_fn(|_, _| noise.sample(&mut rng)));
        }
        let name = format!("{}, {kind:?}, {share}, {seed}", self.name);
        let camera = seed.is_multiple_of(2).then_some(camera);
        Case { name, target: target.clone(), n_bone, placed, camera, right: (2.0, 3.0) }
    }
}

fn scenes(test: &str) -> Vec<Scene> {
    let file = |name: &str| Some(stl(&data(test, name)?, "ct"));
    let bones = [
        ("TLEM2", "bones/TLEM2_CT_fibula_r.stl", [0.3, 0.7]),
        ("MC22", "bones/MC22_fibula_r.stl", [0.3, 0.7]),
        ("myosim", "bones/myosim_fibula_r.stl", [0.3, 0.7]),
        ("jaw", "bones/myosim_jaw.stl", [0.6, 1.0]),
        ("femur", "real/hip/preoperative_specimen00_left_femur.stl", [0.5, 1.0]),
        ("pelvis", "real/hip/preoperative_specimen00_pelvis.stl", [0.5, 1.0]),
    ];
    let meshes: Vec<_> =
        bones.into_iter().filter_map(|(name, path, shares)| Some((name, file(path)?, shares))).collect();
    let mut scenes: Vec<Scene> = Vec::new();
    for (k, (name, mesh, shares)) in meshes.iter().enumerate() {
        let other = meshes[(k + 1) % meshes.len()].1.clone();
        scenes.push(Scene { name, query: MeshQuery::new(mesh), mesh: mesh.clone(), other, shares: *shares });
    }
    let potato = body(4, [40.0, 55.0, 35.0], 4.0, 2.0);
    let other = body(2, [30.0, 40.0, 20.0], 0.8, 4.0);
    scenes.push(Scene { name: "potato", query: MeshQuery::new(&potato), mesh: potato, other, shares: [0.5, 1.0] });
    scenes
}

/// Of bones and a made body, one scan each with every kind of surroundings at 60 % of the points.
fn counted(test: &str, kinds: &[Around], names: &[&str], seed: u64) -> [u64; 3] {
    let words = std::env::var("OSTEOFLOW_CASES").unwrap_or_default();
    let mut sums = [0; 3];
    let scenes = scenes(test);
    // CPU times are those of the calls.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    println!("{}", Counted::HEAD);
    for scene in scenes.iter().filter(|s| names.contains(&s.name) && words.split(',').any(|w| s.name.contains(w))) {
        let target = target_of(&scene.mesh);
        for kind in kinds {
            let case = scene.case(&target, *kind, 0.6, seed);
            let counted = one_thread.install(|| case.counted(1));
            for (sum, more) in sums.iter_mut().zip([counted.n, counted.right, counted.wrong_and_clear]) {
                *sum += more;
            }
        }
    }
    println!("{} of {} right, {} wrong and clear", sums[1], sums[0], sums[2]);
    sums
}

/// Registers the scans: with `SLOW_TESTS` all, else two of a fibula.
///
/// The search and `least` (of 28) were chosen with the scans of seed 0 in view; those of seeds 1 and 2 played no part in it, and those of seed 1
/// have no known camera.
fn check(test: &str, kinds: [Around; 4], least: u64) {
    let all = ["TLEM2", "MC22", "myosim", "jaw", "femur", "pelvis", "potato"];
    if !is_slow() {
        let [n, right, wrong_and_clear] = counted(test, &kinds[..2], &["TLEM2"], 0);
        assert_eq!((right, wrong_and_clear), (n, 0), "right, and wrong and clear, of {n}");
        return;
    }
    for seed in 0..3 {
        println!("seed {seed}");
        let [n, right, wrong_and_clear] = counted(test, &kinds, &all, seed);
        assert!(right >= least * n / 28, "{right} of {n} are right");
        assert_eq!(wrong_and_clear, 0, "wrong and clear");
    }
}

#[test]
fn bones_are_found_among_the_surroundings_that_the_search_was_made_with() {
    check("bones_are_found_among_the_surroundings_that_the_search_was_made_with", SEEN, 26);
}

#[test]
fn bones_are_found_among_surroundings_that_the_search_had_not_seen() {
    check("bones_are_found_among_surroundings_that_the_search_had_not_seen", HELD_OUT, 21);
}
