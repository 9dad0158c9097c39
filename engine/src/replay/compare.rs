//! Compares computed items with the recorded ones as they arrive.

use super::{Difference, WireComparison, WirePart};
use crate::{
    diff,
    plan::{OutputId, Plan},
    recording::{Recording, codec},
    runtime::Tap,
};
use osteoflow_node::{Item, PayloadType, PortPayload};
use std::{
    collections::BTreeMap,
    sync::{Mutex, PoisonError},
};

/// Tap on the wires that are in both the recording and the plan.
pub(super) struct Compare<'a> {
    wires: BTreeMap<OutputId, ComparedWire<'a>>,
}

struct ComparedWire<'a> {
    /// Recorded items; `None` where nothing is compared.
    recorded: Option<&'a [Vec<u8>]>,
    /// Why its items cannot be compared.
    not_comparable: Option<String>,
    payload: PortPayload,
    /// Whether the recording was cut short.
    partial: bool,
    tally: Mutex<Tally>,
}

#[derive(Default)]
struct Tally {
    n_items: u64,
    n_compared: u64,
    /// Later items cannot be compared.
    over: bool,
    first: Option<Difference>,
}

impl<'a> Compare<'a> {
    /// Compares the recorded wires of computed nodes, if `compares`.
    pub(super) fn new(plan: &Plan, recording: &'a Recording, computed: impl Fn(usize) -> bool, compares: bool) -> Self {
        let wire = |id: &OutputId| {
            let recorded = recording.wires.get(&plan.wire_name(*id));
            let payload = plan.nodes[id.node].outputs[id.port].payload;
            let other = recorded.filter(|wire| !wire.is_of(payload)).map(|wire| &wire.payload);
            let is_compared = compares && computed(id.node) && other.is_none();
            let wire = ComparedWire {
                recorded: recorded.filter(|_| is_compared).map(|wire| &*wire.messages),
                not_comparable: other.map(|other| format!("{other} was recorded, {} is given now", payload.name())),
                payload,
                partial: recording.interrupted || recording.truncated.is_some(),
                tally: Mutex::default(),
            };
            (*id, wire)
        };
        Self { wires: plan.record.iter().map(wire).collect() }
    }

    /// Result for a recorded wire.
    pub(super) fn of(&self, name: &str, recording: &Recording, id: Option<OutputId>, part: WirePart) -> WireComparison {
        let n_recorded = recording.wires[name].messages.len() as u64;
        let mut comparison = WireComparison {
            wire: name.into(),
            part,
            n_recorded,
            n_replayed: 0,
            n_compared: 0,
            first_difference: None,
            not_comparable: None,
        };
        let Some(wire) = id.and_then(|id| self.wires.get(&id)) else { return comparison };
        let tally = wire.tally.lock().unwrap_or_else(PoisonError::into_inner);
        (comparison.n_replayed, comparison.n_compared) = (tally.n_items, tally.n_compared);
        comparison.first_difference.clone_from(&tally.first);
        comparison.not_comparable.clone_from(&wire.not_comparable);
        // In a run that was cut short, wires end at different times; this is not a difference.
        if wire.recorded.is_some() && !wire.partial && tally.first.is_none() && n_recorded != tally.n_items {
            let what = diff::Difference::other("items", n_recorded.to_string(), tally.n_items.to_string());
            comparison.first_difference = Some(Difference { item: n_recorded.min(tally.n_items), what });
        }
        comparison
    }
}

impl Tap for Compare<'_> {
    fn listens(&self, wire: OutputId) -> bool {
        self.wires.contains_key(&wire)
    }

    fn item(&self, wire: OutputId, item: &Item) {
        let Some(wire) = self.wires.get(&wire) else { return };
        let mut tally = wire.tally.lock().unwrap_or_else(PoisonError::into_inner);
        tally.n_items += 1;
        if tally.over || tally.first.is_some() {
            return;
        }
        let recorded = wire.recorded.and_then(|recorded| recorded.get(usize::try_from(item.number).ok()?));
        let Some(recorded) = recorded else { return };
        let bytes = codec::encode_on(wire.payload, item);
        if *recorded == bytes {
            tally.n_compared += 1;
        } else if wire.partial && stopped(recorded, &bytes) {
            // A stop request ended the computation.
            tally.over = true;
        } else {
            tally.n_compared += 1;
            let units = wire.payload.ty().map(PayloadType::units).unwrap_or_default();
            let what = diff::first_difference(recorded, &bytes, &units);
            tally.first = what.map(|what| Difference { item: item.number, what });
        }
    }
}

/// Whether an item was recorded as empty and now has a value.
fn stopped(recorded: &[u8], replayed: &[u8]) -> bool {
    let is_empty = |bytes| codec::head(bytes).is_some_and(|head| head.is_empty);
    is_empty(recorded) && !is_empty(replayed)
}
