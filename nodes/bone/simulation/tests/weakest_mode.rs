//! The weakest mode of the built-in bone beside those of measured ones.
//!
//! `cargo test --release -p osteoflow-simulation --test suite weakest_mode:: -- --nocapture` prints the table of
//! docs/method/simulation.md.

use osteoflow_geometry::nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Anatomy, Mesh};
use osteoflow_simulation::{BoneParams, CameraParams, SmoothError, WeakestMode, bone, visible_surface, weakest_mode};

fn mode(bone: &Mesh, anatomy: &Anatomy, camera: &CameraParams, bump_mm: f64) -> WeakestMode {
    let seen = visible_surface(bone, anatomy, camera).unwrap();
    // Every tenth point carries the same information; the error is smooth.
    let points: Vec<_> = seen.points().iter().copied().step_by(10).collect();
    let normals: Vec<_> = seen.normals().unwrap().iter().copied().step_by(10).collect();
    let error = SmoothError { bump_mm, n_draws: 200, ..SmoothError::default() };
    weakest_mode(&points, &normals, &anatomy.proximal, &error, 1).unwrap()
}

/// The slide along the bone for bumps of 4, 8 and 16 mm; prints a row of the table.
fn row(name: &str, bone: &Mesh, anatomy: &Anatomy) -> [f64; 3] {
    let camera = CameraParams::default();
    let modes = [4.0, 8.0, 16.0].map(|bump_mm| mode(bone, anatomy, &camera, bump_mm));
    let [a, b, c] = modes.each_ref().map(|m| m.slide_mm);
    let (across, spin) = (modes[1].across_mm, modes[1].spin_rad.to_degrees());
    println!("| {name} | {a:.2} | {b:.2} | {c:.2} | {across:.2} | {spin:.2} |");
    [a, b, c]
}

#[test]
fn the_built_in_bones_weakest_mode_lies_in_the_range_of_the_measured_bones() {
    println!("| bone | slide mm, bumps of 4 mm | 8 mm | 16 mm | across mm, 8 mm | spin degrees, 8 mm |");
    println!("| --- | --- | --- | --- | --- | --- |");
    let own = (1..=5).map(|shape_seed| {
        let params = BoneParams { shape_seed, ..BoneParams::default() };
        row(&format!("built-in, shape_seed {shape_seed}"), &bone::fibula(&params), &bone::anatomy(&params))
    });
    let own: Vec<[f64; 3]> = own.collect();
    let measured = ["TLEM2_CT_fibula_r", "MC22_fibula_r"].into_iter().map(|name| {
        let (bone, anatomy) = crate::common::measured_bone(name)?;
        Some(row(name, &bone, &anatomy))
    });
    let Some(measured) = measured.collect::<Option<Vec<[f64; 3]>>>() else {
        println!(
            "skipped: the_built_in_bones_weakest_mode_lies_in_the_range_of_the_measured_bones: no development data"
        );
        return;
    };
    for k in 0..3 {
        let low = measured.iter().map(|m| m[k]).fold(f64::MAX, f64::min);
        let high = measured.iter().map(|m| m[k]).fold(0.0, f64::max);
        // The default bone; the others show what shape_seed does.
        assert!((low..=high).contains(&own[0][k]), "{} mm is not between {low} and {high} mm", own[0][k]);
    }
}

/// A cone's surface from a half angle, of radius 6 mm at its middle and 60 mm long.
fn cone(half_angle: f64) -> (Vec<Point3<f64>>, Vec<Vector3<f64>>) {
    let (sin, cos) = half_angle.sin_cos();
    let at = |k: usize| {
        let (z, angle) = ((k / 60) as f64 - 30.0, (k % 60) as f64 * std::f64::consts::TAU / 60.0);
        let radius = 6.0 + z * half_angle.tan();
        let out = Vector3::new(angle.cos(), angle.sin(), 0.0);
        (Point3::from(out * radius + Vector3::z() * z), out * cos - Vector3::z() * sin)
    };
    (0..3600).map(at).unzip()
}

#[test]
fn blunter_cones_slide_less_and_a_round_cone_has_no_answer() {
    let axis = Vector3::z_axis();
    let squashed = |half_angle: f64| {
        let (points, normals) = cone(half_angle);
        // Squashing makes the section oval, which determines the rotation; normals transform by the inverse.
        let points: Vec<_> = points.iter().map(|p| Point3::new(1.6 * p.x, p.y, p.z)).collect();
        let normals: Vec<_> = normals.iter().map(|n| Vector3::new(n.x / 1.6, n.y, n.z).normalize()).collect();
        weakest_mode(&points, &normals, &axis, &SmoothError { n_draws: 100, ..SmoothError::default() }, 1)
            .unwrap()
            .slide_mm
    };
    let slides = [0.05, 0.1, 0.2].map(squashed);
    assert!(slides[0] > 1.8 * slides[1] && slides[1] > 1.8 * slides[2], "slides {slides:?} mm");
    let (points, normals) = cone(0.1);
    assert_eq!(weakest_mode(&points, &normals, &axis, &SmoothError::default(), 1), None, "a round cone spins freely");
}
