//! Calibration of the camera to its marker, from one scan of a phantom of known shape; and of a stylus' tip.

mod pivot;

pub use pivot::{PivotError, PivotReport, pivot};

use crate::icp::{self, IcpError, IcpParams, IcpReport, Source};
use crate::kabsch::centroid;
use crate::mesh_query::MeshQuery;
use crate::sample;
use crate::target::{Target, TargetError};
use nalgebra::{Isometry3, Matrix3, Matrix3x6, Matrix6, Point3, Vector3, Vector6};
use osteoflow_geometry::{Column, Mesh};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, ops::ControlFlow};

/// Cell size for clustering residuals, mm: about the correlation length of a camera's smooth distortion.
pub const CELL_MM: f64 = 10.0;

/// Minimum RMS residual that a motion of 1 mm causes, mm. Three faces give 0.4; where faces are missing, pairs across
/// an edge still give 0.03.
const MIN_HOLD_PER_MM: f64 = 0.1;

/// Distance from a face at which its outside is tested, mm: beyond rounding, within any gap between parts.
const JUST_OUTSIDE_MM: f64 = 1e-3;

/// Parameters of [`phantom_icp`].
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PhantomParams {
    /// Pairs farther apart are not used at the start, mm. 10: a nominal pose is good to a few mm and about 2 degrees.
    #[schemars(range(min = 0.1, max = 1000.0))]
    pub max_pair_distance_mm: f64,
    /// Share of the pairs, the worst first, that the last steps trim. 0.1: edges, where a point may pair with the wrong
    /// face.
    #[schemars(range(min = 0.0, max = 0.9))]
    pub trim_fraction: f64,
    /// Maximum number of steps. 200: ten times what a phantom takes.
    #[schemars(range(min = 1, max = 100000))]
    pub max_iterations: u32,
    /// Points drawn from the CAD's surface. 40000: less than a millimetre apart on a cube of 60 mm; on flat faces the
    /// spacing does not matter.
    #[schemars(range(min = 100, max = 10000000))]
    pub n_samples: u32,
    /// Distance from the camera at which the error caused by the calibration is reported, mm. 200: the paper's.
    #[schemars(range(min = 1.0, max = 10000.0))]
    pub working_distance_mm: f64,
    /// Maximum RMS distance of the used pairs from the CAD's faces, mm. 0.5: ten times the camera's noise; above it the
    /// start was wrong, or it is another phantom.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub max_rms_mm: f64,
    /// Maximum share of the points within `max_pair_distance_mm` that lie farther than `3 max_rms_mm` from the CAD's
    /// faces.
    /// 0.2: a little of a table may be near the phantom, but a face that lies elsewhere is another phantom.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub max_off_share: f64,
}

impl Default for PhantomParams {
    fn default() -> Self {
        Self {
            max_pair_distance_mm: 10.0,
            trim_fraction: 0.1,
            max_iterations: 200,
            n_samples: 40_000,
            working_distance_mm: 200.0,
            max_rms_mm: 0.5,
            max_off_share: 0.2,
        }
    }
}

/// Pose of the phantom in the camera's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PhantomFit {
    /// Takes phantom coordinates to camera coordinates.
    pub t_camera_phantom: Isometry3<f64>,
    /// Accuracy of the pose.
    pub report: PhantomReport,
}

/// Accuracy of a phantom's pose, and its effect on a bone at the working distance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhantomReport {
    /// Scan points.
    pub n_points: usize,
    /// Points that pair with a face, without the trimmed ones.
    pub n_pairs: usize,
    /// RMS distance of the used points from their faces, mm.
    pub rms_mm: f64,
    /// Median absolute distance of all points from the CAD's faces, mm.
    pub median_mm: f64,
    /// 95th percentile of the absolute distances, mm.
    pub p95_mm: f64,
    /// Correction of the nominal pose: RMS movement of the phantom's points, mm.
    pub moved_mm: f64,
    /// Angle between the nominal pose and the fit, rad.
    pub moved_rad: f64,
    /// Standard deviation of the rotation predicted from the residuals, rad; see [`phantom_icp`].
    pub rotation_sd_rad: f64,
    /// Standard deviation of the position of the centroid of the seen points, mm.
    pub translation_sd_mm: f64,
    /// The working distance, mm.
    pub working_distance_mm: f64,
    /// Predicted error of a point at the working distance in front of the camera, RMS over three directions, mm; see
    /// [`phantom_icp`].
    pub error_at_working_distance_mm: f64,
    /// Error that 0.1 degree would cause there, mm: 0.35 mm at 200 mm.
    pub error_of_tenth_degree_mm: f64,
    /// Report of the registration.
    pub icp: IcpReport,
}

