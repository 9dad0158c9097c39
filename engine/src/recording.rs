//! Reads `run.mcap` back: the graph that ran, and the items of every recorded wire.

use crate::{
    codec::{self, CodecError, RecordedItem},
    record::{EXACT_ENCODING, EXACT_TOPIC, FORMAT_VERSION, OUTCOME_METADATA, RUN_METADATA, WIRES_METADATA},
};
use mcap::{
    McapError,
    records::Record,
    sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
};
use osteoflow_node::{Body, Item, PayloadType, Registry};
use std::{
    collections::BTreeMap,
    fs::File,
    io::{self, Read},
    path::{Path, PathBuf},
    sync::Arc,
};

/// No record of ours is longer; a longer one is damage, and is not believed.
const MAX_RECORD_BYTES: usize = 1 << 30;
/// What is read at a time at most, whatever a record claims to need.
const READ_BYTES: usize = 1 << 20;

/// A recording that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be opened or read.
    #[error("cannot read {}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// It is an MCAP file of another program, or none at all.
    #[error("{} is no recording of a run: {reason}", .path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What is missing.
        reason: String,
    },
    /// Its format is newer than this program.
    #[error("{} has format version {found}, this program reads version {FORMAT_VERSION}", .path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: String,
    },
    /// A wire's items are damaged.
    #[error("wire {wire}, item {number}: {reason}")]
    Item {
        /// The wire.
        wire: String,
        /// The item's place.
        number: u64,
        /// What is wrong.
        reason: String,
    },
}

/// A recording, read whole.
#[derive(Debug)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// The graph as it ran, as the text of a graph file.
    pub graph: String,
    /// The graph file it came from.
    pub graph_file: PathBuf,
    /// The graph's name.
    pub name: String,
    /// The run's seed.
    pub seed: u64,
    /// The version of the program that wrote it.
    pub version: String,
    /// The recorded wires, by name.
    pub wires: BTreeMap<String, RecordedWire>,
    /// What `results.json` held; `None` where the run did not get so far.
    pub results: Option<serde_json::Value>,
    /// Constants that the command had put into `results.json`.
    pub fixed_results: Vec<(String, serde_json::Value)>,
    /// Whether the user had stopped the run.
    pub interrupted: bool,
    /// Where a file was cut short or is damaged: what ends it. What came before is intact and here.
    pub truncated: Option<String>,
}

/// The items of one wire.
#[derive(Debug, Default, Clone)]
pub struct RecordedWire {
    /// The payload's name.
    pub payload: String,
    /// The version of its view.
    pub version: u32,
    /// Whether its node is a source.
    pub source: bool,
    /// Each item as it was written, by number.
    pub messages: Vec<Vec<u8>>,
}

impl RecordedWire {
    /// The items, with views that have no type yet.
    ///
    /// # Errors
    /// The number of the first damaged item, and what is wrong with it.
    pub fn items(&self) -> Result<Vec<RecordedItem>, (u64, CodecError)> {
        let items = self.messages.iter().zip(0..);
        items.map(|(bytes, number)| codec::decode(bytes).map_err(|error| (number, error))).collect()
    }
}

impl Recording {
    /// Reads a recording from its start to its end, or to where it was cut short.
    ///
    /// # Errors
    /// [`RecordingError`] if the file is not a recording of a run, or its wires have holes.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut reading = Reading::default();
        let truncated = reading.read(path)?;
        let foreign = |reason: String| RecordingError::Foreign { path: path.into(), reason };
        let run = reading.metadata.remove(RUN_METADATA).ok_or_else(|| {
            foreign(match &truncated {
                Some(reason) => reason.clone(),
                None => format!("it has no metadata record \"{RUN_METADATA}\""),
            })
        })?;
        let entry = |key: &str| run.get(key).cloned().ok_or_else(|| foreign(format!("its metadata lacks \"{key}\"")));
        let version = entry("format_version")?;
        if version != FORMAT_VERSION.to_string() {
            return Err(RecordingError::Version { path: path.into(), found: version });
        }
        let finished = reading.metadata.contains_key(WIRES_METADATA);
        let outcome = reading.metadata.remove(OUTCOME_METADATA).unwrap_or_default();
        let json = |key: &str| outcome.get(key).and_then(|text| serde_json::from_str(text).ok());
        let fixed: Option<serde_json::Value> = json("fixed_results");
        let fixed = fixed.as_ref().and_then(|fixed| fixed.as_object());
        let recording = Self {
            path: path.into(),
            graph: entry("graph")?,
            graph_file: entry("graph_file")?.into(),
            name: entry("name")?,
            seed: entry("seed")?.parse().map_err(|_| foreign("its seed is no number".into()))?,
            version: entry("version")?,
            results: json("results"),
            fixed_results: fixed.into_iter().flatten().map(|(key, value)| (key.clone(), value.clone())).collect(),
            interrupted: outcome.get("status").is_some_and(|status| status == "interrupted"),
            truncated: truncated.or_else(|| (!finished).then(|| "the run did not finish it".into())),
            wires: reading.wires.into_values().collect(),
        };
        recording.wires.iter().try_for_each(|(name, wire)| numbered(name, wire))?;
        Ok(recording)
    }

    /// The items of a wire, with their payloads.
    ///
    /// # Errors
    /// [`RecordingError::Item`] if the wire was not recorded, its payload is unknown here or an item is damaged.
    pub fn items(&self, wire: &str, registry: &Registry) -> Result<Vec<Item>, RecordingError> {
        let fault = |number: u64, reason: String| RecordingError::Item { wire: wire.into(), number, reason };
        let recorded = self.wires.get(wire).ok_or_else(|| fault(0, "the wire was not recorded".into()))?;
        let items = recorded.items().map_err(|(number, error)| fault(number, error.to_string()))?;
        let typed = items.into_iter().map(|item| {
            let number = item.number;
            // An empty shows nothing, so on a wire that takes any payload it needs no type.
            let named = item.payload.clone().unwrap_or((recorded.payload.clone(), recorded.version));
            match &item.body {
                Err(empty) => {
                    let body = Body::Empty(Arc::new(empty.clone()));
                    Ok(Item { number, stamp_ns: item.stamp_ns, body })
                }
                Ok(_) => {
                    let ty = known(&named.0, named.1, registry).map_err(|reason| fault(number, reason))?;
                    item.into_item(ty).map_err(|error| fault(number, error.to_string()))
                }
            }
        });
        typed.collect()
    }
}

