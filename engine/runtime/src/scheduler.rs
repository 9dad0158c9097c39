//! Decides which node runs next and on which worker; independent of items.
//!
//! A node is idle, queued or running. [`Turn::wake`] notifies it; a node notified while it runs is run again. A worker
//! goes on with the nodes it has just made ready, the furthest downstream first. Nodes that may take long go to the
//! queue shared by all workers and run after everything else; handing over a node that takes microseconds would cost
//! more than running it. When the last worker finds nothing, nothing can run: that state is detected exactly.
//!
//! All synchronisation comes from [`crate::sync`], so that a test can replace it by a model checker.

use crate::sync::{
    Condvar, LOOKS_BEFORE_SLEEP, Mutex, MutexGuard, PoisonError,
    atomic::{AtomicBool, AtomicU8, AtomicUsize, Ordering, fence},
    delay, on_workers,
};
use std::time::Instant;

const IDLE: u8 = 0;
const QUEUED: u8 = 1;
const RUNNING: u8 = 2;
const RUNNING_NOTIFIED: u8 = 3;

/// Maximum number of consecutive firings of a node that takes microseconds.
const FIRINGS_IN_A_ROW: usize = 16;

/// What the scheduler runs.
pub(crate) trait Work: Sync {
    /// Runs a node until it waits, or until [`Turn::goes_on`] says that other nodes should run; no two turns of one
    /// node run at once.
    fn step(&self, node: usize, turn: &mut Turn<'_>) -> Stepped;

    /// Whether the node is too fast to be worth handing to another worker.
    fn is_cheap(&self, node: usize) -> bool;

    /// Whether something outside the scheduler may still wake a node. Once this returns `false` and no node is woken by
    /// then, it returns `false` until a step has been made.
    fn is_pending(&self) -> bool {
        false
    }

    /// Called when nothing can run: returns a node to wake, if that state can be resolved. No turn runs meanwhile.
    fn relieve(&self) -> Option<usize>;
}

/// How a turn ended.
#[derive(Debug, PartialEq)]
pub(crate) enum Stepped {
    /// The node may be able to go on.
    Fired,
    /// The node waits to be woken.
    Idle,
}

pub(crate) struct Scheduler {
    states: Vec<AtomicU8>,
    queue: Mutex<Queue>,
    wakeup: Condvar,
    /// Length of the queue, readable without the lock.
    n_queued: AtomicUsize,
    /// Set when a worker panicked: the others must not wait for it.
    abandoned: AtomicBool,
    n_workers: usize,
    shuffle: Option<u64>,
}

#[derive(Default)]
struct Queue {
    ready: ReadySet,
    n_asleep: usize,
    finished: bool,
}

impl Scheduler {
    /// Creates a scheduler with all nodes queued. With a seed in `shuffle`, delays, wake-ups and order are randomized.
    pub(crate) fn new(n_nodes: usize, n_workers: usize, shuffle: Option<u64>) -> Self {
        let mut queue = Queue::default();
        (0..n_nodes).for_each(|node| queue.ready.insert(node));
        Self {
            states: (0..n_nodes).map(|_| AtomicU8::new(QUEUED)).collect(),
            queue: Mutex::new(queue),
            wakeup: Condvar::new(),
            n_queued: AtomicUsize::new(n_nodes),
            abandoned: AtomicBool::new(false),
            n_workers: n_workers.max(1),
            shuffle,
        }
    }

    /// Runs until nothing can run and [`Work::relieve`] finds no node; one worker is the calling thread.
    pub(crate) fn run(&self, work: &dyn Work) {
        let without = |worker, error| {
            tracing::warn!("worker {worker} could not be started, the others do its work: {error}");
            let mut queue = self.lock();
            queue.n_asleep += 1;
            // Sleeping workers rely on it.
            drop(queue);
            self.wakeup.notify_all();
        };
        on_workers(self.n_workers, &|worker| self.work(worker, work), &without);
    }

