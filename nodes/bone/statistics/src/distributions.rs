//! The quantiles and probabilities needed here, by `statrs`.

use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// `Φ⁻¹(p)`.
pub(crate) fn normal_quantile(p: f64) -> f64 {
    Normal::standard().inverse_cdf(p)
}

/// `Φ(z)`.
pub(crate) fn normal_cdf(z: f64) -> f64 {
    Normal::standard().cdf(z)
}

/// The normal quantile that leaves `(1 - level) / 2` on each side: 1.96 for 0.95.
pub(crate) fn two_sided_z(level: f64) -> f64 {
    normal_quantile(0.5 + level / 2.0)
}

/// The quantile of Student's t with `df` degrees of freedom that leaves `(1 - level) / 2` on each side.
pub(crate) fn two_sided_t(level: f64, df: usize) -> f64 {
    students_t(df).inverse_cdf(0.5 + level / 2.0)
}

/// Probability that Student's t exceeds `t`.
pub(crate) fn t_above(t: f64, df: usize) -> f64 {
    students_t(df).sf(t)
}

fn students_t(df: usize) -> StudentsT {
    StudentsT::new(0.0, 1.0, df as f64).expect("df is at least 1")
}
