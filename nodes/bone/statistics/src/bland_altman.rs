//! Agreement of two methods that measure the same quantity.

use serde::Serialize;

use crate::{
    Interval, StatisticsError, Units,
    anova::OneWay,
    distributions::{chi_squared_quantile, two_sided_t},
    summary::{mean, sd},
};

/// The rounded normal quantile that Bland and Altman use for 2.5 % on each side.
pub(crate) const NORMAL_95: f64 = 1.96;

/// Bland-Altman limits of agreement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BlandAltman {
    /// Pairs of measurements.
    pub n: usize,
    /// Number of units that the pairs come from; `n` if each pair is a unit.
    pub n_units: usize,
    /// Mean difference, first method less second.
    pub bias: f64,
    /// Standard deviation of the difference of one pair: between and within units together.
    pub sd: f64,
    /// Standard deviation between units, if pairs repeat.
    pub sd_between: Option<f64>,
    /// Standard deviation within units, if pairs repeat.
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
    Ok(limits([n, n], [bias, sd], None, level, t * sd / n_pairs.sqrt(), [half_of_limit; 2]))
}

/// The limits with their intervals: half of that of the bias, and the distances of a limit's ends, inwards and outwards.
fn limits(
    [n, n_units]: [usize; 2],
    [bias, sd]: [f64; 2],
    between_within: Option<[f64; 2]>,
    level: f64,
    half_of_bias: f64,
    [inward, outward]: [f64; 2],
) -> BlandAltman {
    let (lower_limit, upper_limit) = (bias - NORMAL_95 * sd, bias + NORMAL_95 * sd);
    BlandAltman {
        n,
        n_units,
        bias,
        sd,
        sd_between: between_within.map(|[between, _]| between),
        sd_within: between_within.map(|[_, within]| within),
        lower_limit,
        upper_limit,
        bias_interval: Interval { level, low: bias - half_of_bias, high: bias + half_of_bias },
        lower_interval: Interval { level, low: lower_limit - outward, high: lower_limit + inward },
        upper_interval: Interval { level, low: upper_limit - inward, high: upper_limit + outward },
    }
}

/// Limits of agreement for pairs that repeat within units of the highest level, such as points of one bone.
///
/// The variance of one difference is that within units and that between them by one-way analysis of variance (as in
/// [`crate::repeatability`]): `sd² = MSW + max(0, (MSB - MSW)/n0)`. The bias is the mean over pairs; its interval is t with
/// G - 1 degrees of freedom on `√(G/(G-1) Σ(Σⱼ(dᵢⱼ - bias))²) / N`, the spread of whole units. The interval of a limit
/// combines that of the bias and that of `1.96 sd` by MOVER, the latter from chi-squared intervals of `MSB/n0` and
/// `(1 - 1/n0)MSW`; with units of unequal size it is an approximation. If no unit repeats, this is [`bland_altman`].
///
/// # Errors
/// As [`bland_altman`], and [`StatisticsError`] with fewer than two units: one unit does not show how others
/// differ.
///
/// # Source
/// Bland & Altman 2007, Journal of Biopharmaceutical Statistics 17:571-582, the case where the true value varies; intervals
/// of the limits: Zou 2013, Stat. Methods Med. Res. 22:630-642.
pub fn bland_altman_repeated(units: &Units, differences: &[f64], level: f64) -> Result<BlandAltman, StatisticsError> {
    let parts = units.split_sorted(differences)?;
    if parts.len() == differences.len() {
        return bland_altman(differences, level);
    }
    let (n, n_units) = (differences.len(), parts.len());
    StatisticsError::too_few(&format!("units ({})", units.highest()), n_units, 2)?;
    StatisticsError::out_of_range("the confidence level", level, 1.0)?;
    StatisticsError::constant("differences", differences)?;

    let anova = OneWay::of(&parts);
    let (within, between, n0) = (anova.mean_square_within, anova.variance_between(), anova.n0);
    let bias = parts.iter().map(|part| part.iter().sum::<f64>()).sum::<f64>() / n as f64;
    let sd = (between + within).sqrt();
    let squares: f64 = parts.iter().map(|part| part.iter().map(|d| d - bias).sum::<f64>().powi(2)).sum();
    let standard_error = (n_units as f64 / (n_units - 1) as f64 * squares).sqrt() / n as f64;
    let half_of_bias = two_sided_t(level, n_units - 1) * standard_error;

    // sd² as a sum of two independent mean squares, each with a chi-squared interval.
    let summands = [(between + within / n0, n_units - 1), ((1.0 - 1.0 / n0) * within, n - n_units)];
    let off = |p: f64| {
        let apart = |(part, df): (f64, usize)| part * (df as f64 / chi_squared_quantile(p, df) - 1.0);
        summands.map(apart).iter().map(|a| a * a).sum::<f64>().sqrt()
    };
    let (tail, variance) = ((1.0 - level) / 2.0, sd * sd);
    let sd_low = (variance - off(1.0 - tail)).max(0.0).sqrt();
    let sd_high = (variance + off(tail)).sqrt();
    let inward = half_of_bias.hypot(NORMAL_95 * (sd - sd_low));
    let outward = half_of_bias.hypot(NORMAL_95 * (sd_high - sd));
    let between_within = Some([between.sqrt(), within.sqrt()]);
    Ok(limits([n, n_units], [bias, sd], between_within, level, half_of_bias, [inward, outward]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_agree_if_no_unit_repeats() {
        let differences = [0.3, -0.2, 0.1, 0.6];
        let repeated = bland_altman_repeated(&Units::each_row("bone", 4), &differences, 0.95).unwrap();
        assert_eq!(repeated, bland_altman(&differences, 0.95).unwrap());
    }

    #[test]
    fn pairs_of_units_that_differ_widen_the_limits() {
        let paths: Vec<_> = (0..20).map(|row| [(row / 5).to_string()]).collect();
        let units = Units::new(&["bone"], &paths).unwrap();
        let differences: Vec<f64> = (0..20).map(|row| f64::from(row / 5) + 0.1 * f64::from(row % 5)).collect();
        let naive = bland_altman(&differences, 0.95).unwrap();
        let repeated = bland_altman_repeated(&units, &differences, 0.95).unwrap();
        assert!(repeated.sd > naive.sd && repeated.bias_interval.high > naive.bias_interval.high, "{repeated:?}");
    }

    #[test]
    fn one_unit_and_equal_differences_are_refused() {
        let one = Units::new(&["bone"], &[["A"], ["A"]]).unwrap();
        let refused = bland_altman_repeated(&one, &[0.1, 0.2], 0.95).unwrap_err();
        assert_eq!(refused.to_string(), "1 units (bone), at least 2 needed; measure more, or report the single values");
        assert!(bland_altman(&[0.1, 0.1], 0.95).unwrap_err().to_string().contains("without any spread"));
        assert!(bland_altman(&[0.1], 0.95).unwrap_err().to_string().contains("needed; measure more"));
        assert!(
            bland_altman(&[0.1, f64::NAN], 0.95).unwrap_err().to_string().contains("leave rows without a number out")
        );
    }
}
