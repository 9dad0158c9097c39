//! Poses, marks and motions of a procedure, drawn from the seed.

use super::places::{bone_marker_pose, bone_pose, camera_offset_at_phantom, phantom_pose, scan_pose, towards_camera};
use super::ruler::Ruler;
use super::{CALIBRATION_S, LASER_EVERY_S, MOTION_S, PALPATION_RATE_HZ, SCAN_S, Scene, TOUCH_EVERY_S, laser_s};
use crate::draws::{Term, direction, small_motion, stream};
use crate::params::{MotionParams, PhantomParams};
use crate::phantom::t_camera_camera_marker_nominal;
use crate::plan::section_centre;
use crate::surroundings::surroundings;
use crate::tracker::{Passes, Path, Shake};
use crate::{ProcedureParams, SimulationError, phantom};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Anatomy, Mesh, Points, SurgicalPlan};
use rand_chacha::ChaCha8Rng;

impl<'a> Scene<'a> {
    pub(crate) fn new(
        bone_surface: &'a MeshQuery,
        plan: &'a SurgicalPlan,
        phantom: &'a Mesh,
        params: &'a ProcedureParams,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        let bone = bone_surface.mesh();
        let anatomy = anatomy_of(plan, bone)?;
        let untracked = params.tracker.none;
        // The order of the draws determines what a seed gives: bone, camera offset, phantom, bone marker.
        let rng = &mut stream(seed, Term::Setup, 0);

        let middle_mm = (params.camera.scan_from_mm + params.camera.scan_to_mm) / 2.0;
        let focus = section_centre(bone, anatomy, middle_mm)?;
        let t_world_ct = bone_pose(&focus, rng);
        let t_ct_camera = scan_pose(bone_surface, anatomy, &focus, params, seed).ok_or_else(no_stretch)?;
        // Without a localiser the camera is the world.
        let t_world_ct = if untracked { t_ct_camera.inverse() } else { t_world_ct };
        let around = surroundings_of(bone, anatomy, params)?;

        let offset = camera_offset_at_phantom(rng);
        let offset = if untracked { Isometry3::identity() } else { offset };
        let at_bone = t_world_ct * t_ct_camera;
        let mut camera = Path::resting(at_bone * offset);
        let phantom_path = Path::resting(camera.at(0.0) * phantom_pose(phantom, params, rng));
        carry_to_bone(&mut camera, &at_bone);

        let ruler = Ruler { params: &params.ruler, surface: bone_surface, anatomy, seed };
        let landmarks = ruler.marks(&plan.landmarks, 0)?;
        let assessment = ruler.marks(&plan.assessment, plan.landmarks.points.len())?;
        let laser_marks = laser_marks(&landmarks, &assessment, params);
        let n_laser = laser_marks.points.len();

        let mut bone_path = Path::resting(t_world_ct);
        move_between_scans(&mut bone_path, &mut camera, n_laser, &focus, params, seed);
        pass_at_scans([&mut camera, &mut bone_path], n_laser, &focus, params, seed);
        let touches_s = SCAN_S + n_laser as f64 * LASER_EVERY_S + 2.0;
        let n_touches = landmarks.points.len() + assessment.points.len();
        let palpation_s = params.stylus.n_palpated as f64 / PALPATION_RATE_HZ;
        let saw_s = (touches_s + (n_touches + 2) as f64 * TOUCH_EVERY_S + palpation_s + 1.0).ceil();
        let motion = &params.motion;
        let motion_s = saw_s + motion.saw_s;
        saw(&mut bone_path, [saw_s, motion_s], focus, motion, seed);
        let (shift, turn) = random_motion(&mut stream(seed, Term::BoneMotion, 0), motion.bone_mm, motion.bone_deg);
        bone_path.then(motion_s, motion_s + MOTION_S, shift, turn, focus);

        let t_phantom_phantom_marker_cad =
            plan.t_phantom_phantom_marker.as_ref().map_or_else(phantom::t_phantom_phantom_marker, |p| p.isometry);
        let t_camera_camera_marker =
            plan.t_camera_camera_marker_nominal.as_ref().map_or_else(t_camera_camera_marker_nominal, |p| p.isometry);
        let t_camera_camera_marker = if untracked {
            Isometry3::identity()
        } else {
            t_camera_camera_marker * mounting_error(&params.phantom, seed)
        };
        let slip = [motion.marker_slip_mm, motion.marker_slip_deg];
        let knock = if untracked { [0.0, 0.0] } else { [motion.knock_mm, motion.knock_deg] };
        let wrong_cad = [params.phantom.marker_cad_wrong_mm, params.phantom.marker_cad_wrong_deg];
        let t_ct_bone_marker = bone_marker_pose(anatomy, &focus, rng);
        Ok(Self {
            params,
            seed,
            plan,
            anatomy,
            bone,
            bone_surface,
            around,
            phantom,
            phantom_surface: MeshQuery::new(phantom),
            camera,
            bone_path,
            phantom_path,
            t_camera_camera_marker,
            t_camera_camera_marker_knocked: displaced(t_camera_camera_marker, knock, Term::CameraMarkerKnock, seed),
            t_phantom_phantom_marker_written: displaced(
                t_phantom_phantom_marker_cad,
                wrong_cad,
                Term::PhantomMarkerCad,
                seed,
            ),
            t_phantom_phantom_marker: t_phantom_phantom_marker_cad * print_error(&params.phantom, seed),
            t_ct_bone_marker_slipped: displaced(t_ct_bone_marker, slip, Term::MarkerSlip, seed),
            t_ct_bone_marker,
            laser_marks,
            assessment,
            touches_s,
            motion_s,
        })
    }
}

