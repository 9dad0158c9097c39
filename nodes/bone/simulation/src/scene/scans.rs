//! The clouds of a procedure: of the phantom, of the bone, and of the bone with the laser on.

use super::{CALIBRATION_S, SCAN_S, Scene, laser_s};
use crate::SimulationError;
use crate::camera::{DepthBias, FilmSite, Hole, Periosteum, Pixel, Shot, Sight, Stretch, Sweep, Wound, scan, view};
use crate::draws::{Term, stream};
use crate::image;
use crate::plan::section_centre;
use crate::scene::places::towards_camera;
use crate::tissue::{Site, tissue};
use crate::tracker::Tracker;
use nalgebra::{Point3, Vector3};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{Cloud, Image, Points, Region};
use rand::RngExt;

impl Scene<'_> {
    pub(super) fn phantom_scan(&self, tracker: &Tracker<'_>, bias: &DepthBias) -> Result<Cloud, SimulationError> {
        let camera = &self.params.camera;
        let t_object_camera = self.phantom_path.at(CALIBRATION_S).inverse() * self.camera.at(CALIBRATION_S);
        let sight = Sight { object: &self.phantom_surface, stretch: None, around: None, lumps: None };
        let pixels = view(&sight, &t_object_camera, camera, bias, None);
        if pixels.is_empty() {
            return Err(SimulationError::nothing_visible("phantom", "is its mesh in millimetres?"));
        }
        let stamp_ns = tracker.stamp(CALIBRATION_S);
        let shot = Shot { pixels: &pixels, t_object_camera, hole: None, wound: None, stamp_ns, number: 0 };
        Ok(self.phantom_as_written(scan(&shot, camera, self.seed)?)?)
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
        Ok(self.bone_as_written(scan(&shot, &self.params.camera, self.seed)?)?)
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
        let film = self.film()?;
        let one = |(k, spot): (usize, &osteoflow_geometry::NamedPoint)| {
            let s = laser_s(k);
            let hole = self.hole_on_film(k, &spot.position, film.as_ref());
            let moved = if is_still { None } else { Some(self.bone_view(s, bias, wound.tissue.as_ref())?) };
            let pixels = moved.as_deref().unwrap_or(pixels);
            if !pixels.iter().any(|p| p.on_object && (p.lit() - hole.spot).norm() < hole.radius_mm) {
                return Err(SimulationError::Unsuitable(format!(
                    "the laser spot on {} is hidden from the camera; turn the view (camera.view_azimuth_deg) towards it",
                    spot.name
                )));
            }
            Ok(self.bone_scan(pixels, Some(hole), wound, s, tracker, 2 + k as u64)?.labelled(self.label(&spot.name)))
        };
        spots.points.iter().enumerate().map(one).collect()
    }

    /// A colour image at each laser scan. The film on the bone, if any, is transparent.
    pub(super) fn images(
        &self,
        spots: &Points,
        wound: &Wound,
        tracker: &Tracker<'_>,
    ) -> Result<Vec<Image>, SimulationError> {
        let (params, stretch) = (&self.params.image, self.stretch());
        let sight = Sight { lumps: wound.tissue.as_ref(), ..self.sight(&stretch) };
        let film = self.film()?;
        let view = |s: f64| image::View::new(&sight, &self.t_ct_camera(s), params);
        let still = self.is_still_between_scans().then(|| view(SCAN_S));
        let one = |(k, spot): (usize, &osteoflow_geometry::NamedPoint)| {
            let s = laser_s(k);
            let moved = if still.is_some() { None } else { Some(view(s)) };
            let view = still.as_ref().or(moved.as_ref()).expect("one of both was made");
            let laser = self.hole_on_film(k, &spot.position, film.as_ref());
            let mark = self.t_ct_camera(s).inverse() * self.laser_marks.points[k].position;
            let shot = image::Shot { laser: &laser, mark, stamp_ns: tracker.stamp(s), number: 2 + k as u64 };
            Ok(view.image(&shot, params, self.seed)?.labelled(self.label(&spot.name)))
        };
        spots.points.iter().enumerate().map(one).collect()
    }

    /// The film on the bone, if there is one.
    fn film(&self) -> Result<Option<Periosteum>, SimulationError> {
        let (film, camera) = (&self.params.periosteum, &self.params.camera);
        let grows = film.grows_mm > 0.0 || film.around_mm > 0.0;
        let site = grows.then(|| {
            Ok::<_, SimulationError>(FilmSite {
                from: section_centre(self.bone, self.anatomy, camera.scan_from_mm)?,
                to: section_centre(self.bone, self.anatomy, camera.scan_to_mm)?,
                lateral: self.anatomy.lateral,
                posterior: self.anatomy.posterior,
            })
        });
        let site = site.transpose()?;
        Ok((film.thickness_mm > 0.0 || grows).then(|| Periosteum::new(film, site, self.seed)))
    }

    /// The hole of a spot in the frame of the bone, where its light falls on the film, if there is one.
    fn hole_on_film(&self, k: usize, spot: &Point3<f64>, film: Option<&Periosteum>) -> Hole {
        let t_ct_camera = self.t_ct_camera(laser_s(k));
        let on_bone = t_ct_camera.inverse() * spot;
        self.hole(k, &film.map_or(on_bone, |f| f.onto(&on_bone, &t_ct_camera, self.bone_surface)))
    }

    /// Blood and tissue on the bone.
    pub(super) fn wound(&self, seen: &[Pixel], spots: &Points) -> Result<Wound, SimulationError> {
        let params = &self.params.camera;
        let t_ct_camera = self.t_ct_camera(SCAN_S);
        let mut rng = stream(self.seed, Term::BloodPools, 0);
        let place = |_| t_ct_camera * seen[rng.random_range(0..seen.len())].point();
        // Marks are wiped clean, else nothing could be shown there.
        let clear_mm = params.pool_radius_mm + 1.5 * self.params.laser.hole_radius_mm;
        let is_clear = |pool: &Point3<f64>| spots.points.iter().all(|s| (s.position - pool).norm() > clear_mm);
        let n_pools = if seen.is_empty() { 0 } else { params.n_pools };
        Ok(Wound { pools: (0..n_pools).map(place).filter(is_clear).collect(), tissue: self.tissue(seen, spots)? })
    }

    /// Lumps of soft tissue, placed on what the camera sees of the bone at the full scan.
    fn tissue(&self, seen: &[Pixel], spots: &Points) -> Result<Option<MeshQuery>, SimulationError> {
        if self.params.tissue.share <= 0.0 {
            return Ok(None);
        }
        let (camera, t_ct_camera) = (&self.params.camera, self.t_ct_camera(SCAN_S));
        let seen: Vec<Point3<f64>> = seen.iter().map(|pixel| t_ct_camera * pixel.point()).collect();
        let site = Site {
            bone: self.bone_surface,
            anatomy: self.anatomy,
            stretch_mm: [camera.scan_from_mm, camera.scan_to_mm],
            towards_camera: towards_camera(self.anatomy, self.params),
            seen: &seen,
            marks: &spots.positions(),
            clear_mm: 2.0 * self.params.laser.hole_radius_mm,
        };
        tissue(&self.params.tissue, &site, self.seed)
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

    /// The bone without tissue, as far as it is stripped, and its surroundings.
    pub(super) fn sight<'s>(&'s self, stretch: &'s Stretch) -> Sight<'s> {
        Sight { object: self.bone_surface, stretch: Some(stretch), around: self.around.as_ref(), lumps: None }
    }

    /// The pixels that see the stripped bone, tissue on it, or its surroundings.
    pub(super) fn bone_view(
        &self,
        s: f64,
        bias: &DepthBias,
        tissue: Option<&MeshQuery>,
    ) -> Result<Vec<Pixel>, SimulationError> {
        let stretch = self.stretch();
        let sight = Sight { lumps: tissue, ..self.sight(&stretch) };
        let at = |from_stamp_s: f64| self.t_ct_camera(s + from_stamp_s);
        let camera = &self.params.camera;
        let sweep =
            Sweep { duration_s: camera.scan_s, direction_rad: camera.sweep_deg.to_radians(), t_object_camera: &at };
        let mut pixels = view(&sight, &at(0.0), camera, bias, Some(&sweep).filter(|sweep| sweep.duration_s > 0.0));
        if !pixels.iter().any(|p| p.on_object) {
            let hint = "scan_from_mm and scan_to_mm should lie on the bone, view_azimuth_deg beside it";
            return Err(SimulationError::nothing_visible("bone", hint));
        }
        if let Some(film) = self.film()? {
            film.cover(&mut pixels, &self.t_ct_camera(s), self.bone_surface);
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
