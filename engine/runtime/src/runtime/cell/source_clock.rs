//! The clock that the stamps of a live source follow: the newest stamp promises that nothing older comes, so one damaged stamp
//! far ahead of its time would make all later items late. It is held back until the next items say whether the clock is there.

use osteoflow_node::StampNs;
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// Time by which a stamp may be ahead of the newest one and the time since. 10 s: longer than a network or a buffer delays an item.
const MARGIN_NS: StampNs = 10_000_000_000;
/// Time by which the first stamp may be ahead of this machine's clock. A day: a wrong time zone is no fault, and recordings and clocks
/// that count from their start are in the past.
const FIRST_MARGIN_NS: StampNs = 86_400_000_000_000;
/// Items in a row that agree with each other, and not with those before, by which a source's clock has been set.
const N_AGREEING: usize = 3;
/// Maximum number of items held back; the first of more are refused.
const N_HELD: usize = 16;
/// Largest distance of a stamp from 1970; what lies farther is no time, and leaves no room for tolerances.
pub(super) const MAX_STAMP_NS: u64 = 1 << 62;

/// What an item of a live source is, by its stamp.
#[derive(Debug, PartialEq)]
pub(super) enum Judged<T> {
    /// Its time has come; whether it is late is another question.
    Fits(T),
    /// Ahead of its time, by itself: to be replaced by empties with this stamp.
    Refused(T, StampNs, String),
    /// What the user should know: the clock was set.
    Note(String),
}

/// The stamps of a live source so far, and the items held back.
pub(super) struct SourceClock<T> {
    /// The newest stamp that fits, and when it came.
    newest: Option<(StampNs, Instant)>,
    /// Items ahead of their time, with those without a time among them.
    held: VecDeque<(StampNs, T)>,
    /// Number of items in a row that are far behind the newest.
    n_behind: usize,
    has_jumped: bool,
}

impl<T> Default for SourceClock<T> {
    fn default() -> Self {
        Self { newest: None, held: VecDeque::new(), n_behind: 0, has_jumped: false }
    }
}

impl<T> SourceClock<T> {
    /// The stamp of the last item that is held back, which is the source's present as it sees it.
    pub(super) fn held_ns(&self) -> Option<StampNs> {
        self.held.back().map(|(stamp_ns, _)| *stamp_ns)
    }

    /// What can be said of the next item, which came at `now` by this machine's clocks, and of those held back, in order.
    pub(super) fn take(&mut self, stamp_ns: StampNs, item: T, now: (Instant, StampNs)) -> Vec<Judged<T>> {
        // A constant has the stamp 0, and no time.
        let is_constant = stamp_ns == 0;
        if !is_constant && !self.is_ahead(stamp_ns, now) || is_constant && self.held.is_empty() {
            let mut out = self.refuse(self.held.len(), stamp_ns);
            out.extend(self.behind(stamp_ns));
            if !is_constant && self.newest.is_none_or(|(ns, _)| stamp_ns >= ns) {
                self.newest = Some((stamp_ns, now.0));
            }
            out.push(Judged::Fits(item));
            return out;
        }
        self.held.push_back((stamp_ns, item));
        let stamps: Vec<StampNs> = self.held.iter().map(|(ns, _)| *ns).filter(|ns| *ns != 0).collect();
        let last = &stamps[stamps.len().saturating_sub(N_AGREEING)..];
        let agrees = last.windows(2).all(|pair| pair[1] >= pair[0].saturating_sub(MARGIN_NS));
        if !is_constant && last.len() == N_AGREEING && agrees {
            return self.set(last[0], stamp_ns, now.0);
        }
        self.refuse(self.held.len().saturating_sub(N_HELD), stamp_ns)
    }

    /// The source has ended: what is held back is given, unless it is of the future.
    pub(super) fn end(&mut self, today_ns: StampNs) -> Vec<Judged<T>> {
        let last_ns = self.newest.map_or(today_ns, |(ns, _)| ns);
        let held = self.held.drain(..);
        held.map(|(ns, item)| judged(ns, item, today_ns.saturating_add(FIRST_MARGIN_NS), last_ns)).collect()
    }

