//! Paired test of whether one method gives larger values than another.

use serde::Serialize;

use crate::{StatisticsError, distributions::normal_cdf, hodges_lehmann, ranks::ranks};

/// Wilcoxon's signed-rank test of paired differences.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Wilcoxon {
    /// Number of differences.
    pub n: usize,
    /// Number of differences that are zero and left out of the test.
    pub n_zeros: usize,
    /// Sum of the ranks of positive differences.
    pub w_plus: f64,
    /// Sum of the ranks of negative differences.
    pub w_minus: f64,
    /// The alternative hypothesis: `two_sided`, the differences are not centred on zero.
    pub alternative: &'static str,
    /// Whether p is exact rather than approximated.
    pub exact: bool,
    /// The p-value.
    pub p: f64,
    /// Effect size, matched-pairs rank-biserial correlation: `(w_plus - w_minus) / (w_plus + w_minus)`, from -1 (every
    /// difference negative) to 1.
    pub rank_biserial: f64,
    /// Size of the difference in its own unit: [`hodges_lehmann`] of all differences, including zeros.
    pub hodges_lehmann: f64,
}

/// Wilcoxon's signed-rank test: are paired differences centred on zero?
///
/// The absolute differences are ranked without zeros, with mean ranks for ties, and the ranks of each sign are summed.
/// Exact: the share of all 2ⁿ sign assignments with a rank sum at least as extreme, doubled for two sides. Normal:
/// `z = (w_plus - n(n+1)/4) / √(n(n+1)(2n+1)/24 - Σ(t³-t)/48)` over groups of t ties. Exact up to 50 differences without ties and
/// zeros, up to 13 with them; normal beyond, without a correction for continuity. The rule of scipy's "auto".
///
/// Assumes independent differences: if they repeat within units, test [`crate::unit_means`].
///
/// # Errors
/// [`StatisticsError`] without differences, if one is not finite, or if all are zero.
///
/// # Source
/// Wilcoxon 1945, Biometrics Bulletin 1:80-83. Effect size: Kerby 2014, Comprehensive Psychology 3:11.IT.3.1. The exact test
/// uses the tied ranks, as scipy does up to 13 differences; scipy's `method="exact"` ignores ties.
pub fn wilcoxon(differences: &[f64]) -> Result<Wilcoxon, StatisticsError> {
    let hodges_lehmann = hodges_lehmann(differences)?;
    let signed: Vec<f64> = differences.iter().copied().filter(|d| *d != 0.0).collect();
    let (n, n_zeros) = (differences.len(), differences.len() - signed.len());
    if signed.is_empty() {
        return Err(StatisticsError::without_spread("differences", n, 0.0));
    }
    let (ranks, ties) = ranks(&signed.iter().map(|d| d.abs()).collect::<Vec<_>>());
    // Ranks are multiples of one half, so these sums are exact in any order.
    let w_plus: f64 = ranks.iter().zip(&signed).filter(|(_, d)| **d > 0.0).map(|(rank, _)| rank).sum();
    let w_minus = ranks.iter().sum::<f64>() - w_plus;
    let plain = n_zeros == 0 && ties.len() == signed.len();
    let exact = n <= if plain { 50 } else { 13 };
    let p = if exact { exact_p(&ranks, w_plus) } else { normal_p(&ties, w_plus) };
    let rank_biserial = (w_plus - w_minus) / (w_plus + w_minus);
    Ok(Wilcoxon { n, n_zeros, w_plus, w_minus, alternative: "two_sided", exact, p, rank_biserial, hodges_lehmann })
}

/// p over all sign assignments.
fn exact_p(ranks: &[f64], w_plus: f64) -> f64 {
    // Doubled ranks are integers even with ties. The share of assignments with each doubled sum, rank by rank.
    let doubled: Vec<usize> = ranks.iter().map(|rank| (2.0 * rank) as usize).collect();
    let mut shares = vec![0.0; doubled.iter().sum::<usize>() + 1];
    shares[0] = 1.0;
    let mut largest = 0;
    for rank in doubled {
        largest += rank;
        for sum in (0..=largest).rev() {
            shares[sum] = 0.5 * (shares[sum] + if sum >= rank { shares[sum - rank] } else { 0.0 });
        }
    }
    let doubled_w = (2.0 * w_plus) as usize;
    let less: f64 = shares[..=doubled_w].iter().sum();
    let greater: f64 = shares[doubled_w..].iter().sum();
    (2.0 * less.min(greater)).min(1.0)
}

/// p by the normal approximation.
fn normal_p(ties: &[usize], w_plus: f64) -> f64 {
    let n = ties.iter().sum::<usize>() as f64;
    let tied: f64 = ties.iter().map(|t| *t as f64).map(|t| t * t * t - t).sum();
    let sd = (n * (n + 1.0) * (2.0 * n + 1.0) / 24.0 - tied / 48.0).sqrt();
    let z = (w_plus - n * (n + 1.0) / 4.0) / sd;
    2.0 * normal_cdf(-z.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_difference_proves_nothing() {
        let test = wilcoxon(&[0.4]).unwrap();
        assert_eq!((test.p, test.rank_biserial, test.hodges_lehmann, test.exact), (1.0, 1.0, 0.4, true));
    }

    #[test]
    fn differences_that_are_all_zero_are_refused_and_the_others_counted() {
        let refused = wilcoxon(&[0.0, -0.0]);
        assert!(refused.unwrap_err().to_string().starts_with("all 2 differences are 0, without any spread"));
        let test = wilcoxon(&[0.0, 1.0, 2.0]).unwrap();
        assert_eq!((test.n, test.n_zeros, test.w_plus, test.hodges_lehmann), (3, 1, 3.0, 1.0));
        assert!(wilcoxon(&[f64::NAN]).unwrap_err().to_string().contains("leave rows without a number out"));
    }

    #[test]
    fn swapping_the_methods_turns_the_effect_around_and_keeps_p() {
        let few = [0.3, -0.1, 0.5, 0.2, 0.2, -0.7, 0.9, 0.0];
        for differences in [few.to_vec(), few.repeat(8)] {
            let swapped: Vec<f64> = differences.iter().map(|d| -d).collect();
            let (a, b) = (wilcoxon(&differences).unwrap(), wilcoxon(&swapped).unwrap());
            assert_eq!(a.exact, differences.len() == few.len());
            assert!((a.p - b.p).abs() < 1e-14, "{} {}", a.p, b.p);
            assert_eq!((a.rank_biserial, a.hodges_lehmann), (-b.rank_biserial, -b.hodges_lehmann));
        }
    }
}