    /// Wakes nodes from a thread that is not a worker; the workers run them.
    pub(crate) fn outside<T>(&self, does: impl FnOnce(&mut Turn<'_>) -> T) -> T {
        let mut turn = Turn::new(self, None);
        let done = does(&mut turn);
        turn.settle();
        self.put(&turn.own);
        done
    }

    /// Something pending is no longer so: a worker checks whether anything can still run.
    pub(crate) fn recheck(&self) {
        let _queue = self.lock();
        self.wakeup.notify_one();
    }

    /// Returns a guard that releases the workers if its thread unwinds.
    #[allow(dead_code, reason = "the model of the scheduler has no such thread")]
    pub(crate) fn guard(&self) -> impl Drop + '_ {
        Abandon(self)
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Marks the node as woken; returns `true` if it was idle and must be queued. Call after a fence.
    fn make_ready(&self, node: usize) -> bool {
        let state = &self.states[node];
        let mut now = state.load(Ordering::Relaxed);
        loop {
            let next = match now {
                IDLE => QUEUED,
                RUNNING => RUNNING_NOTIFIED,
                _ => return false,
            };
            match state.compare_exchange_weak(now, next, Ordering::AcqRel, Ordering::Relaxed) {
                Ok(before) => return before == IDLE,
                Err(other) => now = other,
            }
        }
    }

    fn work(&self, worker: usize, work: &dyn Work) {
        let _guard = Abandon(self);
        let mut turn = Turn::new(self, self.shuffle.map(|seed| Dice::new(seed, worker)));
        while let Some(node) = turn.next(work) {
            turn.share_before(node, work);
            turn.disturb();
            turn.take(node, work);
        }
    }

    /// Puts nodes into the shared queue and wakes sleeping workers.
    fn put(&self, nodes: &ReadySet) {
        if nodes.len == 0 {
            return;
        }
        let mut queue = self.lock();
        queue.ready.append(nodes);
        self.n_queued.store(queue.ready.len, Ordering::Relaxed);
        let n_asleep = queue.n_asleep;
        drop(queue);
        (0..nodes.len.min(n_asleep)).for_each(|_| self.wakeup.notify_one());
    }

    /// Next node of the shared queue; waits for one.
    fn pop(&self, work: &dyn Work, dice: &mut Option<Dice>) -> Option<usize> {
        if self.n_workers > 1 {
            let _ = (0..LOOKS_BEFORE_SLEEP).find(|_| {
                std::hint::spin_loop();
                self.n_queued.load(Ordering::Relaxed) > 0
            });
        }
        let mut queue = self.lock();
        loop {
            if queue.finished || self.abandoned.load(Ordering::Relaxed) {
                return None;
            }
            if let Some(node) = queue.ready.pop(dice) {
                self.n_queued.store(queue.ready.len, Ordering::Relaxed);
                return Some(node);
            }
            queue.n_asleep += 1;
            if queue.n_asleep == self.n_workers && !work.is_pending() {
                match work.relieve() {
                    Some(node) => {
                        fence(Ordering::SeqCst);
                        if self.make_ready(node) {
                            queue.ready.insert(node);
                        }
                    }
                    None => {
                        queue.finished = true;
                        self.wakeup.notify_all();
                    }
                }
            } else {
                queue = self.wakeup.wait(queue).unwrap_or_else(PoisonError::into_inner);
            }
            queue.n_asleep -= 1;
        }
    }
}

/// A worker during a node's turn: collects the nodes to wake.
pub(crate) struct Turn<'a> {
    scheduler: &'a Scheduler,
    /// Ready nodes that this worker will run unless another worker does.
    own: ReadySet,
    /// Nodes woken in this turn.
    woken: ReadySet,
    /// Nothing that other threads must see has been done since the last fence.
    is_fenced: bool,
    /// Number of firings in this turn.
    n_fired: usize,
    /// End of the last firing, if the worker has done only bookkeeping since.
    pub clock: Option<Instant>,
    dice: Option<Dice>,
}

impl<'a> Turn<'a> {
    fn new(scheduler: &'a Scheduler, dice: Option<Dice>) -> Self {
        let (own, woken) = Default::default();
        Self { scheduler, own, woken, is_fenced: false, n_fired: 0, clock: None, dice }
    }

    /// Notifies `node` of an item, progress, an end or room; takes effect when the turn ends.
    pub(crate) fn wake(&mut self, node: usize) {
        self.woken.insert(node);
    }

