use super::ValidatedWire;
use crate::recording::{
    RecordedTypes, codec,
    findings::{Finding, Findings},
    format::{
        Drops, FIRST_NS, Live, MetadataRecord, MetadataRecords, OPENING, Recovered, RunMessage, WireCount, WireCounts,
    },
    number_set::NumberSet,
    scan::{Carried, Gather, PassState},
    wires::{Carries, Wire},
};
use osteoflow_container::{Location, Message};
use osteoflow_node::{Registry, StampNs};
use serde::de::DeserializeOwned;
use std::{
    collections::{BTreeMap, BTreeSet},
    ops::ControlFlow,
};

/// Checks of the recorded wires: numbers without gaps, stamps that never decrease, items that can be decoded.
pub(super) struct Items<'a> {
    registry: &'a Registry,
    types: RecordedTypes,
    wires: BTreeMap<String, Checked>,
    /// Earliest and latest stamp, without those of items that have no time.
    times: Option<(StampNs, StampNs)>,
    /// Wire, number and place of one item without a time, by log time.
    timeless: BTreeMap<u64, (String, u64, Location)>,
    unknown_payloads: BTreeSet<String>,
}

#[derive(Default)]
struct Checked {
    about: Option<Wire>,
    numbers: NumberSet,
    n_values: u64,
    /// Stamps and places of items whose predecessor has not been read yet.
    early: BTreeMap<u64, (StampNs, Location)>,
    next: u64,
    last_stamp_ns: Option<StampNs>,
    views: NumberSet,
}

impl<'a> Items<'a> {
    pub(super) fn new(registry: &'a Registry) -> Self {
        Self {
            registry,
            types: RecordedTypes::default(),
            wires: BTreeMap::new(),
            times: None,
            timeless: BTreeMap::new(),
            unknown_payloads: BTreeSet::new(),
        }
    }

    /// The registry, with the payload types of the recording added.
    pub(super) fn registry(&self) -> Registry {
        self.types.registry(self.registry)
    }

    pub(super) fn has_wires(&self) -> bool {
        self.wires.values().any(|wire| wire.about.is_some())
    }

    fn item(
        &mut self,
        wire: &Wire,
        place: Location,
        message: &Message<'_>,
        PassState { allowance, findings }: &mut PassState,
    ) -> ControlFlow<()> {
        let name = &wire.name;
        let item = match codec::decode(message.data) {
            Ok(item) => item,
            Err(error) => {
                let number = codec::number(message.data);
                findings.add("item", Finding::of(name, number, place, error.to_string()));
                return ControlFlow::Continue(());
            }
        };
        let (number, stamp_ns) = (item.number, item.stamp_ns);
        let mut wrong = |kind: &'static str, what: String| findings.add(kind, Finding::of(name, number, place, what));
        if message.sequence != number as u32 {
            wrong("sequence", format!("its message has sequence {}", message.sequence));
        }
        if stamp_ns > 0 {
            self.times = Some(self.times.map_or((stamp_ns, stamp_ns), |(a, b)| (a.min(stamp_ns), b.max(stamp_ns))));
            if message.log_time != stamp_ns as u64 {
                wrong("log time", format!("its log time is {}, its stamp {stamp_ns}", message.log_time));
            }
        } else if message.log_time == 0 {
            wrong("log time", "its log time is zero, which viewers take for 1970".into());
        } else {
            allowance.take(name.len())?;
            self.timeless.entry(message.log_time).or_insert_with(|| (name.clone(), number, place));
        }
        let is_value = item.body.is_ok();
        if is_value {
            let (payload, version) = item.payload.clone().unwrap_or((wire.header.payload.clone(), wire.header.version));
            let ty = self.registry.payload_type(&payload).filter(|ty| ty.reads(version));
            match ty.or_else(|| self.types.get(&payload, version)) {
                None => drop(self.unknown_payloads.insert(format!("{payload}@{version}"))),
                Some(ty) => {
                    let fits = item.body.as_ref().map_or(Ok(()), |view| view.check(ty.schema));
                    if let Err(error) = fits.and_then(|()| item.into_item(ty)) {
                        wrong("item", format!("it is no {payload}: {error}"));
                    }
                }
            }
        }
        let Some(checked) = self.wires.get_mut(name) else { return ControlFlow::Continue(()) };
        checked.n_values += u64::from(is_value);
        // Items out of order are kept until their turn.
        if number > checked.next {
            allowance.take(0)?;
        }
        if !checked.numbers.insert(number) {
            wrong("number", "the number stands there twice".into());
            return ControlFlow::Continue(());
        }
        checked.early.insert(number, (stamp_ns, place));
        while let Some((stamp_ns, place)) = checked.early.remove(&checked.next) {
            let last = checked.last_stamp_ns.replace(stamp_ns);
            if let Some(last) = last.filter(|last| *last > stamp_ns) {
                let what = format!("its stamp {stamp_ns} is before {last}, that of the item before it");
                findings.add("stamp", Finding::of(name, checked.next, place, what));
            }
            checked.next += 1;
        }
        ControlFlow::Continue(())
    }

