use super::{Pair, Residual};
use crate::icp::sums::{Sums, plane_row};
use nalgebra::Vector6;

/// The distance between the points, the paper's.
///
/// Source: Besl and McKay 1992; section 2.3 of the paper.
pub(in crate::icp) struct PointToPoint;

impl Residual for PointToPoint {
    const TARGET_NORMALS: bool = false;

    #[inline]
    fn square(pair: &Pair) -> f64 {
        pair.gap.norm_squared()
    }

    fn add(pair: &Pair, weight: f64, lever_arm_mm: f64, sums: &mut Sums) {
        let (arm, gap) = (&pair.arm, &pair.gap);
        let turn = arm.cross(gap) / lever_arm_mm;
        sums.gradient += Vector6::new(gap.x, gap.y, gap.z, turn.x, turn.y, turn.z) * weight;
        let row = plane_row(&pair.normal, arm, lever_arm_mm);
        let along = gap.dot(&pair.normal);
        sums.plane_squares += weight * along * along;
        sums.add_hold(&row, weight);
        sums.add_grip(arm, gap, weight, lever_arm_mm);
    }
}
