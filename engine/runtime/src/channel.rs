//! A link: a bounded queue from one output to one input, with its policy, progress and counters.
//!
//! The producing node holds the [`SendEnd`], the consuming node the [`RecvEnd`]; both share the [`LinkState`].

use crate::plan::Policy;
use crossbeam_channel::{Receiver, Sender, TryRecvError, bounded, unbounded};
use osteoflow_node::{Body, Empty, Item, StampNs};
use std::{
    collections::{BTreeSet, VecDeque},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering, fence},
    },
};

/// State shared by both ends of a link.
pub(crate) struct LinkState {
    /// No further item has an earlier stamp. Set after the items that precede it, read before the queue.
    progress: AtomicI64,
    /// The producer is blocked: it waits for room.
    blocked: AtomicBool,
    /// Bytes of all items that the consumer has taken; written only by the consumer.
    received_bytes: AtomicU64,
    /// Number of items that the producer has numbered; set when the queue is closed.
    total: AtomicU64,
    /// Numbers and stamps of dropped items that the consumer has not reached yet, in order.
    gaps: Mutex<VecDeque<(u64, StampNs)>>,
}

/// Capacity of a link, and its policy when full.
#[derive(Debug, Clone)]
pub(crate) struct Limits {
    /// Maximum number of waiting items.
    pub capacity: usize,
    /// Maximum number of waiting bytes.
    pub max_bytes: u64,
    /// What happens to an item sent while the link is full.
    pub policy: Policy,
    /// In a replay: numbers of the items to drop, instead of applying the policy.
    pub recorded_drops: Option<BTreeSet<u64>>,
}

/// Sending end.
pub(crate) struct SendEnd {
    /// The link's index in the plan.
    pub link: usize,
    tx: Sender<Item>,
    /// The receiving end too, where the oldest waiting item is dropped to make room.
    oldest: Option<Receiver<Item>>,
    pub limits: Limits,
    /// Number of items numbered so far, including dropped ones.
    pub sent: u64,
    pub dropped: u64,
    pub highest_fill: usize,
    /// Lower bound on the free room: the consumer only makes more.
    room: usize,
    /// Bytes of all items put into the queue and not taken back.
    sent_bytes: u64,
    /// The last item was dropped.
    in_gap: bool,
}

/// Receiving end.
pub(crate) struct RecvEnd {
    /// The link's index in the plan.
    pub link: usize,
    rx: Receiver<Item>,
    /// Number of the next item; where a later one arrives, those between were dropped.
    next_number: u64,
    /// An item held back until empties have replaced the items dropped before it.
    held: Option<Item>,
    last_stamp: StampNs,
    /// Reason of the empties that replace dropped items.
    dropped: Arc<Empty>,
    pub received: u64,
    received_bytes: u64,
    pub ended: bool,
}

/// Result of [`RecvEnd::receive`].
pub(crate) enum Received {
    /// An item; [`RecvEnd::unblocks`] says whether the producer was blocked.
    Item(Item),
    /// No item yet, and none to come before this stamp.
    Nothing(StampNs),
    /// End of the link.
    Ended,
}

/// A send met a full queue under the policy `fail`.
pub(crate) struct Full;

/// Creates both ends of a link. `wire` and `producer` go into the empties that replace dropped items.
pub(crate) fn link(index: usize, limits: Limits, producer: &str, wire: &str) -> (LinkState, SendEnd, RecvEnd) {
    let limits = Limits { capacity: limits.capacity.max(1), ..limits };
    let (tx, rx) = queue(limits.capacity);
    let drops_oldest = limits.policy == Policy::DropOld && limits.recorded_drops.is_none();
    let oldest = drops_oldest.then(|| rx.clone());
    let state = LinkState {
        progress: AtomicI64::new(StampNs::MIN),
        blocked: AtomicBool::new(false),
        received_bytes: AtomicU64::new(0),
        total: AtomicU64::new(0),
        gaps: Mutex::default(),
    };
    let dropped = Empty { node: producer.into(), reason: format!("dropped on {wire} by its policy {}", limits.policy) };
    let send = SendEnd {
        link: index,
        tx,
        oldest,
        limits,
        sent: 0,
        dropped: 0,
        highest_fill: 0,
        room: 0,
        sent_bytes: 0,
        in_gap: false,
    };
    let recv = RecvEnd {
        link: index,
        rx,
        next_number: 0,
        held: None,
        last_stamp: StampNs::MIN,
        dropped: Arc::new(dropped),
        received: 0,
        received_bytes: 0,
        ended: false,
    };
    (state, send, recv)
}

