use super::{Pair, Residual};
use crate::icp::sums::{Sums, plane_row};

/// The distance along the target's normal.
///
/// Source: Chen and Medioni 1992.
pub(in crate::icp) struct PointToPlane;

impl Residual for PointToPlane {
    #[inline]
    fn square(pair: &Pair) -> f64 {
        pair.gap.dot(&pair.normal).powi(2)
    }

    #[inline]
    fn add(pair: &Pair, weight: f64, lever_arm_mm: f64, sums: &mut Sums) {
        sums.add_row(&plane_row(&pair.normal, &pair.arm, lever_arm_mm), pair.gap.dot(&pair.normal), weight);
    }
}
