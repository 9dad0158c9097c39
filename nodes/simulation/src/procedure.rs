//! One whole procedure: calibration, scan, three laser scans, stylus, and a bone that moves afterwards.

use crate::camera::{DepthBias, Hole, Periosteum, Pixel, Shot, Sight, Stretch, Wound, scan, view};
use crate::check_piece::{Look, look_at};
use crate::draws::{Term, attitude, direction, normal, normal3, small_motion, stream};
use crate::params::LaserDisc;
use crate::plan::{frame_along, section_centre};
use crate::stylus::{self, Stylus};
use crate::surroundings::surroundings;
use crate::tracker::{Marker, Path, Tracker};
use crate::{ProcedureParams, RulerParams, SimulationError, Subject, phantom};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Anatomy, Cloud, Mesh, NamedPoint, Planes, Points, Pose, Region, StampNs, SurgicalPlan};
use rand::RngExt;

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

/// When each cloud is taken, seconds after the start: the rhythm of the development recording.
const CALIBRATION_S: f64 = 1.0;
const SCAN_S: f64 = 11.0;
const LASER_EVERY_S: f64 = 4.0;
/// Marks, holes and palpation, and how long each touch takes.
const TOUCH_EVERY_S: f64 = 0.5;
const PALPATION_RATE_HZ: f64 = 20.0;
/// The last motion and the rest after it.
const MOTION_S: f64 = 2.0;
const REST_S: f64 = 3.0;

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

/// The operating room: what stands where, and what moves.
struct Scene<'a> {
    params: &'a ProcedureParams,
    seed: u64,
    plan: &'a SurgicalPlan,
    anatomy: &'a Anatomy,
    bone: &'a Mesh,
    bone_surface: &'a MeshQuery,
    /// What else is seen in the wound, in the bone's frame.
    around: Option<MeshQuery>,
    phantom: &'a Mesh,
    phantom_surface: MeshQuery,
    /// `t_world_camera` over time.
    camera: Path,
    /// `t_world_ct` over time.
    bone_path: Path,
    /// `t_world_phantom`, at rest.
    phantom_path: Path,
    t_camera_camera_marker: Isometry3<f64>,
    t_phantom_phantom_marker_cad: Isometry3<f64>,
    t_phantom_phantom_marker: Isometry3<f64>,
    t_ct_bone_marker: Isometry3<f64>,
    t_ct_bone_marker_slipped: Isometry3<f64>,
    /// The marks on the bone: what the laser shows in turn, and what is assessed, frame of the bone.
    laser_marks: Points,
    assessment: Points,
    /// When the touches begin, and when the last motion does.
    touches_s: f64,
    motion_s: f64,
}