/// A queue of `capacity` items. A short one is allocated at once; a long one grows as it fills and is bounded by
/// [`SendEnd::is_full`].
#[allow(clippy::disallowed_methods, reason = "who sends asks `is_full` first, which bounds it")]
fn queue(capacity: usize) -> (Sender<Item>, Receiver<Item>) {
    const SHORT: usize = 256;
    if capacity <= SHORT { bounded(capacity) } else { unbounded() }
}

/// Size of an item on a wire that is bounded in bytes; never zero, so that every queue is bounded.
fn n_bytes(item: &Item) -> u64 {
    let body = match &item.body {
        Body::Value(value) => value.n_bytes(),
        Body::Empty(empty) => size_of::<Empty>() + empty.reason.len(),
    };
    (size_of::<Item>() + body) as u64
}

impl LinkState {
    fn gaps(&self) -> MutexGuard<'_, VecDeque<(u64, StampNs)>> {
        self.gaps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the producer is blocked on this link.
    pub(crate) fn is_blocked(&self) -> bool {
        self.blocked.load(Ordering::Relaxed)
    }
}

impl SendEnd {
    /// Number of waiting items.
    pub(crate) fn fill(&self) -> usize {
        self.tx.len()
    }

    /// Number of waiting bytes.
    pub(crate) fn bytes(&self, state: &LinkState) -> u64 {
        // Items that the consumer has taken and not yet counted are included.
        self.sent_bytes.saturating_sub(state.received_bytes.load(Ordering::Relaxed))
    }

    /// Whether it holds its maximum number of items or bytes.
    pub(crate) fn is_full(&self, state: &LinkState) -> bool {
        self.fill() >= self.limits.capacity || self.bytes(state) >= self.limits.max_bytes
    }

    /// Whether a replay keeps the item with this number, however full the queue is.
    fn keeps(&self, number: u64) -> bool {
        match (&self.limits.recorded_drops, self.limits.policy) {
            (Some(drops), _) => !drops.contains(&number),
            (None, Policy::Sample(n)) => number.is_multiple_of(n.max(1).into()),
            (None, _) => true,
        }
    }

    /// Whether the producer blocks while the link is full.
    fn waits(&self) -> bool {
        self.limits.recorded_drops.is_some() || matches!(self.limits.policy, Policy::Block | Policy::Sample(_))
    }

    /// Whether the next item can be sent now. If not, the consumer wakes the producer when there is room.
    pub(crate) fn has_room(&mut self, state: &LinkState) -> bool {
        if self.room > 0 && self.bytes(state) < self.limits.max_bytes {
            return true;
        }
        if !self.waits() || !self.count_room(state) || !self.keeps(self.sent) {
            return true;
        }
        state.blocked.store(true, Ordering::Relaxed);
        // Either the consumer, after taking an item, sees the flag, or this second check sees the room.
        fence(Ordering::SeqCst);
        !self.count_room(state)
    }

    /// Recounts the room; returns whether the link is full.
    fn count_room(&mut self, state: &LinkState) -> bool {
        self.room = self.limits.capacity.saturating_sub(self.fill());
        self.room == 0 || self.bytes(state) >= self.limits.max_bytes
    }