/// Errors of [`phantom_icp`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// The CAD has no surface that a camera could see.
    #[error("no face of the phantom's CAD can be seen from outside; do its faces turn inside out?")]
    NoSurface,
    /// The CAD makes no target.
    #[error("the phantom's CAD: {0}")]
    Target(#[from] TargetError),
    /// The registration has no result.
    #[error("the phantom's scan onto its CAD: {0}")]
    Icp(#[from] IcpError),
    /// The scan does not fit the CAD.
    #[error(
        "the phantom's scan lies {rms_mm:.2} mm (RMS) from its CAD, {limit_mm} mm is allowed; is it this phantom, and the \
         nominal pose within a few mm and degrees?"
    )]
    Residual {
        /// Found.
        rms_mm: f64,
        /// Allowed.
        limit_mm: f64,
    },
    /// Part of the scan lies off the CAD.
    #[error(
        "{:.0} % of the phantom's scan lies more than {limit_mm:.1} mm from its CAD, {:.0} % is allowed; is it this \
         phantom, cropped from what stands around it?",
        share * 100.0,
        allowed * 100.0
    )]
    Off {
        /// Found.
        share: f64,
        /// Allowed.
        allowed: f64,
        /// Distance beyond which a point is off the CAD.
        limit_mm: f64,
    },
    /// The scan leaves part of the pose free.
    #[error(
        "the scan of the phantom leaves {n_free} of 6 motions free; show at least three of its faces to the camera"
    )]
    Undetermined {
        /// Free motions.
        n_free: usize,
    },
}

/// Registers the phantom's CAD to its scan (in the camera's frame, camera at the origin), from a nominal pose.
///
/// Only faces that a camera can see take part: CAD programs export a body as overlapping closed parts, whose inner
/// faces are buried in other parts, and of the others only those that face the camera count. Points pair with samples
/// of these faces and move by point-to-plane distances; the worst pairs, at edges, are trimmed.
///
/// The report's standard deviations are a sandwich estimate clustered by cells of [`CELL_MM`]: residuals of one region
/// are correlated (a camera bends its surfaces), so only the sums over cells count as independent errors.
///
/// # Errors
/// [`CalibrationError`]
///
/// # Source
/// Section 2.2 of the paper. For the clustered covariance: Liang and Zeger 1986.
pub fn phantom_icp(
    scan: &[Point3<f64>],
    phantom: &Mesh,
    t_camera_phantom_nominal: &Isometry3<f64>,
    params: &PhantomParams,
) -> Result<PhantomFit, CalibrationError> {
    let target = visible(phantom, params.n_samples as usize)?;
    let icp_params = IcpParams {
        max_pair_distance_mm: params.max_pair_distance_mm,
        // A face that starts some millimetres off must not be trimmed, as it alone may determine a motion.
        gate_sigmas: 0.0,
        one_sided: Some(false),
        trim_fraction: params.trim_fraction,
        max_iterations: params.max_iterations,
        ..IcpParams::default()
    };
    let start = t_camera_phantom_nominal.inverse();
    let source = Source::seen_from(scan, Point3::origin());
    let fit = icp::register(icp::Method::PointToPlane, &target, source, &start, &icp_params, &mut |_| {
        ControlFlow::Continue(())
    })?;
    if fit.report.rms_mm > params.max_rms_mm {
        return Err(CalibrationError::Residual { rms_mm: fit.report.rms_mm, limit_mm: params.max_rms_mm });
    }
    let t_camera_phantom = fit.t_target_source.inverse();
    let pairs = pairs(&target, scan, &fit.t_target_source, params.max_pair_distance_mm);
    let mut distances: Vec<f64> = pairs.iter().map(|p| p.residual_mm.abs()).collect();
    distances.sort_by(f64::total_cmp);
    let at = |share: f64| distances[((distances.len() - 1) as f64 * share).round() as usize];
    let limit_mm = 3.0 * params.max_rms_mm;
    let n_off = distances.len() - distances.partition_point(|d| *d <= limit_mm);
    let share = n_off as f64 / distances.len() as f64;
    if share > params.max_off_share {
        return Err(CalibrationError::Off { share, allowed: params.max_off_share, limit_mm });
    }
    let held = |eigenvalue: &&f64| eigenvalue.sqrt() >= MIN_HOLD_PER_MM;
    let n_free = 6 - fit.report.observability.eigenvalues.iter().filter(held).count();
    if n_free > 0 {
        return Err(CalibrationError::Undetermined { n_free });
    }
    let kept = at(1.0 - params.trim_fraction);
    let used: Vec<Pair> = pairs.into_iter().filter(|p| p.residual_mm.abs() <= kept).collect();
    let spread = Spread::new(&used, &t_camera_phantom);
    let moved = t_camera_phantom.inverse() * t_camera_phantom_nominal;
    let moved_squares: f64 = used.iter().map(|p| (moved * p.phantom - p.phantom).norm_squared()).sum();
    let ahead = Point3::new(0.0, 0.0, params.working_distance_mm);
    let report = PhantomReport {
        n_points: scan.len(),
        n_pairs: fit.report.n_pairs,
        rms_mm: fit.report.rms_mm,
        median_mm: at(0.5),
        p95_mm: at(0.95),
        moved_mm: (moved_squares / used.len() as f64).sqrt(),
        moved_rad: moved.rotation.angle(),
        rotation_sd_rad: spread.rotation_sd_rad(),
        translation_sd_mm: spread.error_at(&spread.centre),
        working_distance_mm: params.working_distance_mm,
        error_at_working_distance_mm: spread.error_at(&ahead),
        error_of_tenth_degree_mm: 0.1_f64.to_radians() * params.working_distance_mm,
        icp: fit.report,
    };
    Ok(PhantomFit { t_camera_phantom, report })
}