impl<'a> Scene<'a> {
    fn new(
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
            let (way, about) = (direction(&mut rng), direction(&mut rng));
            let (shift, turn) =
                (way * motion.bone_between_scans_mm, about * motion.bone_between_scans_deg.to_radians());
            if motion.bone_between_scans_mm > 0.0 || motion.bone_between_scans_deg > 0.0 {
                bone_path.then(s - 0.1, s + 0.1, shift, turn, focus);
            }
            let mut rng = stream(seed, Term::CameraMotionBetweenScans, gap as u64);
            let (way, about) = (direction(&mut rng), direction(&mut rng));
            let (shift, turn) =
                (way * motion.camera_between_scans_mm, about * motion.camera_between_scans_deg.to_radians());
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
        let (way, about) = (direction(&mut rng), direction(&mut rng));
        bone_path.then(
            motion_s,
            motion_s + MOTION_S,
            way * motion.bone_mm,
            about * motion.bone_deg.to_radians(),
            focus,
        );

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
        let (way, about) = (direction(&mut slip), direction(&mut slip));
        let slip = Isometry3::new(way * motion.marker_slip_mm, about * motion.marker_slip_deg.to_radians());
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

    fn run(&self) -> Result<Procedure, SimulationError> {
        let params = self.params;
        let tracker = Tracker {
            params: &params.tracker,
            seed: self.seed,
            start_ns: StampNs::from(params.motion.start_s) * 1_000_000_000,
        };
        let bias = DepthBias::new(&params.camera, self.seed);

        let t_phantom_camera = self.phantom_path.at(CALIBRATION_S).inverse() * self.camera.at(CALIBRATION_S);
        let sight = Sight { object: &self.phantom_surface, stretch: None, around: None };
        let pixels = view(&sight, &t_phantom_camera, &params.camera, &bias);
        if pixels.is_empty() {
            return Err(SimulationError::NothingVisible { what: "phantom", hint: "is its mesh in millimetres?" });
        }
        let take = |shot: Shot<'_>| scan(&shot, &params.camera, self.seed);
        let stamp = |s: f64| tracker.stamp(s);
        let phantom_scan = take(Shot {
            pixels: &pixels,
            t_object_camera: t_phantom_camera,
            hole: None,
            wound: None,
            stamp_ns: stamp(CALIBRATION_S),
            number: 0,
        })?;

        let seen = self.bone_view(SCAN_S, &bias)?;
        let on_bone: Vec<Pixel> = seen.iter().copied().filter(|p| p.on_object).collect();
        let spots = self.laser_spots()?;
        let wound = self.wound(&on_bone, &spots);
        let of_bone = |pixels: &[Pixel], hole, s: f64, number| {
            let t_object_camera = self.t_ct_camera(s);
            take(Shot { pixels, t_object_camera, hole, wound: Some(&wound), stamp_ns: stamp(s), number })
        };
        let full = of_bone(&seen, None, SCAN_S, 1)?;
        let laser_s = |k: usize| SCAN_S + (k + 1) as f64 * LASER_EVERY_S;
        let still = self.is_still_between_scans();
        let laser = spots.points.iter().enumerate().map(|(k, spot)| {
            let s = laser_s(k);
            let hole = self.hole(k, &(self.t_ct_camera(s).inverse() * spot.position));
            let again = if still { None } else { Some(self.bone_view(s, &bias)?) };
            let pixels = again.as_deref().unwrap_or(&seen);
            if !pixels.iter().any(|p| p.on_object && (p.point() - hole.spot).norm() < hole.radius_mm) {
                return Err(SimulationError::SpotHidden { name: spot.name.to_string() });
            }
            Ok(of_bone(pixels, Some(hole), s, 2 + k as u64)?.labelled(spot.name.clone()))
        });
        let laser = if params.laser.scans { laser.collect::<Result<Vec<_>, SimulationError>>()? } else { Vec::new() };

        let end_s = self.motion_s + MOTION_S + REST_S;
        let burst = |s: f64| (s - params.tracker.burst_s, s + params.tracker.burst_s);
        let scans: Vec<(f64, f64)> = (0..=laser.len()).map(|k| burst(SCAN_S + k as f64 * LASER_EVERY_S)).collect();
        let camera_spans: Vec<_> = std::iter::once(burst(CALIBRATION_S)).chain(scans.iter().copied()).collect();
        let bone_spans: Vec<_> = scans.into_iter().chain([(self.touches_s - 0.5, end_s)]).collect();
        let on_camera = |_| self.t_camera_camera_marker;
        let mut camera_marker = tracker.samples(Marker::Camera, &self.camera, on_camera, &camera_spans);
        let mut phantom_marker = tracker.samples(
            Marker::Phantom,
            &self.phantom_path,
            |_| self.t_phantom_phantom_marker,
            &[burst(CALIBRATION_S)],
        );
        let on_marked_bone = |s: f64| self.t_ct_bone_marker_at(s);
        let mut bone_marker = tracker.samples(Marker::Bone, &self.bone_path, on_marked_bone, &bone_spans);
        let mut check = Vec::new();
        let mut touches = Touches::default();
        if params.tracker.none {
            camera_marker.iter_mut().for_each(|pose| pose.isometry = Isometry3::identity());
            phantom_marker.clear();
            bone_marker.clear();
        } else {
            let far_mm = params.phantom.distance_mm.unwrap_or(params.camera.working_distance_mm);
            let look = |name, s, distance_mm| Look { name, s, t_world_camera: self.camera.at(s), distance_mm };
            let looks = [
                look("calibration", CALIBRATION_S, far_mm),
                look("working", SCAN_S, params.camera.working_distance_mm),
            ];
            check = look_at(&looks, &tracker, &bias, &params.check, params.camera.view_spread_deg.to_radians());
            touches = self.touches(&tracker, &spots, &on_bone)?;
        }
        let truth = self.truth(&tracker, spots, laser_s);
        Ok(Procedure {
            plan: self.plan.clone(),
            phantom: self.phantom.clone(),
            region: Some(region(&on_bone)),
            phantom_scan,
            scan: full,
            laser,
            camera_marker,
            phantom_marker,
            bone_marker,
            t_phantom_phantom_marker: Pose::new("phantom", "phantom_marker", self.t_phantom_phantom_marker_cad)
                .at(tracker.stamp(CALIBRATION_S)),
            stylus_init: touches.init,
            stylus_assessment: touches.assessment,
            stylus_palpation: touches.palpation,
            check,
            stylus_pivoting: touches.pivoting,
            stylus_marker: touches.marker,
            truth,
        })
    }

    fn t_ct_camera(&self, s: f64) -> Isometry3<f64> {
        self.bone_path.at(s).inverse() * self.camera.at(s)
    }

    fn t_ct_bone_marker_at(&self, s: f64) -> Isometry3<f64> {
        if s < self.touches_s - 0.5 { self.t_ct_bone_marker } else { self.t_ct_bone_marker_slipped }
    }

    /// What lies on the bone.
    fn wound(&self, seen: &[Pixel], spots: &Points) -> Wound {
        let params = &self.params.camera;
        let t_ct_camera = self.t_ct_camera(SCAN_S);
        let mut rng = stream(self.seed, Term::BloodPools, 0);
        let place = |_| t_ct_camera * seen[rng.random_range(0..seen.len())].point();
        // Marks are wiped clean, else nothing could be shown there.
        let clear_mm = params.pool_radius_mm + 1.5 * self.params.laser.hole_radius_mm;
        let is_clear = |pool: &Point3<f64>| spots.points.iter().all(|s| (s.position - pool).norm() > clear_mm);
        let n_pools = if seen.is_empty() { 0 } else { params.n_pools };
        Wound {
            periosteum: Periosteum::new(&self.params.periosteum, self.seed),
            pools: (0..n_pools).map(place).filter(is_clear).collect(),
        }
    }

    /// The hole about the `k`-th spot, camera frame.
    fn hole(&self, k: usize, spot: &Point3<f64>) -> Hole {
        let laser = &self.params.laser;
        let beam = match laser.disc {
            LaserDisc::Ball => None,
            LaserDisc::Beam => {
                let rng = &mut stream(self.seed, Term::LaserBeam, k as u64);
                let tilt = UnitQuaternion::from_scaled_axis(normal3(rng) * laser.beam_deg.to_radians());
                Some(Unit::new_normalize(tilt * spot.coords))
            }
        };
        Hole { spot: *spot, radius_mm: laser.hole_radius_mm, beam }
    }

    fn is_still_between_scans(&self) -> bool {
        let motion = &self.params.motion;
        [
            motion.bone_between_scans_mm,
            motion.bone_between_scans_deg,
            motion.camera_between_scans_mm,
            motion.camera_between_scans_deg,
        ]
        .iter()
        .all(|&size| size == 0.0)
    }

    /// The pixels that see the stripped bone.
    fn bone_view(&self, s: f64, bias: &DepthBias) -> Result<Vec<Pixel>, SimulationError> {
        let camera = &self.params.camera;
        let stretch = Stretch {
            from: self.anatomy.malleolus_tip,
            along: self.anatomy.proximal.into_inner(),
            min_mm: camera.scan_from_mm,
            max_mm: camera.scan_to_mm,
        };
        let sight = Sight { object: self.bone_surface, stretch: Some(&stretch), around: self.around.as_ref() };
        let pixels = view(&sight, &self.t_ct_camera(s), camera, bias);
        if !pixels.iter().any(|p| p.on_object) {
            let hint = "scan_from_mm and scan_to_mm should lie on the bone, view_azimuth_deg beside it";
            return Err(SimulationError::NothingVisible { what: "bone", hint });
        }
        Ok(pixels)
    }

    /// Where the laser truly points, frame of the bone: the marks, off by the aim across and along the bone.
    fn laser_spots(&self) -> Result<Points, SimulationError> {
        let aim = &self.params.laser;
        let spots = self.laser_marks.points.iter().enumerate().map(|(k, mark)| {
            let mut rng = stream(self.seed, Term::LaserAim, k as u64);
            let (across, along) = (normal(&mut rng) * aim.aim_across_mm, normal(&mut rng) * aim.aim_along_mm);
            beside(mark, across, along, self.bone_surface, self.anatomy)
        });
        Ok(Points::new(&self.bone.frame, spots.collect::<Result<Vec<_>, SimulationError>>()?))
    }

    /// Every touch of the stylus: first the marks, then the holes, then the surface.
    fn touches(&self, tracker: &Tracker<'_>, spots: &Points, seen: &[Pixel]) -> Result<Touches, SimulationError> {
        let params = &self.params.stylus;
        let tip = normal3(&mut stream(self.seed, Term::StylusCalibration, 0)) * params.tip_mm;
        let bias = normal3(&mut stream(self.seed, Term::PalpationBias, 0)) * params.palpation_bias_mm;
        // Turned about its tip beside the phantom, while the camera is carried.
        let dimple = self.phantom_path.at(CALIBRATION_S) * Point3::new(120.0, 0.0, 0.0);
        let mut tracked = match params.pivot_poses {
            0 => None,
            _ => Some(Stylus::calibrated(tracker, params, &dimple, (CALIBRATION_S + 2.0, SCAN_S - 2.0))?),
        };
        let towards_hand = towards_camera(self.anatomy, self.params);
        let mut touch = |name: &str, point_ct: &Point3<f64>, s: f64, error: Vector3<f64>| {
            let at = self.bone_path.at(s) * point_ct;
            let told = match &mut tracked {
                None => at + tracker.drift(s) + tip + error,
                Some(stylus) => stylus.touch(&(at + error), &(self.bone_path.at(s) * towards_hand), s),
            };
            NamedPoint { stamp_ns: tracker.stamp(s), ..NamedPoint::new(name, told) }
        };
        let mut rng = stream(self.seed, Term::StylusTouch, 0);
        let n_landmarks = self.plan.landmarks.points.len();
        let holes_s = self.touches_s + (n_landmarks + 1) as f64 * TOUCH_EVERY_S;
        let marks = [(&spots.points[..n_landmarks], self.touches_s), (&self.assessment.points[..], holes_s)];
        let [init, assessment] = marks.map(|(marks, first_s)| {
            let touched = marks.iter().enumerate().map(|(k, mark)| {
                let error = normal3(&mut rng) * params.touch_mm;
                touch(&mark.name, &mark.position, first_s + k as f64 * TOUCH_EVERY_S, error)
            });
            Points::new("world", touched.collect::<Vec<_>>())
        });

        let first_s = holes_s + (assessment.points.len() + 1) as f64 * TOUCH_EVERY_S;
        let t_ct_camera = self.t_ct_camera(SCAN_S);
        let mut place = stream(self.seed, Term::PalpationPlace, 0);
        let mut rng = stream(self.seed, Term::PalpationTouch, 0);
        let palpation = (0..params.n_palpated).map(|k| {
            let pixel = &seen[place.random_range(0..seen.len())];
            let error = bias + normal3(&mut rng) * params.palpation_mm;
            let s = first_s + k as f64 / PALPATION_RATE_HZ;
            touch(&(k + 1).to_string(), &(t_ct_camera * pixel.point()), s, error)
        });
        let palpation = Points::new("world", palpation.collect::<Vec<_>>());
        let (pivoting, marker) = tracked.map_or_else(Default::default, |stylus| (stylus.pivoting, stylus.touching));
        Ok(Touches { init, assessment, palpation, pivoting, marker })
    }

    fn truth(&self, tracker: &Tracker, spots: Points, laser_s: impl Fn(usize) -> f64) -> Truth {
        let ct = &self.bone.frame;
        let is_tracked = !self.params.tracker.none && self.params.stylus.pivot_poses > 0;
        let bone_at = |s: f64| Pose::new("world", ct, self.bone_path.at(s)).at(tracker.stamp(s));
        let end_s = self.motion_s + MOTION_S + REST_S;
        let in_world = spots.points.iter().enumerate().map(|(k, spot)| NamedPoint {
            stamp_ns: tracker.stamp(laser_s(k)),
            ..NamedPoint::new(spot.name.clone(), self.bone_path.at(laser_s(k)) * spot.position)
        });
        let planes_at = |s: f64| self.plan.planes.transformed("world", &self.bone_path.at(s)).at(tracker.stamp(s));
        Truth {
            bone: self.bone.clone(),
            t_camera_camera_marker: Pose::new("camera", "camera_marker", self.t_camera_camera_marker),
            t_phantom_phantom_marker: Pose::new("phantom", "phantom_marker", self.t_phantom_phantom_marker),
            t_camera_phantom: Pose::new(
                "camera",
                "phantom",
                self.camera.at(CALIBRATION_S).inverse() * self.phantom_path.at(CALIBRATION_S),
            )
            .at(tracker.stamp(CALIBRATION_S)),
            t_world_camera_at_scan: Pose::new("world", "camera", self.camera.at(SCAN_S)).at(tracker.stamp(SCAN_S)),
            t_world_ct_at_scan: bone_at(SCAN_S),
            t_world_ct_at_laser: (0..spots.points.len()).map(|k| bone_at(laser_s(k))).collect(),
            t_world_ct_at_touches: bone_at(self.touches_s),
            t_world_ct_after_motion: bone_at(end_s),
            t_world_bone_marker_at_scan: Pose::new(
                "world",
                "bone_marker",
                self.bone_path.at(SCAN_S) * self.t_ct_bone_marker,
            )
            .at(tracker.stamp(SCAN_S)),
            t_ct_bone_marker: Pose::new(ct, "bone_marker", self.t_ct_bone_marker),
            t_ct_bone_marker_at_touches: Pose::new(ct, "bone_marker", self.t_ct_bone_marker_slipped),
            laser_marks_ct: self.laser_marks.clone(),
            assessment_ct: self.assessment.clone(),
            stylus_tip: is_tracked.then_some(stylus::TIP),
            laser_spots_world: Points::new("world", in_world.collect::<Vec<_>>()),
            laser_spots_ct: spots,
            assessment_world: self.assessment.transformed("world", &self.bone_path.at(self.touches_s)),
            planes_world_at_scan: planes_at(SCAN_S),
            planes_world_after_motion: planes_at(end_s),
        }
    }
}

struct Touches {
    init: Points,
    assessment: Points,
    palpation: Points,
    pivoting: Vec<Pose>,
    marker: Vec<Pose>,
}

impl Default for Touches {
    fn default() -> Self {
        let none = || Points::new("world", Vec::new());
        Self { init: none(), assessment: none(), palpation: none(), pivoting: Vec::new(), marker: Vec::new() }
    }
}

/// What marks planned points on the bone.
struct Ruler<'a> {
    params: &'a RulerParams,
    surface: &'a MeshQuery,
    anatomy: &'a Anatomy,
    seed: u64,
}

