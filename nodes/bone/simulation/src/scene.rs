//! The scene of a simulated procedure: poses and motions of all objects, and the run through it.

mod laser;
mod markers;
mod places;
mod ruler;
mod scans;
mod setup;
mod stream;
mod touches;
mod truth;
mod written;

#[cfg(test)]
pub(crate) use places::scan_pose;

use crate::camera::{DepthBias, Pixel};
use crate::check_piece::{PieceScan, read_holes};
use crate::tracker::{Path, Tracker};
use crate::{Procedure, ProcedureParams, SimulationError};
use markers::Markers;
use nalgebra::Isometry3;
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Anatomy, Mesh, Points, Pose, StampNs, SurgicalPlan};
use touches::Touches;

/// Times of the clouds, seconds after the start, as in the development recording.
const CALIBRATION_S: f64 = 1.0;
const SCAN_S: f64 = 11.0;
const LASER_EVERY_S: f64 = 4.0;
/// Times at which the camera's marker is knocked, and at which the bone's marker slips if it does before the laser scans:
/// outside every burst.
const KNOCK_S: f64 = 6.0;
const SLIP_BEFORE_LASER_S: f64 = 13.0;
/// Prefix of the check piece's holes where it is scanned at the bone.
const WORKING: &str = "working";
/// Time between touches of marks and holes, and rate of the palpation.
const TOUCH_EVERY_S: f64 = 0.5;
const PALPATION_RATE_HZ: f64 = 20.0;
/// Duration of the last motion, and of the rest after it.
const MOTION_S: f64 = 2.0;
const REST_S: f64 = 3.0;

/// Time of the `k`-th laser scan.
fn laser_s(k: usize) -> f64 {
    SCAN_S + (k + 1) as f64 * LASER_EVERY_S
}

/// Poses of all objects over time, as they truly are.
pub(crate) struct Scene<'a> {
    params: &'a ProcedureParams,
    seed: u64,
    plan: &'a SurgicalPlan,
    anatomy: &'a Anatomy,
    bone: &'a Mesh,
    bone_surface: &'a MeshQuery,
    /// Soft tissue around the stripped bone, in the bone's frame.
    around: Option<MeshQuery>,
    phantom: &'a Mesh,
    phantom_surface: MeshQuery,
    /// `t_world_camera` over time.
    camera: Path,
    /// `t_world_ct` over time.
    bone_path: Path,
    /// `t_world_phantom`, at rest.
    phantom_path: Path,
    /// `t_camera_camera_marker` at the calibration, and at the scans after a possible knock.
    t_camera_camera_marker: Isometry3<f64>,
    t_camera_camera_marker_knocked: Isometry3<f64>,
    /// `t_phantom_phantom_marker` as the recording gives it: by CAD, or wrong.
    t_phantom_phantom_marker_written: Isometry3<f64>,
    t_phantom_phantom_marker: Isometry3<f64>,
    t_ct_bone_marker: Isometry3<f64>,
    t_ct_bone_marker_slipped: Isometry3<f64>,
    /// Marks on the bone that the laser shows in turn, frame of the bone.
    laser_marks: Points,
    /// Assessment holes in the bone, frame of the bone.
    assessment: Points,
    /// Start of the touches, and of the last motion.
    touches_s: f64,
    motion_s: f64,
}

