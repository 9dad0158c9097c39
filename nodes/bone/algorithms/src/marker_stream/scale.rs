//! Noise and motion of a marker around each of its samples.

use super::{MotionLimits, Sample, Size, WINDOW_S, deviation, extrapolated, seconds};
use nalgebra::Vector3;

/// Samples farther apart show no motion, s.
const APART_S: f64 = 0.5;

/// Noise of a difference of two samples, at most, over the residual that 30 % of the samples have: 7 standard deviations.
const NOISE: f64 = 4.8;
const NOISE_SHARE: f64 = 0.3;

/// Deviation that a motion has, at most, over the median of its residuals in half a second.
const MOTION: f64 = 10.0;

/// Number of residuals in a row in which shaking cancels, and of their means that show a motion.
const N_MEAN: usize = 4;
const N_SHOW: usize = 3;

/// Smallest number of samples before a sample, and after it, that show the motion there.
const N_AROUND: usize = 12;

/// Share of repeated poses from which samples half a second apart show the noise, and their largest difference over the median.
const REPEATS_FROM: f64 = 0.2;
const NOISE_APART: f64 = 3.0;

/// Steps of the last digit that noise makes.
const N_STEPS: f64 = 3.0;

/// What no tracker resolves: 0.05 mm and 0.02 degrees.
const FLOOR: Size = Size { mm: 0.05, rad: 0.02 * std::f64::consts::PI / 180.0 };

/// The tolerances around each sample.
pub(super) struct Scales {
    /// What noise alone makes of the difference of two samples, at most.
    pub(super) noise: Size,
    /// The interval between samples, s.
    pub(super) period_s: f64,
    /// By sample: what shakes it from sample to sample, and what accelerates it in a period.
    local: Vec<(Size, Size)>,
    limits: MotionLimits,
}

/// Shift and turn of a sample against the middle of its neighbours.
type Residual = (Vector3<f64>, Vector3<f64>);

impl Scales {
    /// `repeats` is the share of poses that repeated the last one, and are not among the samples.
    pub(super) fn new(samples: &[Sample], repeats: f64, limits: &MotionLimits) -> Self {
        let at: Vec<f64> = samples.iter().map(|(stamp_ns, _)| seconds(*stamp_ns - samples[0].0)).collect();
        let period_s = quantile(at.windows(2).map(|t| t[1] - t[0]).collect(), 0.5).unwrap_or(0.0).max(1e-4);
        let residuals: Vec<Option<Residual>> = (0..samples.len()).map(|k| residual(samples, &at, k)).collect();
        let norms = |of: &dyn Fn(&Residual) -> f64| residuals.iter().flatten().map(of).collect::<Vec<f64>>();
        let noise = Size {
            mm: quantile(norms(&|r| r.0.norm()), NOISE_SHARE).unwrap_or(0.0) * NOISE,
            rad: quantile(norms(&|r| r.1.norm()), NOISE_SHARE).unwrap_or(0.0) * NOISE,
        };
        let correlated = if repeats < REPEATS_FROM { Size::default() } else { apart(samples, &at) };
        let noise = noise.max(correlated).max(rounding(samples)).min(limits.saw()).max(FLOOR);
        let scales = Self { noise, period_s, local: Vec::new(), limits: limits.clone() };
        let local = (0..samples.len()).map(|k| scales.around(&residuals, &at, k)).collect();
        Self { local, ..scales }
    }

    /// The larger motion of before and after a sample, which itself is left out.
    fn around(&self, residuals: &[Option<Residual>], at: &[f64], k: usize) -> (Size, Size) {
        let from = at.partition_point(|s| *s < at[k] - WINDOW_S).min(k.saturating_sub(N_AROUND));
        let to = at.partition_point(|s| *s <= at[k] + WINDOW_S).max(k + 1 + N_AROUND).min(at.len());
        let before = motion(&residuals[from..k.saturating_sub(1).max(from)]);
        let after = motion(&residuals[(k + 2).min(to)..to]);
        let most = (self.limits.saw() * 2.0, self.limits.acceleration() * self.period_s.powi(2));
        match (before, after) {
            (None, None) => most,
            (Some(one), None) | (None, Some(one)) => ((one.0 * MOTION).min(most.0), (one.1 * MOTION).min(most.1)),
            (Some(a), Some(b)) => ((a.0.max(b.0) * MOTION).min(most.0), (a.1.max(b.1) * MOTION).min(most.1)),
        }
    }