fn no_stretch() -> SimulationError {
    SimulationError::nothing_visible("bone", "scan_from_mm and scan_to_mm should lie on the bone")
}

/// The plan's anatomy, where the plan suits the bone and has enough points.
fn anatomy_of<'a>(plan: &'a SurgicalPlan, bone: &Mesh) -> Result<&'a Anatomy, SimulationError> {
    let anatomy = plan.anatomy.as_ref().ok_or_else(SimulationError::no_anatomy)?;
    let needs = [("landmarks", plan.landmarks.points.len(), 3), ("assessment points", plan.assessment.points.len(), 1)];
    if let Some(&(what, found, needed)) = needs.iter().find(|&&(_, found, needed)| found < needed) {
        return Err(SimulationError::Unsuitable(format!(
            "the plan has {found} {what}, but at least {needed} are needed to simulate a procedure"
        )));
    }
    plan.landmarks.frame.expect(&bone.frame, "the plan's landmarks")?;
    plan.assessment.frame.expect(&bone.frame, "the plan's assessment points")?;
    plan.planes.frame.expect(&bone.frame, "the plan's planes")?;
    Ok(anatomy)
}

/// Soft tissue around the stripped bone, where it is simulated.
fn surroundings_of(
    bone: &Mesh,
    anatomy: &Anatomy,
    params: &ProcedureParams,
) -> Result<Option<MeshQuery>, SimulationError> {
    if !params.camera.surroundings {
        return Ok(None);
    }
    let stretch_mm = [params.camera.scan_from_mm, params.camera.scan_to_mm];
    let mesh = surroundings(bone, anatomy, &towards_camera(anatomy, params), stretch_mm).ok_or_else(no_stretch)?;
    Ok(Some(MeshQuery::new(&mesh)))
}

/// Moves the camera from the phantom to the bone, between calibration and scan.
fn carry_to_bone(camera: &mut Path, at_bone: &Isometry3<f64>) {
    let at_phantom = camera.at(0.0);
    let turn = (at_bone.rotation * at_phantom.rotation.inverse()).scaled_axis();
    let shift = at_bone.translation.vector - at_phantom.translation.vector;
    camera.then(CALIBRATION_S + 2.0, SCAN_S - 2.0, shift, turn, Point3::origin());
}

/// The marks that the laser points at in turn.
fn laser_marks(landmarks: &Points, assessment: &Points, params: &ProcedureParams) -> Points {
    let mut marks = landmarks.points.to_vec();
    if params.laser.assessment {
        marks.extend(assessment.points.iter().cloned());
    }
    Points::new(&landmarks.frame, marks)
}

