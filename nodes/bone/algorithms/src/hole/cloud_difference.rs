use super::scene::Scene;
use super::spot::{Missing, find};
use super::{Hole, HoleParams};
use crate::Refusal;
use osteoflow_geometry::Cloud;
use rayon::prelude::*;

/// A reference point is missing if the nearest point of the other scan is farther than this many spacings: twice the
/// largest distance between skewed grids, so one or two lost points leave no gap.
const GAP: f64 = 1.8;

/// A gap below this share of the median spacing is none, whatever the local spacing: saves computing the latter.
const LEAST: f64 = 0.7;

/// Where points are far apart, the factor is smaller, so that a gap is no wider than this share of the radius..
const WIDEST: f64 = 0.25;

/// ..but not smaller than this: a lost point alone leaves no gap.
const NARROWEST: f64 = 1.0;

/// The hole as the paper finds it: the reference scan minus the scan with the laser.
///
/// A reference point is missing if the laser scan has no point within a distance that follows the local spacing. Where the
/// laser scan has a viewpoint, distances are measured as its camera sees them, so a surface seen at a slant neither falls
/// apart nor hides a hole that is a few points wide. A disc of the spot's radius is searched for among the missing points;
/// its centre is fitted to its rim, from inside by the missing points and from outside by the present ones, so a hole
/// that another loss partly hides keeps its centre. A gap at the border of the common view has no rim and is no hole.
/// Both clouds are in one frame. `O(n log n)`.
///
/// # Errors
/// [`Refusal`]: no hole, more than one, too sparse to resolve it, or scans that do not coincide.
///
/// # Source
/// Section 2.3 of the paper, which takes the centre of the largest cluster of missing points.
pub fn cloud_difference(reference: &Cloud, cloud: &Cloud, params: &HoleParams) -> Result<Hole, Refusal> {
    let scene = Scene::new(reference, cloud, params)?;
    find(&scene, &missing(&scene, params), params)
}

/// Reference points farther from the scan with the laser than its spacing explains.
pub(super) fn missing(scene: &Scene, params: &HoleParams) -> Missing {
    // The distance between the scans must not look like a gap.
    let apart_mm = 2.0 * scene.residual_mm * scene.sight.depth_share();
    let factor = (WIDEST * params.spot_radius_mm / scene.median_spacing_mm).clamp(NARROWEST, GAP);
    let gap = |i: usize| (factor * scene.spacing_mm(i)).hypot(apart_mm);
    let least = scene.median_spacing_mm * factor * LEAST;
    let is_missing = |i: &usize| {
        let nearest = scene.cloud.nearest_flat(&scene.reference.flat[*i]);
        nearest.is_none_or(|square| square > least * least && square > gap(*i).powi(2))
    };
    let indices: Vec<usize> = (0..scene.reference.len()).into_par_iter().filter(is_missing).collect();
    // A point this close to the rim still has a neighbour beyond it.
    let margin_mm = indices.iter().map(|&i| gap(i)).sum::<f64>() / indices.len().max(1) as f64;
    Missing { indices, margin_mm, alone_is_enough: true }
}
