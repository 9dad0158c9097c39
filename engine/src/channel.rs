//! A link: a bounded queue from one output to one input, with its policy, its progress and its count.
//!
//! The producing node holds the [`SendEnd`], the consuming node the [`RecvEnd`]; what both look at is the [`LinkState`].

use crate::plan::Policy;
use crossbeam_channel::{Receiver, Sender, TryRecvError, TrySendError, bounded};
use osteoflow_node::{Body, Empty, Item, StampNs};
use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering, fence},
};

/// What both ends of a link look at.
pub(crate) struct LinkState {
    /// Nothing more comes before this stamp. Set after the items that precede it, read before the queue is.
    progress: AtomicI64,
    /// The producer waits for room.
    blocked: AtomicBool,
    /// How many items the producer has numbered; known when the queue is closed.
    total: AtomicU64,
}

/// The producer's end.
pub(crate) struct SendEnd {
    /// The link's index in the plan.
    pub(crate) link: usize,
    tx: Sender<Item>,
    /// The consumer's end too, where the oldest waiting item is to make room.
    oldest: Option<Receiver<Item>>,
    policy: Policy,
    pub(crate) capacity: usize,
    /// Items numbered so far, those dropped included.
    pub(crate) sent: u64,
    pub(crate) dropped: u64,
    pub(crate) highest_fill: usize,
}

/// The consumer's end.
pub(crate) struct RecvEnd {
    /// The link's index in the plan.
    pub(crate) link: usize,
    rx: Receiver<Item>,
    /// The number that comes next; where another one comes, those between were dropped.
    next_number: u64,
    /// An item that waits until empties have taken the places of those dropped before it.
    held: Option<Item>,
    last_stamp: StampNs,
    /// What takes the place of a dropped item.
    dropped: Arc<Empty>,
    pub(crate) received: u64,
    pub(crate) ended: bool,
}

/// What a look into the queue brings.
pub(crate) enum Received {
    /// An item; `unblocks` if the producer had waited for its room.
    Item { item: Item, unblocks: bool },
    /// Nothing yet, and nothing before this stamp.
    Nothing(StampNs),
    /// Nothing any more.
    Ended,
}

/// The policy `fail` met a full queue.
pub(crate) struct Full;

/// A link's two ends. `wire` and `producer` are for the empties that take the places of dropped items.
pub(crate) fn link(
    index: usize,
    capacity: usize,
    policy: Policy,
    producer: &str,
    wire: &str,
) -> (LinkState, SendEnd, RecvEnd) {
    let (tx, rx) = bounded(capacity.max(1));
    let oldest = matches!(policy, Policy::DropOld).then(|| rx.clone());
    let state =
        LinkState { progress: AtomicI64::new(StampNs::MIN), blocked: AtomicBool::new(false), total: AtomicU64::new(0) };
    let policy_name = match policy {
        Policy::Sample(n) => format!("sample, one in {n}"),
        Policy::DropOld => "drop_old".into(),
        Policy::DropNew => "drop_new".into(),
        Policy::Block | Policy::Fail => "block".into(),
    };
    let dropped = Empty { node: producer.into(), reason: format!("dropped on {wire} by its policy {policy_name}") };
    let capacity = capacity.max(1);
    let send = SendEnd { link: index, tx, oldest, policy, capacity, sent: 0, dropped: 0, highest_fill: 0 };
    let recv = RecvEnd {
        link: index,
        rx,
        next_number: 0,
        held: None,
        last_stamp: StampNs::MIN,
        dropped: Arc::new(dropped),
        received: 0,
        ended: false,
    };
    (state, send, recv)
}

impl LinkState {
    /// Promises that nothing more comes before `stamp_ns`; after the items that precede it have been sent.
    pub(crate) fn set_progress(&self, stamp_ns: StampNs) {
        self.progress.store(stamp_ns, Ordering::Release);
    }

    /// Whether the producer waits for room on this link.
    pub(crate) fn is_blocked(&self) -> bool {
        self.blocked.load(Ordering::Relaxed)
    }
}

