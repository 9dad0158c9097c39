//! Writes `run.mcap`: a tap on the recorded wires that never changes what flows.
//!
//! Items are cheap handles; views are made, compressed and written on a thread of their own, so that a node waits only
//! when the disk is slower than the graph. Each wire has an exact channel, `/exact/<node.port>`, and beside it, where
//! its payload has a picture for viewers, `/view/<node.port>`.

use crate::{
    codec,
    plan::{OutputId, Plan},
    run::{RunOptions, Tap, catch_panic},
};
use crossbeam_channel::{Receiver, Sender, bounded};
use mcap::{Compression, McapError, WriteOptions, Writer, records::MessageHeader, records::Metadata};
use osteoflow_node::{Body, Item, PortPayload, StampNs};
use serde_json::Value as Json;
use std::{
    collections::BTreeMap,
    fs::File,
    io::BufWriter,
    path::{Path, PathBuf},
    thread::JoinHandle,
};

/// The version of the recording's own records; raised when older readers cannot take them.
pub const FORMAT_VERSION: u32 = 1;
/// The encoding of messages on exact channels.
pub const EXACT_ENCODING: &str = "osteoflow-view";
/// What the topics of exact channels begin with.
pub const EXACT_TOPIC: &str = "/exact/";
/// What the topics of channels for viewers begin with.
pub const VIEW_TOPIC: &str = "/view/";
/// The metadata record that names the graph, its seed and the program.
pub const RUN_METADATA: &str = "osteoflow";
/// The metadata record that counts the items of each wire; only a recording that was finished has it.
pub const WIRES_METADATA: &str = "osteoflow.wires";
/// The metadata record that holds the results, and the constants among them.
pub const OUTCOME_METADATA: &str = "osteoflow.outcome";

/// How many items wait for the writer at most.
const QUEUE: usize = 32;
/// Chunks of this size compress well and lose little where a file is cut short.
const CHUNK_BYTES: u64 = 1 << 20;
/// Measured coordinates hardly compress; more effort buys time lost and no space.
const ZSTD_LEVEL: u32 = 1;

/// A recording that could not be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file could not be created.
    #[error("cannot create {}: {source}", .path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file could not be written to its end.
    #[error("cannot write {}: {}; what came before may be whole", .path.display(), told(.source))]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: McapError,
    },
    /// A payload could not show itself.
    #[error("cannot write {}: the view of a payload {said}", .path.display())]
    Panicked {
        /// The file.
        path: PathBuf,
        /// The panic, with the wire.
        said: String,
    },
}

fn told(error: &McapError) -> String {
    match error {
        McapError::Io(io) => io.to_string(),
        other => other.to_string(),
    }
}

/// What a finished recording holds of each wire: items, and how many of them are values.
pub(crate) type Counts = BTreeMap<String, (u64, u64)>;

/// A recording under way.
pub(crate) struct Recorder {
    path: PathBuf,
    queue: Sender<Entry>,
    writer: JoinHandle<Result<Counts, Stopped>>,
}

impl Recorder {
    /// Begins a recording with the graph and the channels of its recorded wires.
    pub(crate) fn create(path: &Path, plan: &Plan) -> Result<Self, RecordError> {
        let file = File::create(path).map_err(|source| RecordError::Create { path: path.into(), source })?;
        let write = |source| RecordError::Write { path: path.into(), source };
        let mut sink = Sink::begin(file, plan).map_err(write)?;
        let (queue, items): (_, Receiver<Entry>) = bounded(QUEUE);
        let writer = std::thread::Builder::new().name("recorder".into()).spawn(move || {
            let mut outcome = BTreeMap::new();
            let written = items.iter().try_for_each(|entry| match entry {
                Entry::Item(wire, item) => catch_panic(|| sink.item(wire, &item)).map_err(Stopped::Panic)?,
                Entry::Outcome(metadata) => {
                    outcome = metadata;
                    Ok(())
                }
            });
            match written.and_then(|()| sink.end(outcome)) {
                Ok(()) => Ok(sink.counts()),
                Err(stopped) => {
                    // What is whole stays: the chunks and, where the disk lets it, the summary.
                    drop(sink);
                    Err(stopped)
                }
            }
        });
        let writer = writer.map_err(|source| RecordError::Create { path: path.into(), source })?;
        Ok(Self { path: path.into(), queue, writer })
    }

