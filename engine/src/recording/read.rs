//! Reads `run.mcap`: the graph that ran, and the items of every recorded wire.

use super::provenance::Provenance;
use super::{
    RecordedTypes,
    codec::{self, CodecError, RecordedItem},
    format::{
        Drops, Entries, FORMAT_VERSION, Live, MetadataRecord, MetadataRecords, Outcome, RecordedFailure, Recovered,
        RunMessage, RunRecord, WireCounts,
    },
    scan::{Carried, Gather, PassState, Scanned, scan},
    wires::{Carries, Wire},
};
use osteoflow_container::{ReadError, TooLarge};
use osteoflow_node::{Body, ClockReading, Item, PortPayload, Registry};
use serde::de::DeserializeOwned;
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt, io,
    ops::ControlFlow,
    path::{Path, PathBuf},
    sync::Arc,
};

/// A recording that cannot be read: the file, what is wrong with it, and where.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct RecordingError(String);

/// A recording, fully read.
#[derive(Debug)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// The graph that ran, its seed, and the program that ran it.
    pub run: RunRecord,
    /// The recorded wires, by name.
    pub wires: BTreeMap<String, RecordedWire>,
    /// Content of `results.json`; `None` where the run did not get so far.
    pub results: Option<serde_json::Value>,
    /// SHA-256 of the results where paths in `results` stand as they are shown.
    pub(crate) results_digest: Option<String>,
    /// Constants that the command put into `results.json`.
    pub fixed_results: Vec<(String, serde_json::Value)>,
    /// Whether the user stopped the run.
    pub interrupted: bool,
    /// Why a truncated or damaged file ends early. Everything before that is intact and included.
    pub truncated: Option<String>,
    /// What is not sound of a file whose items are all there, such as changed bytes outside of chunks: results, graph or
    /// hashes may not be those of the run.
    pub unsound: Option<String>,
    /// What made it.
    pub(crate) provenance: Provenance,
    /// Numbers of the items that policies dropped, by wire and input.
    pub drops: BTreeMap<(String, String), BTreeSet<u64>>,
    /// Clock readings of firings, by node and number of the firing.
    pub readings: BTreeMap<(String, u64), Vec<ClockReading>>,
    /// Failures of nodes, with item and message.
    pub failures: Vec<RecordedFailure>,
    types: RecordedTypes,
}

/// A metadata record of a file; `None` where it has none.
///
/// # Errors
/// [`RecordingError`] if it cannot be read: a status or a limit that is lost must not pass for none.
fn readable<T: MetadataRecord>(path: &Path, metadata: &MetadataRecords) -> Result<Option<T>, RecordingError> {
    let foreign = |error| RecordingError::foreign(path, format_args!("its metadata record \"{}\": {error}", T::NAME));
    metadata.get::<T>().transpose().map_err(foreign)
}

/// The run record of a file; `truncated` says why it may be missing.
///
/// # Errors
/// [`RecordingError`] if it is missing, lacks an entry or is of a version that is not read.
pub(crate) fn run_record(
    path: &Path,
    metadata: &MetadataRecords,
    truncated: Option<&str>,
) -> Result<RunRecord, RecordingError> {
    let foreign = |reason: String| RecordingError::foreign(path, reason);
    let name = RunRecord::NAME;
    let missing = || truncated.map_or_else(|| format!("it has no metadata record \"{name}\""), str::to_owned);
    let entries = metadata.entries(name).ok_or_else(|| foreign(missing()))?;
    check_version(path, entries)?;
    RunRecord::from_metadata(entries).map_err(|error| foreign(format!("its metadata record \"{name}\": {error}")))
}

/// Refuses the run record of a version that is not read.
pub(crate) fn check_version(path: &Path, entries: &Entries) -> Result<(), RecordingError> {
    match entries.get("format_version").and_then(|version| version.parse::<u32>().ok()) {
        Some(FORMAT_VERSION) => Ok(()),
        Some(version) => Err(RecordingError(format!(
            "{} has format version {version}, this program reads version {FORMAT_VERSION}",
            path.display()
        ))),
        None => {
            let reason = format!("its metadata record \"{}\" lacks the number \"format_version\"", RunRecord::NAME);
            Err(RecordingError::foreign(path, reason))
        }
    }
}

impl RecordingError {
    /// For a file that cannot be scanned at all.
    pub(crate) fn of(path: &Path, error: ReadError) -> Self {
        match error {
            ReadError::Io(error) => Self::read(path, error),
            error => Self::foreign(path, error),
        }
    }

    /// For a file that the system does not read.
    pub(crate) fn read(path: &Path, error: io::Error) -> Self {
        Self(format!("cannot read {}: {error}", path.display()))
    }

    /// For a file of another program, or one that is no MCAP file.
    pub(crate) fn foreign(path: &Path, reason: impl fmt::Display) -> Self {
        Self(format!("{} is no recording of a run: {reason}", path.display()))
    }

