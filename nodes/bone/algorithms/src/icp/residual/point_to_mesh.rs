use super::{Pair, PointToPlane, Residual};
use crate::icp::normal_equations::NormalEquations;

/// The distance to the closest point of the target's triangles, without the error of sampling them.
///
/// The pair's normal is the direction to that point, which is the gradient of the distance, so the step is that of
/// point-to-plane. Source: Pottmann, Huang, Yang and Hu 2006, section 3.
pub(in crate::icp) struct PointToMesh;

impl Residual for PointToMesh {
    const MESH: bool = true;

    #[inline]
    fn square(pair: &Pair) -> f64 {
        pair.difference.norm_squared()
    }

    #[inline]
    fn accumulate(pair: &Pair, weight: f64, lever_arm_mm: f64, equations: &mut NormalEquations) {
        PointToPlane::accumulate(pair, weight, lever_arm_mm, equations);
    }
}