    /// Counts a firing; returns whether the node may fire again in this turn. A firing that takes long ends the turn,
    /// so that the nodes it made ready can start elsewhere.
    pub(crate) fn goes_on(&mut self, cheap: bool) -> bool {
        self.n_fired += 1;
        let at_random = self.dice.as_mut().is_some_and(|dice| dice.one_in(3));
        cheap && self.n_fired < FIRINGS_IN_A_ROW && !at_random
    }

    /// Called before a firing that may take long: lets other workers run the nodes that are ready here.
    pub(crate) fn hand_over(&mut self) {
        if self.scheduler.n_workers > 1 {
            self.settle();
            self.share(|_| true);
        }
        self.is_fenced = false;
    }

    fn next(&mut self, work: &dyn Work) -> Option<usize> {
        self.own.pop(&mut self.dice).or_else(|| {
            self.clock = None;
            self.scheduler.pop(work, &mut self.dice)
        })
    }

    /// Runs the node until it waits or its turn is over.
    fn take(&mut self, node: usize, work: &dyn Work) {
        let state = &self.scheduler.states[node];
        self.n_fired = 0;
        loop {
            state.store(RUNNING, Ordering::Relaxed);
            // Everything done before the wake-up is visible from here on.
            fence(Ordering::SeqCst);
            let stepped = work.step(node, self);
            self.settle();
            match stepped {
                Stepped::Fired => {
                    state.store(QUEUED, Ordering::Release);
                    self.own.insert(node);
                    return;
                }
                Stepped::Idle => {
                    if state.compare_exchange(RUNNING, IDLE, Ordering::AcqRel, Ordering::Acquire).is_ok() {
                        return;
                    }
                }
            }
        }
    }

    /// Memory fence: what the node has done so far is ordered before what it, or the end of its turn, reads next.
    pub(crate) fn fence(&mut self) {
        fence(Ordering::SeqCst);
        self.is_fenced = true;
    }

    /// Wakes the nodes collected in this turn.
    fn settle(&mut self) {
        let is_fenced = std::mem::take(&mut self.is_fenced);
        if self.woken.len == 0 {
            return;
        }
        // Either this sees the node running or idle, or the node, about to run, sees the change.
        if !is_fenced {
            fence(Ordering::SeqCst);
        }
        while let Some(node) = self.woken.pop_last() {
            if self.scheduler.make_ready(node) {
                self.own.insert(node);
            }
        }
    }

    fn share_before(&mut self, node: usize, work: &dyn Work) {
        if self.scheduler.n_workers > 1 && self.own.len > 0 {
            let mut all = !work.is_cheap(node);
            if let Some(dice) = &mut self.dice {
                all ^= dice.one_in(4);
            }
            self.share(|other| all || !work.is_cheap(other));
        }
    }

    /// Moves nodes from the worker's own set to the shared queue.
    fn share(&mut self, which: impl Fn(usize) -> bool) {
        self.scheduler.put(&self.own.split_off(which));
    }

    /// With a seed to shuffle by: random delays, and spurious wake-ups of nodes and workers.
    fn disturb(&mut self) {
        let Some(dice) = &mut self.dice else { return };
        if dice.one_in(8) {
            delay(dice.below(200));
        }
        if dice.one_in(8) {
            let node = dice.below(self.scheduler.states.len());
            fence(Ordering::SeqCst);
            if self.scheduler.make_ready(node) {
                self.own.insert(node);
            }
        }
        if dice.one_in(16) {
            self.scheduler.wakeup.notify_all();
        }
    }
}

/// Releases the other workers when this one unwinds.
struct Abandon<'a>(&'a Scheduler);

impl Drop for Abandon<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.abandoned.store(true, Ordering::Relaxed);
            let _queue = self.0.lock();
            self.0.wakeup.notify_all();
        }
    }
}

/// Random numbers for shuffling; on one worker the same seed gives the same run.
struct Dice(u64);

impl Dice {
    fn new(seed: u64, worker: usize) -> Self {
        // Steele, Lea and Flood's mixer separates neighbouring seeds. Zero would stay zero.
        let mut z = seed.wrapping_add((worker as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        Self((z ^ (z >> 31)) | 1)
    }

    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        ((self.0 >> 33) % n.max(1) as u64) as usize
    }

    fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }
}

