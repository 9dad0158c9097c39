//! Which node runs next, on which worker; nothing here knows of items.
//!
//! A node is idle, queued or running, and is told of news by [`Wake::node`]; news that come while it runs make it look
//! again. A worker goes on with the nodes it has just made ready, the furthest downstream first. Those that may take
//! long go to the queue that all workers share, and before such a one everything else does; handing over a node that
//! takes microseconds would cost more than running it. When the last worker finds nothing, nothing can run: that state
//! is exact.

use std::sync::{
    Condvar, Mutex, MutexGuard, PoisonError,
    atomic::{AtomicBool, AtomicU8, AtomicUsize, Ordering, fence},
};

const IDLE: u8 = 0;
const QUEUED: u8 = 1;
const RUNNING: u8 = 2;
const RUNNING_WITH_NEWS: u8 = 3;

/// How often a worker looks before it sleeps: some microseconds, less than waking it costs.
const LOOKS_BEFORE_SLEEP: usize = 200;

/// How often a node that takes microseconds fires before those it has made ready have their turn.
const FIRINGS_IN_A_ROW: usize = 16;

/// What the scheduler runs.
pub(super) trait Work: Sync {
    /// One step of a node; no two steps of one node run at once.
    fn step(&self, node: usize, wake: &mut Wake<'_>) -> Stepped;

    /// Whether the node takes so little time that handing it to another worker is not worth it.
    fn is_cheap(&self, node: usize) -> bool;

    /// Whether something outside may still wake a node. Once it says no, and a look at what it has woken before brings
    /// nothing, it says no until a step has been made.
    fn is_pending(&self) -> bool {
        false
    }

    /// Nothing can run: wakes a node if something can be done about it. No step runs meanwhile.
    fn relieve(&self) -> Option<usize>;
}

/// What a step did.
#[derive(Debug, PartialEq)]
pub(super) enum Stepped {
    /// The node fired; it may be able to go on.
    Fired,
    /// The node waits for news.
    Idle,
}

/// Takes note of nodes that have news.
pub(super) struct Wake<'a> {
    states: &'a [AtomicU8],
    made_ready: &'a mut Vec<usize>,
}

impl Wake<'_> {
    /// Tells `node` that an item, progress, an end or room has come; after the fact.
    pub(super) fn node(&mut self, node: usize) {
        // Either this sees the node running or idle, or the node, on its way to run, sees the fact.
        fence(Ordering::SeqCst);
        let state = &self.states[node];
        let mut now = state.load(Ordering::Relaxed);
        loop {
            let next = match now {
                IDLE => QUEUED,
                RUNNING => RUNNING_WITH_NEWS,
                _ => return,
            };
            match state.compare_exchange_weak(now, next, Ordering::AcqRel, Ordering::Relaxed) {
                Ok(IDLE) => return self.made_ready.push(node),
                Ok(_) => return,
                Err(other) => now = other,
            }
        }
    }
}

pub(super) struct Scheduler {
    states: Vec<AtomicU8>,
    queue: Mutex<Queue>,
    wakeup: Condvar,
    /// The length of the queue, for a look without the lock.
    n_queued: AtomicUsize,
    /// Set when a worker died of a bug of ours: the others must not wait for it.
    abandoned: AtomicBool,
    n_workers: usize,
}

#[derive(Default)]
struct Queue {
    ready: ReadySet,
    n_asleep: usize,
    finished: bool,
}

impl Scheduler {
    /// All nodes begin queued.
    pub(super) fn new(n_nodes: usize, n_workers: usize) -> Self {
        let mut queue = Queue::default();
        (0..n_nodes).for_each(|node| queue.ready.insert(node));
        Self {
            states: (0..n_nodes).map(|_| AtomicU8::new(QUEUED)).collect(),
            queue: Mutex::new(queue),
            wakeup: Condvar::new(),
            n_queued: AtomicUsize::new(n_nodes),
            abandoned: AtomicBool::new(false),
            n_workers: n_workers.max(1),
        }
    }

    /// Runs until nothing can run and nothing can be done about it; one worker is the calling thread.
    pub(super) fn run(&self, work: &dyn Work) {
        std::thread::scope(|scope| {
            for worker in 1..self.n_workers {
                // As much stack as the main thread has: a node must not care where it runs.
                let thread = std::thread::Builder::new().name(format!("worker-{worker}")).stack_size(8 << 20);
                if let Err(error) = thread.spawn_scoped(scope, || self.work(work)) {
                    tracing::warn!("worker {worker} could not be started, the others do its work: {error}");
                    self.lock().n_asleep += 1;
                }
            }
            self.work(work);
        });
    }

