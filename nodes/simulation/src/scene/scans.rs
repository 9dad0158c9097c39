//! The clouds of a procedure: of the phantom, of the bone, and of the bone with the laser on.

use super::{CALIBRATION_S, SCAN_S, Scene, laser_s};
use crate::SimulationError;
use crate::camera::{DepthBias, Hole, Periosteum, Pixel, Shot, Sight, Stretch, Wound, scan, view};
use crate::draws::{Term, stream};
use crate::tracker::Tracker;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{Cloud, Points, Region};
use rand::RngExt;

impl Scene<'_> {
    pub(super) fn phantom_scan(&self, tracker: &Tracker<'_>, bias: &DepthBias) -> Result<Cloud, SimulationError> {
        let camera = &self.params.camera;
        let t_object_camera = self.phantom_path.at(CALIBRATION_S).inverse() * self.camera.at(CALIBRATION_S);
        let sight = Sight { object: &self.phantom_surface, stretch: None, around: None };
        let pixels = view(&sight, &t_object_camera, camera, bias);
        if pixels.is_empty() {
            return Err(SimulationError::NothingVisible { what: "phantom", hint: "is its mesh in millimetres?" });
        }
        let stamp_ns = tracker.stamp(CALIBRATION_S);
        let shot = Shot { pixels: &pixels, t_object_camera, hole: None, wound: None, stamp_ns, number: 0 };
        Ok(scan(&shot, camera, self.seed)?)
    }

    /// The cloud of the bone at `s`, the `number`-th of the run.
    pub(super) fn bone_scan(
        &self,
        pixels: &[Pixel],
        hole: Option<Hole>,
        wound: &Wound,
        s: f64,
        tracker: &Tracker<'_>,
        number: u64,
    ) -> Result<Cloud, SimulationError> {
        let (t_object_camera, stamp_ns) = (self.t_ct_camera(s), tracker.stamp(s));
        let shot = Shot { pixels, t_object_camera, hole, wound: Some(wound), stamp_ns, number };
        Ok(scan(&shot, &self.params.camera, self.seed)?)
    }

    /// One cloud for each laser spot. `pixels` are those of the full scan, seen again if nothing moves.
    pub(super) fn laser_scans(
        &self,
        pixels: &[Pixel],
        spots: &Points,
        wound: &Wound,
        tracker: &Tracker<'_>,
        bias: &DepthBias,
    ) -> Result<Vec<Cloud>, SimulationError> {
        let is_still = self.is_still_between_scans();
        let one = |(k, spot): (usize, &osteoflow_geometry::NamedPoint)| {
            let s = laser_s(k);
            let hole = self.hole(k, &(self.t_ct_camera(s).inverse() * spot.position));
            let moved = if is_still { None } else { Some(self.bone_view(s, bias)?) };
            let pixels = moved.as_deref().unwrap_or(pixels);
            if !pixels.iter().any(|p| p.on_object && (p.point() - hole.spot).norm() < hole.radius_mm) {
                return Err(SimulationError::SpotHidden { name: spot.name.to_string() });
            }
            Ok(self.bone_scan(pixels, Some(hole), wound, s, tracker, 2 + k as u64)?.labelled(spot.name.clone()))
        };
        spots.points.iter().enumerate().map(one).collect()
    }

    /// Film and blood on the bone.
    pub(super) fn wound(&self, seen: &[Pixel], spots: &Points) -> Wound {
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
    pub(super) fn stretch(&self) -> Stretch {
        let camera = &self.params.camera;
        Stretch {
            from: self.anatomy.malleolus_tip,
            along: self.anatomy.proximal.into_inner(),
            min_mm: camera.scan_from_mm,
            max_mm: camera.scan_to_mm,
        }
    }

    pub(super) fn sight<'s>(&'s self, stretch: &'s Stretch) -> Sight<'s> {
        Sight { object: self.bone_surface, stretch: Some(stretch), around: self.around.as_ref() }
    }

    /// The pixels that see the stripped bone or its surroundings.
    pub(super) fn bone_view(&self, s: f64, bias: &DepthBias) -> Result<Vec<Pixel>, SimulationError> {
        let pixels = view(&self.sight(&self.stretch()), &self.t_ct_camera(s), &self.params.camera, bias);
        if !pixels.iter().any(|p| p.on_object) {
            let hint = "scan_from_mm and scan_to_mm should lie on the bone, view_azimuth_deg beside it";
            return Err(SimulationError::NothingVisible { what: "bone", hint });
        }
        Ok(pixels)
    }
}

/// A box around what the camera sees of the bone, with the margin that a user would leave.
pub(super) fn region(seen: &[Pixel]) -> Region {
    const MARGIN_MM: f64 = 4.0;
    let first = seen[0].point();
    let (min, max) = seen.iter().map(Pixel::point).fold((first, first), |(min, max), p| (min.inf(&p), max.sup(&p)));
    let margin = Vector3::repeat(MARGIN_MM);
    Region { frame: "camera".into(), min: min - margin, max: max + margin }
}
