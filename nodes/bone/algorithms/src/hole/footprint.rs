//! The places at which a laser's spot explains the footprint that it leaves.
//!
//! The footprint is a disc on the surface, or the cross-section of the laser's beam, which is elongated on a slanted surface. Both
//! have the same centre where all of the footprint is in sight, and different ones where the silhouette cuts it off. The points
//! of the surface, lost or not, decide between the two and between places, as far as they can.

use super::scene::Scene;
use super::spot::Missing;
use super::{Hole, HoleParams};
use nalgebra::{Point3, Vector2};

/// Tangent of the angle between beam and line of sight that is assumed besides 0. 15 degrees: a pointer held beside the camera, with
/// 10 degrees about each of two axes.
const TILT: f64 = 0.268;

/// Directions of that tilt.
const N_TILTS: usize = 6;

/// Reach of the points that decide, in radii: the footprint on a surface at 72 degrees, with its rim.
const REACH: f64 = 4.0;

/// Largest distance of the assumed spots from the disc's centre, across the line of sight, in radii: farther away, the two
/// footprints have no point in common.
const SEARCH: f64 = 2.0;

/// Distance from a point of the surface within which a place is on the surface, in point spacings.
const ON_SURFACE: f64 = 2.0;

/// Distance from the fitted disc of others that are tried, in radii.
const BESIDE: f64 = 0.25;

/// Difference between two numbers of contradicting points, in standard deviations, up to which both places explain the
/// footprint.
const SIGNIFICANT: f64 = 3.0;

/// Points of the surface around a hole.
pub(super) struct Footprint<'a> {
    scene: &'a Scene,
    points: Vec<Point3<f64>>,
    /// Whether each of them is missing.
    is_missing: Vec<bool>,
    radius_mm: f64,
    /// Distance within the rim at which points may still be present, mm.
    margin_mm: f64,
    /// Where an image shows the spot.
    shown_at: Option<Point3<f64>>,
}

/// The place of a spot.
pub(super) struct Place {
    pub(super) centre: Point3<f64>,
    /// Largest distance of another place that explains the footprint as well.
    pub(super) uncertainty_mm: f64,
}

/// A spot that is assumed.
struct Spot {
    centre: Point3<f64>,
    /// Its beam; a disc on the surface if `None`.
    beam: Option<Beam>,
    n_wrong: usize,
}

/// A beam in the camera's image, at the scale of the footprint.
#[derive(Clone, Copy)]
struct Beam {
    at: Vector2<f64>,
    tilt: Vector2<f64>,
    depth_mm: f64,
}

impl<'a> Footprint<'a> {
    /// The surroundings of a hole.
    pub(super) fn of_hole(scene: &'a Scene, missing: &Missing, centre: &Point3<f64>, params: &HoleParams) -> Self {
        let radius_mm = params.spot_radius_mm;
        let around = scene.within(&scene.reference, centre, REACH * radius_mm);
        Self {
            scene,
            points: around.iter().map(|(i, _)| scene.reference.points[*i]).collect(),
            is_missing: around.iter().map(|(i, _)| missing.indices.binary_search(i).is_ok()).collect(),
            radius_mm,
            margin_mm: missing.margin_mm,
            shown_at: None,
        }
    }

    /// With the place at which an image shows the spot: it counts as one that explains it, too.
    pub(super) fn shown_at(self, place: Point3<f64>) -> Self {
        Self { shown_at: Some(place), ..self }
    }

