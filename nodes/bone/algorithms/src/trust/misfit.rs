//! The part of the residuals that noise does not explain.

use super::Residual;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Edge of a patch, mm: several patches around the visible side of a bone, a dozen points or more in each.
const PATCH_MM: f64 = 4.0;

/// Patches with fewer points are left out.
const MIN_POINTS: usize = 5;

/// Mean residuals of patches, RMS over the points, without the part that the sensor's noise explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Misfit {
    /// Of all patches, mm.
    pub rms_mm: f64,
    /// Of the patches inside the surface, mm: soft tissue lies outside, another bone on both sides.
    pub inward_mm: f64,
}

impl Misfit {
    /// The misfit of points on the surface.
    pub(super) fn new(on: &[Residual], noise_mm: f64) -> Self {
        let mut patches: BTreeMap<[i64; 3], (usize, f64)> = BTreeMap::new();
        for near in on {
            let key = std::array::from_fn(|k| (near.point[k] / PATCH_MM).floor() as i64);
            let (n, sum) = patches.entry(key).or_default();
            (*n, *sum) = (*n + 1, *sum + near.signed_mm);
        }
        let (mut n_points, mut squares, mut inward) = (0.0, 0.0, 0.0);
        for (n, sum) in patches.values().filter(|(n, _)| *n >= MIN_POINTS) {
            let n = *n as f64;
            n_points += n;
            // The noise of a mean of n is 1/n of its variance; half of it lies inside.
            squares += sum * sum / n - noise_mm * noise_mm;
            inward += sum.min(0.0).powi(2) / n - noise_mm * noise_mm / 2.0;
        }
        let rms = |squares: f64| if n_points > 0.0 { (squares.max(0.0) / n_points).sqrt() } else { 0.0 };
        Self { rms_mm: rms(squares), inward_mm: rms(inward) }
    }
}
