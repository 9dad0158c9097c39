//! A finished run, with the items that results are made of.

use crate::{
    plan::{OutputId, Plan},
    repro::Saved,
    runtime::{RunOutcome, Tap},
};
use osteoflow_node::Item;
use std::sync::{Mutex, PoisonError};

/// A finished run.
pub(crate) struct Finished {
    pub(crate) ended: RunOutcome,
    /// By node and output.
    pub(crate) outputs: Vec<Vec<WireItems>>,
    /// Saved failed items.
    pub(crate) saved: Saved,
}

/// The items kept of a wire.
#[derive(Debug, Default, Clone)]
pub(crate) struct WireItems {
    /// Number of items that the wire carried.
    pub(crate) n_items: u64,
    /// Number of items that are values.
    pub(crate) n_values: u64,
    /// Kept items, in order.
    pub(crate) items: Vec<Item>,
}

/// Which items of a wire are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Keep {
    Nothing,
    Last,
    All,
}

/// Tap that keeps the items that results are made of.
pub(crate) struct ItemKeeper(Vec<Vec<(Keep, Mutex<Vec<Item>>)>>);

impl ItemKeeper {
    /// Keeps the items that `[results]` names, or with `all` every item of every wire.
    pub(crate) fn new(plan: &Plan, all: bool) -> Self {
        let least = if all { Keep::All } else { Keep::Nothing };
        let keep = |id: OutputId| {
            let entries = plan.results.iter().filter(|entry| entry.from == id);
            let keep = entries.map(|entry| if entry.all { Keep::All } else { Keep::Last }).max();
            (keep.map_or(least, |keep| keep.max(least)), Mutex::default())
        };
        Self((0..plan.nodes.len()).map(|node| plan.outputs(node).map(keep).collect()).collect())
    }

    /// Combines the outcome of the run with the kept items.
    pub(crate) fn finish(self, ended: RunOutcome, saved: Saved) -> Finished {
        let wire = |node: usize, port: usize, items: Mutex<Vec<Item>>| WireItems {
            n_items: ended.n_items[node][port],
            n_values: ended.n_values[node][port],
            items: items.into_inner().unwrap_or_else(PoisonError::into_inner),
        };
        let outputs = self.0.into_iter().enumerate().map(|(node, kept)| {
            kept.into_iter().enumerate().map(|(port, (_, items))| wire(node, port, items)).collect()
        });
        let outputs = outputs.collect();
        Finished { ended, outputs, saved }
    }
}

impl Tap for ItemKeeper {
    fn listens(&self, wire: OutputId) -> bool {
        self.0[wire.node][wire.port].0 != Keep::Nothing
    }

    fn item(&self, wire: OutputId, item: &Item) {
        let (keep, items) = &self.0[wire.node][wire.port];
        let mut items = items.lock().unwrap_or_else(PoisonError::into_inner);
        if *keep == Keep::Last {
            items.clear();
        }
        items.push(item.clone());
    }
}
