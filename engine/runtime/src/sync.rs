//! Synchronisation primitives of the scheduler, from the standard library. The model-checking test includes the
//! scheduler's source with a module of the same names from a model checker.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
pub(crate) use std::sync::{Condvar, Mutex, MutexGuard, PoisonError, atomic};

/// Number of polls before a worker sleeps: some microseconds, less than a wake-up costs.
pub(crate) const LOOKS_BEFORE_SLEEP: usize = 200;

pub(crate) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A poisoned lock means that a worker is already unwinding; its panic is the one to report.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Calls `work` with 0 on the calling thread and with 1.. on new threads, and returns when all have finished; `without`
/// is called for each thread that could not be started.
///
/// # Panics
/// With the first panic of `work`, on whichever thread, once all have finished.
pub fn on_workers(n: usize, work: &(dyn Fn(usize) + Sync), without: &dyn Fn(usize, std::io::Error)) {
    // A scope alone would replace the panic of another thread by a message of its own.
    let panicked = Mutex::new(None);
    let work = |worker| {
        if let Err(payload) = catch_unwind(AssertUnwindSafe(|| work(worker))) {
            panicked.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(payload);
        }
    };
    let work = &work;
    std::thread::scope(|scope| {
        for worker in 1..n {
            // The stack size of the main thread, so that nodes run equally on every thread.
            let thread = std::thread::Builder::new().name(format!("worker-{worker}")).stack_size(8 << 20);
            if let Err(error) = thread.spawn_scoped(scope, move || work(worker)) {
                without(worker, error);
            }
        }
        work(0);
    });
    if let Some(payload) = panicked.into_inner().unwrap_or_else(PoisonError::into_inner) {
        resume_unwind(payload);
    }
}

/// Yields to other threads; a larger number waits longer.
pub(crate) fn delay(length: usize) {
    match length {
        0..100 => std::thread::yield_now(),
        100..190 => (0..length * 20).for_each(|_| std::hint::spin_loop()),
        _ => std::thread::sleep(std::time::Duration::from_micros(length as u64 / 4)),
    }
}

/// Repeats a test whose outcome may vary; a model checker explores the outcomes itself.
#[cfg(test)]
pub(crate) fn many_times(test: impl Fn() + Send + Sync + 'static) {
    (0..50).for_each(|_| test());
}

/// Calls `a` on a new thread and `b` on this one, and returns when both have finished.
#[cfg(test)]
pub(crate) fn beside(a: &(dyn Fn() + Sync), b: &(dyn Fn() + Sync)) {
    std::thread::scope(|scope| {
        scope.spawn(a);
        b();
    });
}
