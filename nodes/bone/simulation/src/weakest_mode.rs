//! The weakest mode of a bone: how far a registration slides along it.

use crate::camera::{DepthBias, Sight, Stretch, view};
use crate::params::{CameraParams, ProcedureParams};
use crate::scene::scan_pose;
use crate::{SimulationError, draws, plan::section_centre};
use nalgebra::{Matrix6, Point3, Unit, Vector3, Vector6};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Anatomy, Cloud, Mesh};
use rand::RngExt;

/// The smooth surface errors to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SmoothError {
    /// RMS of the error along the normal, over the points, mm.
    pub rms_mm: f64,
    /// Standard deviation of its Gaussian bumps, mm.
    pub bump_mm: f64,
    /// Number of draws.
    pub n_draws: usize,
}

impl Default for SmoothError {
    /// 0.3 mm in bumps of 8 mm, 400 draws, for an RMS within 4 %.
    fn default() -> Self {
        Self { rms_mm: 0.3, bump_mm: 8.0, n_draws: 400 }
    }
}

/// The effect of smooth surface errors on a point-to-plane registration, over many draws.
#[derive(Debug, Clone, PartialEq)]
pub struct WeakestMode {
    /// RMS of the slide along the bone, mm.
    pub slide_mm: f64,
    /// RMS of the shift across the bone, mm.
    pub across_mm: f64,
    /// RMS of the rotation about the bone, radians.
    pub spin_rad: f64,
    /// Number of points.
    pub n_points: usize,
}

/// The response of point-to-plane along `axis` to smooth surface errors; `None` if the points do not determine the
/// pose, as on a cylinder.
///
/// Linearised: with rows `[(p - c) x n, n]` the response to an error field e is the least-squares solution of `row . x
/// = e`. The field is a sum of Gaussian bumps at points of the surface with random heights, scaled to the given RMS.
/// Slide and shift are those of the points' centroid c. `O(n_draws * n)`.
pub fn weakest_mode(
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
/// [`SimulationError::NothingVisible`] or [`SimulationError::NoSection`] if the stretch is not on the bone.
pub fn visible_surface(bone: &Mesh, anatomy: &Anatomy, camera: &CameraParams) -> Result<Cloud, SimulationError> {
    let hint = "scan_from_mm and scan_to_mm should lie on the bone, view_azimuth_deg beside it";
    let nothing = SimulationError::NothingVisible { what: "bone", hint };
    let params = ProcedureParams {
        camera: CameraParams { view_spread_deg: 0.0, ..camera.clone() },
        ..ProcedureParams::default()
    };
    params.check()?;
    let surface = MeshQuery::new(bone);
    let middle_mm = (camera.scan_from_mm + camera.scan_to_mm) / 2.0;
    let focus = section_centre(bone, anatomy, middle_mm).ok_or(SimulationError::NoSection { height_mm: middle_mm })?;
    let t_ct_camera = scan_pose(&surface, anatomy, &focus, &params, 0).ok_or(nothing.clone())?;
    let stretch = Stretch {
        from: anatomy.malleolus_tip,
        along: anatomy.proximal.into_inner(),
        min_mm: camera.scan_from_mm,
        max_mm: camera.scan_to_mm,
    };
    let sight = Sight { object: &surface, stretch: Some(&stretch), around: None, lumps: None };
    let pixels = view(&sight, &t_ct_camera, &params.camera, &DepthBias::new(&params.camera, 0));
    if pixels.is_empty() {
        return Err(nothing);
    }
    let (points, normals): (Vec<_>, Vec<_>) = pixels.iter().map(|p| (t_ct_camera * p.point(), p.normal)).unzip();
    Ok(Cloud::new(&bone.frame, points)?.with_normals(normals)?.seen_from(t_ct_camera))
}
