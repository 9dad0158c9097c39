//! Samples that lead to each other.

use super::{SILENCE_S, Sample, Size, deviation, extrapolated, scale::Scales, seconds};

/// A single sample leads no farther, s: it may have any velocity.
const SINGLE_S: f64 = 0.25;

/// Standard deviations that are tolerated.
const TOLERANCE_SDS: f64 = 4.0;

/// Number of samples at the end of a track that lead on.
const N_LEAD: usize = 2;

/// Number of samples of another track between two of one, from which it may have been left.
const N_LEFT: usize = 3;

/// The numbers of samples that lead from one to the next, each in one track.
pub(super) fn tracks(samples: &[Sample], scales: &Scales) -> Vec<Vec<usize>> {
    let mut tracks: Vec<Vec<usize>> = Vec::new();
    // Those that may go on.
    let mut live: Vec<usize> = Vec::new();
    for k in 0..samples.len() {
        live.retain(|track| {
            tracks[*track].last().is_some_and(|last| seconds(samples[k].0 - samples[*last].0) <= SILENCE_S)
        });
        let leads = live.iter().map(|track| (*track, Lead::to(samples, &tracks[*track], k, scales)));
        let best = leads.filter(|(_, lead)| lead.off <= 1.0).min_by(|(_, a), (_, b)| a.order(b));
        match best {
            Some((track, _)) => tracks[track].push(k),
            None => {
                live.push(tracks.len());
                tracks.push(vec![k]);
            }
        }
    }
    // Only what follows a first sample says where it should be.
    let mut firsts = Vec::new();
    for track in tracks.iter_mut().filter(|track| track.len() > N_LEAD) {
        let backward: Vec<usize> = track[1..=N_LEAD].iter().rev().copied().collect();
        if Lead::to(samples, &backward, track[0], scales).off > 1.0 {
            firsts.push(vec![track.remove(0)]);
        }
    }
    tracks.extend(firsts);
    split(&tracks, samples.len())
}

/// The tracks, ended where another goes on for some samples before they go on: whether the marker was on that other one is for both to say.
fn split(tracks: &[Vec<usize>], n: usize) -> Vec<Vec<usize>> {
    let mut track_of = vec![0; n];
    for (track, samples) in tracks.iter().enumerate() {
        samples.iter().for_each(|k| track_of[*k] = track);
    }
    let is_left = |a: &usize, b: &usize| {
        let between = &track_of[a + 1..*b];
        between.iter().any(|track| between.iter().filter(|other| *other == track).count() >= N_LEFT)
    };
    tracks.iter().flat_map(|track| track.chunk_by(|a, b| !is_left(a, b)).map(<[usize]>::to_vec)).collect()
}

/// Where a track leads a sample.
struct Lead {
    /// Whether the track shows a velocity.
    is_known: bool,
    /// How far the sample is from there, over what is tolerated.
    off: f64,
    /// Minus the logarithm of its likelihood, up to a constant.
    unlikely: f64,
}

impl Lead {
    fn to(samples: &[Sample], track: &[usize], k: usize, scales: &Scales) -> Self {
        let far = Self { is_known: false, off: f64::INFINITY, unlikely: f64::INFINITY };
        let Some(&last) = track.last() else { return far };
        let gap_s = seconds(samples[k].0 - samples[last].0).abs();
        let pose = &samples[k].1;
        let held = deviation(pose, &samples[last].1);
        let before = track.len().checked_sub(N_LEAD).map(|at| track[at]);
        let before = before.map(|before| (before, seconds(samples[last].0 - samples[before].0).abs()));
        match before {
            Some((before, apart_s)) => {
                let led = extrapolated(&samples[before].1, &samples[last].1, gap_s / apart_s);
                let tolerance = scales.tolerance(k, gap_s);
                Self::new(true, held.over(&tolerance).min(deviation(pose, &led).over(&tolerance)), tolerance)
            }
            None if gap_s <= SINGLE_S => {
                let reach = scales.reach(k, gap_s);
                Self::new(false, held.over(&reach), reach)
            }
            None => far,
        }
    }

    fn new(is_known: bool, off: f64, tolerance: Size) -> Self {
        let sds = off * TOLERANCE_SDS;
        Self { is_known, off, unlikely: sds * sds / 2.0 + 3.0 * (tolerance.mm * tolerance.rad).ln() }
    }

    /// A known velocity before an unknown one, then the likelier.
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        other.is_known.cmp(&self.is_known).then(self.unlikely.total_cmp(&other.unlikely))
    }
}
