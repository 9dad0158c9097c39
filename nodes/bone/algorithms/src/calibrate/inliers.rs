//! Poses that agree, among others that do not.

use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// Fits to few poses from which the search starts: with two fifths of outliers 40 of 300 are without any.
const N_STARTS: usize = 300;
/// Poses of such a fit.
pub(super) const N_OF_START: usize = 4;
/// Maximum number of times that outliers are sought again after a fit.
const N_ROUNDS: usize = 20;

/// Which of `all` are within the gate of a fit to them. It starts from the fit to all or to few whose offsets are judged least, as in
/// the least median of squares (Rousseeuw 1984). `offsets` has those of all from the fit to some.
pub(super) fn inliers<T: Copy>(
    all: &[T],
    offsets: impl Fn(&[T]) -> Option<Vec<f64>>,
    judged: impl Fn(&[f64]) -> f64,
    gate: impl Fn(&[f64]) -> Vec<bool>,
) -> Vec<bool> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let (mut best, mut inliers) = (f64::INFINITY, vec![true; all.len()]);
    for start in 0..=N_STARTS {
        let n = if start == 0 { 0 } else { N_OF_START };
        let few: Vec<T> = (0..n).map(|_| all[rng.random_range(0..all.len())]).collect();
        let Some(offsets) = offsets(if start == 0 { all } else { &few }) else { continue };
        if judged(&offsets) < best {
            (best, inliers) = (judged(&offsets), gate(&offsets));
        }
    }
    for _ in 0..N_ROUNDS {
        let Some(next) = offsets(&selected(all, &inliers)).map(|offsets| gate(&offsets)) else { break };
        if std::mem::replace(&mut inliers, next.clone()) == next {
            break;
        }
    }
    inliers
}

pub(super) fn selected<T: Copy>(all: &[T], is_selected: &[bool]) -> Vec<T> {
    all.iter().zip(is_selected).filter(|(_, is_selected)| **is_selected).map(|(one, _)| *one).collect()
}

/// Whether these indices are the first or the last of `n`, but for a tenth of them.
pub(super) fn is_at_one_end(indices: &[usize], n: usize) -> bool {
    let (Some(first), Some(last)) = (indices.first(), indices.last()) else { return false };
    let span = indices.len() + indices.len() / 10;
    *last < span || n - first <= span
}