    fn is_ahead(&self, stamp_ns: StampNs, (now, today_ns): (Instant, StampNs)) -> bool {
        let most_ns = self.newest.map_or(today_ns.saturating_add(FIRST_MARGIN_NS), |(ns, at)| {
            let since_ns = nanoseconds(now.saturating_duration_since(at));
            ns.saturating_add(since_ns).saturating_add(MARGIN_NS)
        });
        stamp_ns > most_ns || stamp_ns.unsigned_abs() > MAX_STAMP_NS
    }

    /// Refuses the first items that are held back; `next_ns` is the stamp of the one that contradicts them.
    fn refuse(&mut self, n: usize, next_ns: StampNs) -> Vec<Judged<T>> {
        let at_ns = self.newest.map_or(next_ns, |(ns, _)| ns);
        self.held.drain(..n).map(|(ns, item)| judged(ns, item, at_ns, at_ns)).collect()
    }

    /// The clock is where the last items say, of which the first has the stamp `from_ns`.
    fn set(&mut self, from_ns: StampNs, to_ns: StampNs, at: Instant) -> Vec<Judged<T>> {
        let before_ns = self.newest.replace((to_ns, at)).map(|(ns, _)| ns);
        let by = before_ns.map_or_else(
            || "are of the future by this machine's clock".to_owned(),
            |ns| format!("are {} ahead of those before", span(from_ns.saturating_sub(ns))),
        );
        let note = format!(
            "its stamps {by}, from {from_ns} ns on, and {N_AGREEING} items in a row agree: they are taken. Its clock was \
             set, or a recording is played fast; further jumps are not reported"
        );
        let note = (!std::mem::replace(&mut self.has_jumped, true)).then_some(Judged::Note(note));
        let (most_ns, before_ns) = (to_ns.saturating_add(MARGIN_NS), before_ns.unwrap_or(from_ns));
        let held = self.held.drain(..).map(|(ns, item)| judged(ns, item, most_ns, before_ns));
        note.into_iter().chain(held).collect()
    }

    /// Whether the clock was set back, told once: what comes is late until it has caught up.
    fn behind(&mut self, stamp_ns: StampNs) -> Option<Judged<T>> {
        let by_ns = self.newest.filter(|_| stamp_ns != 0)?.0.saturating_sub(stamp_ns);
        self.n_behind = if by_ns > MARGIN_NS { self.n_behind + 1 } else { 0 };
        (self.n_behind == N_AGREEING).then(|| {
            Judged::Note(format!(
                "{N_AGREEING} items in a row are stamped {} before the newest: was its clock set back? Its items are late, and \
                 empties, until it has caught up; start the run anew, or have the stamps corrected where the source can \
                 (clock = \"receiver\" of acquire.openigtlink)",
                span(by_ns)
            ))
        })
    }
}

/// An item that was held back, refused if its stamp is beyond `most_ns` or is no time.
fn judged<T>(stamp_ns: StampNs, item: T, most_ns: StampNs, at_ns: StampNs) -> Judged<T> {
    if stamp_ns <= most_ns && stamp_ns.unsigned_abs() <= MAX_STAMP_NS {
        return Judged::Fits(item);
    }
    let off = match stamp_ns.saturating_sub(at_ns) {
        ahead_ns if ahead_ns > 0 => format!("{} ahead of {at_ns} ns", span(ahead_ns)),
        _ => "more than 146 years from 1970".into(),
    };
    let reason = format!(
        "its stamp {stamp_ns} ns is {off}, and no other item agrees; it is refused, since all later ones would be late"
    );
    Judged::Refused(item, at_ns, reason)
}

pub(super) fn nanoseconds(time: Duration) -> StampNs {
    StampNs::try_from(time.as_nanos()).unwrap_or(StampNs::MAX)
}

