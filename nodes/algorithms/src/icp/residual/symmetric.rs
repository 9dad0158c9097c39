use super::{Pair, Residual};
use crate::icp::sums::{Sums, plane_row};

/// The distance along the mean of both normals: zero wherever both points lie on one sphere or cylinder.
///
/// Source: Rusinkiewicz 2019, eqs. 6 and 10, with the mean of the normals for their sum, so that it is in mm.
pub(in crate::icp) struct Symmetric;

impl Residual for Symmetric {
    const SOURCE_NORMALS: bool = true;

    #[inline]
    fn square(pair: &Pair) -> f64 {
        (pair.gap.dot(&(pair.normal + pair.sound_source_normal())) / 2.0).powi(2)
    }

    #[inline]
    fn add(pair: &Pair, weight: f64, lever_arm_mm: f64, sums: &mut Sums) {
        let normal = (pair.normal + pair.sound_source_normal()) / 2.0;
        // Half of the turn is the target's, about the middle of the pair.
        let middle = pair.arm - pair.gap / 2.0;
        sums.add_row(&plane_row(&normal, &middle, lever_arm_mm), pair.gap.dot(&normal), weight);
    }
}
