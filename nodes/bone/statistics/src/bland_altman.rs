//! Agreement of two methods that measure the same quantity.

use serde::Serialize;

use crate::{
    Interval, StatisticsError,
    distributions::two_sided_t,
    summary::{mean, sd},
};

/// The rounded normal quantile that Bland and Altman use for 2.5 % on each side.
pub(crate) const NORMAL_95: f64 = 1.96;

/// Bland-Altman limits of agreement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BlandAltman {
    /// Pairs of measurements.
    pub n: usize,
    /// Number of units that the pairs come from: each pair is one.
    pub n_units: usize,
    /// Mean difference, first method less second.
    pub bias: f64,
    /// Standard deviation of the difference of one pair.
    pub sd: f64,
    /// Standard deviation between units, which pairs that do not repeat do not show.
    pub sd_between: Option<f64>,
    /// Standard deviation within units, likewise.
    pub sd_within: Option<f64>,
    /// `bias - 1.96 sd`: 95 % of pairs are between this and `upper_limit`.
    pub lower_limit: f64,
    /// `bias + 1.96 sd`.
    pub upper_limit: f64,
    /// Confidence interval of the bias.
    pub bias_interval: Interval,
    /// Confidence interval of the lower limit.
    pub lower_interval: Interval,
    /// Confidence interval of the upper limit.
    pub upper_interval: Interval,
}

/// Limits of agreement of two methods from the differences of independent pairs.
///
/// `bias ± 1.96 sd`. With t of n - 1 degrees of freedom, the interval of the bias is `± t sd/√n`, of each limit
/// `± t sd √(1/n + 1.96²/(2(n-1)))`. Differences should be roughly normal and independent of the size of the measured value.
///
/// # Errors
/// [`StatisticsError`] with fewer than two pairs, a value that is not finite, a level out of range, or if all differences are
/// equal.
///
/// # Source
/// Bland & Altman 1986, Lancet 327:307-310, and 1999, Stat. Methods Med. Res. 8:135-160, section 2.
pub fn bland_altman(differences: &[f64], level: f64) -> Result<BlandAltman, StatisticsError> {
    let n = differences.len();
    StatisticsError::too_few("differences", n, 2)?;
    StatisticsError::not_finite(differences)?;
    StatisticsError::out_of_range("the confidence level", level, 1.0)?;
    StatisticsError::constant("differences", differences)?;
    let mut differences = differences.to_vec();
    differences.sort_unstable_by(f64::total_cmp);
    let (bias, sd) = (mean(&differences), sd(&differences));
    let (t, n_pairs) = (two_sided_t(level, n - 1), n as f64);
    let half_of_limit = t * sd * (1.0 / n_pairs + NORMAL_95 * NORMAL_95 / (2.0 * (n_pairs - 1.0))).sqrt();
    let about = |at: f64, half: f64| Interval { level, low: at - half, high: at + half };
    let (lower_limit, upper_limit) = (bias - NORMAL_95 * sd, bias + NORMAL_95 * sd);
    Ok(BlandAltman {
        n,
        n_units: n,
        bias,
        sd,
        sd_between: None,
        sd_within: None,
        lower_limit,
        upper_limit,
        bias_interval: about(bias, t * sd / n_pairs.sqrt()),
        lower_interval: about(lower_limit, half_of_limit),
        upper_interval: about(upper_limit, half_of_limit),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_pair_and_equal_differences_are_refused() {
        assert!(bland_altman(&[0.1, 0.1], 0.95).unwrap_err().to_string().contains("without any spread"));
        assert!(bland_altman(&[0.1], 0.95).unwrap_err().to_string().contains("needed; measure more"));
        assert!(
            bland_altman(&[0.1, f64::NAN], 0.95).unwrap_err().to_string().contains("leave rows without a number out")
        );
    }
}