/// Moves bone and camera before each laser scan, in the 0.2 s midway between two clouds and outside every burst.
fn move_between_scans(
    bone: &mut Path,
    camera: &mut Path,
    n_laser: usize,
    focus: &Point3<f64>,
    params: &ProcedureParams,
    seed: u64,
) {
    let motion = &params.motion;
    let in_view = Point3::new(0.0, 0.0, params.camera.working_distance_mm);
    let moves = [
        (Term::MotionBetweenScans, bone, motion.bone_between_scans_mm, motion.bone_between_scans_deg, *focus),
        (
            Term::CameraMotionBetweenScans,
            camera,
            motion.camera_between_scans_mm,
            motion.camera_between_scans_deg,
            in_view,
        ),
    ];
    let is_carried = motion.carry_mm > 0.0 || motion.carry_deg > 0.0;
    for (term, path, shift_mm, turn_deg, pivot) in moves {
        let is_carried = is_carried && term == Term::MotionBetweenScans;
        let is_moved = shift_mm > 0.0 || turn_deg > 0.0;
        for gap in 0..n_laser {
            let s = SCAN_S + (gap as f64 + 0.5) * LASER_EVERY_S;
            let carry = random_motion(&mut stream(seed, Term::Carry, gap as u64), motion.carry_mm, motion.carry_deg);
            if is_carried {
                path.then(s - 0.1 - CARRY_S, s - 0.1, carry.0, carry.1, pivot);
            }
            if is_moved {
                let (shift, turn) = random_motion(&mut stream(seed, term, gap as u64), shift_mm, turn_deg);
                path.then(s - 0.1, s + 0.1, shift, turn, pivot);
            }
            if is_carried {
                path.then(s + 0.1, s + 0.1 + CARRY_S, -carry.0, -carry.1, pivot);
            }
        }
    }
}

/// Time for which the bone is carried away, and back.
const CARRY_S: f64 = 1.0;

/// Lets camera and bone move at every cloud of the bone, each about a point of its frame.
fn pass_at_scans(
    [camera, bone]: [&mut Path; 2],
    n_laser: usize,
    focus: &Point3<f64>,
    params: &ProcedureParams,
    seed: u64,
) {
    let MotionParams { camera_speed_mm_s, camera_speed_deg_s, bone_speed_mm_s, bone_speed_deg_s, .. } = params.motion;
    let in_view = Point3::new(0.0, 0.0, params.camera.working_distance_mm);
    let half_s = (params.camera.scan_s / 2.0 + 0.1).max(1.0);
    for (term, path, mm_per_s, deg_per_s, pivot) in [
        (Term::CameraSpeed, camera, camera_speed_mm_s, camera_speed_deg_s, in_view),
        (Term::BoneSpeed, bone, bone_speed_mm_s, bone_speed_deg_s, *focus),
    ] {
        if mm_per_s > 0.0 || deg_per_s > 0.0 {
            let (mm_per_s, rad_per_s) = random_motion(&mut stream(seed, term, 0), mm_per_s, deg_per_s);
            let moments_s = std::iter::once(SCAN_S).chain((0..n_laser).map(laser_s)).collect();
            path.passing(Passes { mm_per_s, rad_per_s, pivot, moments_s, half_s });
        }
    }
}

/// Lets the bone shake between two times.
fn saw(bone: &mut Path, [from_s, to_s]: [f64; 2], pivot: Point3<f64>, motion: &MotionParams, seed: u64) {
    if motion.saw_s > 0.0 {
        let (shift, turn) = random_motion(&mut stream(seed, Term::Saw, 0), motion.saw_mm, motion.saw_deg);
        bone.shaken(Shake { from_s, to_s, hz: motion.saw_hz, shift, turn, pivot });
    }
}

/// Error of the printed phantom: of its marker's place against its CAD.
fn print_error(params: &PhantomParams, seed: u64) -> Isometry3<f64> {
    let rng = &mut stream(params.print_seed.unwrap_or(seed), Term::PhantomPrint, 0);
    small_motion(rng, params.print_mm, params.print_deg.to_radians())
}

/// Error of the camera marker's support against its design.
fn mounting_error(params: &PhantomParams, seed: u64) -> Isometry3<f64> {
    let rng = &mut stream(params.mounting_seed.unwrap_or(seed), Term::CameraMarkerMounting, 0);
    small_motion(rng, params.mounting_mm, params.mounting_deg.to_radians())
}

/// The pose of a marker on an object, displaced by these sizes in random directions: itself if both are 0.
fn displaced(t_object_marker: Isometry3<f64>, [shift_mm, turn_deg]: [f64; 2], term: Term, seed: u64) -> Isometry3<f64> {
    if shift_mm <= 0.0 && turn_deg <= 0.0 {
        return t_object_marker;
    }
    let (shift, turn) = random_motion(&mut stream(seed, term, 0), shift_mm, turn_deg);
    t_object_marker * Isometry3::new(shift, turn)
}

/// Shift (mm) and rotation vector (rad) of the given sizes in random directions.
fn random_motion(rng: &mut ChaCha8Rng, shift_mm: f64, turn_deg: f64) -> (Vector3<f64>, Vector3<f64>) {
    let (way, axis) = (direction(rng), direction(rng));
    (way * shift_mm, axis * turn_deg.to_radians())
}
