//! A sound procedure: bone, window, side, plan, noise, and the errors of calibration and markers.

use crate::common::bench::built_in;
use osteoflow_algorithms::section;
use osteoflow_geometry::nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{Cloud, NamedPoint, Plane, Planes, Points, SurgicalPlan};
use osteoflow_simulation::{Procedure, ProcedureParams, Subject};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, UnitSphere};

/// Mean error of a marker's averaged pose, per axis: placement and what is left of the noise, as the simulation's tracker has.
const MARKER_MM: f64 = 0.062;
const MARKER_DEG: f64 = 0.0235;
/// What the registration of the phantom's scan leaves, per axis: assumed, a depth bias of 0.05 mm on three faces.
const PHANTOM_MM: f64 = 0.03;
const PHANTOM_DEG: f64 = 0.01;
/// Aim of the laser across and along the bone, and location of its hole, mm.
const AIM_MM: [f64; 2] = [0.6, 0.7];
const HOLE_MM: f64 = 0.07;

/// The random numbers of one part of a case.
pub(super) fn stream(seed: u64, number: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(number);
    rng
}

pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample(StandardNormal)
}

pub(super) fn direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let unit: [f64; 3] = UnitSphere.sample(rng);
    Vector3::from(unit)
}

fn small_motion(rng: &mut ChaCha8Rng, mm: f64, deg: f64) -> Isometry3<f64> {
    let mut normal3 = || Vector3::from_fn(|_, _| normal(rng));
    Isometry3::new(normal3() * mm, normal3() * deg.to_radians())
}

/// Coordinates on a bone: mm above the tip of the malleolus, and the angle about the line through the scanned part.
#[derive(Clone)]
pub(super) struct Site {
    pub(super) tip: Point3<f64>,
    pub(super) along: Vector3<f64>,
    pub(super) lateral: Vector3<f64>,
    pub(super) posterior: Vector3<f64>,
    /// Ends of the scan, mm.
    pub(super) window_mm: [f64; 2],
    /// Direction from the bone to the camera, radians about the bone.
    pub(super) view_rad: f64,
    /// Middles of the sections at the ends.
    line: [Point3<f64>; 2],
}

impl Site {
    fn new(subject: &Subject, window_mm: [f64; 2], view_rad: f64) -> Self {
        let anatomy = subject.plan.anatomy.as_ref().unwrap();
        let (along, posterior) = (anatomy.proximal.into_inner(), anatomy.posterior.into_inner());
        let middle = |mm: f64| {
            let at = anatomy.malleolus_tip + along * mm;
            section::middle(subject.bone(), &frame(at, &along, &posterior), Some(60.0)).unwrap()
        };
        let (tip, lateral, line) = (anatomy.malleolus_tip, anatomy.lateral.into_inner(), window_mm.map(middle));
        Self { tip, along, lateral, posterior, window_mm, view_rad, line }
    }

    pub(super) fn height_mm(&self, point: &Point3<f64>) -> f64 {
        (point - self.tip).dot(&self.along)
    }

    /// The point of the line at a height.
    pub(super) fn middle(&self, height_mm: f64) -> Point3<f64> {
        let [from, to] = self.line;
        let [a, b] = self.window_mm;
        from + (to - from) * ((height_mm - a) / (b - a))
    }

    /// Radians about the bone, from lateral towards posterior.
    pub(super) fn around(&self, point: &Point3<f64>) -> f64 {
        let off = point - self.middle(self.height_mm(point));
        off.dot(&self.posterior).atan2(off.dot(&self.lateral))
    }

    pub(super) fn way(&self, around: f64) -> Vector3<f64> {
        self.lateral * around.cos() + self.posterior * around.sin()
    }

    pub(super) fn length_mm(&self) -> f64 {
        self.window_mm[1] - self.window_mm[0]
    }

    pub(super) fn centre_mm(&self) -> f64 {
        (self.window_mm[0] + self.window_mm[1]) / 2.0
    }
}