/// Samples of the faces that are not buried in another part of the body.
fn visible(phantom: &Mesh, n: usize) -> Result<Target, CalibrationError> {
    let query = MeshQuery::new(phantom);
    let samples = sample::surface(phantom, n, &mut ChaCha8Rng::seed_from_u64(0));
    let seen: Vec<bool> = samples
        .points
        .par_iter()
        .zip(&samples.normals)
        .map(|(point, normal)| !query.is_inside(&(point + normal * JUST_OUTSIDE_MM)))
        .collect();
    let kept = |i: &usize| seen[*i];
    let indices: Vec<usize> = (0..seen.len()).filter(kept).collect();
    if indices.is_empty() {
        return Err(CalibrationError::NoSurface);
    }
    let points: Vec<Point3<f64>> = indices.iter().map(|&i| samples.points[i]).collect();
    let normals: Column<Vector3<f64>> = indices.iter().map(|&i| samples.normals[i]).collect();
    Ok(Target::new(&phantom.frame, phantom.origin, points, Some(normals))?)
}

/// A scan point on its face.
struct Pair {
    /// The scan point in the phantom's frame.
    phantom: Point3<f64>,
    normal: Vector3<f64>,
    residual_mm: f64,
}

fn pairs(target: &Target, scan: &[Point3<f64>], t_phantom_camera: &Isometry3<f64>, max_mm: f64) -> Vec<Pair> {
    let normals = target.normals().unwrap_or_default();
    let pair = |point: &Point3<f64>| {
        let phantom = t_phantom_camera * point;
        let (index, _) = target.nearest(&phantom, max_mm)?;
        let normal = *normals.get(index)?;
        Some(Pair { phantom, normal, residual_mm: (phantom - target.points()[index]).dot(&normal) })
    };
    let found: Vec<Option<Pair>> = scan.par_iter().map(pair).collect();
    found.into_iter().flatten().collect()
}

/// Covariance of a small motion of the phantom, in the camera's frame.
struct Spread {
    /// Of shift (mm) and turn (rad) about `centre`.
    covariance: Matrix6<f64>,
    /// Centroid of the phantom's seen points, in the camera's frame, mm.
    centre: Point3<f64>,
}

