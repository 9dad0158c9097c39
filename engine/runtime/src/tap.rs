//! Taps, which listen to a run, and what a replay substitutes.

use crate::{inject::Injected, plan::OutputId, sign::Sign};
use osteoflow_node::{AnySource, ClockReading, Item, Joined, StampNs};
use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

/// Sources that replace the plan's, by the index of the node.
pub type Substitutes = BTreeMap<usize, Box<dyn AnySource>>;

/// Recorded values that a replay uses instead of devices, policies and the clock.
#[derive(Default)]
pub struct Replayed {
    /// Sources that play recorded items.
    pub substitutes: Substitutes,
    /// Numbers of the items to drop, by the index of the link; a link that is missing drops none. `None`: policies
    /// decide.
    pub drops: Option<BTreeMap<usize, BTreeSet<u64>>>,
    /// Clock readings, by the index of the node and the number of the firing; a firing that is missing had none.
    /// `None`: the clock answers.
    pub readings: Option<BTreeMap<(usize, u64), Vec<ClockReading>>>,
    /// The signs that nodes gave whose recorded items are played.
    pub signs: Vec<Sign>,
}

/// Listener to a run. It does not affect the run.
pub trait Tap: Sync {
    /// Whether it receives the items of this wire.
    fn listens(&self, _wire: OutputId) -> bool {
        false
    }

    /// Whether it receives firings; each is then timed on its own.
    fn times_firings(&self) -> bool {
        false
    }

    /// An item was put on a wire that this tap listens to; called in order along each wire.
    fn item(&self, _wire: OutputId, _item: &Item) {}

    /// A node fired at this stamp, or a source answered. `began` counts from the start of the run.
    fn fired(&self, _node: usize, _item: u64, _stamp_ns: StampNs, _began: Duration, _took: Duration) {}

    /// Clock readings of a firing, or of an answer of a source that is not live; called once, when it is over.
    fn live(&self, _node: usize, _item: u64, _readings: &[ClockReading]) {}

    /// The policy of a link, by its index in the plan, dropped the item with this number. Called for every link,
    /// recorded or not, in the order of the numbers along a link.
    fn dropped(&self, _link: usize, _number: u64) {}

    /// A node warned at the activation with this number, from 0.
    fn warned(&self, _node: usize, _item: u64, _message: &str) {}

    /// A firing failed; its items are still joined. Returns a warning for the node, for example that they could not be
    /// saved.
    fn failed(&self, _failed: &Failed<'_>) -> Option<String> {
        None
    }
}

/// A firing that failed.
pub struct Failed<'a> {
    /// Index into the plan.
    pub node: usize,
    /// Number of the activation, from 0.
    pub item: u64,
    /// Its stamp.
    pub stamp_ns: StampNs,
    /// What the ports brought; `None` for a source.
    pub joined: Option<&'a Joined>,
    /// The message.
    pub reason: &'a str,
    /// Whether it panicked.
    pub panicked: bool,
    /// How the failure was injected, if it was.
    pub injected: Option<Injected>,
}
