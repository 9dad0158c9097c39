//! The operating room of a procedure: what stands where, what moves when, and the run through it.

mod laser;
mod places;
mod ruler;
mod setup;
mod touches;
mod truth;

pub(crate) use places::scan_pose;

use crate::camera::{DepthBias, Periosteum, Pixel, Shot, Sight, Stretch, Wound, scan, view};
use crate::check_piece::{Look, look_at};
use crate::draws::{Term, stream};
use crate::tracker::{Marker, Path, Tracker};
use crate::{Procedure, ProcedureParams, SimulationError};
use nalgebra::{Isometry3, Point3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Anatomy, Mesh, Points, Pose, Region, StampNs, SurgicalPlan};
use rand::RngExt;
use touches::Touches;

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

/// When the `k`-th laser scan is taken.
fn laser_s(k: usize) -> f64 {
    SCAN_S + (k + 1) as f64 * LASER_EVERY_S
}

/// The operating room: what stands where, and what moves.
pub(crate) struct Scene<'a> {
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

impl Scene<'_> {
    pub(crate) fn run(&self) -> Result<Procedure, SimulationError> {
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
        let truth = self.truth(&tracker, spots);
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

    /// The stripped part of the bone.
    fn stretch(&self) -> Stretch {
        let camera = &self.params.camera;
        Stretch {
            from: self.anatomy.malleolus_tip,
            along: self.anatomy.proximal.into_inner(),
            min_mm: camera.scan_from_mm,
            max_mm: camera.scan_to_mm,
        }
    }

    fn sight<'s>(&'s self, stretch: &'s Stretch) -> Sight<'s> {
        Sight { object: self.bone_surface, stretch: Some(stretch), around: self.around.as_ref() }
    }

    /// The pixels that see the stripped bone.
    fn bone_view(&self, s: f64, bias: &DepthBias) -> Result<Vec<Pixel>, SimulationError> {
        let pixels = view(&self.sight(&self.stretch()), &self.t_ct_camera(s), &self.params.camera, bias);
        if !pixels.iter().any(|p| p.on_object) {
            let hint = "scan_from_mm and scan_to_mm should lie on the bone, view_azimuth_deg beside it";
            return Err(SimulationError::NothingVisible { what: "bone", hint });
        }
        Ok(pixels)
    }
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
    use crate::{bone, phantom, plan};

    pub(super) const RUNS: u64 = 400;

    /// What one scene gives under many seeds for the draws; where things stand is drawn once.
    pub(super) fn over_seeds<T>(params: &ProcedureParams, what: impl Fn(&Scene<'_>, &[Pixel]) -> T) -> Vec<T> {
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

    pub(super) fn small_and_exact() -> ProcedureParams {
        let mut params = ProcedureParams::default().without_errors();
        params.camera.n_points = 500;
        params
    }

    pub(super) fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
        let (sum, n) = values.into_iter().fold((0.0, 0usize), |(sum, n), v| (sum + v * v, n + 1));
        (sum / n as f64).sqrt()
    }
}