impl SendEnd {
    fn is_full(&self) -> bool {
        self.tx.len() >= self.capacity
    }

    /// Whether the next item can be sent now. Where not, the consumer will say when there is room.
    pub(crate) fn has_room(&self, state: &LinkState) -> bool {
        let needs_room = match self.policy {
            Policy::Block => true,
            Policy::Sample(n) => self.sent.is_multiple_of(n.max(1).into()),
            Policy::DropOld | Policy::DropNew | Policy::Fail => false,
        };
        if !needs_room || !self.is_full() {
            return true;
        }
        state.blocked.store(true, Ordering::Relaxed);
        // Either the consumer, after taking an item, sees the flag, or this second look sees the room.
        fence(Ordering::SeqCst);
        !self.is_full()
    }

    /// Sends the next item, or drops one by the link's policy.
    ///
    /// # Errors
    /// [`Full`] where the policy is to fail; the item is dropped.
    pub(crate) fn send(&mut self, item: Item) -> Result<(), Full> {
        let number = self.sent;
        self.sent += 1;
        if let Policy::Sample(n) = self.policy
            && !number.is_multiple_of(n.max(1).into())
        {
            self.dropped += 1;
            return Ok(());
        }
        let mut item = item;
        loop {
            match self.tx.try_send(item) {
                Ok(()) => {
                    self.highest_fill = self.highest_fill.max(self.tx.len());
                    return Ok(());
                }
                Err(TrySendError::Full(back)) => {
                    if let Some(oldest) = &self.oldest {
                        self.dropped += u64::from(oldest.try_recv().is_ok());
                        item = back;
                        continue;
                    }
                    self.dropped += 1;
                    // A `block` link is sent to only after `has_room`; were that broken, it must not pass in silence.
                    return if matches!(self.policy, Policy::Fail | Policy::Block) { Err(Full) } else { Ok(()) };
                }
                Err(TrySendError::Disconnected(_)) => {
                    self.dropped += 1;
                    return Ok(());
                }
            }
        }
    }

    /// Nothing more comes: the consumer sees the end after the last item.
    pub(crate) fn close(&mut self, state: &LinkState) {
        state.total.store(self.sent, Ordering::Release);
        // The queue closes when its last sender goes; what is kept here has no receiver and takes nothing.
        let (tx, _) = bounded(1);
        (self.tx, self.oldest) = (tx, None);
    }

    /// How many items wait.
    pub(crate) fn fill(&self) -> usize {
        self.tx.len()
    }
}

impl RecvEnd {
    /// The next item, in the order of numbers.
    pub(crate) fn receive(&mut self, state: &LinkState) -> Received {
        if let Some(item) = self.held.take() {
            return self.in_order(item, false);
        }
        // Before the queue: an item that precedes this progress is then seen in the queue.
        let progress = state.progress.load(Ordering::Acquire);
        match self.rx.try_recv() {
            Ok(item) => {
                self.received += 1;
                fence(Ordering::SeqCst);
                let unblocks = state.blocked.load(Ordering::Relaxed) && state.blocked.swap(false, Ordering::Relaxed);
                self.in_order(item, unblocks)
            }
            Err(TryRecvError::Empty) => Received::Nothing(progress),
            Err(TryRecvError::Disconnected) if self.next_number < state.total.load(Ordering::Acquire) => {
                let stamp_ns = self.last_stamp;
                Received::Item { item: self.empty_in_place(stamp_ns), unblocks: false }
            }
            Err(TryRecvError::Disconnected) => {
                self.ended = true;
                Received::Ended
            }
        }
    }

    fn in_order(&mut self, item: Item, unblocks: bool) -> Received {
        if item.number > self.next_number {
            let stamp_ns = item.stamp_ns;
            self.held = Some(item);
            return Received::Item { item: self.empty_in_place(stamp_ns), unblocks };
        }
        self.next_number = item.number + 1;
        self.last_stamp = item.stamp_ns;
        Received::Item { item, unblocks }
    }

