//! A marker whose poses arrive one by one.

use super::sifted::{Sifted, Sign, jump_words};
use osteoflow_algorithms::marker_stream::{Kind, MotionLimits, Sample, judge};
use osteoflow_geometry::{Pose, StampNs};
use std::collections::VecDeque;

/// Samples by which the next is judged: of this time, and no nearer to each other than this, so that a fast tracker's are few and reach as far back.
const KEPT_NS: StampNs = 2_500_000_000;
const APART_NS: StampNs = 12_500_000;

/// Time for which nothing is given after the last pose, before the marker is unknown.
const UNKNOWN_AFTER_NS: StampNs = 100_000_000;

/// The poses of a marker so far.
#[derive(Default)]
pub(crate) struct LiveMarker {
    samples: VecDeque<Sample>,
    /// The last that was given.
    last_ns: Option<StampNs>,
    /// Whether the samples that are left out now were told.
    is_told: bool,
}

impl LiveMarker {
    /// The next pose of the marker called `what`: nothing if it is left out, and why it is unknown if it has been for too long.
    pub(crate) fn take(
        &mut self,
        what: &str,
        pose: Pose,
        limits: &MotionLimits,
        signs: &mut Vec<Sign>,
    ) -> Option<Sifted> {
        let stamp_ns = pose.stamp_ns;
        if stamp_ns == 0 || !limits.are_set() {
            return Some((pose, None));
        }
        // Samples of a stamp ahead of its time, or of a clock that was set back, say nothing of this one.
        self.samples.retain(|(ns, _)| *ns <= stamp_ns);
        self.last_ns = self.last_ns.filter(|ns| *ns <= stamp_ns);
        let n = self.samples.len();
        if n > 1 && self.samples[n - 1].0 - self.samples[n - 2].0 < APART_NS {
            self.samples.pop_back();
        }
        self.samples.push_back((stamp_ns, pose.isometry));
        while self.samples.front().is_some_and(|(ns, _)| stamp_ns - ns > KEPT_NS) {
            self.samples.pop_front();
        }
        let last = self.samples.len() - 1;
        let judged = judge(self.samples.make_contiguous(), limits);
        let Some(cause) = judged.out[last] else {
            // Taken again after a motion that no hand makes.
            let jump =
                judged.jumps.last().filter(|(k, _)| self.is_told && self.samples[*k].0 > self.last_ns.unwrap_or(0));
            signs.extend(jump.map(|(k, jump)| ("marker_jump", jump_words(what, self.samples[*k].0, jump))));
            (self.last_ns, self.is_told) = (Some(stamp_ns), false);
            return Some((pose, None));
        };
        let reason = format!("{what} is left out: {}", cause.words());
        let is_start =
            cause.kind == Kind::Unconfirmed && self.last_ns.is_some_and(|ns| stamp_ns - ns <= UNKNOWN_AFTER_NS);
        // The begin of a motion is told only if no later sample confirms it.
        if !is_start && !std::mem::replace(&mut self.is_told, true) {
            signs.push((cause.kind.rule(), format!("{reason}, at {stamp_ns} ns")));
        }
        let is_bridged = self.last_ns.is_some_and(|ns| stamp_ns - ns <= UNKNOWN_AFTER_NS);
        (!is_bridged).then_some((pose, Some(reason)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::{Isometry3, Vector3};

    const MS: StampNs = 1_000_000;

    /// A position that is given, an empty's reason, or nothing.
    type Given = Option<Result<f64, String>>;

    /// What is given for positions at 20 Hz, and the rules that told something.
    fn given(x: impl Fn(usize) -> f64, n: usize) -> (Vec<Given>, Vec<&'static str>) {
        given_every(50 * MS, x, n)
    }

    fn given_every(period_ns: StampNs, x: impl Fn(usize) -> f64, n: usize) -> (Vec<Given>, Vec<&'static str>) {
        let (mut marker, mut signs) = (LiveMarker::default(), Vec::new());
        let one = |k: usize| {
            let noise = 0.02 * ((k * 7919 % 101) as f64 / 50.0 - 1.0);
            let pose = Pose::new(
                "world",
                "bone_marker",
                Isometry3::new(Vector3::new(300.0 + x(k) + noise, noise, 0.0), Vector3::z()),
            );
            let (pose, reason) = marker.take(
                "t",
                pose.at(1000 * MS + period_ns * k as StampNs),
                &MotionLimits::default(),
                &mut signs,
            )?;
            Some(reason.map_or_else(|| Ok(pose.isometry.translation.x - 300.0 - noise), Err))
        };
        let given = (0..n).map(one).collect();
        (given, signs.into_iter().map(|(rule, _)| rule).collect())
    }

    #[test]
    fn a_spike_is_not_given_and_a_burst_makes_the_marker_unknown_after_100_ms() {
        let (one, signs) = given(|k| if k == 60 { 20.0 } else { 0.0 }, 100);
        assert!(one[60].is_none() && one.iter().flatten().all(|x| x.as_ref().is_ok_and(|x| x.abs() < 1e-9)));
        assert_eq!(signs, Vec::<&str>::new(), "it may have been the begin of a motion");
        let (five, signs) = given(|k| if (60..65).contains(&k) { 20.0 } else { 0.0 }, 100);
        let unknown: Vec<usize> = (0..100).filter(|k| matches!(five[*k], Some(Err(_)))).collect();
        assert_eq!((unknown, signs), (vec![62, 63, 64], vec!["marker_unconfirmed"]));
        assert!((65..100).all(|k| five[k].as_ref().is_some_and(Result::is_ok)));
    }

    #[test]
    fn a_motion_of_300_mm_per_s_is_given_from_its_third_sample_on_and_a_jump_after_a_second() {
        let (moving, signs) = given(|k| 15.0 * k.saturating_sub(59) as f64, 100);
        let missing: Vec<usize> = (0..100).filter(|k| !matches!(moving[*k], Some(Ok(_)))).collect();
        assert!(missing.iter().all(|k| (60..63).contains(k)) && signs.is_empty(), "{missing:?}, {signs:?}");
        let (jump, signs) = given(|k| if k < 60 { 0.0 } else { 80.0 }, 120);
        let first = (60..120).find(|k| matches!(jump[*k], Some(Ok(_)))).expect("it is taken again");
        assert!((80..=82).contains(&first) && (first..120).all(|k| matches!(jump[k], Some(Ok(_)))), "{first}");
        assert_eq!(signs, ["marker_unconfirmed", "marker_jump"]);
    }

    #[test]
    fn a_stamp_ahead_of_its_time_is_no_neighbour_of_what_follows() {
        let (mut marker, mut signs) = (LiveMarker::default(), Vec::new());
        let mut is_given = |k: usize, x: f64| {
            let noise = 0.02 * ((k * 7919 % 101) as f64 / 50.0 - 1.0);
            let isometry = Isometry3::new(Vector3::new(300.0 + x + noise, noise, 0.0), Vector3::z());
            let stamp_ns = if k == 60 { 4_294_000_000_000 * MS } else { 1000 * MS + 50 * MS * k as StampNs };
            let pose = Pose::new("world", "bone_marker", isometry).at(stamp_ns);
            let taken = marker.take("t", pose, &MotionLimits::default(), &mut signs);
            taken.is_some_and(|(_, reason)| reason.is_none())
        };
        for k in 0..100 {
            let is_given = is_given(k, 0.0);
            assert!(is_given || k == 60, "{k}");
        }
        assert!(!is_given(100, 20.0) && is_given(101, 0.0), "a spike is found as before");
    }

    #[test]
    fn a_fast_tracker_is_judged_by_as_long_a_time_as_a_slow_one() {
        // 1000 Hz: a jump after 3 s.
        let (jump, signs) = given_every(MS, |k| if k < 3000 { 0.0 } else { 80.0 }, 5000);
        let first = (3000..5000).find(|k| matches!(jump[*k], Some(Ok(_)))).expect("it is taken again");
        assert!((3990..=4030).contains(&first), "after {} ms", first - 3000);
        assert_eq!(signs, ["marker_unconfirmed", "marker_jump"]);
        let (spike, signs) = given_every(MS, |k| if k == 3001 { 20.0 } else { 0.0 }, 3500);
        let missing: Vec<usize> = (0..3500).filter(|k| !matches!(spike[*k], Some(Ok(_)))).collect();
        assert_eq!((missing, signs), (vec![3001], vec![]));
    }
}