/// Queued nodes; the one furthest downstream goes first, so that queues stay short.
#[derive(Default)]
struct ReadySet {
    words: Vec<u64>,
    len: usize,
}

impl ReadySet {
    fn insert(&mut self, node: usize) {
        let (word, bit) = (node / 64, 1u64 << (node % 64));
        if self.words.len() <= word {
            self.words.resize(word + 1, 0);
        }
        self.len += usize::from(self.words[word] & bit == 0);
        self.words[word] |= bit;
    }

    /// Removes and returns the nodes that `which` selects.
    fn split_off(&mut self, which: impl Fn(usize) -> bool) -> Self {
        let mut out = Self::default();
        for (word, bits) in self.words.iter_mut().enumerate() {
            let before = *bits;
            for bit in (0..64).filter(|bit| before >> bit & 1 == 1 && which(word * 64 + bit)) {
                *bits &= !(1 << bit);
                self.len -= 1;
                out.insert(word * 64 + bit);
            }
        }
        out
    }

    fn append(&mut self, other: &Self) {
        for (word, bits) in other.words.iter().enumerate() {
            (0..64).filter(|bit| bits >> bit & 1 == 1).for_each(|bit| self.insert(word * 64 + bit));
        }
    }

    /// Removes the node furthest downstream, or with dice any node.
    fn pop(&mut self, dice: &mut Option<Dice>) -> Option<usize> {
        match dice {
            Some(dice) if self.len > 1 => {
                let skipped = dice.below(self.len);
                let behind: Vec<_> = (0..skipped).filter_map(|_| self.pop_last()).collect();
                let node = self.pop_last();
                behind.into_iter().for_each(|node| self.insert(node));
                node
            }
            _ => self.pop_last(),
        }
    }