    fn empty_in_place(&mut self, stamp_ns: StampNs) -> Item {
        let number = self.next_number;
        self.next_number += 1;
        Item { number, stamp_ns, body: Body::Empty(self.dropped.clone()) }
    }
}

/// Gives the link a longer queue; nobody may send or receive meanwhile, which holding both ends ensures.
pub(crate) fn enlarge(send: &mut SendEnd, recv: &mut RecvEnd, capacity: usize) {
    let (tx, rx) = bounded(capacity);
    for item in recv.rx.try_iter() {
        // The new queue is the longer one.
        let _ = tx.try_send(item);
    }
    if send.oldest.is_some() {
        send.oldest = Some(rx.clone());
    }
    (send.tx, recv.rx, send.capacity) = (tx, rx, capacity);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn item(number: u64) -> Item {
        let empty = Empty { node: "test".into(), reason: "none".into() };
        Item { number, stamp_ns: number as i64, body: Body::Empty(Arc::new(empty)) }
    }

    /// Sends `n` items at once and receives what comes: (number, reason).
    fn through(policy: Policy, capacity: usize, n: u64) -> (Vec<(u64, String)>, SendEnd, RecvEnd) {
        let (state, mut send, mut recv) = link(0, capacity, policy, "a", "a.x");
        for number in 0..n {
            if send.has_room(&state) {
                let _ = send.send(item(number));
            }
        }
        send.close(&state);
        let mut out = Vec::new();
        while let Received::Item { item, .. } = recv.receive(&state) {
            let Body::Empty(empty) = item.body else { panic!("only empties were sent") };
            out.push((item.number, empty.reason.clone()));
        }
        (out, send, recv)
    }

    fn check(policy: Policy, kept: &[u64]) {
        let (out, send, recv) = through(policy, 2, 6);
        assert_eq!(out.iter().map(|(n, _)| *n).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5], "{policy:?} keeps every place");
        let came: Vec<_> = out.iter().filter(|(_, reason)| reason == "none").map(|(n, _)| *n).collect();
        assert_eq!(came, kept, "{policy:?}");
        assert_eq!(send.sent, recv.received + send.dropped, "{policy:?}: sent = received + dropped");
    }

    #[test]
    fn a_dropped_item_leaves_an_empty_in_its_place() {
        check(Policy::DropOld, &[4, 5]);
        check(Policy::DropNew, &[0, 1]);
        let (out, ..) = through(Policy::DropNew, 2, 6);
        assert_eq!(out[5].1, "dropped on a.x by its policy drop_new");
    }

    #[test]
    fn sample_keeps_one_in_n() {
        let (out, send, recv) = through(Policy::Sample(3), 2, 6);
        let came: Vec<_> = out.iter().filter(|(_, reason)| reason == "none").map(|(n, _)| *n).collect();
        assert_eq!((came, out.len()), (vec![0, 3], 6));
        assert_eq!(send.sent, recv.received + send.dropped);
    }

    #[test]
    fn a_full_link_that_blocks_takes_nothing_and_one_that_fails_says_so() {
        let (state, mut send, _recv) = link(0, 1, Policy::Block, "a", "a.x");
        assert!(send.has_room(&state) && send.send(item(0)).is_ok() && !send.has_room(&state));
        assert!(state.is_blocked());
        let (state, mut send, _recv) = link(0, 1, Policy::Fail, "a", "a.x");
        assert!(send.send(item(0)).is_ok() && send.has_room(&state) && send.send(item(1)).is_err());
    }

    #[test]
    fn an_enlarged_link_keeps_its_items_in_order() {
        let (state, mut send, mut recv) = link(0, 2, Policy::Block, "a", "a.x");
        (0..2).for_each(|n| assert!(send.send(item(n)).is_ok()));
        enlarge(&mut send, &mut recv, 4);
        (2..4).for_each(|n| assert!(send.has_room(&state) && send.send(item(n)).is_ok()));
        assert!(!send.has_room(&state));
        for expected in 0..4 {
            let Received::Item { item, unblocks } = recv.receive(&state) else { panic!("four items wait") };
            assert_eq!((item.number, unblocks), (expected, expected == 0));
        }
    }
}
