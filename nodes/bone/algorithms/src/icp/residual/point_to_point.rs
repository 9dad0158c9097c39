use super::{Pair, Residual};
use crate::icp::normal_equations::{NormalEquations, jacobian_row};
use nalgebra::Vector6;

/// The distance between the points, as in the paper.
///
/// Source: Besl and McKay 1992; section 2.3 of the paper.
pub(in crate::icp) struct PointToPoint;

impl Residual for PointToPoint {
    const TARGET_NORMALS: bool = false;
    const ONE_SIDED: bool = false;

    #[inline]
    fn square(pair: &Pair) -> f64 {
        pair.difference.norm_squared()
    }

    fn accumulate(pair: &Pair, weight: f64, lever_arm_mm: f64, equations: &mut NormalEquations) {
        let (source, difference) = (&pair.source, &pair.difference);
        let torque = source.cross(difference) / lever_arm_mm;
        let force = difference;
        equations.b += Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z) * weight;
        let along = difference.dot(&pair.normal);
        equations.plane_squares += weight * along * along;
        equations.add_h(&jacobian_row(&pair.normal, source, lever_arm_mm), weight);
        equations.add_points(source, difference, weight, lever_arm_mm);
    }
}