/// The payload of that name and version.
fn known(name: &str, version: u32, registry: &Registry) -> Result<&'static PayloadType, String> {
    let ty = registry.payload_type(name).ok_or_else(|| format!("no payload {name} is known here"))?;
    if ty.version != version {
        return Err(format!("it holds version {version} of {name}, version {} is known here", ty.version));
    }
    Ok(ty)
}

/// Along a wire items are numbered from 0 without holes.
fn numbered(name: &str, wire: &RecordedWire) -> Result<(), RecordingError> {
    for (message, expected) in wire.messages.iter().zip(0..) {
        let found = codec::number(message);
        if found != Some(expected) {
            let found = found.map_or("a damaged item".into(), |n| format!("item {n}"));
            let reason = format!("{found} stands in its place; the file is damaged");
            return Err(RecordingError::Item { wire: name.into(), number: expected, reason });
        }
    }
    Ok(())
}

#[derive(Default)]
struct Reading {
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// By channel id: the wire's name and what came on it.
    wires: BTreeMap<u16, (String, RecordedWire)>,
}

impl Reading {
    /// Reads records to the end; answers what ended a file that was cut short.
    fn read(&mut self, path: &Path) -> Result<Option<String>, RecordingError> {
        let io = |source| RecordingError::Read { path: path.into(), source };
        let mut file = File::open(path).map_err(io)?;
        let options =
            LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(MAX_RECORD_BYTES);
        let mut reader = LinearReader::new_with_options(options);
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(n_bytes)) => {
                    let n_bytes = n_bytes.min(READ_BYTES);
                    let n_read = file.read(reader.insert(n_bytes)).map_err(io)?;
                    reader.notify_read(n_read);
                }
                Ok(LinearReadEvent::Record { data, opcode }) => match mcap::parse_record(opcode, data) {
                    Ok(record) => self.take(record),
                    Err(error) => return Ok(Some(told(&error))),
                },
                Err(McapError::BadMagic) if self.metadata.is_empty() => {
                    let reason = "it is no MCAP file".into();
                    return Err(RecordingError::Foreign { path: path.into(), reason });
                }
                Err(error) => return Ok(Some(told(&error))),
            }
        }
        Ok(None)
    }

    fn take(&mut self, record: Record<'_>) {
        match record {
            Record::Metadata(metadata) => drop(self.metadata.insert(metadata.name, metadata.metadata)),
            Record::Channel(channel) if channel.message_encoding == EXACT_ENCODING => {
                let Some(name) = channel.topic.strip_prefix(EXACT_TOPIC) else { return };
                let about = |key: &str| channel.metadata.get(key).cloned().unwrap_or_default();
                // The summary repeats the channels.
                self.wires.entry(channel.id).or_insert_with(|| {
                    let wire = RecordedWire {
                        payload: about("payload"),
                        version: about("version").parse().unwrap_or(0),
                        source: about("source") == "true",
                        messages: Vec::new(),
                    };
                    (name.to_owned(), wire)
                });
            }
            Record::Message { header, data } => {
                if let Some((_, wire)) = self.wires.get_mut(&header.channel_id) {
                    wire.messages.push(data.into_owned());
                }
            }
            _ => {}
        }
    }
}

fn told(error: &McapError) -> String {
    match error {
        McapError::UnexpectedEof => "the file was cut short".into(),
        other => format!("the file is damaged: {other}"),
    }
}
