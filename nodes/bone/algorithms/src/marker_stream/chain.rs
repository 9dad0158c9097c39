//! The tracks that are one marker's, and the motions between them.

use super::{Cause, Kind, Sample, Size, deviation, extrapolated, scale::Scales, seconds};

/// A marker that stays where no hand brings it is taken to be there after this time and number of samples.
const STAYS_S: f64 = 1.0;
const N_STAYS: usize = 10;

/// A part outweighs another that contradicts it by this many times its samples, and at least five.
const OUTWEIGHS: usize = 3;
const N_OUTWEIGHS: usize = 5;

/// The last samples are confirmed where they move on in three samples, or rest for as long elsewhere.
const N_MOVES_ON: usize = 3;
const N_RESTS: usize = 5;
const RESTS_S: f64 = 0.3;

/// The samples of a marker, as far as they follow each other.
pub(super) struct Linked {
    /// For each sample why it is left out.
    pub(super) out: Vec<Option<Cause>>,
    /// The first sample after each motion that no hand makes.
    pub(super) jumps: Vec<(usize, Cause)>,
}

/// Shares of the time between two parts at which the motion of one goes over into that of the other.
const MEETS_AT: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// Number of samples by which a track may reach into the next: where a motion begins, a sample may fit both.
const N_OVERLAP: usize = 3;

/// Samples in the order of their stamps that a marker's motion joins.
type Part = Vec<usize>;

pub(super) fn linked(samples: &[Sample], tracks: &[Part], scales: &Scales) -> Linked {
    let links = Links { samples, scales };
    let mut parts = heaviest(tracks);
    links.leave_unconfirmed(&mut parts);
    let contradicted = links.join(&mut parts);
    let mut out: Vec<Option<Cause>> = vec![None; samples.len()];
    let sound: Vec<usize> = parts.iter().flatten().copied().collect();
    let mut is_sound = vec![false; samples.len()];
    sound.iter().for_each(|k| is_sound[*k] = true);
    let last = sound.last().copied();
    for k in (0..samples.len()).filter(|k| !is_sound[*k]) {
        let at = sound.partition_point(|other| *other < k);
        let near = at.checked_sub(1).or(Some(at)).and_then(|at| sound.get(at));
        let size = near.map_or_else(Size::default, |near| deviation(&samples[k].1, &samples[*near].1));
        let kind = match last {
            _ if contradicted.contains(&k) => Kind::Jump,
            Some(last) if k > last => Kind::Unconfirmed,
            _ => Kind::Outlier,
        };
        out[k] = Some(Cause::new(kind, size));
    }
    let jump = |pair: &[Part]| {
        let (from, to) = (*pair[0].last()?, *pair[1].first()?);
        Some((to, Cause::new(Kind::Jump, deviation(&samples[to].1, &samples[from].1))))
    };
    Linked { out, jumps: parts.windows(2).filter_map(jump).collect() }
}

/// The tracks, one after the other, that have most samples together: of two that overlap by a few samples, the first ends earlier.
fn heaviest(tracks: &[Part]) -> Vec<Part> {
    let mut by_end: Vec<&Part> = tracks.iter().collect();
    by_end.sort_by_key(|track| track.last().copied());
    // For each track the number of samples of the best sequence that ends with it, and the track before it.
    let mut best: Vec<(usize, Option<usize>)> = Vec::with_capacity(by_end.len());
    for (at, track) in by_end.iter().enumerate() {
        let with = |other: usize| {
            let (from, to) = overlap(by_end[other], track);
            let n_lost = (by_end[other].len() - from).min(to);
            let is_short = n_lost <= N_OVERLAP && from > 0 && to < track.len();
            is_short.then(|| (best[other].0 - n_lost, other))
        };
        let before = (0..at).filter_map(with).max_by_key(|(n, other)| (*n, usize::MAX - other));
        best.push((track.len() + before.map_or(0, |(n, _)| n), before.map(|(_, other)| other)));
    }
    let mut at = (0..best.len()).max_by_key(|track| (best[*track].0, usize::MAX - track));
    let mut parts: Vec<Part> = Vec::new();
    while let Some(track) = at {
        let mut part = by_end[track].clone();
        if let Some(next) = parts.last_mut() {
            let (from, to) = overlap(&part, next);
            if part.len() - from <= to {
                part.truncate(from);
            } else {
                next.drain(..to);
            }
        }
        parts.push(part);
        at = best[track].1;
    }
    parts.retain(|part| !part.is_empty());
    parts.reverse();
    parts
}

/// How many samples of the first track come before the second, and how many of the second before the end of the first.
fn overlap(first: &Part, second: &Part) -> (usize, usize) {
    let (begin, end) = (second[0], first[first.len() - 1]);
    (first.partition_point(|k| *k < begin), second.partition_point(|k| *k <= end))
}

fn outweighs(n: usize, other: usize) -> bool {
    n >= N_OUTWEIGHS && n >= OUTWEIGHS * other
}

struct Links<'a> {
    samples: &'a [Sample],
    scales: &'a Scales,
}

