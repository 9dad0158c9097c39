//! The weakest mode of the built-in bone, which is how far a registration slides along it, beside those of measured ones.
//!
//! `cargo test --release -p osteoflow-simulation --lib weakest_mode -- --nocapture` prints the table of
//! docs/method/simulation.md.

#[path = "../tests/common/measured.rs"]
mod measured;

use crate::camera::{DepthBias, Sight, Stretch, view};
use crate::params::{CameraParams, ProcedureParams};
use crate::scene::scan_pose;
use crate::{BoneParams, SimulationError, bone, draws, plan::section_centre};
use nalgebra::{Matrix6, Point3, Unit, Vector3, Vector6};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Anatomy, Cloud, Mesh};
use rand::RngExt;

/// The smooth surface errors to be drawn.
#[derive(Debug, Clone, PartialEq)]
struct SmoothError {
    /// RMS of the error along the normal, over the points, mm.
    rms_mm: f64,
    /// Standard deviation of its Gaussian bumps, mm.
    bump_mm: f64,
    /// Number of draws.
    n_draws: usize,
}

impl Default for SmoothError {
    /// 0.3 mm in bumps of 8 mm, 400 draws, for an RMS within 4 %.
    fn default() -> Self {
        Self { rms_mm: 0.3, bump_mm: 8.0, n_draws: 400 }
    }
}

/// The effect of smooth surface errors on a point-to-plane registration, over many draws.
#[derive(Debug, Clone, PartialEq)]
struct WeakestMode {
    /// RMS of the slide along the bone, mm.
    slide_mm: f64,
    /// RMS of the shift across the bone, mm.
    across_mm: f64,
    /// RMS of the rotation about the bone, radians.
    spin_rad: f64,
    /// Number of points.
    n_points: usize,
}

/// The response of point-to-plane along `axis` to smooth surface errors; `None` if the points do not determine the
/// pose, as on a cylinder.
///
/// Linearised: with rows `[(p - c) x n, n]` the response to an error field e is the least-squares solution of `row . x
/// = e`. The field is a sum of Gaussian bumps at points of the surface with random heights, scaled to the given RMS.
/// Slide and shift are those of the points' centroid c. `O(n_draws * n)`.
fn weakest_mode(
    points: &[Point3<f64>],
    normals: &[Vector3<f64>],
    axis: &Unit<Vector3<f64>>,
    error: &SmoothError,
    seed: u64,
) -> Option<WeakestMode> {
    let n = points.len();
    if n < 6 || normals.len() != n {
        return None;
    }
    let centroid = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n as f64;
    // Rotations are scaled by 10 mm, so that all six unknowns are lengths.
    const LEVER_MM: f64 = 10.0;
    let rows: Vec<Vector6<f64>> = points
        .iter()
        .zip(normals)
        .map(|(p, n)| {
            let turn = (p.coords - centroid).cross(n) / LEVER_MM;
            Vector6::new(turn.x, turn.y, turn.z, n.x, n.y, n.z)
        })
        .collect();
    let normal_matrix: Matrix6<f64> = rows.iter().map(|row| row * row.transpose()).sum();
    let eigenvalues = normal_matrix.symmetric_eigenvalues();
    if eigenvalues.min() <= 1e-9 * eigenvalues.max() {
        return None;
    }
    let solve = normal_matrix.cholesky()?;

    let reach = 3.0 * error.bump_mm;
    let extent = points.iter().map(|p| (p.coords - centroid).norm()).fold(0.0, f64::max);
    // About four bumps overlap along the bone.
    let n_bumps = (8.0 * extent / error.bump_mm).ceil().clamp(8.0, 200.0) as usize;
    let (mut slide, mut across, mut spin) = (0.0, 0.0, 0.0);
    for draw in 0..error.n_draws {
        let mut rng = draws::stream(seed, draws::Term::SmoothError, draw as u64);
        let bumps: Vec<(Point3<f64>, f64)> =
            (0..n_bumps).map(|_| (points[rng.random_range(0..n)], draws::normal(&mut rng))).collect();
        let field: Vec<f64> = points
            .iter()
            .map(|p| {
                bumps
                    .iter()
                    .map(|(centre, height)| (height, (p - centre).norm_squared()))
                    .filter(|(_, square)| *square < reach * reach)
                    .map(|(height, square)| height * (-0.5 * square / error.bump_mm.powi(2)).exp())
                    .sum()
            })
            .collect();
        let rms = (field.iter().map(|e| e * e).sum::<f64>() / n as f64).sqrt();
        if rms == 0.0 {
            continue;
        }
        let pull: Vector6<f64> = rows.iter().zip(&field).map(|(row, e)| row * *e).sum();
        let answer = solve.solve(&pull) * (error.rms_mm / rms);
        let turn = answer.fixed_rows::<3>(0) / LEVER_MM;
        let shift: Vector3<f64> = answer.fixed_rows::<3>(3).into_owned();
        let along = shift.dot(axis);
        slide += along * along;
        across += shift.norm_squared() - along * along;
        spin += turn.dot(axis).powi(2);
    }
    let mean = |sum: f64| (sum / error.n_draws as f64).sqrt();
    Some(WeakestMode { slide_mm: mean(slide), across_mm: mean(across), spin_rad: mean(spin), n_points: n })
}

/// The stripped bone as seen by the camera without errors: points and outward normals in the frame of `bone`.
///
/// # Errors
/// [`SimulationError`] if the stretch is not on the bone.
fn visible_surface(bone: &Mesh, anatomy: &Anatomy, camera: &CameraParams) -> Result<Cloud, SimulationError> {
    let hint = "scan_from_mm and scan_to_mm should lie on the bone, view_azimuth_deg beside it";
    let nothing = SimulationError::nothing_visible("bone", hint);
    let params = ProcedureParams {
        camera: CameraParams { view_spread_deg: 0.0, ..camera.clone() },
        ..ProcedureParams::default()
    };
    params.check()?;
    let surface = MeshQuery::new(bone);
    let middle_mm = (camera.scan_from_mm + camera.scan_to_mm) / 2.0;
    let focus = section_centre(bone, anatomy, middle_mm)?;
    let t_ct_camera = scan_pose(&surface, anatomy, &focus, &params, 0).ok_or(nothing.clone())?;
    let stretch = Stretch {
        from: anatomy.malleolus_tip,
        along: anatomy.proximal.into_inner(),
        min_mm: camera.scan_from_mm,
        max_mm: camera.scan_to_mm,
    };
    let sight = Sight { object: &surface, stretch: Some(&stretch), around: None, lumps: None };
    let pixels = view(&sight, &t_ct_camera, &params.camera, &DepthBias::new(&params.camera, 0), None);
    if pixels.is_empty() {
        return Err(nothing);
    }
    let (points, normals): (Vec<_>, Vec<_>) = pixels.iter().map(|p| (t_ct_camera * p.point(), p.normal)).unzip();
    Ok(Cloud::new(&bone.frame, points)?.with_normals(normals)?.seen_from(t_ct_camera))
}

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
    let is_slow = std::env::var_os("SLOW_TESTS").is_some();
    let own = (1..=if is_slow { 5 } else { 1 }).map(|shape_seed| {
        let params = BoneParams { shape_seed, ..BoneParams::default() };
        row(&format!("built-in, shape_seed {shape_seed}"), &bone::fibula(&params), &bone::anatomy(&params))
    });
    let own: Vec<[f64; 3]> = own.collect();
    let measured = ["TLEM2_CT_fibula_r", "MC22_fibula_r"].into_iter().map(|name| {
        let (bone, anatomy) = measured::measured_bone(name)?;
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