    /// What a sample may be off where those before it lead, `gap_s` after the last of them.
    pub(super) fn tolerance(&self, k: usize, gap_s: f64) -> Size {
        let (shake, accelerated) = self.local[k];
        let periods = (gap_s / self.period_s).max(1.0);
        let most = self.limits.speed() * gap_s;
        self.noise + shake + (accelerated * periods.powi(2)).min(most.max(accelerated))
    }

    /// What a marker may move within `gap_s` at any speed.
    pub(super) fn reach(&self, k: usize, gap_s: f64) -> Size {
        self.noise + self.local[k].0 + self.limits.speed() * gap_s
    }

    /// What a marker of known velocities moves within `gap_s` before a sample, beyond what they explain: a saw shakes it, but leaves it
    /// where it was.
    pub(super) fn by_hand(&self, k: usize, gap_s: f64) -> Size {
        self.noise + self.local[k].0 + self.limits.acceleration() * (gap_s.powi(2) / 4.0)
    }
}

fn residual(samples: &[Sample], at: &[f64], k: usize) -> Option<Residual> {
    let (before, after) = (k.checked_sub(1)?, k + 1);
    if after >= samples.len() || at[after] - at[before] > APART_S {
        return None;
    }
    let share = (at[after] - at[k]) / (at[after] - at[before]).max(1e-9);
    let between = extrapolated(&samples[before].1, &samples[after].1, -share);
    let pose = &samples[k].1;
    Some((
        pose.translation.vector - between.translation.vector,
        (pose.rotation * between.rotation.inverse()).scaled_axis(),
    ))
}

/// Medians of what the mean of six residuals in a row leaves of them, and of that mean: shaking and every second or third sample off
/// cancel in it, a motion does not.
fn motion(residuals: &[Option<Residual>]) -> Option<(Size, Size)> {
    let mut motions = Vec::new();
    for run in residuals.windows(N_MEAN) {
        let Some(run) = run.iter().copied().collect::<Option<Vec<Residual>>>() else { continue };
        let n = N_MEAN as f64;
        let mean =
            (run.iter().map(|r| r.0).sum::<Vector3<f64>>() / n, run.iter().map(|r| r.1).sum::<Vector3<f64>>() / n);
        let middle = run[N_MEAN / 2];
        let shake = Size { mm: (middle.0 - mean.0).norm(), rad: (middle.1 - mean.1).norm() };
        motions.push((shake, Size { mm: mean.0.norm(), rad: mean.1.norm() }));
    }
    if motions.len() < N_SHOW {
        return None;
    }
    let median = |of: &dyn Fn(&(Size, Size)) -> f64| quantile(motions.iter().map(of).collect(), 0.5);
    Some((
        Size { mm: median(&|m| m.0.mm)?, rad: median(&|m| m.0.rad)? },
        Size { mm: median(&|m| m.1.mm)?, rad: median(&|m| m.1.rad)? },
    ))
}

/// The noise of a tracker that rounds, by its last digit; zero where hardly any step is zero.
fn rounding(samples: &[Sample]) -> Size {
    let steps: Vec<Size> = samples.windows(2).map(|pair| deviation(&pair[1].1, &pair[0].1)).collect();
    let of = |values: Vec<f64>, least: f64| {
        let n_equal = values.iter().filter(|step| **step <= least).count();
        let smallest = values.iter().copied().filter(|step| *step > least).fold(f64::INFINITY, f64::min);
        let rounds = smallest.is_finite() && n_equal as f64 > REPEATS_FROM * values.len() as f64;
        if rounds { N_STEPS * smallest } else { 0.0 }
    };
    // The angle between equal rotations is rounded.
    Size {
        mm: of(steps.iter().map(|step| step.mm).collect(), 1e-9),
        rad: of(steps.iter().map(|step| step.rad).collect(), 1e-7),
    }
}

/// The noise of samples a window apart: that of a tracker that repeats poses is correlated, and those in between do not show it.
fn apart(samples: &[Sample], at: &[f64]) -> Size {
    let apart: Vec<Size> = (0..samples.len())
        .filter_map(|k| {
            let later = at.partition_point(|s| *s < at[k] + WINDOW_S);
            Some(deviation(&samples.get(later)?.1, &samples[k].1))
        })
        .collect();
    let of = |values: Vec<f64>| quantile(values, 0.5).unwrap_or(0.0) * NOISE_APART;
    Size { mm: of(apart.iter().map(|size| size.mm).collect()), rad: of(apart.iter().map(|size| size.rad).collect()) }
}

pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(values[(last as f64 * share).floor() as usize])
}
