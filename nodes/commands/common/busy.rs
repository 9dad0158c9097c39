//! Which call of a node has been under way for longest, found by looking at all threads again and again.

use osteoflow_engine::activity::{self, Call, Doing};
use std::time::{Duration, Instant};

/// Interval at which the threads are looked at.
pub(crate) const LOOK: Duration = Duration::from_millis(250);

/// The calls under way at the last look, each with the time of the look that first found it.
#[derive(Default)]
pub(crate) struct Busy(Vec<(usize, Call, Instant)>);

/// A call that has been under way for some time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Longest {
    call: Call,
    /// Since when; up to [`LOOK`] later than it began.
    pub(crate) took: Duration,
}

impl Busy {
    /// Looks at all threads.
    pub(crate) fn look(&mut self) {
        let now = Instant::now();
        // A live source that waits for its device is reported by the engine.
        let calls = activity::everywhere().filter(|(_, call)| call.doing != Doing::Waiting);
        let calls = calls.map(|(thread, call)| {
            let known = self.0.iter().find(|(other, before, _)| (*other, before) == (thread, &call));
            (thread, call, known.map_or(now, |(.., since)| *since))
        });
        self.0 = calls.collect();
    }

    /// The call that has been under way for longest.
    pub(crate) fn longest(&self) -> Option<Longest> {
        let (_, call, since) = self.0.iter().min_by_key(|(.., since)| *since)?;
        Some(Longest { call: *call, took: since.elapsed() })
    }
}

impl std::fmt::Display for Longest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Call { node, item, doing, .. } = self.call;
        match doing {
            Doing::Firing | Doing::Waiting => write!(f, "node \"{node}\", item {item}")?,
            Doing::Building => write!(f, "node \"{node}\", which is built")?,
            Doing::Destroying | Doing::Closing => write!(f, "node \"{node}\", which is destroyed")?,
        }
        write!(f, ", busy for {} s", self.took.as_secs())
    }
}
