//! The reference scan and the scan with the laser, prepared for comparison.

use super::{HoleError, HoleParams};
use crate::nearest::Nearest;
use crate::normals::plane_normal;
use nalgebra::Point3;
use osteoflow_geometry::Cloud;

/// Neighbours that determine the spacing around a point: the first ring of a square grid.
const RING: usize = 8;

/// Approximate number of points sampled for statistics of a whole scan.
const SAMPLED: usize = 1000;

/// Neighbours to which a plane is fitted.
const AROUND: usize = 12;

/// Both scans in one frame, with trees and spacing.
pub(super) struct Scene<'a> {
    pub(super) reference: &'a [Point3<f64>],
    pub(super) cloud: &'a [Point3<f64>],
    pub(super) reference_tree: Nearest,
    pub(super) cloud_tree: Nearest,
    /// Ratio of the spacings of the laser scan and the reference, at least 1.
    coarser: f64,
    /// Point spacing of the laser scan in its camera's grid, across the line of sight, mm, if it has a viewpoint.
    pub(super) grid_mm: Option<f64>,
    /// Points of the laser scan per point of the reference, where both overlap.
    pub(super) density: f64,
    /// Median distance of the scan with the laser from the reference's surface, mm.
    pub(super) residual_mm: f64,
}

impl<'a> Scene<'a> {
    /// # Errors
    /// [`HoleError::Empty`], [`HoleError::ScansApart`].
    pub(super) fn new(reference: &'a Cloud, cloud: &'a Cloud, params: &HoleParams) -> Result<Self, HoleError> {
        for (what, scan) in [("reference", reference), ("laser", cloud)] {
            if scan.len() <= AROUND {
                return Err(HoleError::Empty { what });
            }
        }
        let camera = cloud.viewpoint.map(|viewpoint| Point3::from(viewpoint.translation.vector));
        let (reference, cloud) = (reference.points(), cloud.points());
        let (reference_tree, cloud_tree) = (Nearest::new(reference), Nearest::new(cloud));
        let mut scene = Self {
            reference,
            cloud,
            reference_tree,
            cloud_tree,
            coarser: 1.0,
            grid_mm: None,
            density: 1.0,
            residual_mm: 0.0,
        };
        scene.grid_mm = camera.map(|camera| grid_mm(&scene.cloud_tree, cloud, &camera));
        let mut of_cloud: Vec<f64> = thinned(cloud).map(|p| spacing(&scene.cloud_tree, p)).collect();
        scene.coarser = (median(&mut of_cloud) / scene.median_spacing()).max(1.0);
        scene.residual_mm = scene.median_residual(params.spot_radius_mm);
        if scene.residual_mm > params.max_scan_residual_mm {
            let limit_mm = params.max_scan_residual_mm;
            return Err(HoleError::ScansApart { residual_mm: scene.residual_mm, limit_mm });
        }
        let mut density: Vec<f64> = thinned(reference)
            .step_by(4)
            .map(|p| {
                let count = |tree: &Nearest| tree.within(p, params.spot_radius_mm).len() as f64;
                count(&scene.cloud_tree) / count(&scene.reference_tree)
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

    /// Spacing around a reference point, mm, in whichever scan is coarser.
    pub(super) fn spacing_mm(&self, index: usize) -> f64 {
        self.coarser * spacing(&self.reference_tree, &self.reference[index])
    }

    /// Median of [`Scene::spacing_mm`].
    pub(super) fn median_spacing(&self) -> f64 {
        median(
            &mut thinned(self.reference).map(|p| self.coarser * spacing(&self.reference_tree, p)).collect::<Vec<_>>(),
        )
    }

    /// Median distance of the laser scan from the planes through its neighbours in the reference, over their overlap;
    /// over everything if they do not overlap.
    fn median_residual(&self, reach_mm: f64) -> f64 {
        let residuals: Vec<(f64, f64)> = thinned(self.cloud)
            .map(|p| {
                let found = self.reference_tree.nearest_n(p, AROUND);
                let near = found.first().map_or(f64::MAX, |(_, square)| square.sqrt());
                let around: Vec<Point3<f64>> = found.iter().map(|(i, _)| self.reference[*i]).collect();
                let centre = crate::kabsch::centroid(&around);
                (near, plane_normal(&around).map_or(near, |n| n.dot(&(p - centre)).abs()))
            })
            .collect();
        let mut shared: Vec<f64> = residuals.iter().filter(|(near, _)| *near <= reach_mm).map(|(_, d)| *d).collect();
        // Either scan may be cropped, so a part of one that the other shares is enough.
        let is_shared =
            |p: &Point3<f64>| self.cloud_tree.nearest(p).is_some_and(|(_, square)| square.sqrt() <= reach_mm);
        let covered =
            || thinned(self.reference).filter(|p| is_shared(p)).count() * 2 >= thinned(self.reference).count();
        if shared.len() * 5 < residuals.len() && (shared.is_empty() || !covered()) {
            shared = residuals.iter().map(|(near, _)| *near).collect();
        }
        median(&mut shared)
    }
}

/// Distance to the farthest of the first ring, so a grid seen at a slant counts by its wide side, mm.
fn spacing(tree: &Nearest, point: &Point3<f64>) -> f64 {
    tree.nearest_n(point, RING + 1).last().map_or(0.0, |(_, square)| (square / 2.0).sqrt())
}

/// Median distance of points from their second neighbour across the line of sight, mm: a step of the camera's grid, of which
/// a surface at a slant shows every one along the shorter side.
fn grid_mm(tree: &Nearest, points: &[Point3<f64>], camera: &Point3<f64>) -> f64 {
    let mut steps: Vec<f64> = thinned(points)
        .filter_map(|point| {
            let sight = (point - camera).try_normalize(0.0)?;
            let across = |i: usize| {
                let offset = points[i] - point;
                (offset - sight * offset.dot(&sight)).norm()
            };
            let mut around: Vec<f64> = tree.nearest_n(point, RING + 1).iter().map(|(i, _)| across(*i)).collect();
            around.sort_by(f64::total_cmp);
            // The first is the point itself.
            around.get(2).copied()
        })
        .collect();
    median(&mut steps)
}

/// About [`SAMPLED`] points, evenly along the scan.
fn thinned(points: &[Point3<f64>]) -> impl Iterator<Item = &Point3<f64>> {
    points.iter().step_by(points.len().div_ceil(SAMPLED).max(1))
}

/// The median; zero without values.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}
