//! The location estimate of the signed-rank test.

use crate::StatisticsError;

/// Hodges-Lehmann estimate of the middle of a symmetric sample: the median of the means of all pairs `i ≤ j`.
///
/// The estimate that belongs to [`crate::wilcoxon`], with zeros included. Exact, `O(n log n)` and 64 passes: the pairs are
/// counted but never listed.
///
/// # Errors
/// [`StatisticsError`] without values, or if a value is NaN or infinite.
///
/// # Source
/// Hodges & Lehmann 1963, Annals of Mathematical Statistics 34:598-611.
pub fn hodges_lehmann(values: &[f64]) -> Result<f64, StatisticsError> {
    StatisticsError::too_few("values", values.len(), 1)?;
    StatisticsError::not_finite(values)?;
    let mut halves: Vec<f64> = values.iter().map(|x| x / 2.0).collect();
    halves.sort_unstable_by(f64::total_cmp);
    let n_pairs = halves.len() * (halves.len() + 1) / 2;
    let upper = nth_pair(&halves, n_pairs / 2);
    Ok(if n_pairs % 2 == 1 { upper } else { (nth_pair(&halves, n_pairs / 2 - 1) + upper) / 2.0 })
}

/// The `n`-th smallest sum of a pair, from 0: the smallest number with more than `n` sums that are at most as large.
fn nth_pair(sorted: &[f64], n: usize) -> f64 {
    let largest = sorted.len() - 1;
    let (mut low, mut high) = (key(2.0 * sorted[0]), key(2.0 * sorted[largest]));
    while low < high {
        let middle = low + (high - low) / 2;
        if n_up_to(sorted, number(middle)) > n {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    number(low)
}

/// Number of pairs `i ≤ j` whose sum is at most `limit`.
fn n_up_to(sorted: &[f64], limit: f64) -> usize {
    let mut end = sorted.len();
    let mut n = 0;
    for (i, x) in sorted.iter().enumerate() {
        while end > i && x + sorted[end - 1] > limit {
            end -= 1;
        }
        if end <= i {
            break;
        }
        n += end - i;
    }
    n
}

/// Integers in the order of the floating-point numbers, so that bisection ends at adjacent numbers.
fn key(x: f64) -> u64 {
    let bits = (x + 0.0).to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

fn number(key: u64) -> f64 {
    f64::from_bits(if key >> 63 == 1 { key & !(1 << 63) } else { !key })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_median_of_all_listed_pair_means() {
        let mut x = 0.3_f64;
        for n in 1..40 {
            let values: Vec<f64> = (0..n)
                .map(|i| {
                    x = (x * 3.7) * (1.0 - x);
                    // Some zeros, some ties.
                    if i % 7 == 3 { 0.0 } else { ((x - 0.4) * 20.0).round() / 4.0 }
                })
                .collect();
            let mut pairs: Vec<f64> =
                (0..n).flat_map(|i| (i..n).map(move |j| (i, j))).map(|(i, j)| (values[i] + values[j]) / 2.0).collect();
            let estimate = hodges_lehmann(&values).unwrap();
            assert_eq!(estimate, crate::median(&mut pairs), "{values:?}");
        }
    }
}
