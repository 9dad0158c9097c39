//! Noise of a scan, from the scan alone.

use crate::kabsch::centroid;
use crate::nearest::Nearest;
use nalgebra::{Matrix3, Point3};
use rayon::prelude::*;

/// Neighbours to which a plane is fitted: on a scan of 0.4 mm spacing those within 1.6 mm, far more than the noise.
const AROUND: usize = 48;

/// Number of planes.
const N_PLANES: usize = 1000;

/// Quantile of the planes' variances that counts: planes across an edge are among the upper ones.
const QUANTILE: f64 = 0.4;

/// Standard deviation of the points across the planes fitted to their neighbours, mm; `None` for fewer points than a
/// plane's neighbours. `O(n log n)`.
///
/// Smooth errors of the camera and rounded edges do not count, as each plane is small.
pub(super) fn noise_mm(scan: &[Point3<f64>]) -> Option<f64> {
    if scan.len() <= AROUND {
        return None;
    }
    let tree = Nearest::new(scan);
    let sampled: Vec<&Point3<f64>> = scan.iter().step_by(scan.len().div_ceil(N_PLANES)).collect();
    let mut variances: Vec<f64> = sampled
        .par_iter()
        .map(|point| {
            let near: Vec<Point3<f64>> = tree.nearest_n(point, AROUND).iter().map(|(i, _)| scan[*i]).collect();
            let centre = centroid(&near);
            let scatter: Matrix3<f64> = near.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
            scatter.symmetric_eigenvalues().min().max(0.0) / (near.len() - 3) as f64
        })
        .collect();
    let k = ((variances.len() - 1) as f64 * QUANTILE) as usize;
    Some(variances.select_nth_unstable_by(k, f64::total_cmp).1.sqrt())
}