    /// For a file whose content does not fit into the allowed memory.
    pub(crate) fn too_large(path: &Path, at: u64, n_bytes: u64, error: &TooLarge) -> Self {
        Self(format!("{} is too large at byte {at} of {n_bytes}: {error}", path.display()))
    }

    /// For a wire whose items are damaged or missing.
    pub(crate) fn item(wire: &str, number: u64, reason: impl fmt::Display) -> Self {
        Self(format!("wire {wire}, item {number}: {reason}"))
    }
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
    /// Each item as written, by number.
    pub messages: Vec<Vec<u8>>,
}

impl RecordedWire {
    /// The items, with untyped views.
    ///
    /// # Errors
    /// Number of the first damaged item, and what is wrong with it.
    pub fn items(&self) -> Result<Vec<RecordedItem>, (u64, CodecError)> {
        let items = self.messages.iter().zip(0..);
        items.map(|(bytes, number)| codec::decode(bytes).map_err(|error| (number, error))).collect()
    }

    /// Whether a port with this payload can give its items.
    pub(crate) fn is_of(&self, payload: PortPayload) -> bool {
        payload.ty().is_none_or(|ty| ty.name == self.payload)
    }
}

impl Recording {
    /// Reads a recording from its start to its end, or to where it was truncated or damaged. Of a recovered recording
    /// only the part before the damage is read: later items may depend on lost ones.
    ///
    /// # Errors
    /// [`RecordingError`] if the file is not a recording of a run, or numbers of a wire are missing.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut reading = Gathering::default();
        let Scanned { metadata, damage: truncated, unsound, .. } = scan(path, &mut reading, &mut |_, _| {})?;
        let metadata = &metadata;
        let run = run_record(path, metadata, truncated.as_deref())?;
        if let Some(reason) = reading.unreadable {
            return Err(RecordingError::foreign(path, reason));
        }
        let recovered: Option<Recovered> = readable(path, metadata)?;
        let outcome: Option<Outcome> = readable(path, metadata)?;
        let interrupted = outcome.as_ref().is_some_and(|outcome| outcome.status == Outcome::INTERRUPTED);
        let truncated = truncated
            .or_else(|| recovered.is_some().then(|| "it was recovered from a damaged file".into()))
            .or_else(|| (!metadata.has::<WireCounts>()).then(|| "the run did not finish it".into()));
        let limits = recovered.map(|recovered| recovered.before_damage);
        let provenance = Provenance::of_recording(metadata).map_err(|error| RecordingError::foreign(path, error))?;
        let (mut wires, mut types) = (BTreeMap::new(), RecordedTypes::default());
        for (name, gathered) in reading.wires {
            types.add(&gathered.about);
            let limit = limits.as_ref().map_or(u64::MAX, |limits| limits.get(&name).copied().unwrap_or(0));
            let wire = numbered(&name, gathered, limit, truncated.is_some())?;
            wires.insert(name, wire);
        }
        Ok(Self {
            path: path.into(),
            run,
            results: outcome.as_ref().map(|outcome| outcome.results.clone()),
            results_digest: outcome.as_ref().and_then(|outcome| outcome.results_digest.clone()),
            fixed_results: outcome.iter().flat_map(|outcome| outcome.fixed_results.clone()).collect(),
            interrupted,
            truncated,
            unsound,
            wires,
            provenance,
            drops: reading.drops,
            readings: reading.readings,
            failures: outcome.map(|outcome| outcome.failures).unwrap_or_default(),
            types,
        })
    }

    /// Extends the registry by the recording's payload types that it lacks: their schemas are in the file.
    pub fn registry(&self, known: &Registry) -> Registry {
        self.types.registry(known)
    }

    /// The items of a wire, with their payloads.
    ///
    /// # Errors
    /// [`RecordingError`] if the wire was not recorded, its payload is unknown here or an item is damaged.
    pub fn items(&self, wire: &str, registry: &Registry) -> Result<Vec<Item>, RecordingError> {
        let fault = |number: u64, reason: String| RecordingError::item(wire, number, reason);
        let recorded = self.wires.get(wire).ok_or_else(|| fault(0, "the wire was not recorded".into()))?;
        let items = recorded.items().map_err(|(number, error)| fault(number, error.to_string()))?;
        let typed = items.into_iter().map(|item| {
            let number = item.number;
            typed(item, &recorded.payload, recorded.version, registry).map_err(|reason| fault(number, reason))
        });
        typed.collect()
    }
}

/// A recorded item with its payload: that of its wire, or the one that it names itself.
///
/// # Errors
/// Why the payload is not known, or the item no value of it.
pub(crate) fn typed(item: RecordedItem, payload: &str, version: u32, registry: &Registry) -> Result<Item, String> {
    let body = match item.body {
        // An empty has no view, so on a wire that takes any payload it needs no type.
        Err(empty) => Body::Empty(Arc::new(empty)),
        Ok(view) => {
            let (name, version) = item.payload.as_ref().map_or((payload, version), |(name, version)| (name, *version));
            let ty = registry.payload_type(name).ok_or_else(|| format!("no payload {name} is known here"))?;
            if !ty.reads(version) {
                return Err(format!("it holds version {version} of {name}, version {} is known here", ty.version));
            }
            Body::Value(ty.from_view(&view).map_err(|error| error.to_string())?)
        }
    };
    Ok(Item { number: item.number, stamp_ns: item.stamp_ns, body })
}

