use super::{Pair, Residual};
use crate::icp::normal_equations::{NormalEquations, jacobian_row};

/// The distance along the mean of both normals: zero if both points are on one sphere or cylinder.
///
/// Source: Rusinkiewicz 2019, eqs. 6 and 10, with the mean of the normals instead of their sum, so that it is in mm.
pub(in crate::icp) struct Symmetric;

impl Residual for Symmetric {
    const SOURCE_NORMALS: bool = true;

    #[inline]
    fn square(pair: &Pair) -> f64 {
        (pair.difference.dot(&(pair.normal + pair.sound_source_normal())) / 2.0).powi(2)
    }

    #[inline]
    fn accumulate(pair: &Pair, weight: f64, lever_arm_mm: f64, equations: &mut NormalEquations) {
        let normal = (pair.normal + pair.sound_source_normal()) / 2.0;
        // Half of the turn is the target's, about the middle of the pair.
        let middle = pair.source - pair.difference / 2.0;
        let row = jacobian_row(&normal, &middle, lever_arm_mm);
        equations.add_row(&row, pair.difference.dot(&normal), weight);
    }
}
