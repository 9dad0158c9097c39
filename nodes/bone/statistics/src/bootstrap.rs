//! Cluster bootstrap: intervals by resampling whole units.

use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use serde::Serialize;

use crate::{
    Interval, NoInterval, StatisticsError, Units,
    distributions::{normal_cdf, normal_quantile, two_sided_t},
    interval::or_reason,
    quantile,
};

/// Below this number of units at the highest level an interval is given with a warning.
///
/// Four units drawn with replacement give 35 different samples, and their spread is a poor estimate itself. In 1,000 simulated
/// tables the 95 % interval of the mean contained the true one in
///
/// | bones | [`BootstrapKind::Expanded`] | [`BootstrapKind::Percentile`] | [`BootstrapKind::BiasCorrected`] |
/// |---|---|---|---|
/// | 5 | 90 % | 83 % | 82 % |
/// | 10 | 94 % | 88 % | 88 % |
/// | 30 | 95 % | 94 % | 94 % |
pub const FEW_UNITS: usize = 5;

/// How the ends of the interval are computed from the resamples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BootstrapKind {
    /// The quantiles at `Φ(∓ t √(n/(n-1)))`, with n units and t of n - 1 degrees of freedom: percentiles widened by as much as
    /// a t interval of the mean is widened for few units.
    #[default]
    Expanded,
    /// The quantiles at `(1 ∓ level) / 2`. Too narrow for few units.
    Percentile,
    /// Quantiles corrected for the bias and the skewness of the statistic (BCa). Also too narrow for few units.
    BiasCorrected,
}

/// Parameters of the bootstrap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BootstrapParams {
    /// Confidence level; 0.95.
    pub level: f64,
    /// Number of resamples; 10,000: the ends then vary by about 2 % of the interval's width.
    pub n_resamples: usize,
    /// Seed of the draws; 0.
    pub seed: u64,
    /// The kind of interval; expanded percentile, the only one here with about its nominal coverage for ten units.
    pub kind: BootstrapKind,
}

impl Default for BootstrapParams {
    fn default() -> Self {
        Self { level: 0.95, n_resamples: 10_000, seed: 0, kind: BootstrapKind::default() }
    }
}

/// A statistic with an interval for the population of units of the highest level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bootstrap {
    /// The statistic of all rows.
    pub estimate: f64,
    /// Its interval, or the reason why there is none.
    #[serde(serialize_with = "or_reason")]
    pub interval: Result<Interval, NoInterval>,
    /// The kind of interval.
    pub kind: BootstrapKind,
    /// The resampled units: name of the highest level.
    pub unit: String,
    /// Number of units: the n of the interval.
    pub n_units: usize,
    /// Whether there are fewer than [`FEW_UNITS`]: the interval is probably too narrow, and a table should say so.
    pub few_units: bool,
    /// Number of rows.
    pub n_rows: usize,
    /// Number of resamples.
    pub n_resamples: usize,
    /// Seed of the draws.
    pub seed: u64,
}

/// A statistic of a column with its cluster-bootstrap interval: as many units of the highest level as there are, drawn with
/// replacement, each with all its rows.
///
/// `statistic` receives the values of the drawn units and may reorder them ([`crate::median`] does). If it is not finite in
/// some resample, the estimate has no interval. `O(n_resamples × rows)` and the statistic.
///
/// # Errors
/// [`StatisticsError`]: no rows, columns of different lengths, a value that is not finite, a level outside 0 to 1, or a
/// statistic that is not finite for all rows.
///
/// # Source
/// Davison & Hinkley 1997, Bootstrap Methods and their Application, section 3.8 (drawing at the highest level only);
/// Field & Welsh 2007, J. R. Statist. Soc. B 69:369-390. Expanded: Hesterberg 2015, The American Statistician 69:371-386.
/// BCa: Efron 1987, JASA 82:171-185, with the jackknife over units; ties with the estimate count half to each
/// side.
pub fn bootstrap(
    units: &Units,
    values: &[f64],
    mut statistic: impl FnMut(&mut [f64]) -> f64,
    params: &BootstrapParams,
) -> Result<Bootstrap, StatisticsError> {
    let parts = units.split_sorted(values)?;
    let mut drawn_values = Vec::with_capacity(values.len());
    draw_units(units, params, |drawn| {
        drawn_values.clear();
        drawn.iter().for_each(|unit| drawn_values.extend_from_slice(&parts[*unit]));
        statistic(&mut drawn_values)
    })
}

/// [`bootstrap`] of the mean over rows, from one sum for each unit: 10,000 resamples of 200 units take 13 to 17 ms.
///
/// # Errors
/// As [`bootstrap`].
pub fn bootstrap_mean(units: &Units, values: &[f64], params: &BootstrapParams) -> Result<Bootstrap, StatisticsError> {
    let parts = units.split_sorted(values)?;
    let sums: Vec<(f64, f64)> = parts.iter().map(|part| (part.iter().sum(), part.len() as f64)).collect();
    draw_units(units, params, |drawn| {
        let (mut sum, mut n) = (0.0, 0.0);
        for unit in drawn {
            sum += sums[*unit].0;
            n += sums[*unit].1;
        }
        sum / n
    })
}

