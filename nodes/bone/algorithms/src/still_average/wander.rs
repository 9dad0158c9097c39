//! What the noise of a tracker does to a marker at rest over a window, from the time before it.

use super::StillReport;
use nalgebra::{Isometry3, Vector3};
use osteoflow_geometry::StampNs;

/// Largest number of pairs of samples that are looked at, evenly over the history.
const N_PAIRS: usize = 200;

/// Motion over a window that a marker at rest hardly exceeds, over the standard deviation, along an axis, of its differences over half
/// of it. 6: with noise that is white or correlated by up to 0.96 from sample to sample, rounded to 0.11 mm or not, and repeated for
/// up to 12 samples, less than one window of 100 exceeds it.
const AT_REST: f64 = 6.0;

/// The same for the difference between the means of a window's halves.
const HALVES: f64 = 4.5;

/// Share of the differences that are smaller than the one that is taken, and its length for a standard deviation of one.
const SHARE: f64 = 0.9;
const LENGTH: f64 = 2.5;

/// Steps of the last digit that noise makes within a window.
const N_STEPS: f64 = 2.0;

/// Share of repeated coordinates from which a tracker rounds.
const ROUNDS_FROM: f64 = 0.2;

/// More than this is no noise of a tracker at rest, whatever came before: 0.5 mm and 0.15 degrees, ten times what is measured.
const MOST_MM: f64 = 0.5;
const MOST_RAD: f64 = 0.15 * std::f64::consts::PI / 180.0;

/// Motion over a window that noise explains, from the time before it.
///
/// The noise of trackers is correlated from sample to sample, rounded, and repeated to the last bit, so the differences of successive
/// samples within a window say too little. Those over half a window say it, as far as the marker was at rest before: a steady motion is
/// taken off, and a wild one is bounded by what trackers do at rest.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wander {
    /// Of the origin, mm.
    pub mm: f64,
    /// Of the rotation, rad.
    pub rad: f64,
}

impl Wander {
    /// From the samples so far, the newest last, for windows of `n_window` of them; pairs farther apart than `window_ns` are left out.
    /// Zero with fewer than a window of samples. `O(1)` in the number of samples.
    pub fn of(history: &[(StampNs, Isometry3<f64>)], n_window: usize, window_ns: StampNs) -> Self {
        let lag = (n_window / 2).max(1);
        if n_window < 3 || history.len() < n_window {
            return Self::default();
        }
        let stride = history.len().div_ceil(N_PAIRS);
        let pairs = |lag: usize| {
            history.windows(lag + 1).rev().step_by(stride).filter_map(move |of| {
                let ((begin_ns, a), (end_ns, b)) = (of.first()?, of.last()?);
                (end_ns - begin_ns <= window_ns).then_some((a, b))
            })
        };
        let is_long = history.len() - lag >= n_window * 3 / 2;
        let shifts: Vec<Vector3<f64>> = pairs(lag).map(|(a, b)| b.translation.vector - a.translation.vector).collect();
        let turns: Vec<Vector3<f64>> =
            pairs(lag).map(|(a, b)| (a.rotation.inverse() * b.rotation).scaled_axis()).collect();
        let steps: Vec<f64> = pairs(1)
            .flat_map(|(a, b)| <[f64; 3]>::from(b.translation.vector - a.translation.vector).map(f64::abs))
            .collect();
        Self {
            mm: spread(shifts, is_long).max(rounding(&steps)).min(MOST_MM),
            rad: spread(turns, is_long).min(MOST_RAD),
        }
    }

    /// What it explains of the difference between the means of a window's halves: 4.5 standard deviations of the difference of two samples
    /// half a window apart.
    pub fn of_halves(&self) -> Self {
        let share = HALVES / AT_REST;
        Self { mm: share * self.mm, rad: share * self.rad }
    }
}

impl StillReport {
    /// With what the time before the window explains, where that is more.
    #[must_use]
    pub fn explained_by(self, wander: &Wander) -> Self {
        Self {
            explained_mm: self.explained_mm.max(wander.mm),
            explained_rad: self.explained_rad.max(wander.rad),
            ..self
        }
    }
}

/// The motion that differences over half a window explain.
fn spread(mut differences: Vec<Vector3<f64>>, is_long: bool) -> f64 {
    if differences.is_empty() {
        return 0.0;
    }
    if is_long {
        let steady = Vector3::from_fn(|axis, _| super::motion::median(differences.iter().map(|d| d[axis]).collect()));
        differences.iter_mut().for_each(|d| *d -= steady);
    }
    let mut lengths: Vec<f64> = differences.iter().map(Vector3::norm).collect();
    lengths.sort_by(f64::total_cmp);
    AT_REST * lengths[((lengths.len() - 1) as f64 * SHARE).round() as usize] / LENGTH
}

