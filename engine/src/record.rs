//! Writes `run.mcap`: a tap on the recorded wires.
//!
//! Items are cheap handles. Views are made, compressed and written on a separate thread, so that a node waits only when
//! the disk is slower than the graph. Each wire has an exact channel, `/exact/<node.port>`, and, if its payload has a
//! picture for viewers, a second one, `/view/<node.port>`. Firing times are on `/run/timing`, dropped items on
//! `/run/drops`, clock readings on `/run/live`, messages of nodes on `/run/log`.
//!
//! Everything that a replay needs comes first in the file, and waiting items are written as a chunk several times a
//! second: a run that is killed leaves a recording that can be read and replayed up to its last whole chunk.

mod answers;
mod frame_tree;
mod layout;
mod log;
mod output;
mod pictures;
mod queue;
mod sink;

use crate::{
    durable,
    hash::Digest,
    options::{GIVEN_NODES, RunOptions},
    panics,
    plan::{OutputId, Plan, PlanPlugin},
    plugin,
    recording::format::{
        Entries, FIRST_NS, INPUT_HASHES, LATE_PLUGIN_TEXTS, LATE_PLUGINS, LogLevel, MetadataRecord, Outcome, PROFILE,
        PROGRAM, PluginRecords, PluginTexts, RecordedFailure, RunRecord, WireCounts,
    },
    runtime::{Failed, Tap},
    shown_paths::ShownPaths,
};
pub(crate) use log::LogEntry;
use osteoflow_container::{WriteOptions, Writer};
use osteoflow_node::{Body, ClockReading, Item, StampNs};
use output::Output;
use queue::Queue;
use serde_json::Value as Json;
use sink::{Sink, Stopped};
use std::{
    collections::BTreeSet,
    fmt,
    fs::File,
    io,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// Name of the layout of viewers, beside the recording.
pub(crate) const LAYOUT: &str = "layout.json";
/// Interval at which the writer polls the queue.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Maximum age of an item before it is written as a chunk, however short; bounds what a kill can lose.
const FLUSH_EVERY: Duration = Duration::from_millis(200);
/// How long constants wait for a stamp that is a time; viewers then see them at the first nanosecond.
const MAX_WAIT_FOR_TIME: Duration = Duration::from_secs(2);
/// Number of firings passed to the writer at once.
const FIRING_BATCH: usize = 4096;

/// A recording that could not be written, and why.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct RecordError(String);

impl RecordError {
    fn create(path: &Path, error: io::Error) -> Self {
        Self(format!("cannot create {}: {error}", path.display()))
    }

    fn write(path: &Path, error: impl fmt::Display) -> Self {
        Self(format!("cannot write {}: {error}", path.display()))
    }

    /// Of a file that does not reach its end.
    fn ended(path: &Path, error: io::Error) -> Self {
        Self::write(path, Stopped::from(error).0)
    }
}

/// A recording in progress.
pub(crate) struct Recorder {
    /// The recorded wires.
    wires: BTreeSet<OutputId>,
    path: PathBuf,
    shown: ShownPaths,
    /// The plugins as they are named at its begin, and whether their text is recorded.
    plugins: Vec<PlanPlugin>,
    has_texts: bool,
    shared: Arc<Shared>,
    writer: JoinHandle<Result<RecordingSummary, Stopped>>,
}

/// State shared by the tap and the writer.
struct Shared {
    queue: Queue<QueueItem>,
    firings: Mutex<Vec<Firing>>,
    /// Set when the writer fails; stops the run.
    cancelled: Arc<AtomicBool>,
}

/// Item of the writer's queue.
enum QueueItem {
    Item(OutputId, Item),
    Firings(Vec<Firing>),
    Dropped(usize, u64),
    Live(usize, u64, Vec<ClockReading>),
    Log(LogEntry),
    End(End),
}

/// What the writer leaves.
struct RecordingSummary {
    counts: WireCounts,
    layout: Option<Json>,
}

/// What is known at the end of the run.
#[derive(Default)]
struct End {
    metadata: Vec<(&'static str, Entries)>,
    complete: bool,
    log: Vec<LogEntry>,
}

/// Wall-clock time of a node's firing.
struct Firing {
    node: usize,
    item: u64,
    /// Since the start of the run.
    began: Duration,
    took: Duration,
}

impl Recorder {
    /// Creates a recording with the graph and the channels of its recorded wires; `inputs` are the hashes of the files
    /// that sources read, where a replay identifies them by hash.
    pub(crate) fn create(
        path: &Path,
        plan: &Plan,
        options: &RunOptions,
        inputs: Option<&[Json]>,
        shown: &ShownPaths,
    ) -> Result<Self, RecordError> {
        let create = |error| RecordError::create(path, error);
        let inputs = inputs.map(named_inputs).transpose()?;
        let file = durable::create(path).map_err(create)?;
        let sink = begin(file, plan, options, inputs, shown).map_err(|error| RecordError::ended(path, error))?;
        let shared =
            Arc::new(Shared { queue: Queue::new(), firings: Mutex::default(), cancelled: options.cancelled.clone() });
        let of_writer = shared.clone();
        let writer = std::thread::Builder::new().name("recorder".into()).spawn(move || {
            let written =
                panics::catch(|| record(sink, &of_writer)).unwrap_or_else(|panic| Err(Stopped::by_panic(&panic)));
            if written.is_err() {
                // A dead writer blocks nobody; the run is stopped, since it can leave no recording.
                of_writer.queue.abandon();
                of_writer.cancelled.store(true, Ordering::Relaxed);
            }
            written
        });
        let wires = plan.record.iter().copied().collect();
        let (plugins, has_texts) = (plan.plugins.clone(), plan.recording.plugins);
        Ok(Self {
            wires,
            plugins,
            has_texts,
            shared,
            writer: writer.map_err(create)?,
            path: path.to_owned(),
            shown: shown.clone(),
        })
    }

    /// Writes the remaining items and the outcome of the run, and closes the file.
    pub(crate) fn finish(
        self,
        status: &str,
        results: &Json,
        failures: &[RecordedFailure],
        options: &RunOptions,
        inputs: Option<&[Json]>,
        log: Vec<LogEntry>,
    ) -> Result<WireCounts, RecordError> {
        let shown_results = self.shown.json(results.clone());
        let outcome = Outcome {
            status: status.into(),
            results_digest: (shown_results != *results).then(|| Digest::of_json(results).to_string()),
            results: shown_results,
            fixed_results: options.fixed_results.iter().cloned().collect(),
            failures: failures.to_vec(),
        };
        let mut metadata = vec![(Outcome::NAME, outcome.to_metadata())];
        metadata.extend(inputs.map(|inputs| (INPUT_HASHES, all_inputs(inputs))));
        metadata.extend(self.late_plugins());
        let queue = &self.shared.queue;
        queue.put(QueueItem::Firings(self.shared.take_firings()), 0);
        queue.put(QueueItem::End(End { metadata, complete: status == "complete", log }), 0);
        queue.close();
        let written = self.writer.join().unwrap_or_else(|_| Err(Stopped::by_panic("panicked")));
        let RecordingSummary { counts, layout } =
            written.map_err(|stopped| RecordError::write(&self.path, stopped.0))?;
        durable::sync_folder_of(&self.path).map_err(|error| RecordError::ended(&self.path, error))?;
        if let Some(layout) = layout {
            let path = self.path.with_file_name(LAYOUT);
            let written = durable::write(&path, format!("{layout:#}\n").as_bytes());
            written.map_err(|error| RecordError::ended(&path, error))?;
        }
        Ok(counts)
    }

    /// The records of the plugins that have loaded more while their nodes fired.
    fn late_plugins(&self) -> Vec<(&'static str, Entries)> {
        let late: Vec<_> =
            plugin::with_late_loads(&self.plugins).into_iter().filter(|late| !self.plugins.contains(late)).collect();
        if late.is_empty() {
            return Vec::new();
        }
        let mut records = vec![(LATE_PLUGINS, PluginRecords(late.clone()).to_metadata())];
        if self.has_texts {
            let (known, _) = plugin::texts(&self.plugins);
            let (mut texts, left_out) = plugin::texts(&late);
            texts.retain(|sha256, _| !known.contains_key(sha256));
            left_out.iter().for_each(|why| tracing::warn!("{why}"));
            records.push((LATE_PLUGIN_TEXTS, PluginTexts(texts).to_metadata()));
        }
        records
    }

    fn log(&self, entry: LogEntry) {
        let n_bytes = entry.message.len();
        self.shared.queue.put(QueueItem::Log(entry), n_bytes);
    }
}

impl Shared {
    fn take_firings(&self) -> Vec<Firing> {
        std::mem::take(&mut *self.firings.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Tap for Recorder {
    fn listens(&self, wire: OutputId) -> bool {
        self.wires.contains(&wire)
    }

    fn times_firings(&self) -> bool {
        true
    }

    fn item(&self, wire: OutputId, item: &Item) {
        let n_bytes = match &item.body {
            Body::Value(value) => value.n_bytes(),
            Body::Empty(empty) => empty.reason.len(),
        };
        self.shared.queue.put(QueueItem::Item(wire, item.clone()), n_bytes);
    }

    fn fired(&self, node: usize, item: u64, _: StampNs, began: Duration, took: Duration) {
        let mut firings = self.shared.firings.lock().unwrap_or_else(PoisonError::into_inner);
        firings.push(Firing { node, item, began, took });
        if firings.len() >= FIRING_BATCH {
            let all = std::mem::take(&mut *firings);
            drop(firings);
            self.shared.queue.put(QueueItem::Firings(all), FIRING_BATCH * size_of::<Firing>());
        }
    }

    fn live(&self, node: usize, item: u64, readings: &[ClockReading]) {
        self.shared.queue.put(QueueItem::Live(node, item, readings.to_vec()), size_of_val(readings));
    }

    fn dropped(&self, link: usize, number: u64) {
        self.shared.queue.put(QueueItem::Dropped(link, number), 0);
    }

    fn warned(&self, node: usize, item: u64, message: &str) {
        let (level, message) = (LogLevel::Warning, message.to_owned());
        self.log(LogEntry { node: Some(node), item, stamp_ns: None, level, message });
    }

    fn failed(&self, failed: &Failed<'_>) -> Option<String> {
        let (level, message, stamp_ns) = (LogLevel::Error, failed.reason.to_owned(), Some(failed.stamp_ns));
        self.log(LogEntry { node: Some(failed.node), item: failed.item, stamp_ns, level, message });
        None
    }
}

/// Creates the file with everything known before the run.
fn begin(
    file: File,
    plan: &Plan,
    options: &RunOptions,
    inputs: Option<Entries>,
    shown: &ShownPaths,
) -> io::Result<Sink> {
    let library = concat!("osteoflow ", env!("CARGO_PKG_VERSION"));
    let mut file = Writer::new(
        file,
        WriteOptions {
            profile: PROFILE.into(),
            library: library.into(),
            compression: plan.recording.compression,
            ..WriteOptions::default()
        },
    )?;
    let run = RunRecord {
        graph: shown.text(&plan.resolved),
        graph_file: shown.path(&plan.path),
        name: plan.name.clone(),
        seed: plan.seed,
        sources: plan.recording.sources,
        version: env!("CARGO_PKG_VERSION").into(),
        written: plan.nodes.iter().map(|node| (node.name.to_string(), node.written())).collect(),
        functions: serde_json::from_value(options.command[GIVEN_NODES].clone()).unwrap_or_default(),
    };
    let text = |value: &Json| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let program = options.command.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null());
    let program = program.map(|(key, value)| (key.clone(), shown.text(&text(value)))).collect();
    write(&mut file, &run)?;
    file.write_metadata(PROGRAM, &program)?;
    write(&mut file, &PluginRecords(plan.plugins.clone()))?;
    if plan.recording.plugins {
        let (texts, left_out) = plugin::texts(&plan.plugins);
        left_out.iter().for_each(|why| tracing::warn!("{why}"));
        if !texts.is_empty() {
            write(&mut file, &PluginTexts(texts))?;
        }
    }
    inputs.iter().try_for_each(|inputs| file.write_metadata(INPUT_HASHES, inputs))?;
    Sink::begin(Output { file, listener: options.listener.clone() }, plan, shown)
}

fn write<T: MetadataRecord>(file: &mut Writer<File>, record: &T) -> io::Result<()> {
    file.write_metadata(T::NAME, &record.to_metadata())
}

/// Hash of each file.
fn named_inputs(inputs: &[Json]) -> Result<Entries, RecordError> {
    if let Some(unread) = inputs.iter().find(|input| input["sha256"].as_str().is_none()) {
        let text = |key: &str| unread[key].as_str().unwrap_or("unknown").to_owned();
        let (path, reason) = (text("path"), text("error"));
        return Err(RecordError(format!("cannot read {path} to name it in the recording: {reason}")));
    }
    Ok(all_inputs(inputs))
}

/// Hash of each file, or why it cannot be hashed.
fn all_inputs(inputs: &[Json]) -> Entries {
    let entry = |input: &Json| {
        let text = |key: &str| input[key].as_str().map(str::to_owned);
        let hash = text("sha256").or_else(|| Some(format!("unread: {}", text("error")?)));
        Some((text("path")?, hash?))
    };
    inputs.iter().filter_map(entry).collect()
}

/// Writer thread: runs until the queue is closed and empty, or writing fails.
fn record(mut sink: Sink, shared: &Shared) -> Result<RecordingSummary, Stopped> {
    let mut flushed = Instant::now();
    let began = flushed;
    let mut end = End::default();
    loop {
        let (batch, closed) = shared.queue.take(POLL_INTERVAL);
        if batch.is_empty() && closed {
            break;
        }
        let mut drops = Vec::new();
        for (entry, n_bytes) in batch {
            match entry {
                QueueItem::Item(wire, item) => {
                    // Drops are written before the items that follow from them, so that a truncated file has both or
                    // neither.
                    sink.drops(&std::mem::take(&mut drops))?;
                    sink.item(wire, item, n_bytes)?;
                }
                QueueItem::Firings(firings) => sink.firings(&firings)?,
                QueueItem::Dropped(link, number) => drops.push((link, number)),
                QueueItem::Live(node, item, readings) => sink.live(node, item, &readings)?,
                QueueItem::Log(entry) => sink.log(entry)?,
                QueueItem::End(last) => end = last,
            }
            shared.queue.release(n_bytes);
        }
        sink.drops(&drops)?;
        if flushed.elapsed() >= FLUSH_EVERY {
            sink.firings(&shared.take_firings())?;
            if sink.waits_for_time() && began.elapsed() >= MAX_WAIT_FOR_TIME {
                sink.begin_time(FIRST_NS)?;
            }
            sink.output.file.flush()?;
            flushed = Instant::now();
        }
    }
    sink.finish_views(end.complete, end.log)?;
    let counts = sink.counts();
    write(&mut sink.output.file, &counts)?;
    end.metadata.iter().try_for_each(|(name, metadata)| sink.output.file.write_metadata(name, metadata))?;
    let file = sink.output.file.finish()?;
    file.sync_all()?;
    Ok(RecordingSummary { counts, layout: sink.pictures.layout() })
}
