//! Compares what is computed anew with what was recorded, as it comes.

use super::{Difference, WireComparison, WirePart};
use crate::{
    codec,
    plan::{OutputId, Plan},
    recording::Recording,
    run::Tap,
};
use osteoflow_node::{Item, PortPayload, StampNs};
use std::{
    collections::BTreeMap,
    sync::{Mutex, PoisonError},
};

/// A tap on the wires that both the recording and the plan have.
pub(super) struct Compare<'a> {
    wires: BTreeMap<OutputId, Wire<'a>>,
}

struct Wire<'a> {
    /// The recorded items; none where nothing is to be compared.
    recorded: Option<&'a [Vec<u8>]>,
    payload: PortPayload,
    /// Only a part of the run was recorded to its end.
    partial: bool,
    seen: Mutex<Seen>,
}

#[derive(Default)]
struct Seen {
    n_items: u64,
    n_compared: u64,
    /// What follows cannot be compared.
    over: bool,
    first: Option<Difference>,
}

impl<'a> Compare<'a> {
    /// Compares the recorded wires of those nodes that are computed, if `compares`.
    pub(super) fn new(plan: &Plan, recording: &'a Recording, computed: impl Fn(usize) -> bool, compares: bool) -> Self {
        let wire = |id: &OutputId| {
            let recorded = recording.wires.get(&plan.wire_name(*id)).map(|wire| &*wire.messages);
            let wire = Wire {
                recorded: recorded.filter(|_| compares && computed(id.node)),
                payload: plan.nodes[id.node].outputs[id.port].payload,
                partial: recording.interrupted || recording.truncated.is_some(),
                seen: Mutex::default(),
            };
            (*id, wire)
        };
        Self { wires: plan.record.iter().map(wire).collect() }
    }

    /// What came of a wire that was recorded.
    pub(super) fn of(&self, name: &str, recording: &Recording, id: Option<OutputId>, part: WirePart) -> WireComparison {
        let n_recorded = recording.wires[name].messages.len() as u64;
        let mut comparison = WireComparison {
            wire: name.into(),
            part,
            n_recorded,
            n_replayed: 0,
            n_compared: 0,
            first_difference: None,
        };
        let Some(wire) = id.and_then(|id| self.wires.get(&id)) else { return comparison };
        let seen = wire.seen.lock().unwrap_or_else(PoisonError::into_inner);
        (comparison.n_replayed, comparison.n_compared) = (seen.n_items, seen.n_compared);
        comparison.first_difference.clone_from(&seen.first);
        // Of a run that did not come to its end, wires end at different times, and nothing follows from that.
        if wire.recorded.is_some() && !wire.partial && seen.first.is_none() && n_recorded != seen.n_items {
            let what = format!("{n_recorded} items were recorded, {} came", seen.n_items);
            comparison.first_difference = Some(Difference { item: n_recorded.min(seen.n_items), what });
        }
        comparison
    }
}

impl Tap for Compare<'_> {
    fn item(&self, wire: OutputId, item: &Item) {
        let Some(wire) = self.wires.get(&wire) else { return };
        let mut seen = wire.seen.lock().unwrap_or_else(PoisonError::into_inner);
        seen.n_items += 1;
        if seen.over || seen.first.is_some() {
            return;
        }
        let recorded = wire.recorded.and_then(|recorded| recorded.get(usize::try_from(item.number).ok()?));
        let Some(recorded) = recorded else { return };
        let bytes = codec::encode_on(wire.payload, item);
        if *recorded == bytes {
            seen.n_compared += 1;
        } else if wire.partial && stopped(recorded, &bytes) {
            // The wish to stop had ended the computation.
            seen.over = true;
        } else {
            seen.n_compared += 1;
            seen.first = Some(Difference { item: item.number, what: difference(recorded, &bytes) });
        }
    }
}

/// Whether an item was recorded as empty and now has a value.
fn stopped(recorded: &[u8], replayed: &[u8]) -> bool {
    let is_empty = |bytes| codec::head(bytes).is_some_and(|head| head.is_empty);
    is_empty(recorded) && !is_empty(replayed)
}

/// What differs first in two messages of one number.
fn difference(recorded: &[u8], replayed: &[u8]) -> String {
    let (Ok(a), Ok(b)) = (codec::decode(recorded), codec::decode(replayed)) else {
        return "the recorded item is damaged".into();
    };
    let stamp = |stamp_ns: StampNs| format!("stamp {stamp_ns} ns");
    if a.stamp_ns != b.stamp_ns {
        return format!("{} was recorded, {} came", stamp(a.stamp_ns), stamp(b.stamp_ns));
    }
    match (a.body, b.body) {
        (Ok(a), Ok(b)) => {
            let field = a.head.iter().zip(&b.head).find(|(a, b)| a != b);
            let column = a.columns.iter().zip(&b.columns).find(|(a, b)| a != b);
            match (field, column) {
                (Some(((name, a), (_, b))), _) => format!("{name} was {a:?}, is {b:?}"),
                (None, Some((a, b))) => {
                    format!("column {} differs: {} rows were recorded, {} came", a.name, a.rows(), b.rows())
                }
                (None, None) => {
                    "the views have different parts, or differ in the sign of a zero or the bits of a NaN".into()
                }
            }
        }
        (Err(a), Err(b)) => format!("it was empty ({}), and is for another reason ({})", a.reason, b.reason),
        (Ok(_), Err(empty)) => format!("a value was recorded, none came: {}", empty.reason),
        (Err(empty), Ok(_)) => format!("a value came where none was recorded: {}", empty.reason),
    }
}
