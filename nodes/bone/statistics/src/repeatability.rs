//! Repeatability of a measurement.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::{StatisticsError, anova::OneWay, bland_altman::NORMAL_95};

/// Spread of a measurement within groups and between them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Repeatability {
    /// Number of rows.
    pub n: usize,
    /// Number of groups.
    pub n_groups: usize,
    /// Effective group size, `(N - Σmᵢ²/N) / (G - 1)`.
    pub n0: f64,
    /// Standard deviation within groups, `s_w = √MSW`, with `MSW = Σ(xᵢⱼ - x̄ᵢ)² / (N - G)`.
    pub sd_within: f64,
    /// Standard deviation between the true values of groups, `√((MSB - MSW) / n0)`, with
    /// `MSB = Σmᵢ(x̄ᵢ - x̄)² / (G - 1)`; 0 if the difference is negative.
    pub sd_between: f64,
    /// Repeatability coefficient `1.96 √2 s_w`: two measurements in one group differ by less in 95 % of cases.
    pub coefficient: f64,
    /// Share of the variance between groups, ICC(1,1) `= (MSB - MSW) / (MSB + (n0 - 1) MSW)`. Negative if groups differ less than
    /// expected by chance.
    pub icc: f64,
}

/// Spread within and between groups by one-way random-effects analysis of variance.
///
/// `group_of` is the group of each row and determines the question:
///
/// - **SD within points**: a group is one point of one bone, its rows are the procedures that measured it. The spread of the
///   error at the same point from procedure to procedure, as when the whole procedure is repeated.
/// - **SD within procedures**: a group is one procedure, its rows are the points. The spread of the errors of one procedure
///   from point to point, without a common shift: a rotation of the bone shows here, a slide does not.
///
/// Groups may differ in size; one with a single row has no spread within. `O(n log n)`.
///
/// # Errors
/// [`StatisticsError`] with fewer than two groups or without any group of two rows, with columns of different lengths, a
/// value that is not finite, or if all values are equal.
///
/// # Source
/// Bland & Altman 1996, BMJ 313:744 (s_w) and 1999, Stat. Methods Med. Res. 8:135-160 (coefficient); Shrout &
/// Fleiss 1979, Psychological Bulletin 86:420-428 (ICC(1,1)); n0: Searle, Casella & McCulloch 1992, Variance Components,
/// chapter 3.
pub fn repeatability<G: Ord>(group_of: &[G], values: &[f64]) -> Result<Repeatability, StatisticsError> {
    StatisticsError::lengths(group_of.len(), values.len())?;
    StatisticsError::not_finite(values)?;
    let mut by_group: BTreeMap<&G, Vec<f64>> = BTreeMap::new();
    for (group, value) in group_of.iter().zip(values) {
        by_group.entry(group).or_default().push(*value);
    }
    let mut groups: Vec<Vec<f64>> = by_group.into_values().collect();
    groups.iter_mut().for_each(|group| group.sort_unstable_by(f64::total_cmp));
    StatisticsError::too_few("groups", groups.len(), 2)?;
    StatisticsError::too_few("rows beyond the first of their group", values.len() - groups.len(), 1)?;
    StatisticsError::constant("values", values)?;
    let anova = OneWay::of(&groups);
    let (between, within, n0) = (anova.mean_square_between, anova.mean_square_within, anova.n0);
    let sd_within = within.sqrt();
    Ok(Repeatability {
        n: anova.n,
        n_groups: anova.n_groups,
        n0,
        sd_within,
        sd_between: anova.variance_between().sqrt(),
        coefficient: NORMAL_95 * 2.0_f64.sqrt() * sd_within,
        icc: (between - within) / (between + (n0 - 1.0) * within),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shift_of_a_whole_procedure_shows_within_points_and_not_within_procedures() {
        // Two points in three procedures; procedures shift both points alike.
        let procedure = [0, 0, 1, 1, 2, 2];
        let point = ["M1", "M2", "M1", "M2", "M1", "M2"];
        let error_mm = [0.0, 0.0, 1.0, 1.0, 2.0, 2.0];
        let within_points = repeatability(&point, &error_mm).unwrap();
        assert!((within_points.sd_within - 1.0).abs() < 1e-12 && within_points.sd_between == 0.0);
        let within_procedures = repeatability(&procedure, &error_mm).unwrap();
        assert_eq!((within_procedures.sd_within, within_procedures.icc), (0.0, 1.0));
        assert!((within_procedures.sd_between - 1.0).abs() < 1e-12);
    }

    #[test]
    fn what_does_not_repeat_is_refused() {
        let refused = |groups: &[u8], values: &[f64]| repeatability(groups, values).unwrap_err();
        assert!(refused(&[1, 1], &[0.1, 0.2]).to_string().starts_with("1 groups, at least 2 needed"));
        assert!(
            refused(&[1, 2], &[0.1, 0.2]).to_string().starts_with("0 rows beyond the first of their group, at least 1")
        );
        assert!(
            refused(&[1, 2, 2], &[0.1, 0.1, 0.1]).to_string().starts_with("all 3 values are 0.1, without any spread")
        );
        assert!(refused(&[1, 2], &[0.1, f64::NAN]).to_string().starts_with("value 1 is NaN"));
        assert!(refused(&[1], &[]).to_string().starts_with("one column has 1 rows, the other 0"));
    }
}