impl Ruler<'_> {
    /// The marks of planned points, `first` other points before them having theirs.
    fn marks(&self, planned: &Points, first: usize) -> Result<Points, SimulationError> {
        let RulerParams { shared_mm, each_mm, across_mm } = *self.params;
        if [shared_mm, each_mm, across_mm] == [0.0; 3] {
            return Ok(planned.clone());
        }
        let shared = normal(&mut stream(self.seed, Term::RulerShared, 0)) * shared_mm;
        let marks = planned.points.iter().enumerate().map(|(k, point)| {
            let mut rng = stream(self.seed, Term::RulerEach, (first + k) as u64);
            let (along, across) = (normal(&mut rng) * each_mm, normal(&mut rng) * across_mm);
            beside(point, across, shared + along, self.surface, self.anatomy)
        });
        Ok(Points::new(&planned.frame, marks.collect::<Result<Vec<_>, SimulationError>>()?))
    }
}

/// The place of the surface so far across and along the bone from a point on it.
fn beside(
    point: &NamedPoint,
    across_mm: f64,
    along_mm: f64,
    surface: &MeshQuery,
    anatomy: &Anatomy,
) -> Result<NamedPoint, SimulationError> {
    let on_bone = |place: &Point3<f64>| {
        surface.closest_point(place).ok_or(SimulationError::NotFinite { name: point.name.to_string() })
    };
    let outward = on_bone(&point.position)?.normal;
    let around = anatomy.proximal.cross(&outward).try_normalize(1e-6).unwrap_or_else(Vector3::zeros);
    let moved = point.position + around * across_mm + *anatomy.proximal * along_mm;
    Ok(NamedPoint::new(point.name.clone(), on_bone(&moved)?.point))
}

