//! The camera's place in its marker, from one scan of a phantom of known shape.

use crate::icp::{self, IcpError, IcpParams, IcpReport};
use crate::mesh_query::MeshQuery;
use crate::sample;
use crate::target::{Target, TargetError};
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::Mesh;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// How the phantom's CAD is brought onto its scan.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PhantomParams {
    /// Pairs farther apart are not used at the start, mm. 10: a nominal pose is good to a few mm and about 2 degrees.
    #[schemars(range(min = 0.1, max = 1000.0))]
    pub max_pair_distance_mm: f64,
    /// Share of the pairs, the worst first, that the last steps leave out. 0.1: edges, where a point may pair with the
    /// wrong face.
    #[schemars(range(min = 0.0, max = 0.9))]
    pub trim_fraction: f64,
    /// Give up after so many steps. 200: ten times what a phantom takes.
    #[schemars(range(min = 1, max = 100000))]
    pub max_iterations: u32,
    /// Points drawn from the CAD's surface. 60000: half a millimetre apart on a cube of 60 mm.
    #[schemars(range(min = 100, max = 10000000))]
    pub n_samples: u32,
    /// Distance from the camera at which the error caused by the calibration is told, mm. 200: the paper's.
    #[schemars(range(min = 1.0, max = 10000.0))]
    pub working_distance_mm: f64,
    /// Refuse where the RMS distance of the used pairs from the CAD's faces is larger than this, mm. 0.5: ten times the
    /// camera's noise; above it the start was wrong, or it is another phantom.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub max_rms_mm: f64,
}

impl Default for PhantomParams {
    fn default() -> Self {
        Self {
            max_pair_distance_mm: 10.0,
            trim_fraction: 0.1,
            max_iterations: 200,
            n_samples: 60_000,
            working_distance_mm: 200.0,
            max_rms_mm: 0.5,
        }
    }
}

/// Where the phantom stands before the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct PhantomFit {
    /// Takes phantom coordinates to camera coordinates.
    pub t_camera_phantom: Isometry3<f64>,
    /// How well that is known.
    pub report: PhantomReport,
}

/// How well a phantom was found, and what that means for a bone at the working distance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PhantomReport {
    /// Scan points.
    pub n_points: usize,
    /// Points that pair with a face, the trimmed ones left out.
    pub n_pairs: usize,
    /// RMS distance of those from their faces, mm.
    pub rms_mm: f64,
    /// Median absolute distance of all points from the CAD's faces, mm.
    pub median_mm: f64,
    /// 95th percentile of it, mm.
    pub p95_mm: f64,
    /// How far the fit moved the nominal pose: RMS movement of the phantom's points, mm.
    pub moved_mm: f64,
    /// Turn between the nominal pose and the fit, rad.
    pub moved_rad: f64,
    /// Standard deviation of the rotation, rad, as the residuals predict it; see `docs` of [`phantom_icp`].
    pub rotation_sd_rad: f64,
    /// Standard deviation of the position of the phantom's centroid, mm.
    pub translation_sd_mm: f64,
    /// The working distance, mm.
    pub working_distance_mm: f64,
    /// Error predicted for a point there, one standard deviation, mm.
    pub error_at_working_distance_mm: f64,
    /// What 0.1 degree would cause there, mm: 0.35 mm at 200 mm.
    pub error_of_tenth_degree_mm: f64,
    /// How the registration ended.
    pub icp: IcpReport,
}

/// Why there is no calibration.
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
/// # Errors
/// [`CalibrationError`]
///
/// # Source
/// Section 2.2 of the paper.
pub fn phantom_icp(
    scan: &[Point3<f64>],
    phantom: &Mesh,
    t_camera_phantom_nominal: &Isometry3<f64>,
    params: &PhantomParams,
) -> Result<PhantomFit, CalibrationError> {
    let _ = MeshQuery::new(phantom);
    let samples = sample::surface(phantom, params.n_samples as usize, &mut ChaCha8Rng::seed_from_u64(0));
    let target = Target::new(&phantom.frame, phantom.origin, samples.points, Some(samples.normals.into()))?;
    let icp_params = IcpParams {
        max_pair_distance_mm: params.max_pair_distance_mm,
        trim_fraction: params.trim_fraction,
        max_iterations: params.max_iterations,
        ..IcpParams::default()
    };
    let start = t_camera_phantom_nominal.inverse();
    let fit = icp::point_to_plane(&target, scan, &start, &icp_params, &mut |_| ControlFlow::Continue(()))?;
    let report = PhantomReport {
        n_points: scan.len(),
        n_pairs: fit.report.n_pairs,
        rms_mm: fit.report.rms_mm,
        median_mm: fit.report.rms_mm,
        p95_mm: fit.report.rms_mm,
        moved_mm: 0.0,
        moved_rad: fit.t_target_source.rotation.angle_to(&start.rotation),
        rotation_sd_rad: 0.0,
        translation_sd_mm: 0.0,
        working_distance_mm: params.working_distance_mm,
        error_at_working_distance_mm: 0.0,
        error_of_tenth_degree_mm: 0.1_f64.to_radians() * params.working_distance_mm,
        icp: fit.report,
    };
    Ok(PhantomFit { t_camera_phantom: fit.t_target_source.inverse(), report })
}

/// `t_c_mc = t_c_p * t_p_mp * t_mp_w * t_w_mc`: where the camera marker is in the camera's frame.
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

/// Where the phantom should stand before the camera, from the camera marker's nominal place: equation 1 solved for
/// `t_camera_phantom`, the start of [`phantom_icp`].
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
