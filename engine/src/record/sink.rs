use super::{
    Firing,
    log::{LogEntry, LogFilter},
    output::{Output, Schema},
    pictures::Pictures,
};
use crate::{
    plan::{OutputId, Plan},
    recording::{
        codec,
        format::{
            Drops, EXACT_ENCODING, EXACT_SCHEMA_ENCODING, FIRST_NS, Live, Log, LogLevel, RUN_ENCODING, RunMessage,
            Timing, Topic, WireCount, WireCounts, WireHeader,
        },
    },
    shown_paths::ShownPaths,
};
use osteoflow_container::MessageHeader;
use osteoflow_node::{Body, ClockReading, Item, PayloadType, PortPayload, Role, StampNs};
use serde_json::Value as Json;
use std::{collections::BTreeMap, io, time::Duration};

/// Maximum size of an item. Readers accept no longer record, and the chunk holds more than the item.
const MAX_ITEM_BYTES: usize = (1 << 30) - (16 << 20);
/// Maximum number of bytes waiting for the first stamp that is a time.
const MAX_WAITING_BYTES: usize = 64 << 20;

/// Channels of a recording, with their message counts.
pub(super) struct Sink {
    pub(super) output: Output,
    wires: BTreeMap<OutputId, WireChannels>,
    pub(super) pictures: Pictures,
    log: LogFilter,
    shown: ShownPaths,
    /// Whether the recording is for viewers too.
    views: bool,
    nodes: Vec<String>,
    links: Vec<(String, String)>,
    /// Earliest time written.
    first_ns: u64,
    /// Latest time written; `None` before the first stamp that is a time. Constants, which have no time of their own,
    /// wait for it: viewers show them from then on.
    time_ns: Option<u64>,
    waiting: Vec<Waiting>,
    n_waiting_bytes: usize,
    /// Channels of the run itself, by topic, with the number of messages.
    run: BTreeMap<String, (u16, u32)>,
}

enum Waiting {
    Item(OutputId, Item),
    Run(RunBytes),
    Log(LogEntry),
}

/// A message about the run, with its topic and schema.
struct RunBytes {
    topic: String,
    schema: (&'static str, fn() -> Json),
    bytes: Vec<u8>,
}

/// The channels of a recorded wire.
struct WireChannels {
    name: String,
    node: usize,
    exact: u16,
    payload: PortPayload,
    count: WireCount,
}

/// Why the writer stopped early.
pub(super) struct Stopped(pub(super) String);

impl Stopped {
    pub(super) fn by_panic(panic: &str) -> Self {
        Self(format!("the view of a payload {panic}"))
    }
}

impl From<io::Error> for Stopped {
    fn from(error: io::Error) -> Self {
        Self(format!("{error}; the run was ended, and what was recorded before is whole"))
    }
}

impl Sink {
    /// Adds the channels of the recorded wires.
    pub(super) fn begin(mut output: Output, plan: &Plan, shown: &ShownPaths) -> io::Result<Self> {
        let mut wires = BTreeMap::new();
        for &id in &plan.record {
            let (node, port) = (&plan.nodes[id.node], &plan.nodes[id.node].outputs[id.port]);
            let name = plan.wire_name(id);
            let ty = port.payload.ty();
            let (payload, version) = ty.map_or(("any", 0), |ty| (ty.name, ty.version));
            let units = ty.map(PayloadType::units).unwrap_or_default();
            let units: serde_json::Map<_, _> =
                units.into_iter().map(|(name, unit)| (name.into(), unit.into())).collect();
            let header = WireHeader {
                node: node.name.to_string(),
                port: port.name.clone(),
                kind: node.kind.clone(),
                payload: payload.into(),
                version,
                source: node.role != Role::Node,
                units: Json::Object(units).to_string(),
                schema: ty.map(|ty| serde_json::to_string(ty.schema)).transpose()?,
            };
            let text = codec::schema_text();
            let schema = Schema { name: &header.schema_name(), encoding: EXACT_SCHEMA_ENCODING, data: text.as_bytes() };
            let exact =
                output.add_channel(&schema, &Topic::Exact(&name).name(), EXACT_ENCODING, &header.to_metadata())?;
            let payload = port.payload;
            wires.insert(id, WireChannels { node: id.node, name, exact, payload, count: WireCount::default() });
        }
        let pictures = Pictures::begin(&mut output, plan)?;
        Ok(Self {
            output,
            wires,
            pictures,
            log: LogFilter::default(),
            shown: shown.clone(),
            views: plan.recording.views,
            first_ns: u64::MAX,
            nodes: plan.nodes.iter().map(|node| node.name.to_string()).collect(),
            links: plan.links.iter().map(|link| plan.link_names(link)).collect(),
            time_ns: None,
            waiting: Vec::new(),
            n_waiting_bytes: 0,
            run: BTreeMap::new(),
        })
    }

