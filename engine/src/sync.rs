//! The synchronisation that the scheduler is built of: the standard library's. A test that includes the scheduler's
//! source brings a module of the same names, made by a model checker.

pub(crate) use std::sync::{Condvar, Mutex, MutexGuard, PoisonError, atomic};

/// How often a worker looks before it sleeps: some microseconds, less than waking it costs.
pub(crate) const LOOKS_BEFORE_SLEEP: usize = 200;

/// Calls `work` with 0 on the calling thread and with 1 and so on on threads of their own, and returns when all have; a
/// thread that could not be started is told to `without`.
pub(crate) fn on_workers(n: usize, work: &(dyn Fn(usize) + Sync), without: &dyn Fn(usize, std::io::Error)) {
    std::thread::scope(|scope| {
        for worker in 1..n {
            // As much stack as the main thread has: a node must not care where it runs.
            let thread = std::thread::Builder::new().name(format!("worker-{worker}")).stack_size(8 << 20);
            if let Err(error) = thread.spawn_scoped(scope, move || work(worker)) {
                without(worker, error);
            }
        }
        work(0);
    });
}

/// Lets others go first: the larger the number, the longer.
pub(crate) fn delay(length: usize) {
    match length {
        0..100 => std::thread::yield_now(),
        100..190 => (0..length * 20).for_each(|_| std::hint::spin_loop()),
        _ => std::thread::sleep(std::time::Duration::from_micros(length as u64 / 4)),
    }
}

/// Repeats what may come out differently; a model checker has its own way to do so.
#[cfg(test)]
pub(crate) fn many_times(test: impl Fn() + Send + Sync + 'static) {
    (0..50).for_each(|_| test());
}

/// Calls `a` on a thread of its own and `b` on this one, and returns when both have.
#[cfg(test)]
pub(crate) fn beside(a: &(dyn Fn() + Sync), b: &(dyn Fn() + Sync)) {
    std::thread::scope(|scope| {
        scope.spawn(a);
        b();
    });
}
