//! An interval of 90 %.

use nalgebra::Matrix3;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Radius about an estimate that holds the true vector with a chance of 90 %, from the covariance of its error and the degrees of
/// freedom with which that is estimated.
///
/// The square of the error is taken for a chi-squared one with as many degrees of freedom as its directions count for (Satterthwaite
/// 1946): 3 if all are alike, 1 if all of the error is in one.
pub(super) fn radius_90(covariance: &Matrix3<f64>, degrees_of_freedom: f64) -> f64 {
    let (trace, squares) = (covariance.trace(), covariance.norm_squared());
    if trace == 0.0 {
        return 0.0;
    }
    let directions = (trace * trace / squares).clamp(1.0, 3.0);
    FisherSnedecor::new(directions, degrees_of_freedom.max(1.0))
        .map_or(f64::INFINITY, |f| (trace * f.inverse_cdf(0.9)).sqrt())
}