    /// Sends the next item, or drops one by the link's policy; calls `dropped` with the number of each dropped item.
    ///
    /// # Errors
    /// [`Full`] where the policy is to fail; the item is dropped.
    pub(crate) fn send(&mut self, item: Item, state: &LinkState, dropped: &mut dyn FnMut(u64)) -> Result<(), Full> {
        let number = self.sent;
        self.sent += 1;
        let stamp_ns = item.stamp_ns;
        self.in_gap = false;
        if !self.keeps(number) {
            self.drop_it(number, stamp_ns, &mut state.gaps(), dropped);
            self.in_gap = true;
            // Where the link failed because it was full, it did so at this item.
            return if self.limits.policy == Policy::Fail { Err(Full) } else { Ok(()) };
        }
        while self.oldest.is_some() && self.is_full(state) {
            // A consumer that sees the next item also sees the gap before it.
            let mut gaps = state.gaps();
            let Some(oldest) = self.oldest.as_ref().and_then(|oldest| oldest.try_recv().ok()) else { break };
            self.sent_bytes -= n_bytes(&oldest);
            self.drop_it(oldest.number, oldest.stamp_ns, &mut gaps, dropped);
        }
        let refuses = !self.waits() && self.oldest.is_none();
        let bytes = n_bytes(&item);
        if !(refuses && self.is_full(state)) && self.tx.try_send(item).is_ok() {
            self.sent_bytes += bytes;
            self.room = self.room.saturating_sub(1);
            if self.limits.capacity - self.room > self.highest_fill {
                self.highest_fill = self.highest_fill.max(self.fill());
            }
            return Ok(());
        }
        self.drop_it(number, stamp_ns, &mut state.gaps(), dropped);
        self.in_gap = true;
        // A link that blocks is sent to only after `has_room`; a violation must not pass silently.
        if self.limits.policy == Policy::DropNew && refuses { Ok(()) } else { Err(Full) }
    }

    fn drop_it(
        &mut self,
        number: u64,
        stamp_ns: StampNs,
        gaps: &mut VecDeque<(u64, StampNs)>,
        dropped: &mut dyn FnMut(u64),
    ) {
        self.dropped += 1;
        gaps.push_back((number, stamp_ns));
        dropped(number);
    }

    /// Promises that no further item has a stamp before `stamp_ns`; call after sending the items that precede it.
    ///
    /// After a dropped item the promise is delayed until the next item: only then does the consumer see the empty that
    /// replaces the dropped item, which the promise must not overtake.
    pub(crate) fn promise(&self, state: &LinkState, stamp_ns: StampNs) -> bool {
        if !self.in_gap {
            state.progress.store(stamp_ns, Ordering::Release);
        }
        !self.in_gap
    }

    /// Closes the link: the consumer sees the end after the last item.
    pub(crate) fn close(&mut self, state: &LinkState) {
        state.total.store(self.sent, Ordering::Release);
        // The queue closes when its last sender is dropped; the replacement has no receiver.
        let (tx, _) = bounded(1);
        (self.tx, self.oldest) = (tx, None);
    }
}

impl RecvEnd {
    /// Next item, in the order of numbers.
    pub(crate) fn receive(&mut self, state: &LinkState) -> Received {
        if let Some(item) = self.held.take() {
            return self.in_order(item, state);
        }
        // Read before the queue, so that every item that precedes this progress is seen in the queue.
        let progress = state.progress.load(Ordering::Acquire);
        match self.rx.try_recv() {
            Ok(item) => {
                self.received += 1;
                self.received_bytes += n_bytes(&item);
                state.received_bytes.store(self.received_bytes, Ordering::Relaxed);
                self.in_order(item, state)
            }
            Err(TryRecvError::Empty) => Received::Nothing(progress),
            Err(TryRecvError::Disconnected) if self.next_number < state.total.load(Ordering::Acquire) => {
                Received::Item(self.replacement(state))
            }
            Err(TryRecvError::Disconnected) => {
                self.ended = true;
                Received::Ended
            }
        }
    }

    fn in_order(&mut self, item: Item, state: &LinkState) -> Received {
        if item.number > self.next_number {
            self.held = Some(item);
            return Received::Item(self.replacement(state));
        }
        self.next_number = item.number + 1;
        self.last_stamp = item.stamp_ns;
        Received::Item(item)
    }

    /// Whether the producer is blocked and must be woken now; call after taking items and after a fence.
    pub(crate) fn unblocks(&self, state: &LinkState) -> bool {
        state.blocked.load(Ordering::Relaxed) && state.blocked.swap(false, Ordering::Relaxed)
    }