    /// Writes what waits and what came of the run, and closes the file.
    pub(crate) fn finish(self, status: &str, results: &Json, options: &RunOptions) -> Result<Counts, RecordError> {
        let fixed: Json = options.fixed_results.iter().cloned().collect::<serde_json::Map<_, _>>().into();
        let outcome = BTreeMap::from([
            ("status".into(), status.into()),
            ("results".into(), results.to_string()),
            ("fixed_results".into(), fixed.to_string()),
        ]);
        // If the writer has stopped, it says why below.
        let _ = self.queue.send(Entry::Outcome(outcome));
        drop(self.queue);
        let path = self.path;
        match self.writer.join() {
            Ok(Ok(counts)) => Ok(counts),
            Ok(Err(Stopped::Mcap(source))) => Err(RecordError::Write { path, source }),
            Ok(Err(Stopped::Panic(said))) => Err(RecordError::Panicked { path, said }),
            Err(_) => Err(RecordError::Panicked { path, said: "panicked".into() }),
        }
    }
}

/// What ends a writer before its time.
enum Stopped {
    Mcap(McapError),
    Panic(String),
}

impl From<McapError> for Stopped {
    fn from(error: McapError) -> Self {
        Self::Mcap(error)
    }
}

impl Tap for Recorder {
    fn item(&self, wire: OutputId, item: &Item) {
        // If the writer has stopped, `finish` says why.
        let _ = self.queue.send(Entry::Item(wire, item.clone()));
    }
}

/// What waits for the writer.
enum Entry {
    Item(OutputId, Item),
    Outcome(BTreeMap<String, String>),
}

/// The file and its channels.
struct Sink {
    writer: Writer<BufWriter<File>>,
    wires: BTreeMap<OutputId, Wire>,
    /// The first stamp that is a time: when a constant, which has none, is shown to viewers.
    first_stamp: Option<StampNs>,
    /// Constants that wait for it.
    waiting: Vec<(OutputId, Item)>,
}

struct Wire {
    name: String,
    exact: u16,
    view: Option<u16>,
    payload: PortPayload,
    n_items: u64,
    n_values: u64,
}