    /// The place of the spot: `disc`, the centre of a fitted disc, where a disc explains the footprint, else the middle of the
    /// beams that do. `None` without a viewpoint. `O(n (radius / spacing)²)`.
    pub(super) fn place(&self, disc: Point3<f64>) -> Option<Place> {
        let radius_mm = self.radius_mm;
        let (scale, depth_mm) = self.scene.sight.image(&disc)?;
        let in_image = |p: &Point3<f64>| {
            let flat = self.scene.sight.flatten(p);
            let depth = self.scene.sight.image(p).map_or(depth_mm, |(_, depth_mm)| depth_mm);
            (Vector2::new(flat.x, flat.y) / scale, depth)
        };
        let image: Vec<(Vector2<f64>, f64)> = self.points.iter().map(in_image).collect();
        // The disc was fitted; where another loss moved it a little, discs beside it explain the footprint.
        let beside = self.points.iter().filter(|p| (*p - disc).norm() <= BESIDE * radius_mm);
        let discs = std::iter::once(&disc).chain(beside).map(|p| self.spot(*p, None, &image));
        let mut spots: Vec<Spot> = discs.min_by_key(|spot| spot.n_wrong).into_iter().collect();
        let (middle, step) = (in_image(&disc).0, self.scene.median_spacing_mm / scale);
        let n = (SEARCH * radius_mm / step).ceil() as i32;
        let tilts: Vec<Vector2<f64>> = std::iter::once(Vector2::zeros())
            .chain((0..N_TILTS).map(|k| {
                let (sin, cos) = (k as f64 / N_TILTS as f64 * std::f64::consts::TAU).sin_cos();
                TILT * Vector2::new(cos, sin)
            }))
            .collect();
        for (row, column) in (-n..=n).flat_map(|row| (-n..=n).map(move |column| (row, column))) {
            let at = middle + Vector2::new(f64::from(column), f64::from(row)) * step;
            let off = |k: &usize| (image[*k].0 - at).norm_squared();
            let nearest = (0..image.len()).min_by(|a, b| off(a).total_cmp(&off(b)));
            let Some(k) = nearest.filter(|k| off(k).sqrt() <= ON_SURFACE * step) else { continue };
            let depth_mm = image[k].1;
            spots.extend(tilts.iter().map(|&tilt| {
                let beam = Beam { at, tilt, depth_mm };
                self.spot(self.points[k], Some(beam), &image)
            }));
        }
        let best = spots.iter().min_by_key(|spot| spot.n_wrong)?;
        let wrong = self.wrong(best, &image);
        let explains = |spot: &&Spot| self.is_as_good(spot, best, &wrong, &image);
        let explaining: Vec<&Spot> = spots.iter().filter(explains).collect();
        let centre = if explaining.first().is_some_and(|spot| spot.beam.is_none()) {
            disc
        } else {
            let mean = crate::kabsch::centroid(&explaining.iter().map(|spot| spot.centre).collect::<Vec<_>>());
            let off = |spot: &&Spot| (spot.centre - mean).norm_squared();
            explaining.iter().copied().min_by(|a, b| off(a).total_cmp(&off(b)))?.centre
        };
        let beams = explaining.iter().filter(|spot| spot.beam.is_some());
        let others = beams.map(|spot| spot.centre).chain(self.shown_at);
        let farthest_mm = others.map(|other| (other - centre).norm()).fold(0.0, f64::max);
        // Places closer than the points are not told apart, whatever the footprint.
        let uncertainty_mm = (farthest_mm - self.scene.surface_spacing_mm).max(0.0);
        Some(Place { centre, uncertainty_mm })
    }

    /// Distance of the `k`-th point from the spot or its beam.
    fn off_mm(&self, centre: &Point3<f64>, beam: Option<Beam>, image: &[(Vector2<f64>, f64)], k: usize) -> f64 {
        match beam {
            None => (self.points[k] - centre).norm(),
            Some(Beam { at, tilt, depth_mm }) => (image[k].0 - at - tilt * (image[k].1 - depth_mm)).norm(),
        }
    }

    fn spot(&self, centre: Point3<f64>, beam: Option<Beam>, image: &[(Vector2<f64>, f64)]) -> Spot {
        let n_wrong = (0..image.len()).filter(|&k| self.is_wrong(k, self.off_mm(&centre, beam, image, k))).count();
        Spot { centre, beam, n_wrong }
    }

    /// Whether the `k`-th point contradicts a spot this far away.
    fn is_wrong(&self, k: usize, off_mm: f64) -> bool {
        if self.is_missing[k] { off_mm > self.radius_mm } else { off_mm < self.radius_mm - self.margin_mm }
    }

    fn wrong(&self, spot: &Spot, image: &[(Vector2<f64>, f64)]) -> Vec<bool> {
        let off = |k: usize| self.off_mm(&spot.centre, spot.beam, image, k);
        (0..image.len()).map(|k| self.is_wrong(k, off(k))).collect()
    }

    /// Whether no significantly larger number of points contradicts this spot: of those that contradict one of both alone, half are
    /// expected for each if both are equally good (McNemar's test).
    fn is_as_good(&self, spot: &Spot, best: &Spot, wrong: &[bool], image: &[(Vector2<f64>, f64)]) -> bool {
        let more = (spot.n_wrong - best.n_wrong) as f64;
        // At most all of them contradict one alone.
        if more > SIGNIFICANT * ((spot.n_wrong + best.n_wrong) as f64).sqrt() {
            return false;
        }
        let n_alone = self.wrong(spot, image).iter().zip(wrong).filter(|(a, b)| a != b).count();
        more <= SIGNIFICANT * (n_alone as f64).sqrt()
    }
}

impl Hole {
    /// Moves the centre to the place that explains the footprint, and lowers the confidence to the share of the area in which the spot
    /// may be that the spot has, but not below that of the second tier, if there is one.
    pub(super) fn place(&mut self, footprint: &Footprint<'_>, params: &HoleParams) {
        let radius_mm = params.spot_radius_mm;
        if let Some(Place { centre, uncertainty_mm }) = footprint.place(self.centre) {
            let share = (radius_mm / (radius_mm + uncertainty_mm)).powi(2);
            let agreeing = params.min_confidence_agreeing;
            let least = if agreeing < params.min_confidence { agreeing.min(self.confidence) } else { 0.0 };
            self.centre = centre;
            self.confidence = (self.confidence * share).max(least);
            self.report.centre_uncertainty_mm = Some(uncertainty_mm);
        }
        self.report.confidence = self.confidence;
        self.report.tier = if self.confidence < params.min_confidence { 2 } else { 1 };
    }
}

