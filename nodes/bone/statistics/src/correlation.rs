//! Correlation of two quantities.

use serde::Serialize;

use crate::{
    Interval, NoInterval, StatisticsError,
    distributions::{t_above, two_sided_z},
    interval::or_reason,
    ranks::ranks,
    summary::mean,
};

/// A correlation of two columns.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Correlation {
    /// Rows.
    pub n: usize,
    /// The coefficient, from -1 to 1.
    pub r: f64,
    /// Two-sided p against no correlation: Student's t of `r √((n-2)/(1-r²))` with n - 2 degrees of freedom.
    pub p: f64,
    /// Interval by Fisher's z, or the reason why there is none.
    #[serde(serialize_with = "or_reason")]
    pub interval: Result<Interval, NoInterval>,
}

/// Pearson's correlation: how close the rows are to a line.
///
/// `r = Σ(x-x̄)(y-ȳ) / √(Σ(x-x̄)² Σ(y-ȳ)²)`; interval `tanh(atanh r ± z/√(n-3))`, from 4 rows on.
///
/// p and interval assume independent rows; otherwise use [`crate::bootstrap_rows`].
///
/// # Errors
/// [`StatisticsError`] with fewer than 3 rows, columns of different lengths, a value that is not finite, a level out of range, or
/// if a column does not vary.
///
/// # Source
/// Fisher 1921, Metron 1:3-32.
pub fn pearson(x: &[f64], y: &[f64], level: f64) -> Result<Correlation, StatisticsError> {
    checked(x, y, level)?;
    Ok(correlation(x, y, level, |_| 1.0))
}

/// Spearman's rank correlation: how monotonically one quantity depends on the other.
///
/// Pearson's r of the ranks, with mean ranks for ties; p as Pearson's, and an interval
/// `tanh(atanh r ± z √((1 + r²/2)/(n-3)))`, from 4 rows on.
///
/// # Errors
/// As [`pearson`].
///
/// # Source
/// Spearman 1904; the interval: Bonett & Wright 2000, Psychometrika 65:23-28.
pub fn spearman(x: &[f64], y: &[f64], level: f64) -> Result<Correlation, StatisticsError> {
    checked(x, y, level)?;
    Ok(correlation(&ranks(x).0, &ranks(y).0, level, |r| 1.0 + r * r / 2.0))
}

fn checked(x: &[f64], y: &[f64], level: f64) -> Result<(), StatisticsError> {
    StatisticsError::lengths(x.len(), y.len())?;
    StatisticsError::too_few("rows", x.len(), 3)?;
    StatisticsError::out_of_range("the confidence level", level, 1.0)?;
    for column in [x, y] {
        StatisticsError::not_finite(column)?;
        StatisticsError::constant("values", column)?;
    }
    Ok(())
}

/// Pearson's r with an interval whose variance in z is `scale(r) / (n - 3)`.
fn correlation(x: &[f64], y: &[f64], level: f64, scale: fn(f64) -> f64) -> Correlation {
    let n = x.len();
    // Sorted, so that the sums do not depend on the order of the rows.
    let mut rows: Vec<(f64, f64)> = x.iter().copied().zip(y.iter().copied()).collect();
    rows.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let (x, y): (Vec<f64>, Vec<f64>) = rows.into_iter().unzip();
    let (mean_x, mean_y) = (mean(&x), mean(&y));
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (x, y) in x.iter().zip(&y).map(|(x, y)| (x - mean_x, y - mean_y)) {
        xx += x * x;
        yy += y * y;
        xy += x * y;
    }
    let r = xy / (xx.sqrt() * yy.sqrt());
    // Rounding errors may exceed ±1.
    let r = if 1.0 - r.abs() < n as f64 * f64::EPSILON { r.signum() } else { r };
    let df = n - 2;
    let p = 2.0 * t_above(r.abs() * (df as f64 / ((1.0 - r) * (1.0 + r))).sqrt(), df);
    let interval = if n < 4 {
        Err(NoInterval::TooFewRows { found: n, needed: 4 })
    } else if r.abs() == 1.0 {
        Err(NoInterval::OnALine)
    } else {
        let half = two_sided_z(level) * (scale(r) / (n - 3) as f64).sqrt();
        Ok(Interval { level, low: (r.atanh() - half).tanh(), high: (r.atanh() + half).tanh() })
    };
    Correlation { n, r, p, interval }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_on_a_line_correlate_by_one_without_an_interval() {
        let x = [1.0, 2.0, 3.0, 4.0, 5.0];
        let falling = x.map(|x| 3.0 - 2.0 * x);
        let estimate = pearson(&x, &falling, 0.95).unwrap();
        assert_eq!((estimate.r, estimate.p, estimate.interval), (-1.0, 0.0, Err(NoInterval::OnALine)));
        let cubes = x.map(|x| x * x * x);
        assert_eq!(spearman(&x, &cubes, 0.95).unwrap().r, 1.0);
        assert!(pearson(&x, &cubes, 0.95).unwrap().r < 1.0);
    }

    #[test]
    fn columns_that_cannot_correlate_are_refused() {
        let x = [1.0, 2.0, 3.0];
        assert!(pearson(&x[..2], &x[..2], 0.95).unwrap_err().to_string().contains("at least 3 needed"));
        assert!(pearson(&x, &[1.0; 3], 0.95).unwrap_err().to_string().contains("without any spread"));
        assert!(spearman(&x, &x[..2], 0.95).unwrap_err().to_string().contains("one column has 3 rows, the other 2"));
        assert!(
            spearman(&x, &[1.0, f64::NAN, 2.0], 0.95)
                .unwrap_err()
                .to_string()
                .contains("leave rows without a number out")
        );
        let three = pearson(&x, &[1.0, 0.0, 2.0], 0.95).unwrap();
        assert_eq!(three.interval, Err(NoInterval::TooFewRows { found: 3, needed: 4 }));
    }
}
