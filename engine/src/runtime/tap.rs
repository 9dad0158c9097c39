//! What may listen to a run, and what a replay puts in its place.

use super::Injected;
use crate::plan::OutputId;
use osteoflow_node::{AnySource, ClockReading, Item, Joined, StampNs};
use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

/// Sources that take the place of the plan's, by the index of the node.
pub(crate) type Substitutes = BTreeMap<usize, Box<dyn AnySource>>;

/// What a replay takes from the record, where a run asks the world.
#[derive(Default)]
pub(crate) struct Replayed {
    /// What plays in the place of sources.
    pub(crate) substitutes: Substitutes,
    /// The numbers of the items that policies dropped, by the index of the link; a link that is not named dropped none.
    /// `None`: policies decide.
    pub(crate) drops: Option<BTreeMap<usize, BTreeSet<u64>>>,
    /// What firings took from the clock, by the index of the node and the number of the firing; one that is not named took
    /// nothing. `None`: the clock answers.
    pub(crate) readings: Option<BTreeMap<(usize, u64), Vec<ClockReading>>>,
}

/// Listens to a run and changes nothing in it.
pub(crate) trait Tap: Sync {
    /// Whether it is given the items of this wire.
    fn listens(&self, _wire: OutputId) -> bool {
        false
    }

    /// Whether it is given firings; each is then timed by itself.
    fn times_firings(&self) -> bool {
        false
    }

    /// An item has been put on a wire that it listens to; in order along each wire.
    fn item(&self, _wire: OutputId, _item: &Item) {}

    /// A node fired at this stamp, or a source answered: when, since the run began, and for how long.
    fn fired(&self, _node: usize, _item: u64, _stamp_ns: StampNs, _began: Duration, _took: Duration) {}

    /// What a firing, or an answer of a source that is not live, took from the clock; once, when it is over.
    fn live(&self, _node: usize, _item: u64, _readings: &[ClockReading]) {}

    /// The policy of a link, by its index in the plan, has dropped the item with this number; on any link, recorded or
    /// not. In the order of the numbers along a link.
    fn dropped(&self, _link: usize, _number: u64) {}

    /// A firing has failed; its items are still joined. Answers a warning for the node, such as that they could not be
    /// saved.
    fn failed(&self, _failed: &Failed<'_>) -> Option<String> {
        None
    }
}

/// A firing that failed.
pub(crate) struct Failed<'a> {
    /// Index into the plan.
    pub(crate) node: usize,
    pub(crate) item: u64,
    pub(crate) stamp_ns: StampNs,
    /// What the ports brought; `None` for a source.
    pub(crate) joined: Option<&'a Joined>,
    pub(crate) reason: &'a str,
    pub(crate) panicked: bool,
    /// How it was made to fail, if it was.
    pub(crate) injected: Option<Injected>,
}