#[cfg(test)]
mod tests {
    use super::super::cloud_difference;
    use super::*;
    use nalgebra::{Isometry3, Vector3};
    use osteoflow_geometry::Cloud;

    /// A plane 200 mm before the camera, slanted about y, that ends at this x, and the scan without what `hole` takes.
    fn found(slant_deg: f64, end_mm: f64, hole: impl Fn(&Point3<f64>) -> bool) -> Hole {
        let slope = slant_deg.to_radians().tan();
        let mut points = Vec::new();
        for row in -60..=60 {
            for column in -60..=60 {
                let ray = Vector3::new(f64::from(column), f64::from(row), 0.0) * 0.00115 + Vector3::z();
                // z = 200 + slope x
                let z = 200.0 / (1.0 - slope * ray.x);
                let point = Point3::from(ray * z);
                if point.x <= end_mm {
                    points.push(point);
                }
            }
        }
        let scan = |points: Vec<Point3<f64>>| Cloud::new("camera", points).unwrap().seen_from(Isometry3::identity());
        let left = points.iter().copied().filter(|p| !hole(p)).collect();
        cloud_difference(&scan(points), &scan(left), &HoleParams::default()).unwrap()
    }

    fn disc(p: &Point3<f64>) -> bool {
        (p.coords - Vector3::new(0.0, 0.0, 200.0)).norm() < 2.0
    }

    /// A beam along the line of sight through (0, 0, 200).
    fn beam(p: &Point3<f64>) -> bool {
        p.x.hypot(p.y) * 200.0 / p.z < 2.0
    }

    fn off_mm(hole: &Hole) -> f64 {
        (hole.centre - Point3::new(0.0, 0.0, 200.0)).norm()
    }

    #[test]
    fn a_disc_and_a_beam_that_are_wholly_in_sight_have_one_centre() {
        for slant_deg in [0.0, 45.0, 60.0] {
            for (what, hole) in [("disc", found(slant_deg, 9.0, disc)), ("beam", found(slant_deg, 9.0, beam))] {
                let uncertainty_mm = hole.report.centre_uncertainty_mm.unwrap();
                // A step of the grid is 0.23 mm across, twice that along a slope of 60 degrees.
                assert!(off_mm(&hole) < 0.4, "{what}, {slant_deg} degrees: {:.2} mm", off_mm(&hole));
                assert!(uncertainty_mm < 1.0, "{what}, {slant_deg} degrees: {uncertainty_mm:.2} mm");
            }
        }
    }

    #[test]
    fn the_spacing_is_that_along_the_slope() {
        for (slant_deg, spacing_mm) in [(0.0, 0.23), (45.0, 0.23 * 2_f64.sqrt()), (60.0, 0.46)] {
            let found = found(slant_deg, 9.0, disc).report.spacing_mm;
            assert!(
                (found / spacing_mm - 1.0).abs() < 0.1,
                "{slant_deg} degrees: {found:.3} mm, {spacing_mm:.3} expected"
            );
        }
    }

    #[test]
    fn a_slanted_beam_that_the_silhouette_cuts_off_is_found_or_uncertain() {
        for (slant_deg, end_mm) in [(60.0, 1.0), (60.0, 0.5), (65.0, 0.7)] {
            let hole = found(slant_deg, end_mm, beam);
            let (off_mm, uncertainty_mm) = (off_mm(&hole), hole.report.centre_uncertainty_mm.unwrap());
            let what = format!("{slant_deg} degrees, {end_mm} mm: {off_mm:.2} mm off, {:?}", hole.report);
            assert!(off_mm <= uncertainty_mm + 0.5, "{what}");
            assert!(off_mm < 1.0 || hole.report.tier == 2, "{what}");
        }
    }

    #[test]
    fn without_a_viewpoint_nothing_is_said_of_the_place() {
        let points: Vec<Point3<f64>> = (0..3600)
            .map(|i| Point3::new(f64::from(i % 60) * 0.25 - 7.5, f64::from(i / 60) * 0.25 - 7.5, 200.0))
            .collect();
        let left = points.iter().copied().filter(|p| !disc(p)).collect();
        let scan = |points: Vec<Point3<f64>>| Cloud::new("camera", points).unwrap();
        let hole = cloud_difference(&scan(points), &scan(left), &HoleParams::default()).unwrap();
        assert_eq!((hole.report.centre_uncertainty_mm, hole.report.tier), (None, 1));
    }
}
