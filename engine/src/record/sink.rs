use super::{DROPS_TOPIC, EXACT_ENCODING, EXACT_TOPIC, Firing, LIVE_TOPIC, RecordError, TIMING_TOPIC, VIEW_TOPIC};
use crate::{
    plan::{OutputId, Plan},
    recording::codec,
};
use osteoflow_container::{MessageHeader, Writer};
use osteoflow_node::{Body, ClockReading, Item, PayloadType, PortPayload, Role, StampNs};
use serde_json::{Value as Json, json};
use std::{collections::BTreeMap, fmt::Write, fs::File, io};

/// A reader takes no longer record; an item has to leave room for what else its chunk holds.
const MAX_ITEM_BYTES: usize = (1 << 30) - (16 << 20);
/// So much waits at most for the first stamp that is a time.
const MAX_WAITING_BYTES: usize = 64 << 20;

/// The channels of a recording, and what they have carried.
pub(super) struct Sink {
    pub(super) file: Writer<File>,
    wires: BTreeMap<OutputId, Wire>,
    nodes: Vec<String>,
    links: Vec<(String, String)>,
    /// The latest time written. Before the first stamp that is a time there is none, and constants, which have no time
    /// of their own, wait for it: viewers are shown them from then on.
    time_ns: Option<u64>,
    waiting: Vec<Waiting>,
    n_waiting_bytes: usize,
    /// The channels of the run itself, by topic, with how many messages each has carried.
    told: BTreeMap<&'static str, (u16, u32)>,
}

enum Waiting {
    Item(OutputId, Item),
    Told(&'static str, Vec<u8>),
}

struct Wire {
    name: String,
    exact: u16,
    view: Option<u16>,
    payload: PortPayload,
    n_items: u64,
    n_values: u64,
}

/// What ends a writer before its time.
pub(super) enum Stopped {
    Io(io::Error),
    Panic(String),
    TooLong { wire: String, number: u64, n_bytes: usize },
}

impl From<io::Error> for Stopped {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl Stopped {
    pub(super) fn told(self, path: &std::path::Path) -> RecordError {
        let path = path.into();
        match self {
            Self::Io(source) => RecordError::Write { path, source },
            Self::Panic(said) => RecordError::Panicked { path, said },
            Self::TooLong { wire, number, n_bytes } => RecordError::TooLong { path, wire, number, n_bytes },
        }
    }
}

impl Sink {
    /// Adds the channels of the recorded wires.
    pub(super) fn begin(mut file: Writer<File>, plan: &Plan) -> io::Result<Self> {
        let mut wires = BTreeMap::new();
        let views = plan.recording.views;
        for &id in &plan.record {
            let (node, output) = (&plan.nodes[id.node], &plan.nodes[id.node].outputs[id.port]);
            let name = plan.wire_name(id);
            let ty = match output.payload {
                PortPayload::Type(ty) => Some(ty),
                PortPayload::Any => None,
            };
            let (payload, version) = ty.map_or(("any", 0), |ty| (ty.name, ty.version));
            let units = ty.map(PayloadType::units).unwrap_or_default();
            let units: serde_json::Map<_, _> =
                units.into_iter().map(|(name, unit)| (name.into(), unit.into())).collect();
            let schema = file.add_schema(&format!("{payload}@{version}"), EXACT_ENCODING, codec::LAYOUT.as_bytes())?;
            let mut about = BTreeMap::from([
                ("node".into(), node.name.to_string()),
                ("port".into(), output.name.clone()),
                ("kind".into(), node.kind.clone()),
                ("payload".into(), payload.into()),
                ("version".into(), version.to_string()),
                ("units".into(), Json::Object(units).to_string()),
                ("source".into(), (node.role != Role::Node).to_string()),
            ]);
            if let Some(ty) = ty {
                about.insert("schema".into(), serde_json::to_string(ty.schema)?);
            }
            let exact = file.add_channel(schema, &format!("{EXACT_TOPIC}{name}"), EXACT_ENCODING, &about)?;
            let view = match ty.and_then(PayloadType::display).filter(|_| views) {
                Some(d) => {
                    let schema = file.add_schema(&d.schema_name, &d.schema_encoding, &d.schema_data)?;
                    let topic = format!("{VIEW_TOPIC}{name}");
                    Some(file.add_channel(schema, &topic, &d.message_encoding, &BTreeMap::new())?)
                }
                None => None,
            };
            wires.insert(id, Wire { name, exact, view, payload: output.payload, n_items: 0, n_values: 0 });
        }
        let link = |link: &crate::plan::Link| {
            let to = &plan.nodes[link.to_node];
            (plan.wire_name(link.from), format!("{}.{}", to.name, to.inputs[link.to_port].port.name))
        };
        Ok(Self {
            file,
            wires,
            nodes: plan.nodes.iter().map(|node| node.name.to_string()).collect(),
            links: plan.links.iter().map(link).collect(),
            time_ns: None,
            waiting: Vec::new(),
            n_waiting_bytes: 0,
            told: BTreeMap::new(),
        })
    }

    pub(super) fn item(&mut self, id: OutputId, item: Item, n_bytes: usize) -> Result<(), Stopped> {
        let Some(wire) = self.wires.get_mut(&id) else { return Ok(()) };
        wire.n_items += 1;
        wire.n_values += u64::from(matches!(item.body, Body::Value(_)));
        if item.stamp_ns > 0 && self.time_ns.is_none() {
            self.begin_time(item.stamp_ns)?;
        }
        if self.time_ns.is_some() {
            return self.write(id, &item);
        }
        self.n_waiting_bytes = self.n_waiting_bytes.saturating_add(n_bytes);
        self.waiting.push(Waiting::Item(id, item));
        if self.n_waiting_bytes > MAX_WAITING_BYTES { self.begin_time(1) } else { Ok(()) }
    }

