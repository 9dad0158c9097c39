//! Poses that agree, among others that do not.

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// Fits to few poses from which the search starts: with two fifths of outliers 40 of 300 are without any.
const N_STARTS: usize = 300;
/// Poses of such a fit.
pub(super) const N_OF_START: usize = 4;
/// The reciprocal of the least share of the poses that are at one end by no chance: one of eight stations may be.
const ONE_END: usize = 8;
/// Maximum number of times that outliers are sought again after a fit.
const N_ROUNDS: usize = 20;

/// What is an outlier.
pub(super) struct Gate {
    /// The share of the poses by which a fit is judged.
    pub share: f64,
    /// Poses farther than this many times the distance within which that share is are outliers.
    pub times: f64,
    /// Poses within this are none, mm.
    pub least_mm: f64,
}

impl Gate {
    /// The distance within which the share is, mm; of more poses than determine a fit.
    pub(super) fn judged_mm(&self, offsets: &[f64]) -> f64 {
        let mut sorted = offsets.to_vec();
        sorted.sort_by(f64::total_cmp);
        let rank = ((self.share * sorted.len() as f64) as usize).max(N_OF_START);
        sorted[rank.min(sorted.len() - 1)]
    }

    pub(super) fn within(&self, offsets: &[f64]) -> Vec<bool> {
        let gate_mm = (self.times * self.judged_mm(offsets)).max(self.least_mm);
        offsets.iter().map(|offset| offset.total_cmp(&gate_mm).is_le()).collect()
    }
}

/// Which of `all` are within the gate of a fit to them. It starts from the fit to all or to few whose offsets are judged least, as in
/// the least median of squares (Rousseeuw 1984). `offsets` has those of all from the fit to some, mm.
pub(super) fn inliers<T: Copy>(all: &[T], offsets: impl Fn(&[T]) -> Option<Vec<f64>>, gate: &Gate) -> Vec<bool> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let few = (0..N_STARTS).map(|_| (0..N_OF_START).map(|_| all[rng.random_range(0..all.len())]).collect());
    let starts = std::iter::once(all.to_vec()).chain(few).filter_map(|start: Vec<T>| offsets(&start));
    let best = starts.map(|offsets| (gate.judged_mm(&offsets), offsets)).min_by(|a, b| a.0.total_cmp(&b.0));
    let mut inliers = best.map_or(vec![true; all.len()], |(_, offsets)| gate.within(&offsets));
    for _ in 0..N_ROUNDS {
        let Some(next) = offsets(&selected(all, &inliers)).map(|offsets| gate.within(&offsets)) else { break };
        if std::mem::replace(&mut inliers, next.clone()) == next {
            break;
        }
    }
    inliers
}

pub(super) fn selected<T: Copy>(all: &[T], is_selected: &[bool]) -> Vec<T> {
    all.iter().zip(is_selected).filter(|(_, is_selected)| **is_selected).map(|(one, _)| *one).collect()
}

/// Whether these indices are the first or the last of `n`, but for a tenth of them, and too many for a chance.
pub(super) fn is_at_one_end(indices: &[usize], n: usize) -> bool {
    let (Some(first), Some(last)) = (indices.first(), indices.last()) else { return false };
    let span = indices.len() + indices.len() / 10;
    indices.len() > n / ONE_END && (*last < span || n - first <= span)
}