    fn view(
        &mut self,
        (wire, encoding): (&str, &str),
        place: Location,
        message: &Message<'_>,
        PassState { allowance, findings }: &mut PassState,
    ) -> ControlFlow<()> {
        let number = u64::from(message.sequence);
        let mut wrong =
            |what: String| findings.add("view", Finding::of(wire, number, place, format!("its picture {what}")));
        match encoding {
            "json" => {
                if let Err(error) = serde_json::from_slice::<serde::de::IgnoredAny>(message.data) {
                    wrong(format!("is no JSON: {error}"));
                }
            }
            "protobuf" if !is_protobuf(message.data) => wrong("is no protobuf".into()),
            _ => {}
        }
        if message.sequence == OPENING {
            return ControlFlow::Continue(());
        }
        let views = &mut self.wires.entry(wire.into()).or_default().views;
        if number > views.len() {
            allowance.take(0)?;
        }
        if !views.insert(number) {
            wrong("stands there twice".into());
        }
        ControlFlow::Continue(())
    }

    /// Compares the wires with the counts in the metadata.
    pub(super) fn finish(&mut self, metadata: &MetadataRecords, findings: &mut Findings, notes: &mut Vec<String>) {
        let recovered = metadata.has::<Recovered>();
        let known_missing = metadata.sound::<Recovered>().unwrap_or_default().missing;
        let stored = metadata.entries(WireCounts::NAME);
        for (name, wire) in &mut self.wires {
            // The first item after a gap is compared with the last one before it.
            let mut last = wire.last_stamp_ns;
            for (number, (stamp_ns, place)) in std::mem::take(&mut wire.early) {
                if let Some(before) = last.replace(stamp_ns).filter(|before| *before > stamp_ns) {
                    let what = format!("its stamp {stamp_ns} is before {before}, that of an item before it");
                    findings.add("stamp", Finding::of(name, number, place, what));
                }
            }
            let count = stored.and_then(|stored| stored.get(name));
            let expected = count.and_then(|stored| WireCounts::parse(stored));
            match (count, expected) {
                (Some(stored), None) => {
                    let what = format!("\"{}\" says \"{stored}\", which is no count", WireCounts::NAME);
                    findings.add("count", Finding::of(name, None, None, what));
                }
                (None, _) if stored.is_some() && wire.about.is_some() => {
                    let what = format!("\"{}\" does not count it", WireCounts::NAME);
                    findings.add("count", Finding::of(name, None, None, what));
                }
                _ => {}
            }
            let holes = wire.numbers.missing(expected.map(|count| count.items));
            let known = known_missing.get(name);
            for hole in holes.iter().filter(|hole| !known.is_some_and(|known| known.contains(hole))) {
                let range =
                    if hole.start() == hole.end() { String::new() } else { format!(", up to item {}", hole.end()) };
                findings.add("hole", Finding::of(name, *hole.start(), None, format!("missing{range}")));
            }
            if let Some(WireCount { items, values }) = expected.filter(|_| !recovered) {
                let found = (wire.numbers.len(), wire.n_values);
                if holes.is_empty() && found != (items, values) {
                    let (n_items, n_values) = found;
                    let what =
                        format!("{items} items and {values} values were counted, {n_items} and {n_values} are there");
                    findings.add("count", Finding::of(name, None, None, what));
                }
            }
            let n_shown = wire.views.len();
            if wire.about.is_none() {
                let what = format!("{n_shown} pictures for viewers, but no exact channel");
                findings.add("view", Finding::of(name, None, None, what));
            } else if n_shown > wire.n_values && !recovered {
                let what = format!("{n_shown} pictures for viewers of {} values", wire.n_values);
                findings.add("view", Finding::of(name, None, None, what));
            }
        }
        for name in stored.into_iter().flat_map(|stored| stored.keys()) {
            if !self.wires.contains_key(name) && !recovered {
                findings.add("count", Finding::of(name, None, None, "it was counted, but has no channel"));
            }
        }
        for (payload, fault) in self.types.faults() {
            findings.add("schema", Finding::new(None, format!("the schema of {payload} is damaged: {fault}")));
        }
        self.check_timeless(stored.is_some(), findings);
        if !self.unknown_payloads.is_empty() {
            let names: Vec<_> = self.unknown_payloads.iter().map(String::as_str).collect();
            notes.push(format!("payloads that are unknown here, so only their form was checked: {}", names.join(", ")));
        }
    }

