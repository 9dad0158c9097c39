//! Trackers that repeat a pose.

/// Longest run of equal poses of a tracker that measures, in samples, for each one that chance makes, and beyond them.
const RUNS: f64 = 3.0;
const N_MORE: f64 = 5.0;

/// Smallest share of repeated poses that is assumed.
const LEAST: f64 = 0.02;

/// Smallest number of samples that show how often a tracker repeats a pose.
const N_KNOWN: usize = 100;

/// How often a tracker repeats its last pose to the last bit.
#[derive(Debug, Clone, Default)]
pub struct Repeats {
    n: usize,
    n_equal: usize,
    /// Equal samples in a row.
    run: usize,
    longest: usize,
}

impl Repeats {
    /// Takes the next sample.
    pub fn take(&mut self, is_equal: bool) {
        self.n += 1;
        self.n_equal += usize::from(is_equal);
        self.run = if is_equal { self.run + 1 } else { 0 };
        self.longest = self.longest.max(self.run);
    }

    /// Number of samples so far.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Number of equal samples in a row from which this tracker does not measure: three times the longest run that chance makes of its
    /// own share of repeats, and five more. `None` while too few samples show it.
    pub fn n_frozen(&self) -> Option<usize> {
        // The longest run is what is judged.
        let (n, n_equal) = (self.n - self.longest, self.n_equal - self.longest);
        if n < N_KNOWN {
            return None;
        }
        let share = (n_equal as f64 / n as f64).max(LEAST);
        let by_chance = if share < 1.0 { (n as f64).ln() / -share.ln() } else { f64::INFINITY };
        Some((RUNS * by_chance + N_MORE).ceil() as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn repeats(runs: impl IntoIterator<Item = usize>) -> Repeats {
        let mut repeats = Repeats::default();
        for run in runs {
            repeats.take(false);
            (0..run).for_each(|_| repeats.take(true));
        }
        repeats
    }

    #[test]
    fn a_run_is_frozen_by_how_often_the_tracker_repeats_itself() {
        assert_eq!(repeats([0; 50]).n_frozen(), None);
        // An optical tracker repeats one pose of ten; half a second of 20 Hz is frozen.
        let optical = repeats((0..300).map(|k| usize::from(k % 10 == 0)).chain([28]));
        assert!(optical.n_frozen().is_some_and(|n| n < 20), "{:?}", optical.n_frozen());
        // An electromagnetic one repeats four of five, as measured: runs of 34 samples are its own.
        let magnetic = repeats((0..160).map(|_| 4).chain([34]));
        assert!(magnetic.n_frozen().is_some_and(|n| n > 60), "{:?}", magnetic.n_frozen());
    }
}
