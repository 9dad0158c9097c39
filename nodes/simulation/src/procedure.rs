//! One whole procedure: calibration, scan, three laser scans, stylus, and a bone that moves afterwards.

use crate::scene::Scene;
use crate::{ProcedureParams, SimulationError, Subject, phantom};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Cloud, Mesh, Planes, Points, Pose, Region, SurgicalPlan};

/// Everything that a recording of a real procedure holds, and, kept apart, the truth.
///
/// Clouds lie in frame `camera`, marker poses are `t_world_<marker>` in order of time, stylus points lie in `world`; all
/// stamps are nanoseconds since the Unix epoch.
#[derive(Debug, Clone, PartialEq)]
pub struct Procedure {
    /// What was planned on the bone, frame `ct`.
    pub plan: SurgicalPlan,
    /// The phantom's CAD, frame `phantom`.
    pub phantom: Mesh,
    /// One scan of the phantom.
    pub phantom_scan: Cloud,
    /// The full scan of the bone.
    pub scan: Cloud,
    /// The same view with the laser on each landmark in turn, labelled `P1`, `P2`, ...: a disc around the spot is missing.
    /// Where asked for, the assessment marks follow.
    pub laser: Vec<Cloud>,
    /// `t_world_camera_marker`, in bursts around each cloud.
    pub camera_marker: Vec<Pose>,
    /// `t_world_phantom_marker`, around the calibration only.
    pub phantom_marker: Vec<Pose>,
    /// `t_world_bone_marker`, around each scan, during all touches, and through the bone's last motion.
    pub bone_marker: Vec<Pose>,
    /// `t_phantom_phantom_marker` by CAD: not quite what was printed.
    pub t_phantom_phantom_marker: Pose,
    /// The stylus on the marks that the laser pointed at: the baseline's start.
    pub stylus_init: Points,
    /// The stylus in the assessment holes, M1 to M5 in order.
    pub stylus_assessment: Points,
    /// The stylus on the stripped surface, named `1`, `2`, ...: the baseline's cloud.
    pub stylus_palpation: Points,
    /// The holes of the check piece as read from its cloud, frame `camera`, and as localiser and CAD give them, frame `world`:
    /// first where the phantom stood (`calibration_1`, ..), then where the bone lies (`working_1`, ..).
    pub check: Vec<(Points, Points)>,
    /// `t_world_stylus_marker` while the stylus was turned about its tip; none where that was not asked for.
    pub stylus_pivoting: Vec<Pose>,
    /// `t_world_stylus_marker` at each touch, after such a calibration.
    pub stylus_marker: Vec<Pose>,
    /// The user's region of interest, frame `camera`.
    pub region: Option<Region>,
    /// What really was, for scoring only.
    pub truth: Truth,
}

/// What really was. Nothing of it is an input of a registration.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// The surface that was scanned, frame `ct`.
    pub bone: Mesh,
    /// How the camera's marker truly sits.
    pub t_camera_camera_marker: Pose,
    /// How the phantom's marker was truly printed.
    pub t_phantom_phantom_marker: Pose,
    /// Where the phantom truly was in its scan.
    pub t_camera_phantom: Pose,
    /// Where the camera truly was at the full scan.
    pub t_world_camera_at_scan: Pose,
    /// Where the bone truly was at the full scan.
    pub t_world_ct_at_scan: Pose,
    /// Where the bone truly was at each laser scan.
    pub t_world_ct_at_laser: Vec<Pose>,
    /// Where the bone truly was during the touches.
    pub t_world_ct_at_touches: Pose,
    /// Where the bone truly is in the end.
    pub t_world_ct_after_motion: Pose,
    /// Where the bone's marker truly was at the full scan.
    pub t_world_bone_marker_at_scan: Pose,
    /// How the bone's marker truly sits on the bone.
    pub t_ct_bone_marker: Pose,
    /// How it sits during the touches, when it may have slipped.
    pub t_ct_bone_marker_at_touches: Pose,
    /// The marks that the laser was to show, frame `ct`: the planned points with the ruler's error.
    pub laser_marks_ct: Points,
    /// The assessment marks, frame `ct`: the planned points with the ruler's error.
    pub assessment_ct: Points,
    /// The stylus' tip in its marker's frame, where its marker is tracked.
    pub stylus_tip: Option<Point3<f64>>,
    /// Where the laser spots truly were, frame `ct`: the marks with the aiming error.
    pub laser_spots_ct: Points,
    /// The same in `world`, each at its own scan.
    pub laser_spots_world: Points,
    /// The assessment holes during the touches, frame `world`.
    pub assessment_world: Points,
    /// The planned planes at the full scan, frame `world`.
    pub planes_world_at_scan: Planes,
    /// The planned planes in the end, frame `world`.
    pub planes_world_after_motion: Planes,
}

/// `t_camera_camera_marker` as the support was designed: the marker beside and behind the lens.
pub fn t_camera_camera_marker_nominal() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(36.0, -58.0, -21.0), Vector3::new(-0.4, 0.3, 1.1))
}

impl Procedure {
    /// A procedure on the built-in bone. The same parameters and seed give the same bits on any number of threads.
    ///
    /// # Errors
    /// [`SimulationError`] if a parameter makes no sense or leaves nothing to be seen.
    pub fn simulate(params: &ProcedureParams, seed: u64) -> Result<Self, SimulationError> {
        Self::simulate_for(&Subject::built_in(&params.bone)?, params, seed)
    }

    /// A procedure on a subject, which may serve for many, calibrated with the built-in phantom. `params.bone` is not used.
    ///
    /// # Errors
    /// As [`Procedure::simulate_on`].
    pub fn simulate_for(subject: &Subject, params: &ProcedureParams, seed: u64) -> Result<Self, SimulationError> {
        params.check()?;
        Scene::new(&subject.surface, &subject.plan, &phantom::mesh(), params, seed)?.run()
    }

    /// A procedure on any closed bone surface with a plan, calibrated with any phantom. `params.bone` is not used.
    ///
    /// Where the plan gives no marker poses, the built-in ones are taken.
    ///
    /// # Errors
    /// As [`Procedure::simulate`]; and if the plan has no anatomy, fewer than three landmarks or no assessment point, or
    /// lies in another frame than the bone.
    pub fn simulate_on(
        bone: &Mesh,
        plan: &SurgicalPlan,
        phantom: &Mesh,
        params: &ProcedureParams,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        params.check()?;
        Scene::new(&MeshQuery::new(bone), plan, phantom, params, seed)?.run()
    }
}