/// [`bootstrap`] of a statistic of several columns (a correlation, a ratio), which receives the drawn rows.
///
/// Rows are ordered by unit and, within a unit, as in the table.
///
/// # Errors
/// As [`bootstrap`].
pub fn bootstrap_rows(
    units: &Units,
    mut statistic: impl FnMut(&[usize]) -> f64,
    params: &BootstrapParams,
) -> Result<Bootstrap, StatisticsError> {
    let parts = units.split(&(0..units.n_rows()).collect::<Vec<_>>())?;
    let mut rows = Vec::with_capacity(units.n_rows());
    draw_units(units, params, |drawn| {
        rows.clear();
        drawn.iter().for_each(|unit| rows.extend_from_slice(&parts[*unit]));
        statistic(&rows)
    })
}

/// The common loop: `statistic` receives the units of a resample.
fn draw_units(
    units: &Units,
    params: &BootstrapParams,
    mut statistic: impl FnMut(&[usize]) -> f64,
) -> Result<Bootstrap, StatisticsError> {
    let &BootstrapParams { level, n_resamples, seed, kind } = params;
    StatisticsError::too_few("rows", units.n_rows(), 1)?;
    StatisticsError::too_few("resamples", n_resamples, 100)?;
    StatisticsError::out_of_range("the confidence level", level, 1.0)?;
    let mut all: Vec<usize> = (0..units.n_units()[0]).collect();
    let n_units = all.len();
    let estimate = statistic(&all);
    if !estimate.is_finite() {
        return Err(StatisticsError(format!(
            "the statistic of all {} rows is {estimate}; can it be computed from so few or such equal values?",
            units.n_rows()
        )));
    }

    let interval = if n_units < 2 {
        Err(NoInterval::OneUnit { unit: units.highest().into() })
    } else {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut drawn = vec![0; n_units];
        let mut resampled: Vec<f64> = (0..n_resamples)
            .map(|_| {
                // A 32-bit number scaled to the number of units: no rejection, and a bias of at most n / 2³².
                drawn.iter_mut().for_each(|d| *d = ((u64::from(rng.next_u32()) * n_units as u64) >> 32) as usize);
                statistic(&drawn)
            })
            .collect();
        let n_failed = resampled.iter().filter(|s| !s.is_finite()).count();
        if n_failed > 0 {
            Err(NoInterval::NotFinite { n_failed, n_resamples })
        } else {
            let tail = (1.0 - level) / 2.0;
            let shares = match kind {
                BootstrapKind::Percentile => Ok([tail, 1.0 - tail]),
                BootstrapKind::Expanded => {
                    let n = n_units as f64;
                    let outer = normal_cdf(-two_sided_t(level, n_units - 1) * (n / (n - 1.0)).sqrt());
                    Ok([outer, 1.0 - outer])
                }
                BootstrapKind::BiasCorrected => {
                    let left_out = (0..n_units).map(|unit| {
                        all.remove(unit);
                        let without = statistic(&all);
                        all.insert(unit, unit);
                        without
                    });
                    bias_corrected(estimate, &resampled, &left_out.collect::<Vec<_>>(), tail)
                }
            };
            shares.map(|[low, high]| Interval {
                level,
                low: quantile(&mut resampled, low),
                high: quantile(&mut resampled, high),
            })
        }
    };
    let (unit, n_rows) = (units.highest().into(), units.n_rows());
    Ok(Bootstrap { estimate, interval, kind, unit, n_units, few_units: n_units < FEW_UNITS, n_rows, n_resamples, seed })
}

/// The quantiles of the resamples that bound the BCa interval: `Φ(z₀ + (z₀ + z) / (1 - a (z₀ + z)))` at both tails.
///
/// `z₀` is the normal quantile of the share of resamples below the estimate, `a = Σd³ / 6(Σd²)^1.5` with `d` the differences
/// between the mean of the leave-one-out statistics and each of them.
fn bias_corrected(estimate: f64, resampled: &[f64], left_out: &[f64], tail: f64) -> Result<[f64; 2], NoInterval> {
    let n_resamples = resampled.len();
    let n_failed = left_out.iter().filter(|s| !s.is_finite()).count();
    if n_failed > 0 {
        return Err(NoInterval::NotFinite { n_failed, n_resamples: left_out.len() });
    }
    let under = resampled.iter().filter(|s| **s < estimate).count();
    let up_to = resampled.iter().filter(|s| **s <= estimate).count();
    let z0 = normal_quantile((under + up_to) as f64 / (2 * n_resamples) as f64);
    if !z0.is_finite() {
        return Err(NoInterval::OneSided { n_resamples });
    }
    let mean = left_out.iter().sum::<f64>() / left_out.len() as f64;
    let (squares, cubes) = left_out.iter().map(|s| mean - s).fold((0.0, 0.0), |(q, c), d| (q + d * d, c + d * d * d));
    let a = if squares > 0.0 { cubes / (6.0 * squares.powf(1.5)) } else { 0.0 };
    Ok([tail, 1.0 - tail].map(|p| {
        let z = z0 + normal_quantile(p);
        normal_cdf(z0 + z / (1.0 - a * z))
    }))
}