impl Spread {
    fn new(pairs: &[Pair], t_camera_phantom: &Isometry3<f64>) -> Self {
        let points: Vec<Point3<f64>> = pairs.iter().map(|p| t_camera_phantom * p.phantom).collect();
        let centre = centroid(&points);
        let mut normal = Matrix6::zeros();
        let mut cells: BTreeMap<[i64; 3], Vector6<f64>> = BTreeMap::new();
        for (pair, point) in pairs.iter().zip(&points) {
            let n = t_camera_phantom * pair.normal;
            let turn = (point - centre).cross(&n);
            let row = Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z);
            normal += row * row.transpose();
            let cell = std::array::from_fn(|k| (pair.phantom[k] / CELL_MM).floor() as i64);
            *cells.entry(cell).or_insert_with(Vector6::zeros) += row * pair.residual_mm;
        }
        let middle: Matrix6<f64> = cells.values().map(|sum| sum * sum.transpose()).sum();
        let inverse = normal.try_inverse().unwrap_or_else(Matrix6::zeros);
        Self { covariance: inverse * middle * inverse, centre }
    }

    fn rotation_sd_rad(&self) -> f64 {
        (3..6).map(|k| self.covariance[(k, k)]).sum::<f64>().max(0.0).sqrt()
    }

    /// RMS error of a point in the camera's frame, mm: the shift plus what the turn does there.
    fn error_at(&self, point: &Point3<f64>) -> f64 {
        let mut motion = Matrix3x6::zeros();
        motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        motion.fixed_view_mut::<3, 3>(0, 3).copy_from(&-(point - self.centre).cross_matrix());
        (motion * self.covariance * motion.transpose()).trace().max(0.0).sqrt()
    }
}

/// `t_c_mc = t_c_p * t_p_mp * t_mp_w * t_w_mc`: the pose of the camera marker in the camera's frame.
///
/// # Source
/// Equation 1 of the paper.
pub fn equation_1(
    t_camera_phantom: &Isometry3<f64>,
    t_phantom_phantom_marker: &Isometry3<f64>,
    t_world_phantom_marker: &Isometry3<f64>,
    t_world_camera_marker: &Isometry3<f64>,
) -> Isometry3<f64> {
    t_camera_phantom * t_phantom_phantom_marker * t_world_phantom_marker.inverse() * t_world_camera_marker
}

