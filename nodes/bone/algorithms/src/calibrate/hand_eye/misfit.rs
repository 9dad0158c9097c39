//! How far a target is from one place, with its lengths in any scale: that is no fault of single poses.

use super::{LEAST_SPREAD, Pair, axis_spread, home, motions, offsets, park_martin, with_scale};
use crate::calibrate::inliers::Gate;
use nalgebra::Isometry3;

/// Distance at which an angle counts as a length, mm: about half a board.
const TURN_ARM_MM: f64 = 100.0;
/// Of a target that was moved half-way half of the poses agree; 5 times: with normal errors one of millions; 2 mm: ten times what a
/// tracker errs by.
pub(super) const GATE: Gate = Gate { share: 0.4, times: 5.0, least_mm: 2.0 };

/// The poses with the target's lengths in the right scale.
pub(super) fn in_scale(pairs: &[Pair], scale: f64) -> Vec<Pair> {
    let scaled = |t: &Isometry3<f64>| Isometry3::from_parts((t.translation.vector / scale).into(), t.rotation);
    pairs.iter().map(|(marker, target)| (*marker, scaled(target))).collect()
}

/// The distance of the target at each pose from its mean place in the fit to `used`, angles counted as lengths, mm.
pub(super) fn offsets_mm(pairs: &[Pair], used: &[Pair]) -> Option<Vec<f64>> {
    let motions = motions(used);
    if motions.len() < 2 || axis_spread(&motions) < LEAST_SPREAD {
        return None;
    }
    let (fit, scale) = with_scale(park_martin(&motions)?, &motions, true)?;
    let home = home(&in_scale(used, scale), &fit);
    let (mm, rad) = offsets(&in_scale(pairs, scale), &fit, &home);
    Some(mm.into_iter().zip(rad).map(|(mm, rad)| mm + TURN_ARM_MM * rad).collect())
}

/// The distance by which the fit to all of them is judged, mm.
pub(super) fn misfit_mm(pairs: &[Pair]) -> f64 {
    offsets_mm(pairs, pairs).map_or(f64::INFINITY, |offsets| GATE.judged_mm(&offsets))
}