    fn pop_last(&mut self) -> Option<usize> {
        if self.len == 0 {
            return None;
        }
        let (word, bits) = self.words.iter_mut().enumerate().rev().find(|(_, bits)| **bits != 0)?;
        let bit = 63 - bits.leading_zeros() as usize;
        *bits &= !(1 << bit);
        self.len -= 1;
        Some(word * 64 + bit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sync::{beside, many_times};

    #[test]
    fn the_node_furthest_downstream_comes_first() {
        let mut set = ReadySet::default();
        [3, 130, 64, 3].into_iter().for_each(|node| set.insert(node));
        assert_eq!(set.len, 3);
        let mut odd = set.split_off(|node| node % 2 == 1);
        assert_eq!((set.len, odd.len, odd.pop_last()), (2, 1, Some(3)));
        set.insert(3);
        assert_eq!(
            [set.pop_last(), set.pop_last(), set.pop_last(), set.pop_last()],
            [Some(130), Some(64), Some(3), None]
        );
    }

    #[test]
    fn dice_take_every_ready_node_once() {
        let mut set = ReadySet::default();
        (0..100).for_each(|node| set.insert(node));
        let mut dice = Some(Dice::new(0, 0));
        let mut taken: Vec<_> = std::iter::from_fn(|| set.pop(&mut dice)).collect();
        assert!(!taken.is_sorted_by(|a, b| a > b), "some order of its own");
        taken.sort_unstable();
        assert_eq!(taken, (0..100).collect::<Vec<_>>());
    }

    /// Tokens in a row of bounded places; a node takes a token from its own place and puts it into the next. These
    /// tests also run in `tests/scheduler_model.rs`, where a model checker tries interleavings of every operation on
    /// shared memory.
    struct Row {
        places: Vec<AtomicUsize>,
        /// Capacity of a place; the last node removes tokens from the row.
        room: Vec<AtomicUsize>,
        through: AtomicUsize,
        n_running: AtomicUsize,
        /// Number of tokens still to come from outside.
        n_pending: AtomicUsize,
        n_relieved: AtomicUsize,
    }

    impl Row {
        fn new(n_nodes: usize, first: usize, room: usize, n_pending: usize) -> Self {
            Self {
                places: (0..n_nodes).map(|node| AtomicUsize::new(if node == 0 { first } else { 0 })).collect(),
                room: (0..n_nodes).map(|_| AtomicUsize::new(room)).collect(),
                through: AtomicUsize::new(0),
                n_running: AtomicUsize::new(0),
                n_pending: AtomicUsize::new(n_pending),
                n_relieved: AtomicUsize::new(0),
            }
        }

        fn can_fire(&self, node: usize) -> bool {
            let of = |n: &AtomicUsize| n.load(Ordering::SeqCst);
            let next = node + 1;
            of(&self.places[node]) > 0 && (next == self.places.len() || of(&self.places[next]) < of(&self.room[next]))
        }
    }

    impl Work for Row {
        fn step(&self, node: usize, turn: &mut Turn<'_>) -> Stepped {
            assert_eq!(
                self.n_running.fetch_or(1 << node, Ordering::SeqCst) >> node & 1,
                0,
                "{node} runs twice at once"
            );
            let mut stepped = Stepped::Idle;
            while self.can_fire(node) {
                self.places[node].fetch_sub(1, Ordering::SeqCst);
                if node > 0 {
                    turn.wake(node - 1);
                }
                if node + 1 < self.places.len() {
                    self.places[node + 1].fetch_add(1, Ordering::SeqCst);
                    turn.wake(node + 1);
                } else {
                    self.through.fetch_add(1, Ordering::SeqCst);
                }
                if !turn.goes_on(self.is_cheap(node)) {
                    stepped = Stepped::Fired;
                    break;
                }
            }
            self.n_running.fetch_and(!(1 << node), Ordering::SeqCst);
            stepped
        }

        fn is_cheap(&self, node: usize) -> bool {
            node % 2 == 1
        }

        fn is_pending(&self) -> bool {
            self.n_pending.load(Ordering::SeqCst) > 0
        }

        fn relieve(&self) -> Option<usize> {
            assert_eq!(self.n_running.load(Ordering::SeqCst), 0, "a node runs while nothing can");
            assert_eq!((0..self.places.len()).find(|node| self.can_fire(*node)), None, "this node can run");
            assert_eq!(self.n_pending.load(Ordering::SeqCst), 0, "something is still to come");
            let stuck = (0..self.places.len()).find(|node| self.places[*node].load(Ordering::SeqCst) > 0)?;
            self.room[stuck + 1].fetch_add(1, Ordering::SeqCst);
            self.n_relieved.fetch_add(1, Ordering::SeqCst);
            Some(stuck)
        }
    }

    #[test]
    fn every_token_gets_through_on_any_number_of_workers() {
        for n_workers in [1, 2, 3] {
            for shuffle in [None, Some(1)] {
                many_times(move || {
                    let row = Row::new(3, 3, 1, 0);
                    Scheduler::new(3, n_workers, shuffle).run(&row);
                    assert_eq!(
                        row.through.load(Ordering::SeqCst),
                        3,
                        "on {n_workers} workers, shuffled by {shuffle:?}"
                    );
                    assert_eq!(row.n_relieved.load(Ordering::SeqCst), 0, "it was never stuck");
                });
            }
        }
    }

    #[test]
    fn a_stuck_state_is_relieved_once_all_workers_sleep() {
        for n_workers in [1, 2, 3] {
            many_times(move || {
                let row = Row::new(3, 2, 0, 0);
                Scheduler::new(3, n_workers, None).run(&row);
                let n_relieved = row.n_relieved.load(Ordering::SeqCst);
                // Twice at the first node that has a token to pass on, once at the next.
                assert_eq!((row.through.load(Ordering::SeqCst), n_relieved), (2, 3), "on {n_workers} workers");
            });
        }
    }

    #[test]
    fn a_node_woken_from_outside_runs_and_the_run_waits_for_what_is_pending() {
        for n_workers in [1, 2] {
            many_times(move || {
                let row = Row::new(2, 0, 1, 2);
                let scheduler = Scheduler::new(2, n_workers, None);
                let feed = || {
                    for _ in 0..2 {
                        scheduler.outside(|turn| {
                            row.places[0].fetch_add(1, Ordering::SeqCst);
                            turn.wake(0);
                        });
                        if row.n_pending.fetch_sub(1, Ordering::SeqCst) == 1 {
                            scheduler.recheck();
                        }
                    }
                };
                beside(&feed, &|| scheduler.run(&row));
                assert_eq!(row.through.load(Ordering::SeqCst), 2, "on {n_workers} workers");
            });
        }
    }
}