    /// Checks that each item without a time has a log time within the run. The first of them have that of the first item with a
    /// time, which is written after them and may be lost if the run did not end.
    fn check_timeless(&self, has_end: bool, findings: &mut Findings) {
        let is_first = |log_time: u64| (1..=FIRST_NS as u64).contains(&log_time);
        for (&log_time, (wire, number, place)) in &self.timeless {
            let fits = match self.times {
                Some((first, last)) => is_first(log_time) || (first as u64..=last as u64).contains(&log_time),
                None => !has_end || is_first(log_time),
            };
            if !fits {
                let what = format!("it has no time of its own, and its log time {log_time} is no time of the run");
                findings.add("log time", Finding::of(wire, *number, *place, what));
            }
        }
    }

    pub(super) fn wires(&self) -> Vec<ValidatedWire> {
        let wires = self.wires.iter().filter_map(|(name, wire)| {
            let about = wire.about.as_ref()?;
            Some(ValidatedWire {
                wire: name.clone(),
                payload: format!("{}@{}", about.header.payload, about.header.version),
                n_items: wire.numbers.len(),
                n_values: wire.n_values,
                n_views: wire.views.len(),
            })
        });
        wires.collect()
    }
}

impl Gather for Items<'_> {
    fn wire(&mut self, wire: &Wire) {
        self.types.add(wire);
        self.wires.entry(wire.name.clone()).or_default().about.get_or_insert_with(|| wire.clone());
    }

    fn message(&mut self, carried: Carried<'_>, state: &mut PassState) -> ControlFlow<()> {
        let Carried { carries, message, place, .. } = carried;
        match carries {
            Carries::Exact(wire) => self.item(wire, place, message, state),
            Carries::View { wire, encoding } => self.view((wire, encoding), place, message, state),
            Carries::Drops => about_the_run::<Drops>(place, message, state),
            Carries::Live => about_the_run::<Live>(place, message, state),
            Carries::Other => ControlFlow::Continue(()),
        }
    }
}

/// Checks a message about the run that a replay needs.
fn about_the_run<M: RunMessage + DeserializeOwned>(
    place: Location,
    message: &Message<'_>,
    state: &mut PassState,
) -> ControlFlow<()> {
    if let Err(fault) = M::read(message.data) {
        state.findings.add("run", Finding::new(place, fault));
    }
    ControlFlow::Continue(())
}

/// Whether the bytes are a well-formed protobuf message: complete fields of known wire types.
fn is_protobuf(bytes: &[u8]) -> bool {
    if bytes.is_empty() {
        return true;
    }
    fn varint(bytes: &mut &[u8]) -> Option<u64> {
        let mut value = 0_u64;
        for shift in (0..70).step_by(7) {
            let (&byte, rest) = bytes.split_first()?;
            *bytes = rest;
            value |= u64::from(byte & 0x7f).checked_shl(shift)?;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }
    let mut bytes = bytes;
    let mut field = || {
        let key = varint(&mut bytes)?;
        let n = match key & 7 {
            0 => varint(&mut bytes).map(|_| 0)?,
            1 => 8,
            2 => usize::try_from(varint(&mut bytes)?).ok()?,
            5 => 4,
            _ => return None,
        };
        bytes = bytes.get(n..).filter(|_| key >> 3 != 0)?;
        Some(bytes.is_empty())
    };
    loop {
        match field() {
            Some(true) => return true,
            Some(false) => {}
            None => return false,
        }
    }
}
