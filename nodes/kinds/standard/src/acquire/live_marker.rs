//! A marker whose poses arrive one by one.

use super::sifted::{Sign, jump_words};
use osteoflow_algorithms::marker_stream::{Kind, MotionLimits, Sample, judge};
use osteoflow_geometry::{Pose, StampNs};
use osteoflow_node::Emission;
use std::collections::VecDeque;

/// Samples by which the next is judged: of this time, and at most so many.
const KEPT_NS: StampNs = 2_500_000_000;
const N_KEPT: usize = 200;

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
    /// What to give for the next pose of the marker called `what`: nothing if it is left out, and an empty if it has been for too long.
    pub(crate) fn take(
        &mut self,
        what: &str,
        pose: Pose,
        limits: &MotionLimits,
        signs: &mut Vec<Sign>,
    ) -> Option<Emission> {
        let stamp_ns = pose.stamp_ns;
        if stamp_ns == 0 || !limits.are_set() {
            return Some(Emission::value(pose));
        }
        self.samples.push_back((stamp_ns, pose.isometry));
        while self.samples.len() > N_KEPT || self.samples.front().is_some_and(|(ns, _)| stamp_ns - ns > KEPT_NS) {
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
            return Some(Emission::value(pose));
        };
        let reason = format!("{what} is left out: {}", cause.words());
        let is_start =
            cause.kind == Kind::Unconfirmed && self.last_ns.is_some_and(|ns| stamp_ns - ns <= UNKNOWN_AFTER_NS);
        // The begin of a motion is told only if no later sample confirms it.
        if !is_start && !std::mem::replace(&mut self.is_told, true) {
            signs.push((cause.kind.rule(), format!("{reason}, at {stamp_ns} ns")));
        }
        let is_bridged = self.last_ns.is_some_and(|ns| stamp_ns - ns <= UNKNOWN_AFTER_NS);
        (!is_bridged).then_some(Emission::Empty(reason))
    }
}