/// The direction from the bone to the camera as planned, of unit length.
fn towards_camera(anatomy: &Anatomy, params: &ProcedureParams) -> Vector3<f64> {
    let azimuth = params.camera.view_azimuth_deg.to_radians();
    (*anatomy.lateral * azimuth.cos() + *anatomy.posterior * azimuth.sin()).normalize()
}

/// `t_ct_camera` of the scans: at working distance from the surface, x along the bone, held about as planned.
pub(crate) fn scan_pose(
    surface: &MeshQuery,
    anatomy: &Anatomy,
    focus: &Point3<f64>,
    params: &ProcedureParams,
    seed: u64,
) -> Option<Isometry3<f64>> {
    let towards_camera = towards_camera(anatomy, params);
    const OUTSIDE_MM: f64 = 60.0;
    let from = focus + towards_camera * OUTSIDE_MM;
    let on_surface = surface.cast_ray(&from, &-towards_camera)?.point;
    // Camera z looks at the bone, x runs proximally, y = z x x.
    let z = -towards_camera;
    let looking = frame_along(&z, &z.cross(&anatomy.proximal));
    let held = normal3(&mut stream(seed, Term::Setup, 1)) * params.camera.view_spread_deg.to_radians();
    let about_focus = Translation3::from(on_surface.coords) * UnitQuaternion::from_scaled_axis(held);
    let back = Translation3::new(0.0, 0.0, -params.camera.working_distance_mm);
    Some(about_focus * looking * back)
}

