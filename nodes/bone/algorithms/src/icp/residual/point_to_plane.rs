use super::{Pair, Residual};
use crate::icp::normal_equations::{NormalEquations, jacobian_row};

/// The distance along the target's normal.
///
/// Source: Chen and Medioni 1992.
pub(in crate::icp) struct PointToPlane;

impl Residual for PointToPlane {
    #[inline]
    fn square(pair: &Pair) -> f64 {
        pair.difference.dot(&pair.normal).powi(2)
    }

    #[inline]
    fn accumulate(pair: &Pair, weight: f64, lever_arm_mm: f64, equations: &mut NormalEquations) {
        let row = jacobian_row(&pair.normal, &pair.source, lever_arm_mm);
        equations.add_row(&row, pair.difference.dot(&pair.normal), weight);
    }
}
