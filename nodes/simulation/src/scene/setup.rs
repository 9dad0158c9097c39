//! What stands where and what moves when, drawn from the seed.

use super::places::{bone_marker_pose, carried, phantom_pose, scan_pose, towards_camera};
use super::ruler::Ruler;
use super::{CALIBRATION_S, LASER_EVERY_S, MOTION_S, PALPATION_RATE_HZ, SCAN_S, Scene, TOUCH_EVERY_S};
use crate::draws::{Term, attitude, direction, normal, small_motion, stream};
use crate::plan::section_centre;
use crate::procedure::t_camera_camera_marker_nominal;
use crate::surroundings::surroundings;
use crate::tracker::Path;
use crate::{ProcedureParams, SimulationError, phantom};
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Mesh, Points, SurgicalPlan};
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
        let anatomy = plan.anatomy.as_ref().ok_or(SimulationError::NoAnatomy)?;
        let needs =
            [("landmarks", plan.landmarks.points.len(), 3), ("assessment points", plan.assessment.points.len(), 1)];
        if let Some(&(what, found, needed)) = needs.iter().find(|&&(_, found, needed)| found < needed) {
            return Err(SimulationError::TooFewPoints { what, found, needed });
        }
        plan.landmarks.frame.expect(&bone.frame, "the plan's landmarks")?;
        plan.assessment.frame.expect(&bone.frame, "the plan's assessment points")?;
        plan.planes.frame.expect(&bone.frame, "the plan's planes")?;
        let nothing = |what, hint| SimulationError::NothingVisible { what, hint };
        let phantom_surface = MeshQuery::new(phantom);

        let mut setup = stream(seed, Term::Setup, 0);
        // The bone lies anyhow in the localiser's world, about 1.2 m from its origin.
        let middle_mm = (params.camera.scan_from_mm + params.camera.scan_to_mm) / 2.0;
        let focus =
            section_centre(bone, anatomy, middle_mm).ok_or(SimulationError::NoSection { height_mm: middle_mm })?;
        let place = direction(&mut setup) * (1200.0 + 100.0 * normal(&mut setup));
        let lies = Translation3::from(place) * attitude(&mut setup) * Translation3::from(-focus.coords);
        let t_ct_camera = scan_pose(bone_surface, anatomy, &focus, params, seed)
            .ok_or(nothing("bone", "scan_from_mm and scan_to_mm should lie on the bone"))?;
        // Without a localiser the camera is the world.
        let t_world_ct = if params.tracker.none { t_ct_camera.inverse() } else { lies };

        let around = params.camera.surroundings.then(|| {
            let stretch_mm = [params.camera.scan_from_mm, params.camera.scan_to_mm];
            surroundings(bone, anatomy, &towards_camera(anatomy, params), stretch_mm)
                .ok_or(nothing("bone", "scan_from_mm and scan_to_mm should lie on the bone"))
        });
        let around = around.transpose()?.map(|mesh| MeshQuery::new(&mesh));

        // Between calibration and scan the camera is carried from the phantom to the bone.
        let before = carried(&mut setup);
        let before = if params.tracker.none { Isometry3::identity() } else { before };
        let mut camera = Path::resting(t_world_ct * t_ct_camera * before);
        let t_camera_phantom = phantom_pose(phantom, params, &mut setup);
        let phantom_path = Path::resting(camera.at(0.0) * t_camera_phantom);
        let at_phantom = camera.at(0.0);
        let at_bone = t_world_ct * t_ct_camera;
        let turn = (at_bone.rotation * at_phantom.rotation.inverse()).scaled_axis();
        let shift = at_bone.translation.vector - at_phantom.translation.vector;
        camera.then(CALIBRATION_S + 2.0, SCAN_S - 2.0, shift, turn, Point3::origin());

        let motion = &params.motion;
        let mut bone_path = Path::resting(t_world_ct);
        let ruler = Ruler { params: &params.ruler, surface: bone_surface, anatomy, seed };
        let landmarks = ruler.marks(&plan.landmarks, 0)?;
        let assessment = ruler.marks(&plan.assessment, plan.landmarks.points.len())?;
        let mut shown = landmarks.points.to_vec();
        if params.laser.assessment {
            shown.extend(assessment.points.iter().cloned());
        }
        let laser_marks = Points::new(&bone.frame, shown);
        let n_laser = laser_marks.points.len();
        for gap in 0..n_laser {
            // In the 0.2 s midway between two clouds, outside every burst.
            let s = SCAN_S + (gap as f64 + 0.5) * LASER_EVERY_S;
            let mut rng = stream(seed, Term::MotionBetweenScans, gap as u64);
            let (shift, turn) = any_way(&mut rng, motion.bone_between_scans_mm, motion.bone_between_scans_deg);
            if motion.bone_between_scans_mm > 0.0 || motion.bone_between_scans_deg > 0.0 {
                bone_path.then(s - 0.1, s + 0.1, shift, turn, focus);
            }
            let mut rng = stream(seed, Term::CameraMotionBetweenScans, gap as u64);
            let (shift, turn) = any_way(&mut rng, motion.camera_between_scans_mm, motion.camera_between_scans_deg);
            if motion.camera_between_scans_mm > 0.0 || motion.camera_between_scans_deg > 0.0 {
                let in_view = Point3::new(0.0, 0.0, params.camera.working_distance_mm);
                camera.then(s - 0.1, s + 0.1, shift, turn, in_view);
            }
        }
        let touches_s = SCAN_S + n_laser as f64 * LASER_EVERY_S + 2.0;
        let n_touches = landmarks.points.len() + assessment.points.len();
        let palpation_s = params.stylus.n_palpated as f64 / PALPATION_RATE_HZ;
        let motion_s = (touches_s + (n_touches + 2) as f64 * TOUCH_EVERY_S + palpation_s + 1.0).ceil();
        let mut rng = stream(seed, Term::BoneMotion, 0);
        let (shift, turn) = any_way(&mut rng, motion.bone_mm, motion.bone_deg);
        bone_path.then(motion_s, motion_s + MOTION_S, shift, turn, focus);

        let design =
            plan.t_phantom_phantom_marker.as_ref().map_or_else(phantom::t_phantom_phantom_marker, |p| p.isometry);
        let nominal =
            plan.t_camera_camera_marker_nominal.as_ref().map_or_else(t_camera_camera_marker_nominal, |p| p.isometry);
        let wrong = &params.phantom;
        let print = small_motion(
            &mut stream(wrong.print_seed.unwrap_or(seed), Term::PhantomPrint, 0),
            wrong.print_mm,
            wrong.print_deg.to_radians(),
        );
        let mounted = small_motion(
            &mut stream(wrong.mounting_seed.unwrap_or(seed), Term::CameraMarkerMounting, 0),
            wrong.mounting_mm,
            wrong.mounting_deg.to_radians(),
        );
        let t_ct_bone_marker = bone_marker_pose(anatomy, &focus, &mut setup);
        let mut slip = stream(seed, Term::MarkerSlip, 0);
        let (shift, turn) = any_way(&mut slip, motion.marker_slip_mm, motion.marker_slip_deg);
        let slip = Isometry3::new(shift, turn);
        let has_slipped = motion.marker_slip_mm > 0.0 || motion.marker_slip_deg > 0.0;
        Ok(Self {
            params,
            seed,
            plan,
            anatomy,
            bone,
            bone_surface,
            around,
            phantom,
            phantom_surface,
            camera,
            bone_path,
            phantom_path,
            t_camera_camera_marker: if params.tracker.none { Isometry3::identity() } else { nominal * mounted },
            t_phantom_phantom_marker_cad: design,
            t_phantom_phantom_marker: design * print,
            t_ct_bone_marker_slipped: if has_slipped { t_ct_bone_marker * slip } else { t_ct_bone_marker },
            t_ct_bone_marker,
            laser_marks,
            assessment,
            touches_s,
            motion_s,
        })
    }
}

/// A shift and a turn of these sizes, each in any direction.
fn any_way(rng: &mut ChaCha8Rng, shift_mm: f64, turn_deg: f64) -> (Vector3<f64>, Vector3<f64>) {
    let (way, about) = (direction(rng), direction(rng));
    (way * shift_mm, about * turn_deg.to_radians())
}