/// Nominal pose of the phantom, from the nominal pose of the camera marker: equation 1 solved for `t_camera_phantom`,
/// the start of [`phantom_icp`].
pub fn nominal_t_camera_phantom(
    t_camera_camera_marker_nominal: &Isometry3<f64>,
    t_phantom_phantom_marker: &Isometry3<f64>,
    t_world_phantom_marker: &Isometry3<f64>,
    t_world_camera_marker: &Isometry3<f64>,
) -> Isometry3<f64> {
    t_camera_camera_marker_nominal
        * t_world_camera_marker.inverse()
        * t_world_phantom_marker
        * t_phantom_phantom_marker.inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, shaft, together};
    use nalgebra::UnitQuaternion;
    use rand_distr::{Distribution, Normal};

    /// A cube with blocks on three of its faces, sunk into it: their lower faces and the cube's faces below are hidden.
    fn phantom() -> Mesh {
        let cube = cuboid([-30.0; 3], [30.0; 3]);
        let blocks = [
            cuboid([-20.0, -10.0, 25.0], [5.0, 20.0, 42.0]),
            cuboid([25.0, -22.0, -15.0], [38.0, -2.0, 20.0]),
            cuboid([-12.0, 25.0, -25.0], [18.0, 36.0, 4.0]),
        ];
        blocks.iter().fold(cube, |body, block| together(&body, block))
    }

    /// Three faces to the camera, 230 mm away.
    fn pose() -> Isometry3<f64> {
        let diagonal = Vector3::new(1.0, 0.8, 0.9);
        let look = UnitQuaternion::rotation_between(&diagonal, &-Vector3::z()).unwrap();
        Isometry3::from_parts(
            Vector3::new(4.0, -3.0, 230.0).into(),
            UnitQuaternion::from_euler_angles(0.0, 0.0, 0.4) * look,
        )
    }

    /// What a camera at the origin sees, with depth noise and a smooth distortion of 0.05 mm each.
    fn scan(phantom: &Mesh, t_camera_phantom: &Isometry3<f64>) -> Vec<Point3<f64>> {
        let query = MeshQuery::new(&phantom.transformed("camera", t_camera_phantom));
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let noise = Normal::new(0.0, 0.05).unwrap();
        let mut points = Vec::new();
        for i in -100..100 {
            for j in -100..100 {
                let ray = Vector3::new(f64::from(i) * 0.003, f64::from(j) * 0.003, 1.0).normalize();
                if let Some(hit) = query.cast_ray(&Point3::origin(), &ray) {
                    let bend = 0.05 * (hit.point.x / 20.0).sin() * (hit.point.y / 25.0).cos();
                    points.push(hit.point + ray * (bend + noise.sample(&mut rng)));
                }
            }
        }
        points
    }

    #[test]
    fn the_phantom_is_found_from_a_nominal_pose_some_millimetres_and_degrees_off() {
        let truth = pose();
        let scan = scan(&phantom(), &truth);
        for (shift, turn) in [([5.0, -4.0, 3.0], [0.02, 0.03, -0.02]), ([-6.0, 3.0, -4.0], [-0.03, 0.02, 0.03])] {
            let off = Isometry3::from_parts(Vector3::from(shift).into(), UnitQuaternion::from_scaled_axis(turn.into()));
            let fit = phantom_icp(&scan, &phantom(), &(truth * off), &PhantomParams::default()).unwrap();
            let error = fit.t_camera_phantom.inverse() * truth;
            let (mm, degrees) = (error.translation.vector.norm(), error.rotation.angle().to_degrees());
            assert!(mm < 0.1 && degrees < 0.06, "{mm:.3} mm and {degrees:.3} degrees: {:?}", fit.report);
            assert!((fit.report.moved_rad - off.rotation.angle()).abs() < 0.002);
            assert!((fit.report.error_of_tenth_degree_mm - 0.349).abs() < 0.001);
            let predicted = fit.report.error_at_working_distance_mm;
            assert!(predicted > 1e-3 && predicted < 0.1, "{predicted} mm predicted");
        }
    }

    #[test]
    fn another_body_and_a_single_face_are_refused() {
        let truth = pose();
        let round = shaft().transformed("ct", &Isometry3::translation(0.0, 30.0, -40.0));
        let wrong = phantom_icp(&scan(&round, &truth), &phantom(), &truth, &PhantomParams::default());
        // A cylinder fitted as well as possible: either the residual is too large, or the turn about its axis is free.
        let refused = matches!(wrong, Err(CalibrationError::Residual { .. } | CalibrationError::Undetermined { .. }));
        assert!(refused, "{wrong:?}");
        // Half of the seen points lie in front of the phantom: whichever half is trimmed, the other does not suffice.
        let mut crowded = scan(&phantom(), &truth);
        let covered: Vec<Point3<f64>> = crowded.iter().map(|p| p + Vector3::new(0.0, 0.0, -8.0)).collect();
        crowded.extend(covered);
        let crowded =
            phantom_icp(&crowded, &phantom(), &truth, &PhantomParams { trim_fraction: 0.6, ..Default::default() });
        assert!(
            matches!(crowded, Err(CalibrationError::Off { .. } | CalibrationError::Undetermined { .. })),
            "{crowded:?}"
        );
        let cube = cuboid([-30.0; 3], [30.0; 3]);
        let facing = Isometry3::translation(0.0, 0.0, 230.0);
        let one_face = phantom_icp(&scan(&cube, &facing), &cube, &facing, &PhantomParams::default());
        assert!(matches!(one_face, Err(CalibrationError::Undetermined { n_free: 3 })), "{one_face:?}");
        let nowhere = phantom_icp(&[], &cube, &facing, &PhantomParams::default());
        assert!(matches!(nowhere, Err(CalibrationError::Icp(IcpError::TooFewPoints { .. }))));
    }

    #[test]
    fn equation_1_and_the_nominal_pose_are_inverse_to_each_other() {
        let m = |k: f64| Isometry3::new(Vector3::new(k, 2.0 * k, -k), Vector3::new(0.1 * k, -0.2, 0.3 * k));
        let (t_p_mp, t_w_mp, t_w_mc, t_c_mc) = (m(1.0), m(2.0), m(3.0), m(4.0));
        let t_c_p = nominal_t_camera_phantom(&t_c_mc, &t_p_mp, &t_w_mp, &t_w_mc);
        let again = equation_1(&t_c_p, &t_p_mp, &t_w_mp, &t_w_mc);
        assert!((again.to_homogeneous() - t_c_mc.to_homogeneous()).amax() < 1e-12);
    }
}
