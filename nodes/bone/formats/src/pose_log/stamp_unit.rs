//! Whether the stamps of a log are in the unit in which they are read.

use nalgebra::Vector3;
use osteoflow_geometry::StampNs;

/// No tracker is faster: the fastest for motion capture give 2000 poses a second.
const FASTEST_S: f64 = 5e-4;
/// The interval from which on a thousandth of it is a tracker's.
const SLOW_S: f64 = 1.0;
/// The interval of the fastest trackers for surgery (400 Hz), read in the next larger unit. Below it a tool at rest that is logged once a
/// second or two is likelier than a faster tracker, which at rest looks the same.
const SLOW_AT_REST_S: f64 = 2.5;
/// A tool at rest stays within this, mm: noise and what a fixed marker yields.
const REST_MM: f64 = 5.0;
/// Faster than a hand moves a tool, mm/s, and the noise of a position, mm, that comes to it.
const HAND_MM_S: f64 = 2000.0;
const NOISE_MM: f64 = 1.0;
/// Positions of a motion that is sampled densely are apart by less than this part of its extent; those of stations are not.
const DENSE: f64 = 0.2;
/// Number of steps faster than a hand up to which they may be outliers: one makes two.
const N_OUTLIERS: usize = 2;
/// Number of poses on each side of a change of the unit.
const N_BESIDE: usize = 5;

/// The stamps of one tool, and where it was seen when, mm, in the order of the file.
#[derive(Default)]
pub(super) struct Track {
    pub(super) stamps: Vec<StampNs>,
    pub(super) seen: Vec<(StampNs, Vector3<f64>)>,
}

impl Track {
    /// A sign that the stamps are in another unit, or have too few digits.
    pub(super) fn sign(&self) -> Option<String> {
        let steps: Vec<f64> = self.stamps.windows(2).map(|pair| pair[0].abs_diff(pair[1]) as f64 * 1e-9).collect();
        if steps.len() < 2 {
            return None;
        }
        self.few_digits().or_else(|| self.change(&steps)).or_else(|| {
            let step_s = median(&steps);
            if step_s > 0.0 && step_s < FASTEST_S {
                return Some(format!("its poses are {step_s:.1e} s apart, as of no tracker; is the unit of the stamps right?"));
            }
            let unit = [1e3, 1e6, 1e9].into_iter().find(|unit| step_s / unit < SLOW_S).unwrap_or(1e9);
            (step_s >= SLOW_S && !self.is_sparse(step_s, unit)).then(|| {
                format!(
                    "its poses are {step_s:.1} s apart, and {:.1} ms, as of a tracker, if the stamps are in a unit {unit} times smaller than \
                     the one they are read in; give their unit, or leave it so if they were taken that slowly",
                    step_s / unit * 1e3
                )
            })
        })
    }

    /// Whether the tool moved as if its poses were indeed so far apart: between stations, or logged now and then.
    fn is_sparse(&self, step_s: f64, unit: f64) -> bool {
        let moves = || self.seen.windows(2).map(|pair| (pair[0].0.abs_diff(pair[1].0), (pair[1].1 - pair[0].1).norm()));
        let n_fast = moves().filter(|(ns, mm)| *mm > HAND_MM_S * *ns as f64 * 1e-9 / unit + NOISE_MM).count();
        let ends = self.seen.iter().map(|(_, at)| (*at, *at)).reduce(|a, b| (a.0.inf(&b.0), a.1.sup(&b.1)));
        let extent_mm = ends.map_or(0.0, |(low, high)| (high - low).norm());
        let is_dense = median(&moves().map(|(_, mm)| mm).collect::<Vec<_>>()) < DENSE * extent_mm;
        n_fast > N_OUTLIERS || if extent_mm < REST_MM { step_s < SLOW_AT_REST_S } else { !is_dense }
    }

    /// Poses at different places with one stamp.
    fn few_digits(&self) -> Option<String> {
        let n = self.seen.windows(2).filter(|pair| pair[0].0 == pair[1].0 && pair[0].1 != pair[1].1).count();
        (4 * n > self.stamps.len()).then(|| {
            format!(
                "{n} of {} poses have the stamp of the one before at another place; do the stamps have too few digits?",
                self.stamps.len()
            )
        })
    }

    /// A change of the unit within the file, at the largest step.
    fn change(&self, steps: &[f64]) -> Option<String> {
        let at = (0..steps.len()).max_by(|a, b| steps[*a].total_cmp(&steps[*b]))?;
        let (before, after) = (&steps[..at], &steps[at + 1..]);
        if before.len().min(after.len()) < N_BESIDE {
            return None;
        }
        let (before_s, after_s) = (median(before), median(after));
        let ratio = (after_s / before_s).log10().abs() / 3.0;
        // Within a quarter.
        let is_unit = ratio.is_finite() && ratio > 0.9 && (ratio - ratio.round()).abs() < 0.03;
        is_unit.then(|| {
            format!("its poses are {before_s:.3e} s apart up to {} ns and {after_s:.3e} s from then on; does the unit of the stamps change there?", self.stamps[at])
        })
    }
}

/// The upper median of the positive values; 0 of none.
fn median(values: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| *value > 0.0).collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}
