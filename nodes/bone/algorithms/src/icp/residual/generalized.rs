use super::{Pair, Residual};
use crate::icp::normal_equations::NormalEquations;
use nalgebra::{Matrix3, Vector3};

/// Variance along a normal if that along the surface is 1. Segal's value.
const NORMAL_VARIANCE: f64 = 1e-3;

/// The Mahalanobis distance between two planar Gaussians (GICP), scaled to equal the distance along the normals in mm where
/// both normals agree.
///
/// Source: Segal, Haehnel and Thrun 2009, eq. 2 and section III-B.
pub(in crate::icp) struct Generalized;

impl Generalized {
    #[inline]
    fn information(pair: &Pair) -> Matrix3<f64> {
        let planar = |n: &Vector3<f64>| Matrix3::identity() - n * n.transpose() * (1.0 - NORMAL_VARIANCE);
        let covariance = planar(&pair.normal) + planar(pair.sound_source_normal());
        // Its smallest eigenvalue is twice the variance along the normals, so there is an inverse.
        covariance.try_inverse().unwrap_or_else(Matrix3::zeros) * (2.0 * NORMAL_VARIANCE)
    }
}

impl Residual for Generalized {
    const SOURCE_NORMALS: bool = true;

    #[inline]
    fn square(pair: &Pair) -> f64 {
        pair.difference.dot(&(Self::information(pair) * pair.difference))
    }

    #[inline]
    fn accumulate(pair: &Pair, weight: f64, lever_arm_mm: f64, equations: &mut NormalEquations) {
        equations.add_block(&(Self::information(pair) * weight), &pair.difference, &pair.source, lever_arm_mm);
    }
}