    /// The empty that replaces the next item, which was dropped; has its number and stamp.
    fn replacement(&mut self, state: &LinkState) -> Item {
        let number = self.next_number;
        self.next_number += 1;
        let gap = state.gaps().pop_front();
        debug_assert_eq!(gap.map(|(dropped, _)| dropped), Some(number), "every drop leaves its place");
        let stamp_ns = gap.map_or(self.last_stamp, |(_, stamp_ns)| stamp_ns);
        self.last_stamp = stamp_ns;
        Item { number, stamp_ns, body: Body::Empty(self.dropped.clone()) }
    }
}

/// Replaces the queue by a longer one. Holding both ends ensures that nobody sends or receives meanwhile.
pub(crate) fn enlarge(send: &mut SendEnd, recv: &mut RecvEnd, capacity: usize) {
    let (tx, rx) = queue(capacity);
    for item in recv.rx.try_iter() {
        // The new queue is longer, so every item fits.
        let _ = tx.try_send(item);
    }
    if send.oldest.is_some() {
        send.oldest = Some(rx.clone());
    }
    (send.tx, recv.rx, send.limits.capacity, send.room) = (tx, rx, capacity, 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    const EACH: u64 = size_of::<Item>() as u64 + size_of::<Empty>() as u64 + 4;

    fn item(number: u64) -> Item {
        let empty = Empty { node: "test".into(), reason: "none".into() };
        Item { number, stamp_ns: number as i64, body: Body::Empty(Arc::new(empty)) }
    }

    fn limits(policy: Policy, capacity: usize) -> Limits {
        Limits { capacity, max_bytes: u64::MAX, policy, recorded_drops: None }
    }

    /// Sends `n` items at once and returns what is received, as (number, stamp, reason), then the dropped numbers.
    fn send_all(limits: Limits, n: u64) -> (Vec<(u64, i64, String)>, Vec<u64>) {
        let (state, mut send, mut recv) = link(0, limits, "a", "a.x");
        let mut dropped = Vec::new();
        for number in 0..n {
            if send.has_room(&state) {
                let _ = send.send(item(number), &state, &mut |number| dropped.push(number));
            }
        }
        send.close(&state);
        let mut out = Vec::new();
        while let Received::Item(item) = recv.receive(&state) {
            let Body::Empty(empty) = item.body else { panic!("only empties were sent") };
            out.push((item.number, item.stamp_ns, empty.reason.clone()));
        }
        assert_eq!(send.sent, recv.received + send.dropped, "sent = received + dropped");
        assert_eq!(send.bytes(&state), 0, "nothing waits any more");
        assert_eq!(dropped.len() as u64, send.dropped);
        (out, dropped)
    }

    /// Checks which of six items pass a link of capacity two, by its policy and in a replay of its drops.
    fn check(policy: Policy, kept: &[u64]) {
        let (out, mut dropped) = send_all(limits(policy, 2), 6);
        assert_eq!(out.iter().map(|o| o.0).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5], "{policy:?} keeps every place");
        let came: Vec<_> = out.iter().filter(|o| o.2 == "none").map(|o| o.0).collect();
        assert_eq!(came, kept, "{policy:?}");
        dropped.sort_unstable();
        let lost: Vec<_> = (0..6).filter(|n| !kept.contains(n)).collect();
        assert_eq!(dropped, lost, "{policy:?} tells what it drops");
        // In a replay, room does not matter.
        let replayed = Limits { recorded_drops: Some(dropped.into_iter().collect()), ..limits(policy, 9) };
        assert_eq!(send_all(replayed, 6), (out, lost), "{policy:?}, replayed");
    }

    #[test]
    fn a_dropped_item_is_replaced_by_an_empty_and_a_replay_drops_the_same() {
        check(Policy::DropOld, &[4, 5]);
        check(Policy::DropNew, &[0, 1]);
        check(Policy::Sample(3), &[0, 3]);
        check(Policy::Fail, &[0, 1]);
        let (out, _) = send_all(limits(Policy::DropNew, 2), 6);
        assert_eq!(out[5].2, "dropped on a.x by its policy drop_new");
    }

    #[test]
    fn the_empty_of_a_dropped_item_has_its_number_and_stamp() {
        let stamps = |policy| send_all(limits(policy, 9), 6).0.iter().map(|o| o.1).collect::<Vec<_>>();
        assert_eq!(stamps(Policy::Sample(3)), [0, 1, 2, 3, 4, 5]);
        assert_eq!(stamps(Policy::Block), [0, 1, 2, 3, 4, 5]);
    }

    #[test]
    fn a_promise_waits_for_the_item_after_a_dropped_one() {
        let (state, mut send, mut recv) = link(0, limits(Policy::Sample(2), 9), "a", "a.x");
        let give = |send: &mut SendEnd, n| assert!(send.send(item(n), &state, &mut |_| ()).is_ok());
        give(&mut send, 0);
        assert!(send.promise(&state, 0));
        give(&mut send, 1);
        assert!(!send.promise(&state, 7), "the place of item 1 is not yet taken");
        let Received::Item(_) = recv.receive(&state) else { panic!("item 0 waits") };
        assert!(matches!(recv.receive(&state), Received::Nothing(0)));
        give(&mut send, 9);
        assert!(send.promise(&state, 9));
        let Received::Item(item) = recv.receive(&state) else { panic!("item 1 is an empty now") };
        assert_eq!((item.number, item.stamp_ns), (1, 1));
    }

    #[test]
    fn a_full_link_blocks_or_fails_by_its_policy() {
        let send_to = |send: &mut SendEnd, state: &LinkState, n| send.send(item(n), state, &mut |_| ()).is_ok();
        let (state, mut send, _recv) = link(0, limits(Policy::Block, 1), "a", "a.x");
        assert!(send.has_room(&state) && send_to(&mut send, &state, 0) && !send.has_room(&state));
        assert!(state.is_blocked());
        let (state, mut send, _recv) = link(0, limits(Policy::Fail, 1), "a", "a.x");
        assert!(send_to(&mut send, &state, 0) && send.has_room(&state) && !send_to(&mut send, &state, 1));
    }

    #[test]
    fn links_are_bounded_in_bytes_and_one_large_item_passes() {
        for (max_bytes, room_for) in [(1, 1), (EACH, 1), (EACH + 1, 2), (5 * EACH, 5)] {
            let limits = Limits { max_bytes, ..limits(Policy::Block, 100) };
            let (state, mut send, mut recv) = link(0, limits, "a", "a.x");
            let mut n_sent = 0;
            while send.has_room(&state) {
                assert!(send.send(item(n_sent), &state, &mut |_| ()).is_ok());
                n_sent += 1;
            }
            assert_eq!((n_sent, send.bytes(&state)), (room_for, room_for * EACH), "{max_bytes} bytes");
            let Received::Item(_) = recv.receive(&state) else { panic!("an item waits") };
            assert!(recv.unblocks(&state) && send.has_room(&state), "{max_bytes} bytes: what is taken makes room");
        }
        let limits = Limits { max_bytes: 2 * EACH, ..limits(Policy::DropOld, 100) };
        let (_, dropped) = send_all(limits, 6);
        assert_eq!(dropped, [0, 1, 2, 3]);
    }

    #[test]
    fn an_enlarged_link_keeps_its_items_in_order() {
        let (state, mut send, mut recv) = link(0, limits(Policy::Block, 2), "a", "a.x");
        let give = |send: &mut SendEnd, n| assert!(send.send(item(n), &state, &mut |_| ()).is_ok());
        (0..2).for_each(|n| give(&mut send, n));
        enlarge(&mut send, &mut recv, 4);
        (2..4).for_each(|n| give(&mut send, n));
        assert!(!send.has_room(&state));
        for expected in 0..4 {
            let Received::Item(item) = recv.receive(&state) else { panic!("four items wait") };
            assert_eq!((item.number, recv.unblocks(&state)), (expected, expected == 0));
        }
    }
}
