//! What a node takes from the world's clock: data of the run, recorded with the firing and answered from the record in a
//! replay.

use crate::{StampNs, plugin::HostBudget};
use serde::{Deserialize, Serialize};
use std::{
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// One thing that a firing took from the clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Reading {
    /// The time of day, ns since the Unix epoch.
    Clock {
        /// The answer.
        ns: StampNs,
    },
    /// A time budget.
    Budget {
        /// How often it was looked at before it was over, or in all if it never was.
        looks: u64,
        /// Whether a look found it over.
        over: bool,
    },
}

/// A time budget of a firing, from [`crate::Context::budget`].
///
/// Whether it is over is decided by the clock once, when the graph first runs; a replay answers every look as it was
/// answered then. So look at it at places that the inputs alone decide, such as the end of each iteration, and from one
/// thread.
pub struct Budget(Keeper);

/// Who looks at the clock.
enum Keeper {
    Own(OwnBudget),
    /// Of a plugin's firing.
    Host(HostBudget),
}

struct OwnBudget {
    began: Instant,
    limit: Duration,
    looks: Arc<Looks>,
    /// What the record says: after how many looks it was over, or that it never was.
    recorded: Option<Option<u64>>,
}

#[derive(Default)]
struct Looks {
    n: AtomicU64,
    over: AtomicBool,
}

impl Budget {
    pub(crate) fn of_host(budget: HostBudget) -> Self {
        Self(Keeper::Host(budget))
    }

    /// Whether the time is up; from then on always.
    pub fn is_over(&mut self) -> bool {
        match &mut self.0 {
            Keeper::Own(budget) => budget.is_over(),
            Keeper::Host(budget) => budget.is_over(),
        }
    }
}

impl OwnBudget {
    fn is_over(&mut self) -> bool {
        if self.looks.over.load(Ordering::Relaxed) {
            return true;
        }
        let n = self.looks.n.load(Ordering::Relaxed);
        let over = match self.recorded {
            Some(over_after) => over_after.is_some_and(|after| n >= after),
            None => self.began.elapsed() >= self.limit,
        };
        match over {
            true => self.looks.over.store(true, Ordering::Relaxed),
            false => self.looks.n.store(n + 1, Ordering::Relaxed),
        }
        over
    }
}

/// The readings of the firing at hand.
#[derive(Default)]
pub(crate) struct Readings {
    taken: Vec<Taken>,
    /// In a replay: what the record still holds for this firing.
    recorded: Option<VecDeque<Reading>>,
}

enum Taken {
    Clock(StampNs),
    Budget(Arc<Looks>),
}

/// The record holds no such reading; the clock has answered.
pub(crate) struct NotRecorded;

impl Readings {
    /// The next firing begins; in a replay with what the record holds for it.
    pub(crate) fn begin(&mut self) {
        self.taken.clear();
        self.recorded = None;
    }

    pub(crate) fn give(&mut self, recorded: &[Reading]) {
        self.recorded = Some(recorded.iter().copied().collect());
    }

    #[inline]
    pub(crate) fn has_any(&self) -> bool {
        !self.taken.is_empty()
    }

    /// What was taken since the firing began.
    pub(crate) fn take(&mut self) -> Vec<Reading> {
        let told = |taken| match taken {
            Taken::Clock(ns) => Reading::Clock { ns },
            Taken::Budget(looks) => {
                Reading::Budget { looks: looks.n.load(Ordering::Relaxed), over: looks.over.load(Ordering::Relaxed) }
            }
        };
        self.taken.drain(..).map(told).collect()
    }

    pub(crate) fn clock(&mut self) -> (StampNs, Option<NotRecorded>) {
        let (ns, missing) = match self.recorded.as_mut().map(VecDeque::pop_front) {
            Some(Some(Reading::Clock { ns })) => (ns, None),
            Some(_) => (now_ns(), Some(NotRecorded)),
            None => (now_ns(), None),
        };
        self.taken.push(Taken::Clock(ns));
        (ns, missing)
    }

    pub(crate) fn budget(&mut self, limit: Duration) -> (Budget, Option<NotRecorded>) {
        let (recorded, missing) = match self.recorded.as_mut().map(VecDeque::pop_front) {
            Some(Some(Reading::Budget { looks, over })) => (Some(over.then_some(looks)), None),
            Some(_) => (None, Some(NotRecorded)),
            None => (None, None),
        };
        let looks = Arc::new(Looks::default());
        self.taken.push(Taken::Budget(looks.clone()));
        (Budget(Keeper::Own(OwnBudget { began: Instant::now(), limit, looks, recorded })), missing)
    }
}

fn now_ns() -> StampNs {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    StampNs::try_from(since.as_nanos()).unwrap_or(StampNs::MAX)
}
