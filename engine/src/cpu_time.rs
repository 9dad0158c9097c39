//! Processor time of a thread, and of the processes that compute for it.

use crate::runtime::CpuClock;
use std::{cell::Cell, time::Duration};

thread_local! {
    /// What other processes have spent on firings of nodes that this thread waited for.
    static APART: Cell<Duration> = const { Cell::new(Duration::ZERO) };
}

/// The clock of firings; none on systems without one for threads.
#[cfg(unix)]
pub(crate) const CPU_CLOCK: Option<CpuClock> = Some(|| now(rustix::time::ClockId::ThreadCPUTime) + APART.get());
#[cfg(not(unix))]
pub(crate) const CPU_CLOCK: Option<CpuClock> = None;

/// Adds what a process has spent on a firing that this thread waited for.
#[cfg(unix)]
pub(crate) fn add_apart(spent: Duration) {
    APART.set(APART.get().saturating_add(spent));
}

/// The processor time of this process, on all threads.
#[cfg(unix)]
pub(crate) fn of_process() -> Duration {
    now(rustix::time::ClockId::ProcessCPUTime)
}

#[cfg(unix)]
fn now(clock: rustix::time::ClockId) -> Duration {
    Duration::try_from(rustix::time::clock_gettime(clock)).unwrap_or_default()
}
