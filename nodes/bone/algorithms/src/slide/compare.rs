//! Whether the residuals tell two places apart.

use nalgebra::Point3;
use std::collections::BTreeMap;

/// Edge of the cells of the scan whose residuals count as one draw, mm: the correlation length of a camera's distortion and of
/// a CT surface's bumps.
const CELL_MM: f64 = 10.0;

/// RMS growth of the residuals that is no difference, mm: neither a CT surface nor its samples are known better.
const FLOOR_MM: f64 = 0.02;

/// The cells of scan points, in the scan's own frame, so that the start does not change them.
pub(super) struct Cells {
    of_point: Vec<usize>,
    n: usize,
}

/// How much worse one place is than another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Difference {
    /// Difference of the mean squared residuals, mm².
    pub(super) mean: f64,
    /// Its standard error, mm², from what differs between cells.
    pub(super) error: f64,
}

impl Cells {
    pub(super) fn new(points: &[Point3<f64>], centre: &Point3<f64>) -> Self {
        let mut known: BTreeMap<[i64; 3], usize> = BTreeMap::new();
        let of_point = points
            .iter()
            .map(|p| {
                let key = std::array::from_fn(|k| ((p[k] - centre[k]) / CELL_MM).floor() as i64);
                let next = known.len();
                *known.entry(key).or_insert(next)
            })
            .collect();
        Self { of_point, n: known.len() }
    }

    /// Number of cells.
    pub(super) fn len(&self) -> usize {
        self.n
    }

    /// By how much `costs` exceed `best`, point by point.
    ///
    /// Source: Vuong 1989 for paired differences; Liang and Zeger 1986 for the sum over clusters.
    pub(super) fn difference(&self, costs: &[f64], best: &[f64]) -> Difference {
        let n = costs.len().max(1) as f64;
        let mut sums = vec![(0.0, 0.0); self.n];
        for ((cost, best), cell) in costs.iter().zip(best).zip(&self.of_point) {
            sums[*cell].0 += cost - best;
            sums[*cell].1 += 1.0;
        }
        let mean = sums.iter().map(|(sum, _)| sum).sum::<f64>() / n;
        let squares: f64 = sums.iter().map(|(sum, count)| (sum - mean * count).powi(2)).sum();
        let cells = self.n as f64;
        let error = (squares * cells / (cells - 1.0).max(1.0)).sqrt() / n;
        Difference { mean, error }
    }
}

impl Difference {
    /// The RMS by which the residuals grow, mm; 0 where they fall.
    pub(super) fn excess_mm(&self) -> f64 {
        self.mean.max(0.0).sqrt()
    }

    /// Above 1 if the residuals are larger by more than the floor and by this many standard errors.
    pub(super) fn clear(&self, sigmas: f64) -> f64 {
        (self.sigmas() / sigmas).min(self.mean / (FLOOR_MM * FLOOR_MM))
    }

    /// The difference in standard errors.
    pub(super) fn sigmas(&self) -> f64 {
        self.mean / self.error.max(f64::MIN_POSITIVE)
    }
}
