//! Equivalence of two methods.

use serde::Serialize;

use crate::{
    Interval, StatisticsError,
    distributions::{t_above, two_sided_t},
    summary::{mean, sd},
};

/// Two one-sided tests of paired differences against a margin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tost {
    /// Number of pairs.
    pub n: usize,
    /// Mean difference.
    pub mean: f64,
    /// Standard deviation of the differences, with n - 1.
    pub sd: f64,
    /// The margin, in the unit of the differences.
    pub margin: f64,
    /// Significance level.
    pub alpha: f64,
    /// p against "the mean difference is -margin or less".
    pub p_lower: f64,
    /// p against "the mean difference is margin or more".
    pub p_upper: f64,
    /// The larger of the two: p against "they differ by the margin or more".
    pub p: f64,
    /// `p < alpha`, which is equivalent to `interval` being within the margin.
    pub equivalent: bool,
    /// Interval of the mean difference at level `1 - 2 alpha`.
    pub interval: Interval,
}

/// Equivalence of two methods by two one-sided t tests on their paired differences.
///
/// `t = (mean ± margin) / (sd / √n)` with `n - 1` degrees of freedom. The margin is the largest difference that does not
/// matter, stated before the data are seen. Not equivalent does not mean different: the interval shows which.
/// Assumes independent differences: use [`crate::unit_means`] first if they repeat within units.
///
/// # Errors
/// [`StatisticsError`] with fewer than two differences, one that is not finite, a margin not above 0, an alpha not between 0
/// and 0.5, or if all differences are equal.
///
/// # Source
/// Schuirmann 1987, Journal of Pharmacokinetics and Biopharmaceutics 15:657-680.
pub fn tost(differences: &[f64], margin: f64, alpha: f64) -> Result<Tost, StatisticsError> {
    let n = differences.len();
    StatisticsError::too_few("differences", n, 2)?;
    StatisticsError::not_finite(differences)?;
    StatisticsError::out_of_range("alpha", alpha, 0.5)?;
    if !(margin > 0.0 && margin.is_finite()) {
        return Err(StatisticsError(format!(
            "the margin of equivalence is {margin}; state the largest difference that does not matter, above 0"
        )));
    }
    StatisticsError::constant("differences", differences)?;
    let mut differences = differences.to_vec();
    differences.sort_unstable_by(f64::total_cmp);
    let (mean, sd) = (mean(&differences), sd(&differences));
    let standard_error = sd / (n as f64).sqrt();
    let p_lower = t_above((mean + margin) / standard_error, n - 1);
    let p_upper = t_above((margin - mean) / standard_error, n - 1);
    let p = p_lower.max(p_upper);
    let level = 1.0 - 2.0 * alpha;
    let half = two_sided_t(level, n - 1) * standard_error;
    let interval = Interval { level, low: mean - half, high: mean + half };
    Ok(Tost { n, mean, sd, margin, alpha, p_lower, p_upper, p, equivalent: p < alpha, interval })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_are_equivalent_if_the_interval_is_within_the_margin() {
        let differences = [0.10, -0.05, 0.02, 0.07, 0.01, -0.03, 0.04];
        let within = |margin: f64| {
            let test = tost(&differences, margin, 0.05).unwrap();
            assert_eq!(test.equivalent, test.interval.low > -margin && test.interval.high < margin, "{test:?}");
            test.equivalent
        };
        assert!(within(0.1) && within(0.07));
        assert!(!within(0.05) && !within(0.01));
    }

    #[test]
    fn what_cannot_be_tested_is_refused() {
        assert!(tost(&[1.0], 0.1, 0.05).unwrap_err().to_string().contains("needed; measure more"));
        assert!(tost(&[1.0, 2.0], 0.0, 0.05).unwrap_err().to_string().contains("the margin of equivalence is 0;"));
        assert!(tost(&[1.0, f64::NAN], 0.1, 0.05).unwrap_err().to_string().contains("value 1 is NaN"));
        assert!(tost(&[1.0, 2.0], 0.1, 0.6).unwrap_err().to_string().contains("but must lie between 0 and"));
        assert_eq!(
            tost(&[0.0, 0.0], 0.1, 0.05).unwrap_err().to_string(),
            "all 2 differences are 0, without any spread; state that instead of a test"
        );
    }
}
