//! How far a target is from one place, with its lengths in any scale: that is no fault of single poses.

use super::{LEAST_SPREAD, Motion, Pair, axis_spread, motions, park_martin, placed};
use crate::calibrate::inliers::N_OF_START;
use nalgebra::{Isometry3, Matrix3, Matrix3x4, Matrix4, Translation3, UnitQuaternion, Vector4};

/// Distance at which an angle counts as a length, mm: about half a board.
const TURN_ARM_MM: f64 = 100.0;
/// The share of the poses that is judged by: of a target that was moved half-way half agree.
const JUDGED_SHARE: f64 = 0.4;
/// Poses farther than this many times the distance within which that share is are outliers: with normal errors one of millions.
const GATE: f64 = 5.0;
/// Poses within this are no outliers, mm: ten times what a tracker errs by.
const LEAST_GATE_MM: f64 = 2.0;

/// The camera in its marker's frame with this rotation, and the scale of the target's lengths beside it: `(R_a - I) t - R t_b / scale =
/// -t_a` for all motions. `None` if they do not determine it.
pub(super) fn with_scale(rotation: UnitQuaternion<f64>, motions: &[Motion]) -> Option<(Isometry3<f64>, f64)> {
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for m in motions {
        let mut rows = Matrix3x4::zeros();
        let turn = m.a.rotation.to_rotation_matrix().into_inner() - Matrix3::identity();
        rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        rows.fixed_view_mut::<3, 1>(0, 3).copy_from(&-(rotation * m.b.translation.vector));
        normal += rows.transpose() * rows;
        right -= rows.transpose() * m.a.translation.vector;
    }
    let solution = normal.try_inverse()? * right;
    let (t, scale) = (Translation3::new(solution[0], solution[1], solution[2]), 1.0 / solution[3]);
    (scale.is_finite() && scale > 0.0).then_some((Isometry3::from_parts(t, rotation), scale))
}

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
    let (fit, scale) = with_scale(park_martin(&motions)?, &motions)?;
    let home = placed(&in_scale(used, scale), &fit).1;
    let off = |at: Isometry3<f64>| {
        (at.translation.vector - home.translation.vector).norm() + TURN_ARM_MM * at.rotation.angle_to(&home.rotation)
    };
    Some(placed(&in_scale(pairs, scale), &fit).0.into_iter().map(off).collect())
}

/// The distance within which the judged share of the poses is, mm.
pub(super) fn judged_mm(offsets: &[f64]) -> f64 {
    let mut sorted = offsets.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = ((JUDGED_SHARE * sorted.len() as f64) as usize).max(N_OF_START);
    sorted[rank.min(sorted.len() - 1)]
}

pub(super) fn within_gate(offsets: &[f64]) -> Vec<bool> {
    let gate_mm = (GATE * judged_mm(offsets)).max(LEAST_GATE_MM);
    offsets.iter().map(|offset| *offset <= gate_mm).collect()
}

/// That distance in the fit to all of them.
pub(super) fn misfit_mm(pairs: &[Pair]) -> f64 {
    offsets_mm(pairs, pairs).map_or(f64::INFINITY, |offsets| judged_mm(&offsets))
}