/// A span of time in words.
fn span(ns: StampNs) -> String {
    let seconds = ns as f64 * 1e-9;
    match seconds.abs() {
        s if s < 3600.0 => format!("{seconds:.1} s"),
        s if s < 86_400.0 => format!("{:.1} h", seconds / 3600.0),
        _ => format!("{:.1} days", seconds / 86_400.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: StampNs = 1_000_000_000;
    const TODAY_NS: StampNs = 1_790_000_000 * S;
    /// What a flipped bit makes of it: the year 2106.
    const BAD_NS: StampNs = 4_294_000_000 * S;

    /// What becomes of the items with these stamps, sent `every` after each other: a stamp that is given, 0 for one that is
    /// refused; and the notes.
    fn given(stamps_s: &[f64], every: Duration) -> (Vec<f64>, Vec<String>) {
        let (mut clock, began) = (SourceClock::default(), Instant::now());
        let mut judged = Vec::new();
        for (k, stamp_s) in stamps_s.iter().enumerate() {
            let now = (began + every * k as u32, TODAY_NS);
            judged.extend(clock.take((stamp_s * S as f64) as StampNs, *stamp_s, now));
        }
        judged.extend(clock.end(TODAY_NS));
        let (mut items, mut notes) = (Vec::new(), Vec::new());
        for judged in judged {
            match judged {
                Judged::Fits(stamp_s) => items.push(stamp_s),
                Judged::Refused(..) => items.push(0.0),
                Judged::Note(note) => notes.push(note),
            }
        }
        (items, notes)
    }

    /// Samples of a tracker that counts from its start, with `bad` in the places `at`.
    fn tracker(at: &[usize], bad: f64) -> Vec<f64> {
        (0..12).map(|k| if at.contains(&k) { bad + k as f64 } else { 100.0 + k as f64 / 20.0 }).collect()
    }

    #[test]
    fn damaged_stamps_are_refused_by_themselves_wherever_they_are() {
        let every = Duration::from_millis(50);
        for bad in [BAD_NS as f64 / 1e9, 9e9, -9e9] {
            for at in [&[0][..], &[6], &[11], &[5, 6], &[0, 1], &[3, 7]] {
                let mut expected = tracker(at, bad);
                at.iter().for_each(|k| expected[*k] = 0.0);
                assert_eq!(given(&tracker(at, bad), every), (expected, vec![]), "{bad} at {at:?}");
            }
        }
        // In the past, yet minutes ahead of a clock that counts from its start.
        let (items, notes) = given(&tracker(&[6], 700.0), every);
        assert_eq!((items[6], items.iter().filter(|s| **s == 0.0).count(), notes.len()), (0.0, 1, 0));
    }

    #[test]
    fn a_clock_that_was_set_is_taken_after_three_items_that_agree_and_is_told_once() {
        let set: Vec<f64> = (0..9).map(|k| if k < 4 { 1.0 + f64::from(k) } else { 3e9 + f64::from(k) }).collect();
        let (items, notes) = given(&set, Duration::from_secs(1));
        assert_eq!((items, notes.len()), (set, 1));
        assert!(
            notes[0].contains("34722.2 days ahead of those before") && notes[0].contains("3 items in a row"),
            "{notes:?}"
        );
        let back: Vec<f64> = (0..9).map(|k| if k < 4 { 5000.0 + f64::from(k) } else { f64::from(k) }).collect();
        let (items, notes) = given(&back, Duration::from_secs(1));
        assert_eq!((items, notes.len()), (back, 1), "the wires say that they are late");
        assert!(notes[0].starts_with("3 items in a row are stamped 1.4 h before the newest: was its clock set back?"));
    }

    #[test]
    fn pauses_and_recordings_with_gaps_lose_nothing_however_fast_they_are_played() {
        let of_2019 = |k: u32| 1_550_000_000.0 + 120.0 * f64::from(k);
        let gaps: Vec<f64> = (0..8).map(of_2019).collect();
        for every in [Duration::ZERO, Duration::from_secs(120)] {
            let (items, notes) = given(&gaps, every);
            assert_eq!((items, notes.len()), (gaps.clone(), usize::from(every.is_zero())));
        }
        // Constants have no time, before and among the others.
        let constants = [0.0, 0.0, 1_550_000_000.0, 0.0, 1_550_000_001.0];
        assert_eq!(given(&constants, Duration::ZERO), (constants.to_vec(), vec![]));
        let old_first = [1_540_000_000.0, of_2019(0), 0.0, of_2019(0) + 0.1, of_2019(0) + 0.2];
        assert_eq!(given(&old_first, Duration::ZERO).0, old_first);
    }

    #[test]
    fn items_that_agree_with_nothing_do_not_fill_the_memory() {
        let falling: Vec<f64> = (0..40).map(|k| 4e9 - 100.0 * f64::from(k)).collect();
        let mut clock = SourceClock::default();
        let now = (Instant::now(), TODAY_NS);
        let n_refused: usize = falling.iter().map(|s| clock.take((*s * 1e9) as StampNs, (), now).len()).sum();
        assert_eq!((n_refused, clock.held.len()), (24, N_HELD));
    }
}