impl Sink {
    fn begin(file: File, plan: &Plan) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .profile("osteoflow")
            .library(concat!("osteoflow ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(ZSTD_LEVEL)
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES));
        let mut writer = options.create(BufWriter::new(file))?;
        writer.write_metadata(&Metadata {
            name: RUN_METADATA.into(),
            metadata: BTreeMap::from([
                ("format_version".into(), FORMAT_VERSION.to_string()),
                ("graph".into(), plan.resolved.clone()),
                ("graph_file".into(), plan.path.display().to_string()),
                ("name".into(), plan.name.clone()),
                ("seed".into(), plan.seed.to_string()),
                ("version".into(), env!("CARGO_PKG_VERSION").into()),
            ]),
        })?;
        let mut wires = BTreeMap::new();
        for &id in &plan.record {
            let node = &plan.nodes[id.node];
            let name = plan.wire_name(id);
            let (payload, version, display) = match node.outputs[id.port].payload {
                PortPayload::Type(ty) => (ty.name, ty.version, ty.display()),
                PortPayload::Any => ("any", 0, None),
            };
            let schema =
                writer.add_schema(&format!("{payload}@{version}"), EXACT_ENCODING, codec::LAYOUT.as_bytes())?;
            let about = BTreeMap::from([
                ("node".into(), node.name.to_string()),
                ("port".into(), node.outputs[id.port].name.clone()),
                ("kind".into(), node.kind.clone()),
                ("payload".into(), payload.into()),
                ("version".into(), version.to_string()),
                ("source".into(), (!matches!(node.role, osteoflow_node::Role::Node)).to_string()),
            ]);
            let exact = writer.add_channel(schema, &format!("{EXACT_TOPIC}{name}"), EXACT_ENCODING, &about)?;
            let view = match display {
                Some(d) => {
                    let schema = writer.add_schema(&d.schema_name, &d.schema_encoding, &d.schema_data)?;
                    let topic = format!("{VIEW_TOPIC}{name}");
                    Some(writer.add_channel(schema, &topic, &d.message_encoding, &BTreeMap::new())?)
                }
                None => None,
            };
            wires.insert(
                id,
                Wire { name, exact, view, payload: node.outputs[id.port].payload, n_items: 0, n_values: 0 },
            );
        }
        Ok(Self { writer, wires, first_stamp: None, waiting: Vec::new() })
    }

    fn item(&mut self, id: OutputId, item: &Item) -> Result<(), Stopped> {
        let Some(wire) = self.wires.get_mut(&id) else { return Ok(()) };
        wire.n_items += 1;
        wire.n_values += u64::from(matches!(item.body, Body::Value(_)));
        if item.stamp_ns > 0 && self.first_stamp.is_none() {
            self.first_stamp = Some(item.stamp_ns);
            self.write_waiting(item.stamp_ns)?;
        }
        match self.first_stamp {
            Some(first) => self.write(id, item, if item.stamp_ns > 0 { item.stamp_ns } else { first }),
            None => {
                self.waiting.push((id, item.clone()));
                Ok(())
            }
        }
    }

    fn write_waiting(&mut self, log_time_ns: StampNs) -> Result<(), Stopped> {
        let waiting = std::mem::take(&mut self.waiting);
        waiting.iter().try_for_each(|(id, item)| self.write(*id, item, log_time_ns))
    }

    /// Writes an item and its picture. The exact message holds the stamp as it is, zero and negative ones too; its log
    /// time is one that viewers take.
    fn write(&mut self, id: OutputId, item: &Item, log_time_ns: StampNs) -> Result<(), Stopped> {
        let Wire { exact, view, payload, .. } = self.wires[&id];
        self.writer.write_to_known_channel(&header(exact, item, log_time_ns), &codec::encode_on(payload, item))?;
        let (Some(channel), Body::Value(value)) = (view, &item.body) else { return Ok(()) };
        let Some(picture) = value.to_display(log_time_ns) else { return Ok(()) };
        Ok(self.writer.write_to_known_channel(&header(channel, item, log_time_ns), &picture)?)
    }

    fn end(&mut self, outcome: BTreeMap<String, String>) -> Result<(), Stopped> {
        // Viewers take no time of zero; a run without any time is shown at its first nanosecond.
        self.write_waiting(self.first_stamp.unwrap_or(1))?;
        let counts = self.wires.values();
        let counts = counts.map(|w| (w.name.clone(), format!("{} items, {} values", w.n_items, w.n_values)));
        let metadata = counts.collect();
        self.writer.write_metadata(&Metadata { name: WIRES_METADATA.into(), metadata })?;
        self.writer.write_metadata(&Metadata { name: OUTCOME_METADATA.into(), metadata: outcome })?;
        self.writer.finish()?;
        Ok(())
    }

    fn counts(&self) -> Counts {
        self.wires.values().map(|w| (w.name.clone(), (w.n_items, w.n_values))).collect()
    }
}

fn header(channel_id: u16, item: &Item, log_time_ns: StampNs) -> MessageHeader {
    let time = log_time_ns as u64;
    MessageHeader { channel_id, sequence: item.number as u32, log_time: time, publish_time: time }
}
