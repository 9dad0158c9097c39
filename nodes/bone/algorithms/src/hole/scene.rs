//! The reference scan and the scan with the laser, prepared for comparison.

use super::HoleParams;
use super::depth_outliers::corrected;
use super::sight::Sight;
use crate::Refusal;
use crate::median::median;
use crate::nearest::Nearest;
use crate::normals::plane_normal;
use nalgebra::Point3;
use osteoflow_geometry::Cloud;
use rayon::iter::StepBy;
use rayon::prelude::*;

/// Neighbours that determine the spacing around a point: the first ring of a square grid.
const RING: usize = 8;

/// Approximate number of points sampled for statistics of a whole scan.
const SAMPLED: usize = 1000;

/// Neighbours to which a plane is fitted.
const AROUND: usize = 12;

/// Both scans in one frame, with trees and spacing.
pub(super) struct Scene {
    pub(super) reference: Scan,
    pub(super) cloud: Scan,
    pub(super) sight: Sight,
    /// Ratio of the spacings of the laser scan and the reference, at least 1.
    coarser: f64,
    /// Median of [`Scene::spacing_mm`].
    pub(super) median_spacing_mm: f64,
    /// Median point spacing on the surface, mm: more than the camera sees where the surface is slanted.
    pub(super) surface_spacing_mm: f64,
    /// Point spacing of the laser scan in its camera's grid, across the line of sight, mm, if it has a viewpoint.
    pub(super) grid_mm: Option<f64>,
    /// Points of the laser scan per point of the reference, where both overlap.
    pub(super) density: f64,
    /// Median distance of the scan with the laser from the reference's surface, mm.
    pub(super) residual_mm: f64,
}

/// One scan as the camera of the scan with the laser sees it.
pub(super) struct Scan {
    /// Points in the frame of the clouds, without outliers in depth.
    pub(super) points: Vec<Point3<f64>>,
    /// The points as [`Sight`] flattens them, and their tree.
    pub(super) flat: Vec<Point3<f64>>,
    tree: Nearest,
}

impl Scan {
    fn new(points: Vec<Point3<f64>>, sight: &Sight) -> Self {
        let flat: Vec<Point3<f64>> = points.iter().map(|p| sight.flatten(p)).collect();
        Self { points, tree: Nearest::new(&flat), flat }
    }

    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    /// Squared distance (mm²) of the nearest point, both flattened.
    pub(super) fn nearest_flat(&self, flat: &Point3<f64>) -> Option<f64> {
        self.tree.nearest(flat).map(|(_, square)| square)
    }

    /// Spacing around a point as the camera sees it, from the distance of the farthest of the first ring, and the distance of
    /// the second neighbour, mm.
    fn spacing(&self, index: usize) -> [f64; 2] {
        let ring = self.tree.nearest_n(&self.flat[index], RING + 1);
        // The first is the point itself.
        let [farthest, second] = [ring.last(), ring.get(2)].map(|p| p.map_or(0.0, |(_, square)| *square));
        [(farthest / 2.0).sqrt(), second.sqrt()]
    }

    /// Medians of [`Scan::spacing`].
    fn median_spacing(&self) -> [f64; 2] {
        let all: Vec<[f64; 2]> = self.sampled().map(|i| self.spacing(i)).collect();
        [0, 1].map(|k| median(&mut all.iter().map(|mm| mm[k]).collect::<Vec<_>>()))
    }

    /// About [`SAMPLED`] indices, evenly along the scan.
    fn sampled(&self) -> StepBy<rayon::range::Iter<usize>> {
        (0..self.len()).into_par_iter().step_by(self.len().div_ceil(SAMPLED).max(1))
    }
}