/// What a replay needs of a file, up to the first damage: later items may depend on lost ones.
#[derive(Default)]
pub(crate) struct Gathering {
    pub(crate) wires: BTreeMap<String, Gathered>,
    drops: BTreeMap<(String, String), BTreeSet<u64>>,
    readings: BTreeMap<(String, u64), Vec<ClockReading>>,
    /// The first message about the run that a replay needs and that cannot be read.
    unreadable: Option<String>,
}

pub(crate) struct Gathered {
    pub(crate) about: Wire,
    /// By number, in file order.
    pub(crate) messages: Vec<(Option<u64>, Vec<u8>)>,
}

impl Gathering {
    fn about_the_run<M: RunMessage + DeserializeOwned>(&mut self, data: &[u8]) -> Option<M> {
        match M::read(data) {
            Ok(message) => Some(message),
            Err(fault) => {
                self.unreadable.get_or_insert(fault);
                None
            }
        }
    }
}

impl Gather for Gathering {
    const STOPS_AT_DAMAGE: bool = true;

    fn wire(&mut self, wire: &Wire) {
        let gathered = || Gathered { about: wire.clone(), messages: Vec::new() };
        self.wires.entry(wire.name.clone()).or_insert_with(gathered);
    }

    fn message(&mut self, carried: Carried<'_>, state: &mut PassState) -> ControlFlow<()> {
        let Carried { carries, message, .. } = carried;
        match carries {
            Carries::Exact(wire) => {
                state.allowance.take(message.data.len())?;
                if let Some(gathered) = self.wires.get_mut(&wire.name) {
                    gathered.messages.push((codec::number(message.data), message.data.to_vec()));
                }
            }
            Carries::Drops => {
                state.allowance.take(message.data.len())?;
                for (wire, input, number) in
                    self.about_the_run::<Drops>(message.data).into_iter().flat_map(|of| of.drops)
                {
                    state.allowance.take(0)?;
                    self.drops.entry((wire, input)).or_default().insert(number);
                }
            }
            Carries::Live => {
                state.allowance.take(message.data.len())?;
                if let Some(Live { node, item, readings }) = self.about_the_run(message.data) {
                    self.readings.insert((node, item), readings);
                }
            }
            Carries::View { .. } | Carries::Other => {}
        }
        ControlFlow::Continue(())
    }
}

/// The wire's items in the order of their numbers, from 0 without gaps. Of an incomplete file, those before the first
/// gap, and at most `limit`.
fn numbered(name: &str, gathered: Gathered, limit: u64, partial: bool) -> Result<RecordedWire, RecordingError> {
    let Gathered { about, mut messages } = gathered;
    // Not an item: it sorts first and is reported below.
    messages.sort_by_key(|(number, _)| *number);
    let mut wire = RecordedWire {
        payload: about.header.payload,
        version: about.header.version,
        source: about.header.source,
        messages: Vec::new(),
    };
    for ((found, message), expected) in messages.into_iter().zip(0..) {
        if expected >= limit || (partial && found.is_some_and(|n| n > expected)) {
            break;
        }
        if found != Some(expected) {
            let found = found.map_or("a damaged item".into(), |n| format!("item {n}"));
            let reason = format!("{found} stands in its place; `osteoflow validate` tells all that is wrong");
            return Err(RecordingError::item(name, expected, reason));
        }
        wire.messages.push(message);
    }
    Ok(wire)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_that_cannot_be_read_is_an_error_and_one_that_is_missing_is_none() {
        let mut metadata = MetadataRecords::default();
        let read = |metadata: &MetadataRecords| readable::<Outcome>(Path::new("a.mcap"), metadata);
        assert!(read(&metadata).unwrap().is_none());
        metadata.insert(Outcome::NAME, [("status".into(), Outcome::INTERRUPTED.into())].into());
        let error = read(&metadata).unwrap_err().to_string();
        assert!(error.contains("\"osteoflow.outcome\": it lacks \"results\""), "{error}");
    }

    #[test]
    fn a_message_about_the_run_that_cannot_be_read_is_told_and_not_left_out() {
        let mut reading = Gathering::default();
        let sound = reading.about_the_run::<Drops>(br#"{"drops": [["a.b", "c.d", 3]]}"#).unwrap();
        assert_eq!((sound.drops.len(), &reading.unreadable), (1, &None));
        assert!(reading.about_the_run::<Live>(br#"{"node": "a", "item": 1}"#).is_none());
        assert!(reading.about_the_run::<Drops>(b"").is_none());
        let told = reading.unreadable.unwrap();
        assert!(told.starts_with("a message of /run/live cannot be read: missing field `readings`"), "{told}");
    }
}
