//! Correction for multiple tests.

use crate::StatisticsError;

/// Holm's correction: p-values to be compared with alpha when several tests are made, in the order given.
///
/// With m p-values in ascending order, the k-th (from 0) becomes `(m - k) p`, at most 1, and never less than the one
/// before. The probability of any false positive among all m is then at most alpha, whatever their dependence. Pass all tests
/// that were made, not only the significant ones.
///
/// # Errors
/// [`StatisticsError`] if one is not within 0 to 1.
///
/// # Source
/// Holm 1979, Scandinavian Journal of Statistics 6:65-70.
pub fn holm(p_values: &[f64]) -> Result<Vec<f64>, StatisticsError> {
    if let Some(value) = p_values.iter().copied().find(|p| !(0.0..=1.0).contains(p)) {
        return Err(StatisticsError(format!("a p-value is {value}, but must lie between 0 and 1; 95 % is 0.95")));
    }
    let mut order: Vec<usize> = (0..p_values.len()).collect();
    order.sort_unstable_by(|a, b| p_values[*a].total_cmp(&p_values[*b]));
    let (mut corrected, mut least) = (vec![0.0; p_values.len()], 0.0_f64);
    for (k, i) in order.into_iter().enumerate() {
        least = least.max((p_values.len() - k) as f64 * p_values[i]).min(1.0);
        corrected[i] = least;
    }
    Ok(corrected)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_p_value_outside_0_to_1_is_refused() {
        assert!(holm(&[0.1, f64::NAN]).unwrap_err().to_string().contains("but must lie between 0 and"));
        assert!(holm(&[1.2]).unwrap_err().to_string().contains("but must lie between 0 and"));
        assert_eq!(holm(&[]), Ok(vec![]));
    }
}