/// How the camera differs between its places at the bone and at the phantom.
fn carried(rng: &mut rand_chacha::ChaCha8Rng) -> Isometry3<f64> {
    Isometry3::new(normal3(rng) * 60.0, normal3(rng) * 0.2)
}

/// `t_camera_phantom`: a corner of the phantom towards the camera, so that three faces with blocks are seen, its middle
/// a tenth beyond the working distance.
fn phantom_pose(phantom: &Mesh, params: &ProcedureParams, rng: &mut rand_chacha::ChaCha8Rng) -> Isometry3<f64> {
    let toward = Vector3::new(1.0, 1.0, 1.0).normalize();
    let corner_on = UnitQuaternion::rotation_between(&toward, &-Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_rotation_matrix(&Rotation3::identity()));
    let radius = phantom.vertices().iter().map(|v| v.coords.norm()).fold(0.0, f64::max);
    let spread = params.camera.view_spread_deg.to_radians();
    let held = UnitQuaternion::from_scaled_axis(normal3(rng) * spread);
    let aside = normal3(rng) * 4.0;
    let away = params.phantom.distance_mm.unwrap_or(params.camera.working_distance_mm) + radius / 2.0;
    Translation3::from(Vector3::new(0.0, 0.0, away) + aside) * held * corner_on
}

