//! Summary statistics of a column.

use serde::Serialize;

use crate::{StatisticsError, quantile};

/// Summary statistics of a column, in the unit of its values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Summary {
    /// Number of rows. Not the n of a statement about other bones: that is the number of units at the highest level.
    pub n: usize,
    /// `Σx / n`: the **bias**, if the values are signed.
    pub mean: f64,
    /// `√(Σ(x - mean)² / (n - 1))`; `None` for a single row.
    pub sd: Option<f64>,
    /// `√(Σx² / n)`: bias and spread in one number.
    pub rms: f64,
    /// The median.
    pub median: f64,
    /// The 95 % quantile, by linear interpolation ([`quantile`]).
    pub p95: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// `Σ|x| / n`.
    pub mean_abs: f64,
}

impl Summary {
    /// Summary of a column; independent of the order of its rows to the last bit. `O(n log n)`.
    ///
    /// # Errors
    /// [`StatisticsError`] if it is empty, or a value is NaN or infinite.
    pub fn of(values: &[f64]) -> Result<Self, StatisticsError> {
        StatisticsError::too_few("values", values.len(), 1)?;
        StatisticsError::not_finite(values)?;
        let mut values = values.to_vec();
        // Sums of sorted values do not depend on which run finished first.
        values.sort_unstable_by(f64::total_cmp);
        let n = values.len();
        let mean = mean(&values);
        let mean_of = |f: fn(f64) -> f64| values.iter().map(|x| f(*x)).sum::<f64>() / n as f64;
        Ok(Self {
            n,
            mean,
            sd: (n > 1).then(|| sd(&values)),
            rms: mean_of(|x| x * x).sqrt(),
            min: values[0],
            max: values[n - 1],
            mean_abs: mean_of(f64::abs),
            median: quantile(&mut values, 0.5),
            p95: quantile(&mut values, 0.95),
        })
    }
}

/// Arithmetic mean; `values` is not empty.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard deviation with `n - 1`, of at least two values.
pub(crate) fn sd(values: &[f64]) -> f64 {
    let mean = mean(values);
    (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_row_has_a_mean_but_no_spread() {
        let summary = Summary::of(&[-1.5]).unwrap();
        assert_eq!((summary.n, summary.mean, summary.sd), (1, -1.5, None));
        assert_eq!((summary.rms, summary.mean_abs, summary.median, summary.p95), (1.5, 1.5, -1.5, -1.5));
    }

    #[test]
    fn nothing_and_no_number_are_refused() {
        assert!(Summary::of(&[]).unwrap_err().to_string().starts_with("0 values, at least 1 needed"));
        let refused = Summary::of(&[1.0, f64::NAN]).unwrap_err();
        assert!(refused.to_string().starts_with("value 1 is NaN"));
        assert!(Summary::of(&[f64::INFINITY]).unwrap_err().to_string().starts_with("value 0 is inf"));
    }
}
