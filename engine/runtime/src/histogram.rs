//! Histogram of durations with fixed classes, so that its memory does not grow with the run.

use std::time::Duration;

/// Number of classes per power of two: a percentile is at most 1/32 (3 %) above the exact one.
const CLASSES: u64 = 32;
const CLASS_BITS: u32 = CLASSES.ilog2();
/// Durations from 2^44 ns (five hours) on share the last class.
const MAX_BITS: u32 = 44;

/// Counts durations; takes 10 KiB once the first is counted.
#[derive(Debug, Clone, Default)]
pub(crate) struct Histogram {
    counts: Vec<u64>,
    n: u64,
    sum_ns: u64,
    max_ns: u64,
}

/// The percentiles of a histogram.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Spread {
    /// Median.
    pub p50: Duration,
    /// 95th percentile.
    pub p95: Duration,
    /// 99th percentile.
    pub p99: Duration,
    /// Maximum; exact.
    pub max: Duration,
}

impl Histogram {
    /// Counts `n` durations that took `ns` together, each with an equal share.
    pub(crate) fn count(&mut self, n: u64, ns: u64) {
        if self.counts.is_empty() {
            self.counts = vec![0; class(u64::MAX) + 1];
        }
        let each = ns / n.max(1);
        self.counts[class(each)] += n;
        self.n += n;
        self.sum_ns = self.sum_ns.saturating_add(ns);
        self.max_ns = self.max_ns.max(each);
    }

    pub(crate) fn n(&self) -> u64 {
        self.n
    }

    pub(crate) fn sum_ns(&self) -> u64 {
        self.sum_ns
    }

    /// Percentiles by the upper bounds of their classes.
    pub(crate) fn spread(&self) -> Spread {
        let percentile = |share: u64| {
            let rank = (self.n * share).div_ceil(100);
            let mut below = 0;
            let reached = self.counts.iter().position(|count| {
                below += count;
                below >= rank && rank > 0
            });
            Duration::from_nanos(reached.map_or(0, |class| largest_of(class).min(self.max_ns)))
        };
        Spread { p50: percentile(50), p95: percentile(95), p99: percentile(99), max: Duration::from_nanos(self.max_ns) }
    }
}

fn class(ns: u64) -> usize {
    let ns = ns.min((1 << MAX_BITS) - 1);
    if ns < CLASSES {
        return ns as usize;
    }
    // The leading bit gives the power of two, the bits after it the class.
    let power = ns.ilog2() - CLASS_BITS;
    ((u64::from(power) * CLASSES) + (ns >> power)) as usize
}

fn largest_of(class: usize) -> u64 {
    let class = class as u64;
    if class + 1 == self::class(u64::MAX) as u64 + 1 {
        return u64::MAX;
    }
    match class / CLASSES {
        0 => class,
        power => ((class % CLASSES + CLASSES + 1) << (power - 1)) - 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_contiguous_and_three_percent_wide() {
        for class in 0..self::class(u64::MAX) {
            let largest = largest_of(class);
            assert_eq!((self::class(largest), self::class(largest + 1)), (class, class + 1), "{largest} ns");
            let smallest = if class == 0 { 0 } else { largest_of(class - 1) + 1 };
            assert!(largest - smallest <= smallest / CLASSES, "{smallest} to {largest} ns");
        }
        assert_eq!(largest_of(self::class(u64::MAX)), u64::MAX);
    }

    #[test]
    fn percentiles_are_those_of_a_sorted_list_within_a_class() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.spread(), Spread::default());
        let mut all: Vec<u64> = (0..1000).map(|i| i * i * 37 % 1_000_003).collect();
        all.iter().for_each(|ns| histogram.count(1, *ns));
        all.sort_unstable();
        let spread = histogram.spread();
        for (found, rank) in [(spread.p50, 500), (spread.p95, 950), (spread.p99, 990), (spread.max, 1000)] {
            let (found, exact) = (found.as_nanos() as u64, all[rank - 1]);
            assert!(found >= exact && found <= exact + exact / CLASSES, "rank {rank}: {found} for {exact} ns");
        }
        assert_eq!((histogram.n(), histogram.sum_ns()), (1000, all.iter().sum()));
    }
}