impl Scene<'_> {
    pub(crate) fn run(&self) -> Result<Procedure, SimulationError> {
        let params = self.params;
        let tracker = Tracker {
            params: &params.tracker,
            seed: self.seed,
            start_ns: StampNs::from(params.motion.start_s) * 1_000_000_000,
        };
        let bias = DepthBias::new(&params.camera, self.seed);
        let phantom_scan = self.phantom_scan(&tracker, &bias)?;
        self.check_labels()?;
        let on_object = |pixels: &[Pixel]| pixels.iter().copied().filter(|p| p.on_object).collect::<Vec<_>>();
        let bare = self.bone_view(SCAN_S, &bias, None)?;
        // Tissue is placed on the bone that would be seen without it, and the stylus pierces it.
        let on_bone = on_object(&bare);
        let spots = self.laser_spots()?;
        let wound = self.wound(&on_bone, &spots)?;
        let pixels = match &wound.tissue {
            None => bare,
            tissue => self.bone_view(SCAN_S, &bias, tissue.as_ref())?,
        };
        let scan = self.bone_scan(&pixels, None, &wound, SCAN_S, &tracker, 1)?;
        let laser =
            if params.laser.scans { self.laser_scans(&pixels, &spots, &wound, &tracker, &bias)? } else { Vec::new() };
        let images =
            if params.image.taken && params.laser.scans { self.images(&spots, &wound, &tracker)? } else { Vec::new() };
        let (markers, check, touches) = if params.tracker.none {
            (self.markers(&tracker, laser.len()).untracked(), Vec::new(), Touches::default())
        } else {
            let check = self.check(&tracker, &bias);
            (self.markers(&tracker, laser.len()), check, self.touches(&tracker, &spots, &on_bone)?)
        };
        let Markers { camera_marker, phantom_marker, bone_marker } = markers;
        Ok(Procedure {
            plan: self.plan.clone(),
            phantom: self.phantom.clone(),
            region: Some(self.region_as_written(scans::region(&on_object(&pixels)))),
            phantom_scan,
            scan,
            laser,
            images,
            camera_marker,
            phantom_marker,
            bone_marker,
            t_phantom_phantom_marker: Pose::new("phantom", "phantom_marker", self.t_phantom_phantom_marker_written)
                .at(tracker.stamp(CALIBRATION_S)),
            stylus_init: touches.init,
            stylus_assessment: touches.assessment,
            stylus_palpation: touches.palpation,
            check,
            stylus_pivoting: touches.pivoting,
            stylus_marker: touches.marker,
            truth: self.truth(&tracker, spots),
        })
    }

    fn t_ct_camera(&self, s: f64) -> Isometry3<f64> {
        self.bone_path.at(s).inverse() * self.camera.at(s)
    }

    /// End of the recording.
    fn end_s(&self) -> f64 {
        self.motion_s + MOTION_S + REST_S
    }

    /// The check piece's holes, read at the phantom's distance and at the working distance.
    fn check(&self, tracker: &Tracker<'_>, bias: &DepthBias) -> Vec<(Points, Points)> {
        let params = self.params;
        let working_mm = params.camera.working_distance_mm;
        let scan = |name, s, distance_mm| PieceScan { name, s, t_world_camera: self.camera.at(s), distance_mm };
        let scans = [
            scan("calibration", CALIBRATION_S, params.phantom.distance_mm.unwrap_or(working_mm)),
            scan(WORKING, SCAN_S, working_mm),
        ];
        let spread_rad = params.camera.view_spread_deg.to_radians();
        let holes = read_holes(&scans, tracker, bias, &params.check, spread_rad).into_iter();
        holes.map(|(read, known)| (self.holes_as_written(read), known)).collect()
    }
}

#[cfg(test)]
#[path = "../tests/common/exact.rs"]
mod exact;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{bone, phantom, plan};

    pub(super) const RUNS: u64 = 400;

    /// Evaluates one scene with many seeds for the errors; its poses are drawn once.
    pub(super) fn over_seeds<T>(params: &ProcedureParams, what: impl Fn(&Scene<'_>, &[Pixel]) -> T) -> Vec<T> {
        let bone = bone::fibula(&params.bone);
        let plan = plan(&bone, &bone::anatomy(&params.bone)).unwrap();
        let (surface, phantom) = (MeshQuery::new(&bone), phantom::mesh());
        let mut scene = Scene::new(&surface, &plan, &phantom, params, 1).unwrap();
        let seen = scene.bone_view(SCAN_S, &DepthBias::new(&params.camera, 1), None).unwrap();
        (0..RUNS)
            .map(|seed| {
                scene.seed = seed;
                what(&scene, &seen)
            })
            .collect()
    }

    pub(super) fn small_and_exact() -> ProcedureParams {
        let mut params = exact::without_errors(ProcedureParams::default());
        params.camera.n_points = 500;
        params
    }

    pub(super) fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
        let (sum, n) = values.into_iter().fold((0.0, 0usize), |(sum, n), v| (sum + v * v, n + 1));
        (sum / n as f64).sqrt()
    }
}
