//! Clock readings of a node: recorded with the firing, and answered from the recording in a replay.

use crate::{StampNs, host::HostBudget};
use serde::{Deserialize, Serialize};
use std::{
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// A reading of the clock by a firing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClockReading {
    /// The time of day, ns since the Unix epoch.
    Clock {
        /// The time.
        ns: StampNs,
    },
    /// A time budget.
    Budget {
        /// Number of checks that found time left.
        looks: u64,
        /// Whether a check found the time used up.
        over: bool,
    },
    /// For the engine: the value of a port was too old by its arrival.
    Stale {
        /// The port's place among the inputs.
        port: u32,
        /// Its age.
        ns: StampNs,
    },
    /// For the engine: the firing took longer than its deadline.
    Late {
        /// How long it took.
        ns: StampNs,
    },
}

impl ClockReading {
    /// Whether the engine read the clock, not the node.
    fn is_of_engine(&self) -> bool {
        matches!(self, Self::Stale { .. } | Self::Late { .. })
    }
}

/// A time budget of a firing, from [`crate::Context::budget`].
///
/// The clock decides once, when the graph first runs; a replay answers each check as it was answered then. So check the
/// budget where the inputs alone decide, such as at the end of each iteration, and from one thread.
pub struct Budget(Timer);

enum Timer {
    Own(OwnBudget),
    /// In a plugin.
    Host(HostBudget),
}

struct OwnBudget {
    began: Instant,
    limit: Duration,
    checks: Arc<Checks>,
    /// In a replay: the number of checks after which the time was up, if it ever was.
    recorded: Option<Option<u64>>,
}

#[derive(Default)]
struct Checks {
    n: AtomicU64,
    over: AtomicBool,
}

impl Budget {
    pub(crate) fn of_host(budget: HostBudget) -> Self {
        Self(Timer::Host(budget))
    }

    /// Whether the time is up. Once true, it stays true.
    pub fn is_over(&mut self) -> bool {
        match &mut self.0 {
            Timer::Own(budget) => budget.is_over(),
            Timer::Host(budget) => budget.is_over(),
        }
    }
}

impl OwnBudget {
    fn is_over(&mut self) -> bool {
        if self.checks.over.load(Ordering::Relaxed) {
            return true;
        }
        let n = self.checks.n.load(Ordering::Relaxed);
        let over = match self.recorded {
            Some(over_after) => over_after.is_some_and(|after| n >= after),
            None => self.began.elapsed() >= self.limit,
        };
        match over {
            true => self.checks.over.store(true, Ordering::Relaxed),
            false => self.checks.n.store(n + 1, Ordering::Relaxed),
        }
        over
    }
}

/// The clock readings of the current firing.
#[derive(Default)]
pub(crate) struct Readings {
    taken: Vec<Taken>,
    /// In a replay: the recorded readings that remain for this firing.
    recorded: Option<VecDeque<ClockReading>>,
}

enum Taken {
    /// By a node in a process of its own.
    Elsewhere(ClockReading),
    Clock(StampNs),
    Budget(Arc<Checks>),
}

impl Readings {
    /// Begins the next firing.
    pub(crate) fn begin(&mut self) {
        self.taken.clear();
        self.recorded = None;
    }

    pub(crate) fn replay(&mut self, recorded: &[ClockReading]) {
        self.recorded = Some(recorded.iter().filter(|reading| !reading.is_of_engine()).copied().collect());
    }

    /// What a replay has left to answer; none outside a replay.
    pub(crate) fn recorded(&self) -> Option<Vec<ClockReading>> {
        self.recorded.as_ref().map(|recorded| recorded.iter().copied().collect())
    }

    /// Readings that another process took.
    pub(crate) fn add(&mut self, readings: Vec<ClockReading>) {
        self.taken.extend(readings.into_iter().map(Taken::Elsewhere));
    }

    #[inline]
    pub(crate) fn has_any(&self) -> bool {
        !self.taken.is_empty()
    }

    /// The readings since the firing began.
    pub(crate) fn take(&mut self) -> Vec<ClockReading> {
        let reading = |taken| match taken {
            Taken::Elsewhere(reading) => reading,
            Taken::Clock(ns) => ClockReading::Clock { ns },
            Taken::Budget(checks) => ClockReading::Budget {
                looks: checks.n.load(Ordering::Relaxed),
                over: checks.over.load(Ordering::Relaxed),
            },
        };
        self.taken.drain(..).map(reading).collect()
    }

    /// The time, and whether the clock answers although the recording should.
    pub(crate) fn clock(&mut self) -> (StampNs, bool) {
        let (ns, is_missing) = match self.recorded.as_mut().map(VecDeque::pop_front) {
            Some(Some(ClockReading::Clock { ns })) => (ns, false),
            recorded => (now_ns(), recorded.is_some()),
        };
        self.taken.push(Taken::Clock(ns));
        (ns, is_missing)
    }

    /// A budget, and whether the clock decides although the recording should.
    pub(crate) fn budget(&mut self, limit: Duration) -> (Budget, bool) {
        let (recorded, is_missing) = match self.recorded.as_mut().map(VecDeque::pop_front) {
            Some(Some(ClockReading::Budget { looks, over })) => (Some(over.then_some(looks)), false),
            recorded => (None, recorded.is_some()),
        };
        let checks = Arc::new(Checks::default());
        self.taken.push(Taken::Budget(checks.clone()));
        (Budget(Timer::Own(OwnBudget { began: Instant::now(), limit, checks, recorded })), is_missing)
    }
}

fn now_ns() -> StampNs {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    StampNs::try_from(since.as_nanos()).unwrap_or(StampNs::MAX)
}
