//! Calibrations to a phantom of blocks, and pivots of a stylus.

use super::text::{golden, line, motion, outcome};
use crate::common::displaced;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use osteoflow_algorithms::calibrate::{PhantomParams, equation_1, nominal_t_camera_phantom, phantom_icp, pivot};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, Normal};

/// A union of boxes, each by two corners.
fn boxes(corners: &[[[f64; 3]; 2]]) -> Mesh {
    const FACES: [[u32; 3]; 12] = [
        [0, 2, 1],
        [1, 2, 3],
        [4, 5, 6],
        [5, 7, 6],
        [0, 1, 4],
        [1, 5, 4],
        [2, 6, 3],
        [3, 6, 7],
        [0, 4, 2],
        [2, 4, 6],
        [1, 3, 5],
        [3, 7, 5],
    ];
    let corner = |of: &[[f64; 3]; 2], k: usize| Point3::from([0, 1, 2].map(|axis| of[k >> axis & 1][axis]));
    let vertices: Vec<Point3<f64>> = corners.iter().flat_map(|of| (0..8).map(|k| corner(of, k))).collect();
    let faces: Vec<[u32; 3]> =
        (0..corners.len() as u32).flat_map(|b| FACES.map(|face| face.map(|v| v + 8 * b))).collect();
    Mesh::new("phantom", SurfaceOrigin::Exact, vertices, faces).unwrap()
}

const CUBE: [[f64; 3]; 2] = [[-30.0; 3], [30.0; 3]];
const BLOCKS: [[[f64; 3]; 2]; 4] = [
    CUBE,
    [[-20.0, -10.0, 25.0], [5.0, 20.0, 42.0]],
    [[25.0, -22.0, -15.0], [38.0, -2.0, 20.0]],
    [[-12.0, 25.0, -25.0], [18.0, 36.0, 4.0]],
];

/// Three faces to the camera, 230 mm away.
fn pose() -> Isometry3<f64> {
    let look = UnitQuaternion::rotation_between(&Vector3::new(1.0, 0.8, 0.9), &-Vector3::z()).unwrap();
    Isometry3::from_parts(
        Vector3::new(4.0, -3.0, 230.0).into(),
        UnitQuaternion::from_euler_angles(0.0, 0.0, 0.4) * look,
    )
}

/// What a camera at the origin sees, with noise of depth.
fn scan(phantom: &Mesh, t_camera_phantom: &Isometry3<f64>, noise_mm: f64) -> Vec<Point3<f64>> {
    let query = MeshQuery::new(&phantom.transformed("camera", t_camera_phantom));
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let noise = Normal::new(0.0, noise_mm).unwrap();
    let pixels = (-55..55).flat_map(|i| (-55..55).map(move |j| (f64::from(i) * 0.0055, f64::from(j) * 0.0055)));
    let rays = pixels.map(|(x, y)| Vector3::new(x, y, 1.0).normalize());
    let hits = rays.filter_map(|ray| Some((query.cast_ray(&Point3::origin(), &ray)?.point, ray)));
    hits.map(|(at, ray)| at + ray * (0.05 * (at.x / 20.0).sin() + noise.sample(&mut rng))).collect()
}

