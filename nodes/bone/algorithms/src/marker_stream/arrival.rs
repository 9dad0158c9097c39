//! Stamps that are times of arrival.

use super::{SILENCE_S, scale::quantile, seconds};
use osteoflow_geometry::StampNs;

/// Number of intervals over which a period is averaged.
const N_PERIODS: usize = 10;

/// Smallest number of stamps that show it.
const N_SHOW: usize = 30;

/// Intervals below this share of the period are of samples that arrive together.
const TOGETHER: f64 = 0.5;

/// Share of such intervals from which samples arrive in bursts.
const BURSTS_FROM: f64 = 0.3;

/// Stamps whose intervals scatter by more than this share of the period are not those of a tracker's clock.
const JITTER_FROM: f64 = 0.25;

/// What a stream's stamps look like if they are times of arrival.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// The mean interval, s.
    pub period_s: f64,
    /// Share of the samples that come together with the one before.
    pub together: f64,
    /// How late samples may be, s.
    pub late_s: f64,
}

impl Arrival {
    /// `None` if the stamps, in order, look like those of a clock that ticks at each measurement. Looked at is the longest time without a
    /// silence: at stations a marker is measured a few times each. `O(n log n)`.
    pub fn of(stamps: &[StampNs]) -> Option<Self> {
        let stamps = stamps.chunk_by(|a, b| seconds(b - a) < SILENCE_S).max_by_key(|span| span.len())?;
        if stamps.len() < N_SHOW {
            return None;
        }
        let mean = |span: &[StampNs]| seconds(span[N_PERIODS] - span[0]) / N_PERIODS as f64;
        let periods: Vec<f64> = stamps.windows(N_PERIODS + 1).map(mean).collect();
        // Losses lengthen it.
        let period_s = quantile(periods, 0.5).filter(|period_s| *period_s > 0.0)?;
        let intervals: Vec<f64> = stamps.windows(2).map(|pair| seconds(pair[1] - pair[0])).collect();
        let n = intervals.len() as f64;
        let together = intervals.iter().filter(|s| **s < TOGETHER * period_s).count() as f64 / n;
        let off = intervals.iter().map(|s| (s - (s / period_s).round().max(1.0) * period_s).abs()).collect();
        let jitter_s = quantile(off, 0.5)?;
        let longest_s = quantile(intervals, 0.9)?;
        if together < BURSTS_FROM && jitter_s < JITTER_FROM * period_s {
            return None;
        }
        let late_s = if together < BURSTS_FROM { 2.0 * jitter_s } else { longest_s };
        Some(Self { period_s, together, late_s })
    }

    /// In words.
    pub fn words(&self) -> String {
        let Self { period_s, together, late_s } = self;
        let (ms, late_ms) = (period_s * 1e3, late_s * 1e3);
        let how = if *together < BURSTS_FROM {
            "are not those of a clock that ticks with it".to_owned()
        } else {
            format!("put {:.0} % of them less than half of that apart", together * 100.0)
        };
        format!(
            "its poses come every {ms:.0} ms, but their stamps {how}: they are probably times of arrival, and poses may be {late_ms:.0} ms \
             late; record the tracker's own stamps"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrival(stamp_ms: impl Fn(usize) -> f64) -> Option<Arrival> {
        let mut stamps: Vec<StampNs> = (0..200).map(|k| (stamp_ms(k) * 1e6) as StampNs).collect();
        stamps.sort_unstable();
        Arrival::of(&stamps)
    }

    #[test]
    fn bursts_and_jitter_are_told_and_a_clock_with_losses_is_not() {
        assert_eq!(arrival(|k| 50.0 * k as f64), None);
        // One in eight is lost, and the others tick at 66 and 133 ms.
        assert_eq!(arrival(|k| 66.7 * (k + k / 7) as f64), None);
        // A millisecond of jitter.
        assert_eq!(arrival(|k| 50.0 * k as f64 + (k * 7919 % 13) as f64 / 6.0), None);
        // Stations, of three samples each.
        assert_eq!(arrival(|k| 2000.0 * (k / 3) as f64 + 20.0 * (k % 3) as f64), None);
        let bursts = arrival(|k| 50.0 * (k - k % 5) as f64 + 200.0 + (k % 5) as f64).unwrap();
        assert!(bursts.together > 0.7 && (0.15..0.3).contains(&bursts.late_s), "{bursts:?}");
        let reversed = arrival(|k| (50 * k + 65 * (4 - k % 5)) as f64).unwrap();
        assert!(reversed.together > 0.7 && (0.15..0.3).contains(&reversed.late_s), "{reversed:?}");
        let jitter = arrival(|k| 50.0 * k as f64 + (k * 7919 % 101) as f64).unwrap();
        assert!(jitter.late_s > 0.02, "{jitter:?}");
    }
}