/// A frame at a point whose z is a direction.
fn frame(at: Point3<f64>, z: &Vector3<f64>, about_y: &Vector3<f64>) -> Isometry3<f64> {
    let z = z.normalize();
    let x = about_y.cross(&z).normalize();
    let turn = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
    Isometry3::from_parts(at.into(), UnitQuaternion::from_rotation_matrix(&turn))
}

/// A procedure without a mistake; its bone and plan are in frame `ct` as the bone has them.
pub(super) struct Sound {
    pub(super) seed: u64,
    pub(super) subject: Subject,
    pub(super) site: Site,
    n_points: usize,
}

/// What the devices of a procedure give, and the truth.
pub(super) struct Measurements {
    /// The scan, frame `camera`.
    pub(super) scan: Cloud,
    /// The laser's holes as they are seen, frame `camera`.
    pub(super) holes: Vec<NamedPoint>,
    pub(super) t_ct_camera: Isometry3<f64>,
    pub(super) t_ct_bone_marker: Isometry3<f64>,
    /// As markers and calibration give it.
    pub(super) t_bone_marker_camera: Isometry3<f64>,
    /// As the calibration gives it.
    pub(super) t_camera_camera_marker: Isometry3<f64>,
    pub(super) t_camera_phantom_marker: Isometry3<f64>,
}

impl Sound {
    pub(super) fn drawn(seed: u64) -> Self {
        let rng = &mut stream(seed, 1);
        let (_, bone) = built_in(rng.random_range(1..=12));
        let length_mm = rng.random_range(70.0..120.0);
        let from_mm = rng.random_range(40.0..200.0 - length_mm);
        let view_deg: f64 = rng.random_range(-180.0..180.0);
        let site = Site::new(bone, [from_mm, from_mm + length_mm], view_deg.to_radians());
        let n_points = rng.random_range(10_000..=20_000);
        let plan = plan(bone, &site, rng);
        let subject = Subject { plan, ..bone.clone() };
        Self { seed, subject, site, n_points }
    }

    pub(super) fn measured(&self) -> Measurements {
        let mut params = ProcedureParams::default();
        (params.laser.scans, params.stylus.n_palpated) = (false, 0);
        let camera = &mut params.camera;
        (camera.n_points, camera.view_azimuth_deg) = (self.n_points, self.site.view_rad.to_degrees());
        [camera.scan_from_mm, camera.scan_to_mm] = self.site.window_mm;
        let procedure = Procedure::simulate_for(&self.subject, &params, self.seed).unwrap();
        let truth = &procedure.truth;
        let t_ct_camera = truth.t_world_ct_at_scan.isometry.inverse() * truth.t_world_camera_at_scan.isometry;
        let t_ct_bone_marker = truth.t_ct_bone_marker.isometry;
        let t_camera_camera_marker = truth.t_camera_camera_marker.isometry;
        let rng = &mut stream(self.seed, 2);
        let (calibrated, t_camera_phantom_marker) = calibrated(&procedure, rng);
        let mut marker = || small_motion(rng, MARKER_MM, MARKER_DEG);
        let t_bone_marker_camera = marker().inverse()
            * t_ct_bone_marker.inverse()
            * t_ct_camera
            * t_camera_camera_marker
            * marker()
            * calibrated.inverse();
        let holes = self.holes(&t_ct_camera, rng);
        Measurements {
            scan: procedure.scan,
            holes,
            t_ct_camera,
            t_ct_bone_marker,
            t_bone_marker_camera,
            t_camera_camera_marker: calibrated,
            t_camera_phantom_marker,
        }
    }

    /// The laser's holes at the landmarks, with the errors of aim and detector.
    fn holes(&self, t_ct_camera: &Isometry3<f64>, rng: &mut ChaCha8Rng) -> Vec<NamedPoint> {
        let Site { along, .. } = self.site;
        let one = |mark: &NamedPoint| {
            let across = along.cross(&self.site.way(self.site.around(&mark.position)));
            let aimed = mark.position + across * (AIM_MM[0] * normal(rng)) + along * (AIM_MM[1] * normal(rng));
            let spot = self.subject.surface.closest_point(&aimed).unwrap().point;
            let seen = t_ct_camera.inverse() * spot + Vector3::from_fn(|_, _| HOLE_MM * normal(rng));
            NamedPoint::new(mark.name.clone(), seen)
        };
        self.subject.plan.landmarks.points.iter().map(one).collect()
    }
}

