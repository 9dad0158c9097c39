//! Quantiles by linear interpolation.

/// The `q`-quantile of the sample by linear interpolation; reorders `values`. `O(n)`.
///
/// With the sample sorted and counted from 0, the value at position `q (n - 1)`: rule 7 of Hyndman & Fan 1996 (The American
/// Statistician 50:361-365), the default of numpy and R.
///
/// # Panics
/// If `values` is empty or `q` outside 0 to 1.
pub fn quantile(values: &mut [f64], q: f64) -> f64 {
    assert!(!values.is_empty() && (0.0..=1.0).contains(&q), "quantile {q} of {} values", values.len());
    let place = q * (values.len() - 1) as f64;
    let (_, low, above) = values.select_nth_unstable_by(place as usize, f64::total_cmp);
    let next = above.iter().copied().min_by(f64::total_cmp).unwrap_or(*low);
    *low + place.fract() * (next - *low)
}

/// The median, which is the mean of the two middle values of an even number; reorders `values`. `O(n)`.
///
/// # Panics
/// If `values` is empty.
pub fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantile_lies_between_its_neighbours() {
        let mut values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(quantile(&mut values, 0.0), 1.0);
        assert_eq!(quantile(&mut values, 1.0), 4.0);
        assert_eq!(median(&mut values), 2.5);
        assert_eq!(median(&mut [7.0]), 7.0);
    }
}
