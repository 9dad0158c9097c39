//! The clock of a sender beside the one of this machine.

use osteoflow_geometry::StampNs;
use std::{collections::VecDeque, fmt};

/// Messages after which the offset is known well enough to be reported.
const N_FIRST: usize = 20;
/// Messages over which the smallest delay is taken.
const N_WINDOW: usize = 100;
/// Change of the offset that is reported: longer than a network delays a hundred messages in a row.
const JUMP_NS: StampNs = 250_000_000;
/// Jumps within [`N_STEADY`] messages after which the clock is taken to run at another rate, as that of a recording played fast.
const N_JUMPS: usize = 3;
/// Messages after a jump forward by which a damaged stamp is told from a clock that was set.
const N_DOUBTED: usize = 3;
/// Messages within which jumps count together.
const N_STEADY: usize = 300;

/// Estimates how far this machine's clock is ahead of a sender's: the least difference of arrival and stamp over the last
/// messages, which contains the shortest delay of a message.
#[derive(Debug, Default)]
pub struct ClockOffset {
    window: VecDeque<StampNs>,
    reported_ns: Option<StampNs>,
    /// Stamp and arrival of the first message.
    first_ns: Option<(StampNs, StampNs)>,
    n: usize,
    /// Numbers of the last messages at which the offset jumped.
    jumps: VecDeque<usize>,
    /// Whether the clock runs at another rate, which has been reported.
    is_played: bool,
    /// The window and the offset before a jump forward, and the number of messages that may contradict it.
    before_jump: Option<(VecDeque<StampNs>, StampNs, usize)>,
}

/// What is worth reporting of a sender's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ClockNote {
    /// The offset, known for the first time.
    Offset(StampNs),
    /// The offset before and now.
    Jump(StampNs, StampNs),
    /// The offset changes all the time: the seconds of the sender in one of this machine's.
    Rate(f64),
}

impl ClockOffset {
    /// Takes a message into account.
    pub fn add(&mut self, stamp_ns: StampNs, arrived_ns: StampNs) -> Option<ClockNote> {
        let (delay_ns, mut damaged) = (arrived_ns.saturating_sub(stamp_ns), None);
        if let (Some((window, before, n)), Some(now)) = (self.before_jump.take(), self.reported_ns) {
            if delay_ns.saturating_sub(now) > JUMP_NS {
                (self.window, self.reported_ns, damaged) = (window, Some(before), Some(ClockNote::Jump(now, before)));
                self.jumps.pop_back();
            } else if n > 1 {
                self.before_jump = Some((window, before, n - 1));
            }
        }
        if self.window.len() == N_WINDOW {
            self.window.pop_front();
        }
        self.window.push_back(delay_ns);
        self.n += 1;
        if damaged.is_some() {
            return damaged;
        }
        let (first_stamp_ns, first_arrived_ns) = *self.first_ns.get_or_insert((stamp_ns, arrived_ns));
        let now = self.offset_ns()?;
        let Some(before) = self.reported_ns else {
            self.reported_ns = Some(now);
            return Some(ClockNote::Offset(now));
        };
        // A clock set back shows over the whole window, one set forward at once.
        if (now - before).abs() <= JUMP_NS || self.is_played {
            return None;
        }
        self.reported_ns = Some(now);
        if now < before && self.before_jump.is_none() {
            let window = self.window.iter().copied().filter(|delay| delay - before >= -JUMP_NS).collect();
            self.before_jump = Some((window, before, N_DOUBTED));
        }
        self.window.retain(|delay| delay - now <= JUMP_NS);
        self.jumps.push_back(self.n);
        self.jumps.retain(|n| self.n - n < N_STEADY);
        if self.jumps.len() < N_JUMPS {
            return Some(ClockNote::Jump(before, now));
        }
        self.is_played = true;
        let elapsed_ns = (arrived_ns - first_arrived_ns).max(1);
        Some(ClockNote::Rate((stamp_ns - first_stamp_ns) as f64 / elapsed_ns as f64))
    }