/// Poses of the camera's and the phantom's markers in the camera by a calibration with errors: equation 1.
fn calibrated(procedure: &Procedure, rng: &mut ChaCha8Rng) -> (Isometry3<f64>, Isometry3<f64>) {
    let truth = &procedure.truth;
    let (t_c_p, t_p_mp) = (truth.t_camera_phantom.isometry, truth.t_phantom_phantom_marker.isometry);
    let t_c_mc = truth.t_camera_camera_marker_at_calibration.isometry;
    let fitted = t_c_p * small_motion(rng, PHANTOM_MM, PHANTOM_DEG);
    let t_c_mp = fitted * procedure.t_phantom_phantom_marker.isometry;
    let mut marker = || small_motion(rng, MARKER_MM, MARKER_DEG);
    let t_mp_mc = marker().inverse() * (t_c_p * t_p_mp).inverse() * t_c_mc * marker();
    (t_c_mp * t_mp_mc, t_c_mp)
}

/// Landmarks on the side that is seen, assessment points on the scanned part and up to 50 mm beyond, two cuts up to 80 mm beyond.
fn plan(bone: &Subject, site: &Site, rng: &mut ChaCha8Rng) -> SurgicalPlan {
    let on_surface = |name: String, height_mm: f64, deg: f64| {
        let (way, centre) = (site.way(site.view_rad + deg.to_radians()), section_middle(bone, site, height_mm));
        let hit = bone.surface.cast_ray(&(centre + way * 60.0), &-way).unwrap();
        NamedPoint::new(name, hit.point)
    };
    let ([from_mm, to_mm], length_mm) = (site.window_mm, site.length_mm());
    let places = [(0.2, -35.0), (0.5, 35.0), (0.8, -35.0)];
    let landmarks = places.iter().enumerate().map(|(k, (share, deg))| {
        let height_mm = from_mm + (share + rng.random_range(-0.08..0.08)) * length_mm;
        on_surface(format!("P{}", k + 1), height_mm, deg + rng.random_range(-8.0..8.0))
    });
    let landmarks: Vec<NamedPoint> = landmarks.collect();
    let reach_mm = [rng.random_range(0.0..10.0), rng.random_range(0.0..50.0)];
    let assessment = (1..=5).map(|k| {
        let height_mm = rng.random_range(from_mm - reach_mm[0]..to_mm + reach_mm[1]);
        on_surface(format!("M{k}"), height_mm, rng.random_range(-60.0..60.0))
    });
    let assessment: Vec<NamedPoint> = assessment.collect();
    let first_mm = rng.random_range(from_mm + 15.0..to_mm + 35.0);
    let heights_mm = [first_mm, first_mm + rng.random_range(25.0..45.0)];
    let planes = heights_mm.iter().enumerate().map(|(k, &height_mm)| {
        let mut tilt = || rng.random_range(-0.25..0.25);
        let normal = site.along + site.lateral * tilt() + site.posterior * tilt();
        let place = frame(section_middle(bone, site, height_mm), &normal, &site.posterior);
        Plane::new(format!("plane_{}", k + 1), place)
    });
    let planes: Vec<Plane> = planes.collect();
    let ct = &bone.bone().frame;
    SurgicalPlan {
        landmarks: Points::new(ct, landmarks),
        assessment: Points::new(ct, assessment),
        planes: Planes::new(ct, planes),
        ..bone.plan.clone()
    }
}

fn section_middle(bone: &Subject, site: &Site, height_mm: f64) -> Point3<f64> {
    let across = frame(site.tip + site.along * height_mm, &site.along, &site.posterior);
    section::middle(bone.bone(), &across, Some(60.0)).unwrap()
}