/// The motion that the last digit explains; zero where coordinates hardly repeat.
fn rounding(steps: &[f64]) -> f64 {
    let n_equal = steps.iter().filter(|step| **step == 0.0).count();
    let smallest = steps.iter().copied().filter(|step| *step > 1e-9).fold(f64::INFINITY, f64::min);
    let rounds = smallest.is_finite() && n_equal as f64 > ROUNDS_FROM * steps.len() as f64;
    if rounds { N_STEPS * smallest } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::still_average::still_average;
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
    use rand_distr::{Distribution, Normal};

    /// The noise of a tracker.
    #[derive(Clone, Copy)]
    struct Noise {
        sd_mm: f64,
        /// From sample to sample.
        correlation: f64,
        /// The last digit, mm.
        digit_mm: f64,
        /// Largest number of equal samples.
        n_equal: usize,
    }

    const WHITE: Noise = Noise { sd_mm: 0.03, correlation: 0.0, digit_mm: 0.0, n_equal: 1 };
    const OPTICAL: Noise = Noise { sd_mm: 0.04, correlation: 0.85, digit_mm: 0.01, n_equal: 1 };
    const MAGNETIC: Noise = Noise { sd_mm: 0.055, correlation: 0.9, digit_mm: 0.11, n_equal: 1 };
    const REPEATED: Noise = Noise { sd_mm: 0.06, correlation: 0.96, digit_mm: 0.11, n_equal: 12 };

    /// Share of windows of 11 samples at 20 Hz that move by more than noise explains, where the marker moves by `motion` of the sample's
    /// number.
    fn share(noise: Noise, n: usize, motion: impl Fn(usize) -> f64, of: impl Iterator<Item = usize>) -> f64 {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let normal = Normal::new(0.0, noise.sd_mm).unwrap();
        let mut draw = || Vector3::from_fn(|_, _| normal.sample(&mut rng));
        let innovation = (1.0 - noise.correlation.powi(2)).sqrt();
        let (mut at, mut held, mut left) = (draw(), Vector3::zeros(), 0);
        let mut samples = Vec::new();
        for k in 0..n {
            at = at * noise.correlation + draw() * innovation;
            if left == 0 {
                (held, left) = (at, 1 + (k * 7919) % noise.n_equal);
            }
            left -= 1;
            let shifted = held + Vector3::new(0.6, -0.64, 0.48) * motion(k);
            let rounded = if noise.digit_mm > 0.0 {
                shifted.map(|c| (c / noise.digit_mm).round() * noise.digit_mm)
            } else {
                shifted
            };
            samples.push((k as StampNs * 50_000_000, Isometry3::from_parts(rounded.into(), Default::default())));
        }
        let moved = |end: &usize| {
            let history = &samples[end.saturating_sub(200)..=*end];
            let poses: Vec<_> = samples[end - 10..=*end].iter().map(|(_, pose)| *pose).collect();
            let report = still_average(&poses, f64::INFINITY, f64::INFINITY).unwrap().report;
            let wander = Wander::of(history, 11, 500_000_000);
            let report = report.explained_by(&wander);
            // By the fitted line, or by the halves, which end an average.
            report.moved_mm > report.explained_mm.max(0.1) || report.drift_mm > wander.of_halves().mm.max(0.1)
        };
        let (mut n_moved, mut n_all) = (0, 0);
        for end in of {
            n_all += 1;
            n_moved += usize::from(moved(&end));
        }
        f64::from(n_moved as u32) / f64::from(n_all as u32)
    }

    #[test]
    fn a_marker_at_rest_moves_in_less_than_one_window_of_a_hundred_whatever_its_tracker() {
        for noise in [WHITE, OPTICAL, MAGNETIC, REPEATED] {
            let told = share(noise, 8000, |_| 0.0, 10..8000);
            assert!(told < 0.01, "{told} of the windows, correlation {}", noise.correlation);
        }
    }

    #[test]
    fn a_millimetre_in_half_a_second_is_found_after_any_rest_and_within_any_drift() {
        for noise in [WHITE, OPTICAL, MAGNETIC, REPEATED] {
            let after_rest = |k: usize| 0.1 * (k % 100).saturating_sub(80) as f64;
            let share_moved = share(noise, 4000, after_rest, (90..4000).step_by(100));
            assert!(share_moved > 0.95, "{share_moved} after a rest, correlation {}", noise.correlation);
            let share_moved = share(noise, 400, |k| 0.1 * k as f64, 10..400);
            assert!(share_moved > 0.95, "{share_moved} within a drift, correlation {}", noise.correlation);
        }
        let share_moved = share(WHITE, 400, |k| 0.03 * k as f64, 60..400);
        assert!(share_moved > 0.9, "a steady drift of 0.3 mm with white noise of 0.03 mm: {share_moved}");
    }

    #[test]
    fn pairs_across_a_gap_and_short_histories_explain_nothing() {
        let pose = |k: i64, s: i64| (s * 1_000_000_000, Isometry3::translation(k as f64, 0.0, 0.0));
        let apart: Vec<_> = (0..30).map(|k| pose(k, 10 * k)).collect();
        assert_eq!(Wander::of(&apart, 11, 500_000_000), Wander::default());
        assert_eq!(Wander::of(&apart[..5], 11, StampNs::MAX), Wander::default());
        assert_eq!(Wander::of(&apart[..12], 11, StampNs::MAX).mm, MOST_MM);
    }
}