impl Scene {
    /// # Errors
    /// [`Refusal`] if a scan is empty, or both lie apart.
    pub(super) fn new(reference: &Cloud, cloud: &Cloud, params: &HoleParams) -> Result<Self, Refusal> {
        for (what, scan) in [("reference", reference), ("laser", cloud)] {
            if scan.len() <= AROUND {
                return Err(no_points(what));
            }
        }
        let sight = Sight::of(cloud);
        let (reference, cloud) = (Scan::new(corrected(reference), &sight), Scan::new(corrected(cloud), &sight));
        let ([of_reference, _], [of_cloud, grid_mm]) = (reference.median_spacing(), cloud.median_spacing());
        let mut scene = Self {
            grid_mm: sight.is_known().then_some(grid_mm),
            reference,
            cloud,
            sight,
            coarser: (of_cloud / of_reference).max(1.0),
            median_spacing_mm: of_cloud.max(of_reference),
            surface_spacing_mm: 0.0,
            density: 1.0,
            residual_mm: 0.0,
        };
        let [residual_mm, slant] = scene.median_residual(params.spot_radius_mm);
        (scene.residual_mm, scene.surface_spacing_mm) = (residual_mm, scene.median_spacing_mm * slant);
        if scene.residual_mm > params.max_scan_residual_mm {
            let limit_mm = params.max_scan_residual_mm;
            return Err(Refusal::of(format!(
                "the laser scan lies {:.2} mm (median) from the reference scan, {limit_mm} mm is allowed; did the bone or the \
                 camera move without a marker, or is the calibration off?",
                scene.residual_mm
            )));
        }
        let mut density: Vec<f64> = scene
            .reference
            .sampled()
            .step_by(4)
            .map(|i| {
                let count =
                    |scan: &Scan| scan.tree.within(&scene.reference.flat[i], params.spot_radius_mm).len() as f64;
                count(&scene.cloud) / count(&scene.reference)
            })
            .filter(|share| *share > 0.0)
            .collect();
        scene.density = median(&mut density).max(f64::MIN_POSITIVE);
        Ok(scene)
    }

    /// The scan with fewer points.
    pub(super) fn coarser_scan(&self) -> &'static str {
        if self.coarser > 1.0 { "laser" } else { "reference" }
    }

    /// Spacing around a reference point as the camera sees it, mm, in whichever scan is coarser.
    pub(super) fn spacing_mm(&self, index: usize) -> f64 {
        self.coarser * self.reference.spacing(index)[0]
    }

    /// Indices and squared distances (mm²) of the points of a scan no farther than `radius_mm` in space, by index.
    pub(super) fn within(&self, scan: &Scan, point: &Point3<f64>, radius_mm: f64) -> Vec<(usize, f64)> {
        let mut neighbours = scan.tree.within(&self.sight.flatten(point), self.sight.reach_mm(point, radius_mm));
        neighbours.iter_mut().for_each(|(i, square)| *square = (scan.points[*i] - point).norm_squared());
        neighbours.retain(|(_, square)| *square <= radius_mm * radius_mm);
        neighbours
    }

    /// Median distance of the laser scan from the planes through its neighbours in the reference, over their overlap;
    /// over everything if they do not overlap. Second, the median of [`Sight::slant`].
    fn median_residual(&self, reach_mm: f64) -> [f64; 2] {
        let Self { reference, cloud, .. } = self;
        let residuals: Vec<(f64, f64, f64)> = cloud
            .sampled()
            .map(|i| {
                let point = &cloud.points[i];
                let neighbours = reference.tree.nearest_n(&cloud.flat[i], AROUND);
                let around: Vec<Point3<f64>> = neighbours.iter().map(|(j, _)| reference.points[*j]).collect();
                let near = around.iter().map(|p| (p - point).norm()).fold(f64::MAX, f64::min);
                let centre = crate::kabsch::centroid(&around);
                let normal = plane_normal(&around);
                let off = normal.map_or(near, |n| n.dot(&(point - centre)).abs());
                (near, off, normal.map_or(1.0, |n| self.sight.slant(point, &n)))
            })
            .collect();
        let mut shared: Vec<f64> =
            residuals.iter().filter(|(near, ..)| *near <= reach_mm).map(|(_, off, _)| *off).collect();
        // Either scan may be cropped, so a part of one that the other shares is enough.
        let is_shared = |i: &usize| !self.within(cloud, &reference.points[*i], reach_mm).is_empty();
        let covered = || reference.sampled().filter(is_shared).count() * 2 >= reference.sampled().count();
        if shared.len() * 5 < residuals.len() && (shared.is_empty() || !covered()) {
            shared = residuals.iter().map(|(near, ..)| *near).collect();
        }
        let slants = residuals.iter().filter(|(near, ..)| *near <= reach_mm).map(|(.., slant)| *slant);
        let slant = if shared.is_empty() { 1.0 } else { median(&mut slants.collect::<Vec<_>>()) };
        [median(&mut shared), slant]
    }
}

/// The refusal of an empty scan, `reference` or `laser`.
pub(super) fn no_points(what: &str) -> Refusal {
    Refusal::of(format!("the {what} scan has no points; is the region of interest around the bone?"))
}

/// The refusal of a laser scan that does not say where its camera was.
pub(super) fn no_viewpoint() -> Refusal {
    Refusal::of("the laser scan has no viewpoint, which its camera's image needs; use hole.cloud_difference, or set it")
}