/// `t_ct_bone_marker`: on a pin in the bone's proximal part, 110 mm beyond the middle of the scan and 45 mm off the bone.
fn bone_marker_pose(anatomy: &Anatomy, focus: &Point3<f64>, rng: &mut rand_chacha::ChaCha8Rng) -> Isometry3<f64> {
    let place = focus + *anatomy.proximal * 110.0 + *anatomy.lateral * 45.0;
    Isometry3::from_parts(place.into(), attitude(rng))
}

/// A box about what the camera sees of the bone, with a margin as a hand would leave.
fn region(seen: &[Pixel]) -> Region {
    const MARGIN_MM: f64 = 4.0;
    let first = seen[0].point();
    let (min, max) = seen.iter().map(Pixel::point).fold((first, first), |(min, max), p| (min.inf(&p), max.sup(&p)));
    let margin = Vector3::repeat(MARGIN_MM);
    Region { frame: "camera".into(), min: min - margin, max: max + margin }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LaserParams, StylusParams, bone, plan};

    const RUNS: u64 = 400;

    /// What one scene gives under many seeds for the draws; where things stand is drawn once.
    fn over_seeds<T>(params: &ProcedureParams, what: impl Fn(&Scene<'_>, &[Pixel]) -> T) -> Vec<T> {
        let bone = bone::fibula(&params.bone);
        let plan = plan(&bone, &bone::anatomy(&params.bone)).unwrap();
        let (surface, phantom) = (MeshQuery::new(&bone), phantom::mesh());
        let mut scene = Scene::new(&surface, &plan, &phantom, params, 1).unwrap();
        let seen = scene.bone_view(SCAN_S, &DepthBias::new(&params.camera, 1)).unwrap();
        (0..RUNS)
            .map(|seed| {
                scene.seed = seed;
                what(&scene, &seen)
            })
            .collect()
    }

    fn small_and_exact() -> ProcedureParams {
        let mut params = ProcedureParams::default().without_errors();
        params.camera.n_points = 500;
        params
    }

    fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
        let (sum, n) = values.into_iter().fold((0.0, 0usize), |(sum, n), v| (sum + v * v, n + 1));
        (sum / n as f64).sqrt()
    }

    #[test]
    fn the_laser_misses_across_and_along_the_bone_by_as_much_as_asked_for_and_stays_on_it() {
        let params = ProcedureParams {
            laser: LaserParams { aim_across_mm: 0.3, aim_along_mm: 0.7, ..LaserParams::default() },
            ..small_and_exact()
        };
        let along_and_across = over_seeds(&params, |scene, _| {
            let spots = scene.laser_spots().unwrap();
            let one = |k: usize| {
                let off = spots.points[k].position - scene.plan.landmarks.points[k].position;
                let on_bone = scene.bone_surface.closest_point(&spots.points[k].position).unwrap().distance_mm;
                assert!(on_bone < 1e-9, "{on_bone} mm off the bone");
                let along = off.dot(&scene.anatomy.proximal);
                (along, (off - *scene.anatomy.proximal * along).norm())
            };
            [one(0), one(1), one(2)]
        });
        let along = rms(along_and_across.iter().flatten().map(|(along, _)| *along));
        let across = rms(along_and_across.iter().flatten().map(|(_, across)| *across));
        // Four standard errors over 1,200 draws are 8 %; carrying a spot back onto the bone changes it by a little more.
        assert!((along - 0.7).abs() < 0.07, "{along} mm along");
        assert!((across - 0.3).abs() < 0.04, "{across} mm across");
    }

    #[test]
    fn a_touch_errs_by_the_tip_alike_and_by_the_hand_anew() {
        let stylus = StylusParams { tip_mm: 0.1, touch_mm: 0.2, n_palpated: 0, ..small_and_exact().stylus };
        let params = ProcedureParams { stylus, ..small_and_exact() };
        let off = over_seeds(&params, |scene, seen| {
            let tracker = Tracker { params: &params.tracker, seed: scene.seed, start_ns: 1 };
            let touched = scene.touches(&tracker, &scene.plan.landmarks, seen).unwrap();
            let truth = scene.plan.assessment.transformed("world", &scene.bone_path.at(scene.touches_s));
            let off = touched.assessment.points.iter().zip(truth.points.iter()).map(|(a, b)| a.position - b.position);
            off.collect::<Vec<_>>()
        });
        let fresh = off.iter().flat_map(|run| run.windows(2).map(|w| (w[1] - w[0]).norm_squared() / 6.0));
        let fresh = (fresh.sum::<f64>() / (RUNS * 4) as f64).sqrt();
        let all = rms(off.iter().flatten().flat_map(|d| [d.x, d.y, d.z]));
        assert!((fresh - 0.2).abs() < 0.01, "fresh {fresh} mm per axis");
        assert!((all - 0.1f64.hypot(0.2)).abs() < 0.012, "together {all} mm per axis");
    }

    #[test]
    fn palpated_points_err_by_a_common_and_a_fresh_part() {
        let stylus = StylusParams { palpation_bias_mm: 0.3, palpation_mm: 0.25, ..small_and_exact().stylus };
        let params = ProcedureParams { stylus, ..small_and_exact() };
        let (common, fresh): (Vec<f64>, Vec<f64>) = over_seeds(&params, |scene, seen| {
            let tracker = Tracker { params: &params.tracker, seed: scene.seed, start_ns: 1 };
            let t_ct_world = scene.bone_path.at(scene.touches_s).inverse();
            let touched = scene.touches(&tracker, &scene.plan.landmarks, seen).unwrap().palpation;
            assert_eq!(touched.points.len(), 300);
            // The nearest of the pixels that the points were taken from is not the one: the same draws give it again.
            let mut place = stream(scene.seed, Term::PalpationPlace, 0);
            let off: Vec<Vector3<f64>> = touched
                .points
                .iter()
                .map(|p| {
                    let truly = scene.t_ct_camera(SCAN_S) * seen[place.random_range(0..seen.len())].point();
                    t_ct_world * p.position - truly
                })
                .collect();
            let mean = off.iter().sum::<Vector3<f64>>() / 300.0;
            (rms(mean.iter().copied()), rms(off.iter().flat_map(|d| (d - mean).iter().copied().collect::<Vec<_>>())))
        })
        .into_iter()
        .unzip();
        // Four standard errors over 1,200 means are 8 %.
        assert!((rms(common) - 0.3).abs() < 0.025);
        assert!((rms(fresh) - 0.25).abs() < 0.003);
    }
}
