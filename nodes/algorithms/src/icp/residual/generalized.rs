use super::{Pair, Residual};
use crate::icp::sums::Sums;
use nalgebra::Matrix3;

/// Variance along a normal where that along the surface is 1. Segal's value.
const ALONG_NORMAL: f64 = 1e-3;

/// The Mahalanobis distance where both points may lie anywhere nearby on their planes (GICP), scaled so that it is the
/// distance along the normals in mm where both agree.
///
/// Source: Segal, Haehnel and Thrun 2009, eq. 2 and section III-B.
pub(in crate::icp) struct Generalized;

impl Generalized {
    #[inline]
    fn information(pair: &Pair) -> Matrix3<f64> {
        let flat = |n: &nalgebra::Vector3<f64>| Matrix3::identity() - n * n.transpose() * (1.0 - ALONG_NORMAL);
        let covariance = flat(&pair.normal) + flat(pair.sound_source_normal());
        // Its least eigenvalue is twice the variance along the normals, so there is an inverse.
        covariance.try_inverse().unwrap_or_else(Matrix3::zeros) * (2.0 * ALONG_NORMAL)
    }
}

impl Residual for Generalized {
    const SOURCE_NORMALS: bool = true;

    #[inline]
    fn square(pair: &Pair) -> f64 {
        pair.gap.dot(&(Self::information(pair) * pair.gap))
    }

    #[inline]
    fn add(pair: &Pair, weight: f64, lever_arm_mm: f64, sums: &mut Sums) {
        sums.add_block(&(Self::information(pair) * weight), &pair.gap, &pair.arm, lever_arm_mm);
    }
}
