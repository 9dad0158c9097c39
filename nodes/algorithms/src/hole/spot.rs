//! What all detectors share: the two scans, and the search for a disc among the missing points.

use super::{Hole, HoleError, HoleParams, HoleReport};
use crate::kabsch::centroid;
use crate::nearest::Nearest;
use nalgebra::Point3;
use osteoflow_geometry::Cloud;

/// Both scans, with trees.
pub(super) struct Scene<'a> {
    pub(super) reference: &'a [Point3<f64>],
    pub(super) cloud: &'a [Point3<f64>],
    reference_tree: Nearest,
    cloud_tree: Nearest,
    spacing_mm: f64,
}

impl<'a> Scene<'a> {
    pub(super) fn new(reference: &'a Cloud, cloud: &'a Cloud, _params: &HoleParams) -> Result<Self, HoleError> {
        for (what, scan) in [("reference", reference), ("laser", cloud)] {
            if scan.len() < 3 {
                return Err(HoleError::Empty { what });
            }
        }
        let reference_tree = Nearest::new(reference.points());
        let cloud_tree = Nearest::new(cloud.points());
        let mut gaps: Vec<f64> = reference
            .points()
            .iter()
            .filter_map(|p| reference_tree.nearest_n(p, 5).last().map(|(_, d)| d.sqrt()))
            .collect();
        gaps.sort_by(f64::total_cmp);
        let spacing_mm = gaps[gaps.len() / 2];
        Ok(Self { reference: reference.points(), cloud: cloud.points(), reference_tree, cloud_tree, spacing_mm })
    }

    pub(super) fn without_neighbour(&self) -> Vec<usize> {
        let radius = 2.0 * self.spacing_mm;
        let alone = |p: &Point3<f64>| self.cloud_tree.nearest(p).is_none_or(|(_, d)| d > radius * radius);
        (0..self.reference.len()).filter(|&i| alone(&self.reference[i])).collect()
    }
}

pub(super) fn find(scene: &Scene<'_>, missing: &[usize], params: &HoleParams) -> Result<Hole, HoleError> {
    let radius = params.spot_radius_mm;
    let is_missing = |i: &usize| missing.binary_search(i).is_ok();
    let inside = |p: &Point3<f64>| {
        scene.reference_tree.within(p, radius).into_iter().map(|(i, _)| i).filter(is_missing).collect::<Vec<usize>>()
    };
    let best = missing.iter().map(|&i| inside(&scene.reference[i])).max_by_key(Vec::len).unwrap_or_default();
    if best.len() < 10 {
        return Err(HoleError::None {
            expected_radius_mm: radius,
            n_missing: missing.len(),
            best: format!("no more than {} of them lie together", best.len()),
        });
    }
    let centre = centroid(&best.iter().map(|&i| scene.reference[i]).collect::<Vec<_>>());
    let n_expected = scene.reference_tree.within(&centre, radius).len();
    let empty_share = best.len() as f64 / n_expected.max(1) as f64;
    let report = HoleReport {
        n_reference: scene.reference.len(),
        n_cloud: scene.cloud.len(),
        n_missing: missing.len(),
        n_hole: best.len(),
        n_candidates: 1,
        spacing_mm: scene.spacing_mm,
        scan_residual_mm: 0.0,
        radius_mm: radius * empty_share.sqrt(),
        expected_radius_mm: radius,
        empty_share,
        rim_share: 1.0,
        size_share: 1.0,
        confidence: empty_share,
    };
    Ok(Hole { centre, radius_mm: report.radius_mm, confidence: report.confidence, report })
}
