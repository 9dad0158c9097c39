//! The scheduler under a model checker: compiles its source with shuttle's threads, locks and atomics instead of those of
//! the standard library. Its tests (no lost wake-up, every token gets through, the run ends exactly when nothing can run,
//! relief only when all workers sleep, nodes woken from outside) are repeated for some hundreds of interleavings, and for a
//! hundred times as many with `SLOW_TESTS`.
//!
//! Shuttle assumes sequentially consistent memory: the comment at each fence argues why it suffices; that is not checked
//! here.

#![allow(dead_code, unreachable_pub, reason = "the engine uses the rest of the scheduler")]

#[path = "../src/scheduler.rs"]
mod scheduler;

/// `crate::sync` implemented with shuttle.
mod sync {
    pub(crate) use shuttle::sync::{Condvar, Mutex, MutexGuard, atomic};
    pub(crate) use std::sync::PoisonError;

    pub(crate) const LOOKS_BEFORE_SLEEP: usize = 1;

    pub(crate) fn on_workers(n: usize, work: &(dyn Fn(usize) + Sync), _: &dyn Fn(usize, std::io::Error)) {
        // The thread that opened the scope may only wait for its end.
        shuttle::thread::scope(|scope| {
            for worker in 0..n {
                scope.spawn(move || work(worker));
            }
        });
    }

    pub(crate) fn delay(_: usize) {
        shuttle::thread::yield_now();
    }

    pub(crate) fn beside(a: &(dyn Fn() + Sync), b: &(dyn Fn() + Sync)) {
        shuttle::thread::scope(|scope| {
            scope.spawn(a);
            scope.spawn(b);
        });
    }

    /// Random interleavings, and interleavings with few context switches (probabilistic concurrency testing).
    pub(crate) fn many_times(test: impl Fn() + Send + Sync + 'static) {
        let test = std::sync::Arc::new(test);
        let n = if std::env::var_os("SLOW_TESTS").is_some() { 30_000 } else { 300 };
        let again = test.clone();
        shuttle::check_random(move || test(), n);
        let beside_nothing = move || {
            // The scheduler of shuttle needs at least two threads, also for one worker.
            let other = shuttle::thread::spawn(shuttle::thread::yield_now);
            again();
            other.join().expect("it does nothing");
        };
        shuttle::check_pct(beside_nothing, n, 3);
    }
}