    pub(super) fn item(&mut self, id: OutputId, item: Item, n_bytes: usize) -> Result<(), Stopped> {
        let Some(wire) = self.wires.get_mut(&id) else { return Ok(()) };
        wire.count.items += 1;
        wire.count.values += u64::from(matches!(item.body, Body::Value(_)));
        if item.stamp_ns > 0 && self.time_ns.is_none() {
            self.begin_time(item.stamp_ns)?;
        }
        if self.time_ns.is_some() {
            return self.write(id, &item);
        }
        self.n_waiting_bytes = self.n_waiting_bytes.saturating_add(n_bytes);
        self.waiting.push(Waiting::Item(id, item));
        if self.n_waiting_bytes > MAX_WAITING_BYTES { self.begin_time(FIRST_NS) } else { Ok(()) }
    }

    /// Writes firing times.
    pub(super) fn firings(&mut self, firings: &[Firing]) -> Result<(), Stopped> {
        if firings.is_empty() {
            return Ok(());
        }
        let ns = |duration: Duration| u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        let rows = firings.iter().map(|f| (&*self.nodes[f.node], f.item, ns(f.began), ns(f.took)));
        let message = run_bytes(&Timing { firings: rows.collect() });
        self.write_run(message)
    }

    /// Writes dropped items, as link index and item number.
    pub(super) fn drops(&mut self, drops: &[(usize, u64)]) -> Result<(), Stopped> {
        if drops.is_empty() {
            return Ok(());
        }
        let row = |(link, number): &(usize, u64)| {
            let (from, to) = self.links[*link].clone();
            (from, to, *number)
        };
        self.write_run(run_bytes(&Drops { drops: drops.iter().map(row).collect() }))
    }

    /// Writes the clock readings of a firing.
    pub(super) fn live(&mut self, node: usize, item: u64, readings: &[ClockReading]) -> Result<(), Stopped> {
        let node = self.nodes[node].clone();
        self.write_run(run_bytes(&Live { node, item, readings: readings.to_vec() }))
    }

    /// Writes a message about the run itself, at the latest time written.
    fn write_run(&mut self, message: RunBytes) -> Result<(), Stopped> {
        let Some(time_ns) = self.time_ns else {
            self.n_waiting_bytes += message.bytes.len();
            self.waiting.push(Waiting::Run(message));
            return Ok(());
        };
        self.write_run_at(message, time_ns)
    }

    fn write_run_at(&mut self, message: RunBytes, time_ns: u64) -> Result<(), Stopped> {
        self.first_ns = self.first_ns.min(time_ns);
        let RunBytes { topic, schema: (name, schema), bytes } = message;
        if !self.run.contains_key(&topic) {
            let schema = schema().to_string();
            let schema = Schema { name, encoding: "jsonschema", data: schema.as_bytes() };
            let channel = self.output.add_channel(&schema, &topic, RUN_ENCODING, &BTreeMap::new())?;
            self.run.insert(topic.clone(), (channel, 0));
        }
        let Some((channel, n)) = self.run.get_mut(&topic) else { return Ok(()) };
        let head = MessageHeader { channel_id: *channel, sequence: *n, log_time: time_ns, publish_time: time_ns };
        *n = n.wrapping_add(1);
        Ok(self.output.write_message(head, bytes.into())?)
    }

    /// Writes a message of a node for viewers, at its stamp or at the latest time written.
    pub(super) fn log(&mut self, mut entry: LogEntry) -> Result<(), Stopped> {
        entry.message = self.shown.text(&entry.message);
        let Some(entry) = self.log.pass(entry).filter(|_| self.views) else { return Ok(()) };
        if self.time_ns.is_some() {
            return self.write_log(&entry);
        }
        self.n_waiting_bytes += entry.message.len();
        self.waiting.push(Waiting::Log(entry));
        Ok(())
    }