    /// Does what wakes nodes on a thread that is no worker; the workers go on with them.
    pub(super) fn outside<T>(&self, does: impl FnOnce(&mut Wake<'_>) -> T) -> T {
        let (mut made_ready, mut ready) = (Vec::new(), ReadySet::default());
        let done = does(&mut Wake { states: &self.states, made_ready: &mut made_ready });
        made_ready.into_iter().for_each(|node| ready.insert(node));
        self.put(&ready);
        done
    }

    /// What was pending is so no more: a worker looks whether anything can still run.
    pub(super) fn look_again(&self) {
        let _queue = self.lock();
        self.wakeup.notify_one();
    }

    /// Lets the workers go when the thread that holds it unwinds.
    pub(super) fn guard(&self) -> impl Drop + '_ {
        Abandon(self)
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self, work: &dyn Work) {
        let _guard = Abandon(self);
        let (mut made_ready, mut own) = (Vec::new(), ReadySet::default());
        while let Some(node) = own.pop_last().or_else(|| self.pop(work)) {
            if self.n_workers > 1 && own.len > 0 {
                let all = !work.is_cheap(node);
                self.share(&mut own, |other| all || !work.is_cheap(other));
            }
            self.run_node(node, work, &mut made_ready);
            made_ready.drain(..).for_each(|node| own.insert(node));
        }
    }

    /// Steps the node until it waits or others should have their turn.
    fn run_node(&self, node: usize, work: &dyn Work, made_ready: &mut Vec<usize>) {
        let state = &self.states[node];
        state.store(RUNNING, Ordering::Relaxed);
        fence(Ordering::SeqCst);
        let mut n_fired = 0;
        loop {
            match work.step(node, &mut Wake { states: &self.states, made_ready }) {
                Stepped::Fired => {
                    n_fired += 1;
                    if !made_ready.is_empty() && (n_fired >= FIRINGS_IN_A_ROW || !work.is_cheap(node)) {
                        state.store(QUEUED, Ordering::Release);
                        made_ready.push(node);
                        return;
                    }
                }
                Stepped::Idle => {
                    if state.compare_exchange(RUNNING, IDLE, Ordering::AcqRel, Ordering::Acquire).is_ok() {
                        return;
                    }
                    state.store(RUNNING, Ordering::Relaxed);
                    fence(Ordering::SeqCst);
                }
            }
        }
    }

    /// Moves nodes from a worker's own to the queue of all, and wakes those who sleep.
    fn share(&self, own: &mut ReadySet, which: impl Fn(usize) -> bool) {
        self.put(&own.split_off(which));
    }

    /// Puts nodes into the queue of all, and wakes those who sleep.
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

    fn pop(&self, work: &dyn Work) -> Option<usize> {
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
            if let Some(node) = queue.ready.pop_last() {
                self.n_queued.store(queue.ready.len, Ordering::Relaxed);
                return Some(node);
            }
            queue.n_asleep += 1;
            if queue.n_asleep == self.n_workers && !work.is_pending() {
                match work.relieve() {
                    Some(node) => {
                        let before = self.states[node].swap(QUEUED, Ordering::AcqRel);
                        if before == IDLE {
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

/// Lets the other workers go when this one unwinds.
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

/// The queued nodes; the one furthest downstream goes first, so that queues stay short.
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

    /// Takes the nodes out that are asked for.
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

    fn pop_last(&mut self) -> Option<usize> {
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

    /// A ring of counters: each step passes one token on.
    struct Ring(Vec<AtomicUsize>);

    impl Work for Ring {
        fn step(&self, node: usize, wake: &mut Wake<'_>) -> Stepped {
            let Ok(left) = self.0[node].fetch_update(Ordering::AcqRel, Ordering::Acquire, |n| n.checked_sub(1)) else {
                return Stepped::Idle;
            };
            let next = (node + 1) % self.0.len();
            if next != 0 {
                self.0[next].fetch_add(1, Ordering::AcqRel);
                wake.node(next);
            }
            let _ = left;
            Stepped::Fired
        }

        fn is_cheap(&self, node: usize) -> bool {
            node % 2 == 1
        }

        fn relieve(&self) -> Option<usize> {
            None
        }
    }

    #[test]
    fn every_token_gets_through_on_any_number_of_workers() {
        for n_workers in [1, 2, 8] {
            for _ in 0..20 {
                let ring = Ring((0..5).map(|node| AtomicUsize::new(if node == 0 { 500 } else { 0 })).collect());
                Scheduler::new(5, n_workers).run(&ring);
                let left: Vec<_> = ring.0.iter().map(|n| n.load(Ordering::Relaxed)).collect();
                assert_eq!(left, [0; 5], "tokens left on {n_workers} workers");
            }
        }
    }
}