    /// When nodes fired.
    pub(super) fn firings(&mut self, firings: &[Firing]) -> Result<(), Stopped> {
        if firings.is_empty() {
            return Ok(());
        }
        let mut text = String::with_capacity(firings.len() * 40);
        text.push_str("{\"firings\":[");
        for (i, firing) in firings.iter().enumerate() {
            let (comma, node) = (if i > 0 { "," } else { "" }, Json::from(&*self.nodes[firing.node]));
            let (began, took) = (firing.began.as_nanos(), firing.took.as_nanos());
            // Writing to a string cannot fail.
            let _ = write!(text, "{comma}[{node},{},{began},{took}]", firing.item);
        }
        text.push_str("]}");
        self.tell(TIMING_TOPIC, text.into_bytes())
    }

    /// What policies dropped: a link's index and the item's number.
    pub(super) fn drops(&mut self, drops: &[(usize, u64)]) -> Result<(), Stopped> {
        if drops.is_empty() {
            return Ok(());
        }
        let rows = drops.iter().map(|(link, number)| {
            let (from, to) = &self.links[*link];
            json!([from, to, number])
        });
        let message = json!({ "drops": rows.collect::<Json>() });
        self.tell(DROPS_TOPIC, message.to_string().into_bytes())
    }

    /// What a firing took from the clock.
    pub(super) fn live(&mut self, node: usize, item: u64, readings: &[ClockReading]) -> Result<(), Stopped> {
        let message = json!({ "node": self.nodes[node], "item": item, "readings": readings });
        self.tell(LIVE_TOPIC, message.to_string().into_bytes())
    }

    /// Writes a message about the run itself, at the latest time there is.
    fn tell(&mut self, topic: &'static str, message: Vec<u8>) -> Result<(), Stopped> {
        let Some(time_ns) = self.time_ns else {
            self.n_waiting_bytes += message.len();
            self.waiting.push(Waiting::Told(topic, message));
            return Ok(());
        };
        if !self.told.contains_key(topic) {
            let (name, schema) = told_schema(topic);
            let schema = self.file.add_schema(name, "jsonschema", schema.to_string().as_bytes())?;
            self.told.insert(topic, (self.file.add_channel(schema, topic, "json", &BTreeMap::new())?, 0));
        }
        let Some((channel, n)) = self.told.get_mut(topic) else { return Ok(()) };
        let head = MessageHeader { channel_id: *channel, sequence: *n, log_time: time_ns, publish_time: time_ns };
        *n = n.wrapping_add(1);
        Ok(self.file.write_message(head, message.into())?)
    }

    /// What waited for a time is written at this one.
    pub(super) fn begin_time(&mut self, time_ns: StampNs) -> Result<(), Stopped> {
        if self.time_ns.is_some() {
            return Ok(());
        }
        self.time_ns = Some(time_ns as u64);
        self.n_waiting_bytes = 0;
        std::mem::take(&mut self.waiting).into_iter().try_for_each(|waiting| match waiting {
            Waiting::Item(id, item) => self.write(id, &item),
            Waiting::Told(topic, message) => self.tell(topic, message),
        })
    }

    /// Whether anything waits for a time.
    pub(super) fn waits_for_time(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Writes an item and its picture. The exact message holds the stamp as it is, zero and negative ones too; its log
    /// time is one that viewers take.
    fn write(&mut self, id: OutputId, item: &Item) -> Result<(), Stopped> {
        let latest = self.time_ns.unwrap_or(1);
        let time_ns = if item.stamp_ns > 0 { item.stamp_ns as u64 } else { latest };
        self.time_ns = Some(latest.max(time_ns));
        let Wire { name, exact, view, payload, .. } = &self.wires[&id];
        // The format counts messages with 32 bits; the message itself holds the whole number.
        let sequence = item.number as u32;
        let head = |channel_id: u16| MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        let parts = codec::parts_on(*payload, item);
        if parts.len() > MAX_ITEM_BYTES {
            return Err(Stopped::TooLong { wire: name.clone(), number: item.number, n_bytes: parts.len() });
        }
        self.file.write_message(head(*exact), parts)?;
        let (Some(channel), Body::Value(value)) = (view, &item.body) else { return Ok(()) };
        let Some(picture) = value.to_display(time_ns as StampNs) else { return Ok(()) };
        Ok(self.file.write_message(head(*channel), picture.into())?)
    }

    /// For each wire: items, and how many of them are values.
    pub(super) fn counts(&self) -> super::Counts {
        self.wires.values().map(|w| (w.name.clone(), (w.n_items, w.n_values))).collect()
    }
}

/// The schema of a channel of the run itself.
fn told_schema(topic: &str) -> (&'static str, Json) {
    let rows = |name: &str, doc: &str| {
        json!({
            "type": "object",
            "properties": { name: { "type": "array", "description": doc, "items": { "type": "array" } } },
        })
    };
    match topic {
        TIMING_TOPIC => {
            let doc = "node, item, when it began in ns since the run began, how long it took in ns; by the wall clock";
            ("osteoflow.Timing", rows("firings", doc))
        }
        LIVE_TOPIC => {
            let properties = json!({
                "node": { "type": "string" },
                "item": { "type": "integer", "description": "number of the firing" },
                "readings": { "type": "array", "description": "in order; a replay answers with them" },
            });
            ("osteoflow.Live", json!({ "type": "object", "properties": properties }))
        }
        _ => ("osteoflow.Drops", rows("drops", "wire, input, number of the item that the input's policy dropped")),
    }
}