    /// Reports the offset that is known so far, if none was reported yet.
    pub fn settle(&mut self) -> Option<ClockNote> {
        let now = self.window.iter().min().copied().filter(|_| self.reported_ns.is_none())?;
        self.reported_ns = Some(now);
        Some(ClockNote::Offset(now))
    }

    /// The offset, ns; `None` before enough messages came.
    pub fn offset_ns(&self) -> Option<StampNs> {
        (self.reported_ns.is_some() || self.window.len() >= N_FIRST).then(|| self.window.iter().min().copied())?
    }
}

impl fmt::Display for ClockNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = |ns: StampNs| ns as f64 * 1e-9;
        match self {
            Self::Offset(ns) => write!(f, "its clock is {:.3} s behind this machine's, delay included", seconds(*ns)),
            Self::Rate(rate) => {
                write!(f, "its clock runs {rate:.2} times as fast as this machine's; is a recording played?")
            }
            Self::Jump(before, now) => write!(
                f,
                "its clock jumped by {:.3} s: it was {:.3} s behind this machine's and is {:.3} s",
                seconds(before - now),
                seconds(*before),
                seconds(*now)
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: StampNs = 1_000_000_000;

    /// The notes over messages at 20 Hz with a delay of up to 30 ms.
    fn notes(n: i64, stamp_of: impl Fn(i64) -> StampNs) -> Vec<ClockNote> {
        let mut clock = ClockOffset::default();
        let arrived = |i: i64| 1_750_000_000 * S + i * S / 20;
        (0..n).filter_map(|i| clock.add(stamp_of(arrived(i)), arrived(i) + (i * 7 % 30) * S / 1000)).collect()
    }

    #[test]
    fn an_offset_is_reported_once_and_without_the_jitter() {
        assert_eq!(notes(1000, |now| now - 3 * S), [ClockNote::Offset(3 * S)]);
    }

    #[test]
    fn a_clock_set_forward_or_back_is_reported_once() {
        let half = 1_750_000_000 * S + 25 * S;
        for by in [3600 * S, -S] {
            let sentences = notes(1000, |now| if now < half { now } else { now + by });
            assert_eq!(sentences[0], ClockNote::Offset(0));
            let is_near = |now: StampNs| (now + by).abs() < S / 30;
            assert!(matches!(sentences[1..], [ClockNote::Jump(0, now)] if is_near(now)), "{sentences:?}");
        }
    }

    #[test]
    fn a_damaged_stamp_shifts_no_message_after_it() {
        for n_bad in 1..3 {
            let mut clock = ClockOffset::default();
            for i in 0..100 {
                let stamp_ns =
                    if (50..50 + n_bad).contains(&i) { 4_294_000_000 * S } else { 1_750_000_000 * S + i * S / 20 };
                clock.add(stamp_ns, 1_750_000_000 * S + i * S / 20 + S);
                let is_bad = (50..50 + n_bad).contains(&i);
                assert!(i < 20 || (clock.offset_ns() == Some(S)) != is_bad, "{i}: {:?}", clock.offset_ns());
            }
        }
    }

    #[test]
    fn a_recording_played_fast_is_reported_once_and_not_as_jumps_without_end() {
        let start = 1_750_000_000 * S;
        let sentences = notes(10_000, |now| start + (now - start) * 10);
        assert!(
            matches!(sentences[..], [ClockNote::Offset(_), ClockNote::Jump(..), ClockNote::Jump(..), ClockNote::Rate(rate)]
            if (rate - 10.0).abs() < 0.5),
            "{sentences:?}"
        );
    }

    #[test]
    fn a_stall_of_two_seconds_is_no_jump() {
        let mut clock = ClockOffset::default();
        let mut notes = Vec::new();
        for i in 0..400 {
            let stamp = i * S / 20;
            // Forty messages arrive together.
            let arrived = if (200..240).contains(&i) { 240 * S / 20 } else { stamp };
            notes.extend(clock.add(stamp, arrived));
        }
        assert_eq!(notes, [ClockNote::Offset(0)]);
    }
}
