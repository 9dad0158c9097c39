//! Motion over a window against the noise of its samples.

use nalgebra::Vector3;

/// Motion of the fitted line over its standard deviation that isotropic Gaussian noise exceeds in one of 2,000 windows of
/// 3, 4, .. samples, rounded up. Found by drawing 400,000 windows of each size.
const EXPLAINED: [f64; 14] = [30.6, 33.8, 11.9, 8.5, 7.4, 6.7, 6.3, 5.9, 5.8, 5.6, 5.5, 5.4, 5.3, 5.2];

/// A sequence of vectors: its noise, and its motion from the first to the last.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Motion {
    /// Standard deviation along each axis.
    pub(super) noise: f64,
    /// The straight line fitted to the vectors, from the first to the last.
    pub(super) line: Vector3<f64>,
    /// The length that noise exceeds in one of 2,000 windows.
    pub(super) explained: f64,
}

impl Motion {
    /// Zeros for fewer than three vectors. `O(n log n)`.
    ///
    /// The noise is that of the differences of successive vectors, less their median, without the largest: a steady motion
    /// and a step are no noise.
    ///
    /// # Source
    /// Variance from successive differences: von Neumann et al. 1941.
    pub(super) fn of(vectors: &[Vector3<f64>]) -> Self {
        let n = vectors.len();
        if n < 3 {
            return Self::default();
        }
        let differences: Vec<Vector3<f64>> = vectors.windows(2).map(|w| w[1] - w[0]).collect();
        let steady = Vector3::from_fn(|axis, _| median(differences.iter().map(|d| d[axis]).collect()));
        let mut squares: Vec<f64> = differences.iter().map(|d| (d - steady).norm_squared()).collect();
        squares.sort_by(f64::total_cmp);
        squares.pop();
        // A difference of two has twice the variance, along three axes.
        let noise = (squares.iter().sum::<f64>() / (6.0 * squares.len() as f64)).sqrt();
        let middle = (n - 1) as f64 / 2.0;
        let slope: Vector3<f64> = vectors.iter().enumerate().map(|(k, v)| v * (k as f64 - middle)).sum();
        let spread: f64 = (0..n).map(|k| (k as f64 - middle).powi(2)).sum();
        let length = (n - 1) as f64;
        let limit = EXPLAINED[(n - 3).min(EXPLAINED.len() - 1)];
        Self { noise, line: slope * (length / spread), explained: limit * noise / spread.sqrt() * length }
    }
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { (values[middle - 1] + values[middle]) / 2.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
    use rand_distr::{Distribution, Normal};

    /// Windows of `n` samples with noise along each axis, moved by `motion(share of the window)` along a slanted line.
    fn windows(n: usize, noise: [f64; 3], motion: impl Fn(f64) -> f64, n_windows: usize) -> Vec<Motion> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let way = Vector3::new(0.6, -0.64, 0.48);
        let one = |_| {
            let sample = |k: usize| {
                let jitter = noise.map(|sd| Normal::new(0.0, sd).unwrap().sample(&mut rng));
                Vector3::from(jitter) + way * motion(k as f64 / (n - 1) as f64)
            };
            Motion::of(&(0..n).map(sample).collect::<Vec<_>>())
        };
        (0..n_windows).map(one).collect()
    }

    fn share(of: &[Motion]) -> f64 {
        of.iter().filter(|m| m.line.norm() > m.explained).count() as f64 / of.len() as f64
    }

    #[test]
    fn a_marker_at_rest_hardly_ever_moves_by_more_than_its_noise_explains() {
        for n in [3, 4, 5, 6, 8, 10, 12, 16, 24, 60] {
            for sd in [0.03, 0.09] {
                let told = share(&windows(n, [sd; 3], |_| 0.0, 20_000));
                assert!(told < 1.5e-3, "{n} samples of {sd} mm: {told} of the windows");
            }
            // A tracker sees depth three times worse.
            let told = share(&windows(n, [0.03, 0.03, 0.09], |_| 0.0, 20_000));
            assert!(told < 0.02, "{n} samples, worse in depth: {told} of the windows");
        }
    }

    #[test]
    fn a_drift_of_0_3_mm_and_a_late_step_are_more_than_the_noise_explains() {
        for n in [9, 10, 11] {
            let drift = share(&windows(n, [0.03; 3], |at| 0.3 * at, 4_000));
            assert!(drift > 0.99, "{n} samples: a drift of 0.3 mm is found in {drift} of the windows");
            let step = share(&windows(n, [0.03; 3], |at| if at < 1.0 { 0.0 } else { 1.0 }, 4_000));
            assert!(step > 0.99, "{n} samples: a step of 1 mm at the end is found in {step} of the windows");
        }
    }

    #[test]
    fn the_noise_is_that_of_the_samples_whether_they_drift_or_not() {
        for motion in [0.0, 3.0] {
            let of = windows(11, [0.03; 3], |at| motion * at, 4_000);
            let noise = (of.iter().map(|m| m.noise * m.noise).sum::<f64>() / of.len() as f64).sqrt();
            // Without the largest of ten differences it is a tenth less.
            assert!((0.026..0.031).contains(&noise), "{noise} mm with a drift of {motion} mm");
            let moved = of.iter().map(|m| m.line.norm()).sum::<f64>() / of.len() as f64;
            assert!((moved - motion).abs() < 0.06, "{moved} mm, not {motion} mm");
        }
        let two = [Vector3::zeros(), Vector3::x()];
        assert_eq!(Motion::of(&two), Motion::default());
    }
}
