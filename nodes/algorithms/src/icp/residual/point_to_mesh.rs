use super::{Pair, PointToPlane, Residual};
use crate::icp::sums::Sums;

/// The distance to the closest point of the target's triangles, free of the error of sampling them.
///
/// The pair's normal is the direction to that point, along which the distance changes, so a step is point-to-plane's.
/// Source: Pottmann, Huang, Yang and Hu 2006, section 3.
pub(in crate::icp) struct PointToMesh;

impl Residual for PointToMesh {
    const MESH: bool = true;

    #[inline]
    fn square(pair: &Pair) -> f64 {
        pair.gap.norm_squared()
    }

    #[inline]
    fn add(pair: &Pair, weight: f64, lever_arm_mm: f64, sums: &mut Sums) {
        PointToPlane::add(pair, weight, lever_arm_mm, sums);
    }
}
