use std::{
    collections::VecDeque,
    sync::{Condvar, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

/// Maximum number of bytes waiting for the writer; beyond it, taps block because the disk is slower than the graph.
const MAX_BYTES: usize = 64 << 20;
/// Overhead counted per entry, so that many small entries are bounded too.
const ENTRY_BYTES: usize = 256;

/// Bounded queue of entries waiting to be written, in order of arrival.
///
/// The writer polls every few milliseconds; it is woken only when much is waiting, so that recording a small item costs
/// no wake-up.
pub(super) struct Queue<T> {
    state: Mutex<State<T>>,
    room: Condvar,
    news: Condvar,
}

struct State<T> {
    entries: VecDeque<(T, usize)>,
    /// Bytes of waiting entries, and of those that the writer has taken and not yet written.
    n_bytes: usize,
    /// The queue is closed.
    closed: bool,
    /// The writer has ended: entries are discarded and nobody blocks.
    dead: bool,
}

impl<T> Queue<T> {
    pub(super) fn new() -> Self {
        let state = State { entries: VecDeque::new(), n_bytes: 0, closed: false, dead: false };
        Self { state: Mutex::new(state), room: Condvar::new(), news: Condvar::new() }
    }

    fn locked(&self) -> MutexGuard<'_, State<T>> {
        // Nothing panics while it holds the lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an entry; blocks while the queue is full. An entry larger than the queue is accepted alone.
    pub(super) fn put(&self, entry: T, n_bytes: usize) {
        let n_bytes = n_bytes.saturating_add(ENTRY_BYTES);
        let mut state = self.locked();
        while !state.dead && state.n_bytes > 0 && state.n_bytes.saturating_add(n_bytes) > MAX_BYTES {
            self.news.notify_one();
            state = self.room.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if state.dead {
            return;
        }
        state.n_bytes = state.n_bytes.saturating_add(n_bytes);
        state.entries.push_back((entry, n_bytes));
        if state.n_bytes > MAX_BYTES / 4 {
            self.news.notify_one();
        }
    }

    /// Takes all waiting entries, each with the number of bytes to release once it is written; and whether the queue is
    /// closed.
    pub(super) fn take(&self, patience: Duration) -> (VecDeque<(T, usize)>, bool) {
        let mut state = self.locked();
        if state.n_bytes <= MAX_BYTES / 4 && !state.closed {
            state = self.news.wait_timeout(state, patience).unwrap_or_else(PoisonError::into_inner).0;
        }
        (std::mem::take(&mut state.entries), state.closed)
    }

    /// Releases the bytes of a written entry.
    pub(super) fn release(&self, n_bytes: usize) {
        let mut state = self.locked();
        state.n_bytes = state.n_bytes.saturating_sub(n_bytes);
        self.room.notify_all();
    }

    /// Closes the queue.
    pub(super) fn close(&self) {
        self.locked().closed = true;
        self.news.notify_one();
    }

    /// Marks the writer as ended and wakes blocked producers.
    pub(super) fn abandon(&self) {
        let mut state = self.locked();
        state.dead = true;
        state.entries.clear();
        self.room.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    const NONE: Duration = Duration::ZERO;

    #[test]
    fn a_burst_waits_for_the_writer_and_arrives_complete_and_in_order() {
        let (queue, n_put) = (Queue::new(), AtomicUsize::new(0));
        let size = MAX_BYTES / 8;
        std::thread::scope(|scope| {
            scope.spawn(|| {
                for i in 0..40 {
                    queue.put(i, size);
                    n_put.fetch_add(1, Ordering::SeqCst);
                }
                queue.close();
            });
            let (mut got, mut n_written) = (Vec::new(), 0);
            loop {
                let (batch, closed) = queue.take(Duration::from_millis(1));
                if batch.is_empty() && closed {
                    break;
                }
                for (entry, n_bytes) in batch {
                    let ahead = n_put.load(Ordering::SeqCst) - n_written;
                    assert!(ahead <= 8, "{ahead} entries of an eighth of the room each wait");
                    got.push(entry);
                    n_written += 1;
                    queue.release(n_bytes);
                }
            }
            assert_eq!(got, (0..40).collect::<Vec<_>>());
        });
    }

    #[test]
    fn an_entry_larger_than_the_queue_passes_alone() {
        let queue = Queue::new();
        queue.put("large", 10 * MAX_BYTES);
        let (mut batch, _) = queue.take(NONE);
        let (entry, n_bytes) = batch.pop_front().unwrap();
        assert_eq!(entry, "large");
        queue.release(n_bytes);
        queue.put("next", 1);
        assert_eq!(queue.take(NONE).0.len(), 1);
    }

    #[test]
    fn producers_do_not_wait_for_a_writer_that_has_ended() {
        let queue = Queue::new();
        queue.put(0, MAX_BYTES);
        std::thread::scope(|scope| {
            scope.spawn(|| queue.put(1, MAX_BYTES));
            queue.abandon();
        });
        queue.put(2, MAX_BYTES);
        assert!(queue.take(NONE).0.is_empty());
    }
}