#[test]
fn a_phantom_is_found_where_it_was_or_refused_in_the_same_words() {
    let params = PhantomParams { n_samples: 8000, ..PhantomParams::default() };
    let phantom = boxes(&BLOCKS);
    let truth = pose();
    let seen = scan(&phantom, &truth, 0.05);
    let near = truth * Isometry3::new(Vector3::new(3.0, -4.0, 2.0), Vector3::new(0.03, 0.02, -0.03));
    let mut text = String::new();
    let mut described =
        |name: &str, scan: &[Point3<f64>], phantom: &Mesh, nominal: &Isometry3<f64>, params: &PhantomParams| {
            let fit = phantom_icp(scan, phantom, nominal, params);
            text += &outcome(name, &fit.map(|fit| (motion(&fit.t_camera_phantom), fit.report)));
        };
    described("usual", &seen, &phantom, &near, &params);
    described("noise", &scan(&phantom, &truth, 0.15), &phantom, &near, &params);
    described("no noise", &scan(&phantom, &truth, 0.0), &phantom, &near, &params);
    described(
        "few samples",
        &seen,
        &phantom,
        &near,
        &PhantomParams { n_samples: 900, max_iterations: 6, ..params.clone() },
    );
    described(
        "smooth",
        &seen,
        &phantom,
        &near,
        &PhantomParams { smooth_mm: 0.0, working_distance_mm: 350.0, ..params.clone() },
    );
    described(
        "gate",
        &seen,
        &phantom,
        &near,
        &PhantomParams { gate_sigmas: 2.0, max_pair_distance_mm: 6.0, ..params.clone() },
    );
    let mut around = seen.clone();
    around.extend((0..400).map(|k| Point3::new(f64::from(k % 20) - 10.0, f64::from(k / 20) + 30.0, 205.0)));
    described("something else in view", &around, &phantom, &near, &params);
    let larger: Vec<Point3<f64>> = seen.iter().map(|p| p * 1.03).collect();
    described("too large", &larger, &phantom, &near, &params);
    described("a little too large", &seen.iter().map(|p| p * 1.008).collect::<Vec<_>>(), &phantom, &near, &params);
    let mirrored: Vec<Point3<f64>> = seen.iter().map(|p| Point3::new(-p.x, p.y, p.z)).collect();
    described("mirrored", &mirrored, &phantom, &near, &params);
    let far = truth * Isometry3::new(Vector3::new(8.0, -9.0, 7.0), Vector3::new(0.03, 0.1, -0.1));
    described("far", &seen, &phantom, &far, &params);
    let turned = truth * Isometry3::new(Vector3::zeros(), Vector3::new(0.0, 0.2, 0.0));
    described("turned", &seen, &phantom, &turned, &params);
    described("beside", &seen, &phantom, &(truth * Isometry3::translation(90.0, 0.0, 0.0)), &params);
    described("another phantom", &seen, &boxes(&[BLOCKS[0], BLOCKS[2]]), &near, &params);
    described("a cube", &scan(&boxes(&[CUBE]), &truth, 0.05), &boxes(&[CUBE]), &near, &params);
    let flat =
        Isometry3::from_parts(Vector3::new(0.0, 0.0, 230.0).into(), UnitQuaternion::from_euler_angles(3.1, 0.0, 0.0));
    described("one face", &scan(&boxes(&[CUBE]), &flat, 0.05), &boxes(&[CUBE]), &flat, &params);
    described("strict", &seen, &phantom, &near, &PhantomParams { max_rms_mm: 0.03, ..params.clone() });
    described("strict excess", &seen, &phantom, &near, &PhantomParams { max_excess_mm: 0.001, ..params.clone() });
    described("strict move", &seen, &phantom, &near, &PhantomParams { max_moved_mm: 1.0, ..params.clone() });
    described("strict turn", &seen, &phantom, &near, &PhantomParams { max_moved_deg: 1.0, ..params.clone() });
    described("strict share", &around, &phantom, &near, &PhantomParams { max_off_share: 0.001, ..params.clone() });
    described("strict scale", &seen, &phantom, &near, &PhantomParams { max_scale_error: 0.0, ..params.clone() });
    described("few points", &seen[..9], &phantom, &near, &params);
    described("no points", &[], &phantom, &near, &params);
    let mut broken = seen.clone();
    broken[5].z = f64::NAN;
    described("not finite", &broken, &phantom, &near, &params);
    golden("phantom", &text);
}

#[test]
fn a_stylus_and_equation_1_have_the_answers_they_had() {
    let t = |k: u64| displaced(&Point3::new(k as f64, 2.0, 3.0), 50.0 + k as f64, 0.5, 100 + k);
    let mut text = line("equation 1", &motion(&equation_1(&t(1), &t(2), &t(3), &t(4))));
    text += &line("nominal", &motion(&nominal_t_camera_phantom(&t(1), &t(2), &t(3), &t(4))));
    let tip = Point3::new(10.0, -3.0, 140.0);
    let poses = |n: u64, rad: f64, one_axis: bool| -> Vec<Isometry3<f64>> {
        (0..n)
            .map(|k| {
                let turn = match one_axis {
                    true => UnitQuaternion::from_scaled_axis(Vector3::x() * rad * k as f64 / n as f64),
                    false => displaced(&Point3::origin(), 0.0, rad, 200 + k).rotation,
                };
                let noise = displaced(&Point3::origin(), 0.1, 0.0, 300 + k).translation.vector;
                Isometry3::from_parts((Vector3::new(900.0, 20.0, -30.0) - turn * tip.coords + noise).into(), turn)
            })
            .collect()
    };
    for (n, rad, one_axis) in [(40, 0.4, false), (3, 0.4, false), (2, 0.4, false), (40, 0.02, false), (40, 0.8, true)] {
        text += &outcome(format!("{n} poses, {rad} rad, one axis {one_axis}"), &pivot(&poses(n, rad, one_axis)));
    }
    let mut lost = poses(5, 0.4, false);
    lost[2].translation.y = f64::NAN;
    text += &outcome("not finite", &pivot(&lost));
    golden("pivot", &text);
}
