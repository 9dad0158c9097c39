//! The poses that agree.

use super::{LEAST_SPREAD, Pair, axis_spread, home, in_scale, motions, park_martin, with_scale};
use nalgebra::Isometry3;
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// Fits to few poses from which the search starts: with two fifths of outliers 40 of 300 are without any.
const N_STARTS: usize = 300;
/// Poses of such a fit.
const N_OF_START: usize = 4;
/// Maximum number of times that outliers are sought again after a fit.
const N_ROUNDS: usize = 10;
/// Distance at which an angle counts as a length, mm: about half a board.
const TURN_ARM_MM: f64 = 100.0;
/// The share of the poses that is judged by: of a target that was moved half-way half agree.
const JUDGED_SHARE: f64 = 0.4;
/// Poses farther from the rest than this many times the distance within which that share is are outliers. 5: with normal errors one of
/// millions.
const GATE: f64 = 5.0;
/// Poses within this are no outliers, mm: ten times what a tracker errs by.
const LEAST_GATE_MM: f64 = 2.0;

/// Which poses agree: those near to the fit to few of them that is nearest to its share of all. The scale of the target is fitted, too:
/// it is no fault of single poses.
pub(super) fn agreeing(pairs: &[Pair]) -> Vec<bool> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let (mut best_mm, mut inliers) = (f64::INFINITY, vec![true; pairs.len()]);
    let starts = if pairs.len() > N_OF_START + 1 { N_STARTS } else { 0 };
    for _ in 0..starts {
        let few: Vec<Pair> = (0..N_OF_START).map(|_| pairs[rng.random_range(0..pairs.len())]).collect();
        let Some(offsets) = offsets_mm(pairs, &few) else { continue };
        let found_mm = judged_mm(&offsets);
        if found_mm < best_mm {
            (best_mm, inliers) = (found_mm, within_gate(&offsets));
        }
    }
    for _ in 0..N_ROUNDS {
        let used: Vec<Pair> =
            pairs.iter().zip(&inliers).filter(|(_, is_inlier)| **is_inlier).map(|(pair, _)| *pair).collect();
        let Some(next) = offsets_mm(pairs, &used).map(|offsets| within_gate(&offsets)) else { break };
        if std::mem::replace(&mut inliers, next.clone()) == next {
            break;
        }
    }
    inliers
}

/// The distances of the target from one place, within which the judged share of the poses is, mm, of a fit to all of them.
pub(super) fn misfit_mm(pairs: &[Pair]) -> f64 {
    offsets_mm(pairs, pairs).map_or(f64::INFINITY, |offsets| judged_mm(&offsets))
}

/// The distance of the target at each pose from its mean place in the fit to `used`, angles counted as lengths.
fn offsets_mm(pairs: &[Pair], used: &[Pair]) -> Option<Vec<f64>> {
    let motions = motions(used);
    if motions.len() < 2 || axis_spread(&motions) < LEAST_SPREAD {
        return None;
    }
    let (fit, scale) = with_scale(park_martin(&motions)?, &motions)?;
    let scaled = |(marker, target): &Pair| (*marker, in_scale(target, scale));
    let (place, turn) = home(&used.iter().map(scaled).collect::<Vec<_>>(), &fit);
    let offset = |(marker, target): Pair| {
        let at: Isometry3<f64> = marker * fit * target;
        (at.translation.vector - place).norm() + TURN_ARM_MM * at.rotation.angle_to(&turn)
    };
    Some(pairs.iter().map(scaled).map(offset).collect())
}

fn judged_mm(offsets: &[f64]) -> f64 {
    let mut sorted = offsets.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = ((JUDGED_SHARE * sorted.len() as f64) as usize).max(N_OF_START);
    sorted[rank.min(sorted.len() - 1)]
}

fn within_gate(offsets: &[f64]) -> Vec<bool> {
    let gate_mm = (GATE * judged_mm(offsets)).max(LEAST_GATE_MM);
    offsets.iter().map(|offset| *offset <= gate_mm).collect()
}
