//! One-way random-effects analysis of variance: spread between units and within them.

use crate::summary::mean;

/// Mean squares of values in groups, and the effective group size.
pub(crate) struct OneWay {
    pub(crate) n: usize,
    pub(crate) n_groups: usize,
    /// `Σ mᵢ(x̄ᵢ - x̄)² / (G - 1)`.
    pub(crate) mean_square_between: f64,
    /// `Σ(xᵢⱼ - x̄ᵢ)² / (N - G)`.
    pub(crate) mean_square_within: f64,
    /// `(N - Σmᵢ²/N) / (G - 1)`: the effective group size; equals the size of groups of one size.
    pub(crate) n0: f64,
}

impl OneWay {
    /// For at least two groups, at least one of them with two values.
    pub(crate) fn of(groups: &[Vec<f64>]) -> Self {
        let n_groups = groups.len();
        let n: usize = groups.iter().map(Vec::len).sum();
        let total = groups.iter().map(|group| group.iter().sum::<f64>()).sum::<f64>() / n as f64;
        let (mut between, mut within, mut squared_sizes) = (0.0, 0.0, 0.0);
        for group in groups {
            let (size, middle) = (group.len() as f64, mean(group));
            between += size * (middle - total).powi(2);
            within += group.iter().map(|x| (x - middle).powi(2)).sum::<f64>();
            squared_sizes += size * size;
        }
        let df_between = (n_groups - 1) as f64;
        Self {
            n,
            n_groups,
            mean_square_between: between / df_between,
            mean_square_within: within / (n - n_groups) as f64,
            n0: (n as f64 - squared_sizes / n as f64) / df_between,
        }
    }

    /// Variance between groups, `(MSB - MSW) / n0`, or 0 if that is negative.
    pub(crate) fn variance_between(&self) -> f64 {
        ((self.mean_square_between - self.mean_square_within) / self.n0).max(0.0)
    }
}
