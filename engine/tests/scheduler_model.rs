//! The scheduler under a model checker: its source as it is, with shuttle's threads, locks and atomics in the place of
//! the standard library's. What the tests in it demand (no lost wake-up, every token gets through, the end exactly when
//! nothing can run, relief only when all sleep, nodes woken from outside) then holds for every interleaving tried: some
//! hundreds each time, and a hundred times as many with `SLOW_TESTS`.
//!
//! Shuttle tries orders of operations and takes memory for sequentially consistent: that a fence stands where one is
//! needed is argued beside each, and not checked here.

#![allow(dead_code, unreachable_pub, reason = "the engine uses the rest of the scheduler")]

#[path = "../src/runtime/scheduler.rs"]
mod scheduler;

/// What `crate::sync` gives the scheduler, by shuttle.
mod sync {
    pub(crate) use shuttle::sync::{Condvar, Mutex, MutexGuard, atomic};
    pub(crate) use std::sync::PoisonError;

    pub(crate) const LOOKS_BEFORE_SLEEP: usize = 1;

    pub(crate) fn on_workers(n: usize, work: &(dyn Fn(usize) + Sync), _: &dyn Fn(usize, std::io::Error)) {
        // Shuttle's thread that opened the scope must not wait for anything but its end.
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

    /// Interleavings at random, and such as few changes of thread make (probabilistic concurrency testing).
    pub(crate) fn many_times(test: impl Fn() + Send + Sync + 'static) {
        let test = std::sync::Arc::new(test);
        let n = if std::env::var_os("SLOW_TESTS").is_some() { 30_000 } else { 300 };
        let again = test.clone();
        shuttle::check_random(move || test(), n);
        let beside_nothing = move || {
            // It wants at least two threads, which one worker alone is not.
            let other = shuttle::thread::spawn(shuttle::thread::yield_now);
            again();
            other.join().expect("it does nothing");
        };
        shuttle::check_pct(beside_nothing, n, 3);
    }
}
