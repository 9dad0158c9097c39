//! What prepares a cloud: selections, averages, normals.

use super::BONE;
use super::text::{golden, indices, line, motion, outcome, points, vectors};
use crate::common::{USUAL, displaced};
use nalgebra::{Isometry3, Point2, Point3, Unit, Vector3};
use osteoflow_algorithms::merge::merge;
use osteoflow_algorithms::normals::{NormalParams, estimate, of_surface};
use osteoflow_algorithms::still_average::still_average;
use osteoflow_algorithms::{downsample, kabsch, roi, sample};
use osteoflow_geometry::{Cloud, Region};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

fn scan() -> Cloud {
    BONE.scan(&BONE.camera(150.0), [130.0, 170.0], 0.8, &USUAL, None, 61)
}

#[test]
fn selections_of_a_cloud_are_what_they_were() {
    let scan = scan();
    let at = scan.points()[scan.len() / 3];
    let mut text = String::new();
    for cell_mm in [0.3, 1.0, 2.5, 500.0] {
        text += &line(format!("voxel {cell_mm}"), &indices(&downsample::voxel(&scan, cell_mm)));
    }
    for n in [1, 3, 50, scan.len() - 1, scan.len(), 100_000] {
        text += &line(format!("every {n}"), &indices(&downsample::every(&scan, n)));
        text += &line(format!("evenly {n}"), &indices(&downsample::evenly(&scan, n)));
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        text += &line(format!("drawn {n}"), &indices(&downsample::drawn(&scan, n, &mut rng)));
    }
    let region = Region { frame: "ct".into(), min: at - Vector3::repeat(4.0), max: at + Vector3::new(2.0, 3.0, 9.0) };
    text += &line("box", &indices(&roi::in_box(&scan, &region)));
    text += &line("sphere", &indices(&roi::in_sphere(&scan, &at, 6.0)));
    let direction = Unit::new_normalize(Vector3::new(0.2, 0.1, 1.0));
    text += &line("slab", &indices(&roi::in_slab(&scan, &at, &direction, -3.0, 5.5)));
    let polygon = [[-0.05, -0.02], [0.04, -0.01], [0.02, 0.03], [0.0, 0.0]].map(Point2::from);
    text += &outcome("polygon", &roi::in_polygon(&scan, &polygon).map(|kept| indices(&kept)));
    text += &outcome("two corners", &roi::in_polygon(&scan, &polygon[..2]));
    let blind = Cloud::new("ct", scan.points().to_vec()).unwrap();
    text += &outcome("no viewpoint", &roi::in_polygon(&blind, &polygon));
    text += &outcome("merged", &merge(&[scan.clone(), blind]).map(|c| (points(c.points()), c.viewpoint.is_some())));
    golden("selections", &text);
}

#[test]
fn normals_and_samples_are_what_they_were() {
    let scan = scan();
    let mut text = String::new();
    for (neighbours, max_distance_mm) in [(24, 3.0), (6, 3.0), (24, 1.2), (3, 0.7), (24, 0.01)] {
        let result = estimate(&scan, &NormalParams { neighbours, max_distance_mm });
        let result =
            result.map(|(cloud, n_dropped)| (points(cloud.points()), vectors(cloud.normals().unwrap()), n_dropped));
        text += &outcome(format!("{neighbours} within {max_distance_mm}"), &result);
    }
    let drawn = sample::surface(&BONE.mesh, 3000, &mut ChaCha8Rng::seed_from_u64(6));
    let faces: Vec<usize> = drawn.faces.iter().map(|f| *f as usize).collect();
    text += &line("samples", &(points(&drawn.points), vectors(&drawn.normals), indices(&faces)));
    text += &outcome("of the surface", &of_surface(&drawn.points).as_deref().map(vectors));
    // A shell of two walls 3 mm apart: only the whole says which side is outside.
    let tube: Vec<Point3<f64>> = (0..4000)
        .map(|k| {
            let (turn, z) = (f64::from(k) * 0.618 * std::f64::consts::TAU, f64::from(k) * 0.01);
            let r = if k % 2 == 0 { 6.0 } else { 3.0 } + 0.2 * (z / 3.0).sin();
            Point3::new(r * turn.cos(), r * turn.sin(), z)
        })
        .collect();
    text += &outcome("of a tube", &of_surface(&tube).as_deref().map(vectors));
    let one_line: Vec<Point3<f64>> = (0..40).map(|k| Point3::new(f64::from(k), 0.0, 0.0)).collect();
    text += &outcome("of a line", &of_surface(&one_line));
    text += &outcome("of two points", &of_surface(&one_line[..2]));
    text += &outcome("of one place", &of_surface(&[Point3::origin(); 40]));
    let mut broken = tube.clone();
    broken[17].x = f64::INFINITY;
    text += &outcome("not finite", &of_surface(&broken));
    golden("normals", &text);
}

#[test]
fn poses_average_and_pair_as_they_did() {
    let base = displaced(&Point3::new(3.0, 4.0, 5.0), 100.0, 1.0, 70);
    let window = |n: u64, drift: f64| -> Vec<Isometry3<f64>> {
        (0..n)
            .map(|k| {
                let t = k as f64 / n as f64;
                let drift =
                    Isometry3::new(Vector3::new(drift, 0.0, -drift) * t, Vector3::new(0.0, 0.01, 0.0) * drift * t);
                base * displaced(&Point3::origin(), 0.05, 0.0004, 80 + k) * drift
            })
            .collect()
    };
    let mut text = String::new();
    for (n, drift) in [(1, 0.0), (2, 0.0), (7, 0.0), (60, 0.0), (60, 0.3), (61, 2.0)] {
        for (mm, rad) in [(0.3, 0.01), (5.0, 0.001), (5.0, 0.1)] {
            let mean = still_average(&window(n, drift), mm, rad).map(|a| (motion(&a.mean), a.report));
            text += &outcome(format!("{n} drift {drift} limits {mm} {rad}"), &mean);
        }
    }
    text += &outcome("none", &still_average(&[], 1.0, 1.0).map(|a| a.report));
    let mut lost = window(3, 0.0);
    lost[1].translation.x = f64::NAN;
    text += &outcome("not finite", &still_average(&lost, 1.0, 1.0).map(|a| a.report));
    let source: Vec<Point3<f64>> = BONE.mesh.vertices().iter().step_by(30_000).copied().collect();
    let target: Vec<Point3<f64>> =
        source.iter().enumerate().map(|(k, p)| base * p + Vector3::new(0.3, -0.2, 0.1) * (k % 3) as f64).collect();
    text += &outcome("kabsch", &kabsch::kabsch(&target, &source).map(|t| motion(&t)));
    text += &outcome("kabsch of two", &kabsch::kabsch(&target[..2], &source[..2]).map(|t| motion(&t)));
    text += &outcome("kabsch unpaired", &kabsch::kabsch(&target[..4], &source[..3]).map(|t| motion(&t)));
    let along: Vec<Point3<f64>> = (0..5).map(|k| Point3::new(f64::from(k), 2.0, 1.0)).collect();
    text += &outcome("kabsch of a line", &kabsch::kabsch(&along, &along).map(|t| motion(&t)));
    golden("poses", &text);
}
