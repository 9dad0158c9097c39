use super::paired::{not_finite, nothing};
use super::quantile::quantile;
use crate::Refusal;
use crate::target::Target;
use nalgebra::{Isometry3, Point3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Distances of a scan from the surface it was registered to. Neither FRE nor TRE: it stays small for a bone that has
/// slid along itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SurfaceReport {
    /// Scan points, the whole region.
    pub n: usize,
    /// Points within `max_pair_distance_mm` of the surface.
    pub n_kept: usize,
    /// `n_kept / n`.
    pub inlier_share: f64,
    /// The limit, mm.
    pub max_pair_distance_mm: f64,
    /// RMS distance of the kept points, mm.
    pub rms_kept_mm: f64,
    /// RMS distance of all points, mm.
    pub rms_all_mm: f64,
    /// Mean distance of all points, mm.
    pub mean_all_mm: f64,
    /// Median distance of all points, mm.
    pub median_all_mm: f64,
    /// 95th percentile of the distance of all points, mm.
    pub p95_all_mm: f64,
    /// Largest distance, mm.
    pub max_all_mm: f64,
}

/// Distances of `source` points, moved by `t_target_source`, from the `target`: along the normal of the nearest target
/// point if that is near and has a normal, so the distance does not depend on the spacing of the target's points; else
/// between the points.
///
/// # Errors
/// [`Refusal`] without points or if none is near the surface.
pub fn surface_residual(
    target: &Target,
    source: &[Point3<f64>],
    t_target_source: &Isometry3<f64>,
    max_pair_distance_mm: f64,
) -> Result<SurfaceReport, Refusal> {
    if source.is_empty() {
        return Err(nothing("scan point"));
    }
    let distances: Option<Vec<(bool, f64)>> = source
        .par_iter()
        .map(|point| {
            let moved = t_target_source * point;
            let (index, distance) = target.nearest(&moved, f64::INFINITY)?;
            let kept = distance <= max_pair_distance_mm;
            let along = target.normals().map(|n| (moved - target.points()[index]).dot(&n[index]).abs());
            Some((kept, along.filter(|_| kept).unwrap_or(distance)))
        })
        .collect();
    let distances = distances.ok_or_else(|| not_finite("a scan point"))?;
    let kept: Vec<f64> = distances.iter().filter(|(kept, _)| *kept).map(|(_, d)| *d).collect();
    if kept.is_empty() {
        return Err(nothing("scan point near the surface"));
    }
    let mut all: Vec<f64> = distances.iter().map(|(_, d)| *d).collect();
    all.sort_by(f64::total_cmp);
    let rms = |d: &[f64]| (d.iter().map(|d| d * d).sum::<f64>() / d.len() as f64).sqrt();
    Ok(SurfaceReport {
        n: all.len(),
        n_kept: kept.len(),
        inlier_share: kept.len() as f64 / all.len() as f64,
        max_pair_distance_mm,
        rms_kept_mm: rms(&kept),
        rms_all_mm: rms(&all),
        mean_all_mm: all.iter().sum::<f64>() / all.len() as f64,
        median_all_mm: quantile(&all, 0.5).unwrap_or(0.0),
        p95_all_mm: quantile(&all, 0.95).unwrap_or(0.0),
        max_all_mm: all[all.len() - 1],
    })
}