    fn write_log(&mut self, entry: &LogEntry) -> Result<(), Stopped> {
        let stamp = entry.stamp_ns.filter(|&stamp| stamp > 0).map(|stamp| stamp as u64);
        let time_ns = stamp.or(self.time_ns).unwrap_or(FIRST_NS as u64);
        let node = entry.node.and_then(|node| self.nodes.get(node)).map_or("osteoflow", String::as_str);
        let message = run_bytes(&Log::new(time_ns, entry.level, node, &entry.message));
        self.write_run_at(message, time_ns)
    }

    /// Writes what viewers are shown at the end: transforms, answers if the run is `complete`, and messages.
    pub(super) fn finish_views(&mut self, complete: bool, log: Vec<LogEntry>) -> Result<(), Stopped> {
        // Viewers reject a time of zero; a run without any time is shown at its first nanoseconds.
        self.begin_time(FIRST_NS)?;
        let before_all = self.first_ns.saturating_sub(1).max(1);
        let notes =
            self.pictures.finish(&mut self.output, (before_all, self.time_ns.unwrap_or(before_all)), complete)?;
        log.into_iter().try_for_each(|entry| self.log(entry))?;
        let warning = |message| LogEntry { node: None, item: 0, stamp_ns: None, level: LogLevel::Warning, message };
        notes.into_iter().map(warning).try_for_each(|entry| self.log(entry))
    }

    /// Sets the first time and writes the messages that waited for it.
    pub(super) fn begin_time(&mut self, time_ns: StampNs) -> Result<(), Stopped> {
        if self.time_ns.is_some() {
            return Ok(());
        }
        self.time_ns = Some(time_ns as u64);
        self.n_waiting_bytes = 0;
        // From here on, a truncated file names the wires it was to hold: their channels are written at once, in a chunk with a
        // message, since one without has no time.
        self.write_run(run_bytes(&Timing { firings: Vec::new() }))?;
        self.output.file.flush()?;
        std::mem::take(&mut self.waiting).into_iter().try_for_each(|waiting| match waiting {
            Waiting::Item(id, item) => self.write(id, &item),
            Waiting::Run(message) => self.write_run(message),
            Waiting::Log(entry) => self.write_log(&entry),
        })
    }

    /// Whether messages wait for a time.
    pub(super) fn waits_for_time(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Writes an item and its picture. The exact message holds the stamp unchanged, also zero and negative ones; its
    /// log time is one that viewers accept.
    fn write(&mut self, id: OutputId, item: &Item) -> Result<(), Stopped> {
        let latest = self.time_ns.unwrap_or(1);
        let time_ns = if item.stamp_ns > 0 { item.stamp_ns as u64 } else { latest };
        self.time_ns = Some(latest.max(time_ns));
        self.first_ns = self.first_ns.min(time_ns);
        let WireChannels { name, node, exact, payload, .. } = &self.wires[&id];
        // The format's sequence number has 32 bits; the message itself holds the full number.
        let sequence = item.number as u32;
        let head = |channel_id: u16| MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
        let parts = codec::parts_on(*payload, item);
        if parts.len() > MAX_ITEM_BYTES {
            return Err(Stopped(format!(
                "item {} of {name} has {} bytes, and a recording holds items of up to a gigabyte; take the wire out of [record]",
                item.number,
                parts.len()
            )));
        }
        self.output.write_message(head(*exact), codec::framed(parts))?;
        self.pictures.follow(&self.output, id, item, time_ns);
        match &item.body {
            Body::Value(value) => Ok(self.pictures.write(&mut self.output, id, (item, value), time_ns)?),
            Body::Empty(empty) if *empty.node == *self.nodes[*node] => {
                let (node, message) = (Some(*node), format!("no value: {}", empty.reason));
                let level = LogLevel::Info;
                self.log(LogEntry { node, item: item.number, stamp_ns: Some(time_ns as StampNs), level, message })
            }
            Body::Empty(_) => Ok(()),
        }
    }

    /// Number of items of each wire, and of values among them.
    pub(super) fn counts(&self) -> WireCounts {
        WireCounts(self.wires.values().map(|wire| (wire.name.clone(), wire.count)).collect())
    }
}

fn run_bytes<T: RunMessage>(message: &T) -> RunBytes {
    let bytes = serde_json::to_vec(message).expect("texts and numbers are JSON");
    RunBytes { topic: T::TOPIC.name(), schema: T::SCHEMA, bytes }
}