impl Links<'_> {
    /// Takes off what the last samples alone say.
    fn leave_unconfirmed(&self, parts: &mut Vec<Part>) {
        while let [.., before, last] = &parts[..] {
            if self.is_confirmed(before, last) || self.is_back(&parts[..parts.len() - 2], last) {
                return;
            }
            parts.pop();
        }
    }

    fn is_confirmed(&self, before: &Part, last: &Part) -> bool {
        let (Some(third), Some(end)) = (last.get(N_MOVES_ON - 1), before.last()) else { return false };
        let motion = deviation(&self.samples[*third].1, &self.samples[last[0]].1);
        let step = deviation(&self.samples[last[0]].1, &self.samples[*end].1);
        let rests = last.len() >= N_RESTS && self.span_s(last) >= RESTS_S;
        rests || motion.over(&self.scales.noise.max(step)) > 1.0
    }

    /// Whether a part begins where one before it ended.
    fn is_back(&self, before: &[Part], part: &Part) -> bool {
        let shaken = self.scales.by_hand(part[0], 0.0);
        let ends = before.iter().filter_map(|part| part.last());
        ends.into_iter().any(|end| deviation(&self.samples[part[0]].1, &self.samples[*end].1).over(&shaken) <= 1.0)
    }

    /// Joins the parts between which a hand moves the marker, and leaves out those that the others outweigh; gives the samples of parts
    /// that contradict each other with nothing to choose between them.
    fn join(&self, parts: &mut Vec<Part>) -> Vec<usize> {
        let mut contradicted = Vec::new();
        let mut at = 0;
        while at + 1 < parts.len() {
            if self.is_astray(&parts[at..]) {
                parts.remove(at + 1);
                at = 0;
                continue;
            }
            if self.is_by_hand(&parts[at], &parts[at + 1]) {
                let next = parts.remove(at + 1);
                parts[at].extend(next);
                at = 0;
                continue;
            }
            let (stays, other_stays) = (self.stays(&parts[at]), self.stays(&parts[at + 1]));
            let (n, n_other) = (parts[at].len(), parts[at + 1].len());
            match (stays, other_stays) {
                (true, true) => {
                    let (before, after) = parts.split_at_mut(at + 1);
                    if !self.trim(&mut before[at], &mut after[0]) {
                        at += 1;
                        continue;
                    }
                }
                _ if outweighs(n, n_other) || (stays && !other_stays) => drop(parts.remove(at + 1)),
                _ if outweighs(n_other, n) || (other_stays && !stays) => drop(parts.remove(at)),
                _ => contradicted.extend(parts.drain(at..at + 2).flatten()),
            }
            at = 0;
        }
        contradicted
    }

    /// Whether of the first three parts the second, which the others outweigh, leads from the first but not to the third, and the first does.
    fn is_astray(&self, parts: &[Part]) -> bool {
        let [before, part, after, ..] = parts else { return false };
        self.stays(before)
            && self.stays(after)
            && outweighs(before.len().min(after.len()), part.len())
            && self.span_s(part) < RESTS_S
            && self.is_by_hand(before, after)
            && self.is_by_hand(before, part)
            && !self.is_by_hand(part, after)
    }

    fn stays(&self, part: &Part) -> bool {
        part.len() >= N_STAYS && self.span_s(part) >= STAYS_S
    }

    fn span_s(&self, part: &Part) -> f64 {
        match part[..] {
            [first, .., last] => seconds(self.samples[last].0 - self.samples[first].0),
            _ => 0.0,
        }
    }

    /// Whether a hand moves the marker from one part to the next.
    fn is_by_hand(&self, before: &[usize], after: &[usize]) -> bool {
        self.tolerance(before, after).is_some_and(|by_hand| self.meet(before, after, by_hand))
    }

    /// Takes off the last sample of one part, or the first of the next, if the others meet without it.
    fn trim(&self, before: &mut Part, after: &mut Part) -> bool {
        let Some(by_hand) = self.tolerance(before, after) else { return false };
        if self.meet(&before[..before.len() - 1], after, by_hand) {
            before.pop();
        } else if self.meet(before, &after[1..], by_hand) {
            after.remove(0);
        } else {
            return false;
        }
        true
    }

    /// What a hand moves the marker between the parts, beyond their velocities.
    fn tolerance(&self, before: &[usize], after: &[usize]) -> Option<Size> {
        let (from, to) = (*before.last()?, *after.first()?);
        Some(self.scales.by_hand(to, seconds(self.samples[to].0 - self.samples[from].0)))
    }

    /// Whether the velocities at the end of one part and at the begin of the next meet somewhere between them.
    fn meet(&self, before: &[usize], after: &[usize], by_hand: Size) -> bool {
        let (Some(&from), Some(&to)) = (before.last(), after.first()) else { return false };
        let gap_s = seconds(self.samples[to].0 - self.samples[from].0);
        MEETS_AT.iter().any(|share| {
            let led = self.led(before.iter().rev(), gap_s * share);
            let back = self.led(after.iter(), gap_s * (1.0 - share));
            deviation(&led, &back).over(&by_hand) <= 1.0
        })
    }

    /// Where the first of these samples is led by the one after it, away from that.
    fn led<'a>(&self, mut ends: impl Iterator<Item = &'a usize>, by_s: f64) -> nalgebra::Isometry3<f64> {
        let end = *ends.next().expect("a part has samples");
        match ends.next() {
            Some(inner) => {
                let apart_s = seconds(self.samples[end].0 - self.samples[*inner].0).abs();
                extrapolated(&self.samples[*inner].1, &self.samples[end].1, by_s / apart_s.max(1e-9))
            }
            None => self.samples[end].1,
        }
    }
}
