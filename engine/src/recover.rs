//! Writes what is intact of a damaged recording into a sound file, and says what is missing.
//!
//! A chunk is intact or lost: its CRC vouches for all of it or for nothing. Chunks behind damage are found again by the
//! lengths of their records. Every intact item is kept under its own number; nothing is shifted into a hole. The file
//! written says in a metadata record of its own what is missing, and how many items of each wire lay before the first
//! damage: so far a replay can compute, since what lies behind may rest on what is lost.

use crate::recording::{
    RecordingError, check_version, codec,
    findings::Finding,
    format::{INPUT_HASHES, MetadataRecord, Outcome, Recovered, RunRecord, WireCounts},
    number_set::NumberSet,
    scan::{Carried, Gather, PassState, Passed, pass},
    wires::{Carries, Wire},
};
use osteoflow_container::{
    Channel, Damage, End, Message, MessageHeader, Progress, Record, Segments, WriteOptions, Writer, durable::Part,
    regular,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io,
    ops::{ControlFlow, RangeInclusive},
    path::{Path, PathBuf},
};

/// A file that could not be recovered.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The damaged file cannot be read.
    #[error(transparent)]
    Read(#[from] RecordingError),
    /// Nothing is ever overwritten.
    #[error("{} is there already; name another file", .0.display())]
    Exists(PathBuf),
    /// The new file cannot be written.
    #[error("cannot write {0}; nothing of it was left")]
    Write(String),
    /// There is nothing to write.
    #[error("nothing in {0}; no file was written")]
    Nothing(String),
}

/// What was saved, and what was not.
#[derive(Debug, Clone, PartialEq)]
pub struct RecoverReport {
    /// Bytes of the damaged file.
    pub n_bytes: u64,
    /// Segments that are lost, by their place in the damaged file.
    pub damages: Vec<Damage>,
    /// Messages in the new file, pictures for viewers among them.
    pub n_messages: u64,
    /// The wires, by name.
    pub wires: Vec<RecoveredWire>,
    /// What is not sound of a file without lost segments: bytes that no chunk holds have changed.
    pub unsound: Vec<Finding>,
    /// What the file no longer says of the run.
    pub lost: Vec<String>,
    /// Messages whose channels nothing describes any more; they are left out.
    pub n_unknown: u64,
}

/// A wire and what is left of it.
#[derive(Debug, Clone, PartialEq)]
pub struct RecoveredWire {
    /// `node.port`.
    pub wire: String,
    /// Items in the new file.
    pub n_items: u64,
    /// How many of them lay before the first damage.
    pub before_damage: u64,
    /// Numbers that are known to be missing: those below the largest, and those up to the count where that is left.
    pub missing: Vec<RangeInclusive<u64>>,
    /// Whether more may be missing behind the last, because the count is lost.
    pub open_end: bool,
}

impl RecoverReport {
    /// Bytes of the damaged file that are lost.
    pub fn bytes_lost(&self) -> u64 {
        self.damages.iter().map(|damage| damage.bytes.end - damage.bytes.start).sum()
    }

    /// Whether nothing is missing.
    pub fn is_whole(&self) -> bool {
        self.damages.is_empty() && self.unsound.is_empty() && self.lost.is_empty() && self.n_unknown == 0
    }

    /// Whether the new file still says which graph ran.
    pub fn is_recording(&self) -> bool {
        !self.lost.iter().any(|lost| lost.contains(&format!("\"{}\"", RunRecord::NAME)))
    }
}

/// Writes what is intact of `from` to `to`, which must not exist.
///
/// # Errors
/// [`RecoverError`] if `from` cannot be read, is of a version that is not read or holds nothing, or `to` exists or cannot be written.
pub fn recover(from: &Path, to: &Path, progress: Progress<'_>) -> Result<RecoverReport, RecoverError> {
    copy(from, to, Recovery::default(), progress)
}

fn copy(
    from: &Path,
    to: &Path,
    mut recovery: Recovery<'_>,
    progress: Progress<'_>,
) -> Result<RecoverReport, RecoverError> {
    regular(from).and_then(File::open).map_err(|error| RecordingError::read(from, error))?;
    let write_error = |error| RecoverError::Write(format!("{}: {error}", to.display()));
    if to.symlink_metadata().is_ok() {
        return Err(RecoverError::Exists(to.into()));
    }
    let mut part = Part::new(to).map_err(write_error)?;
    recovery.output.file = Some(part.file().try_clone().map_err(write_error)?);
    let passed = pass(from, &mut recovery, progress).and_then(|passed| {
        // Nothing would read what is written.
        passed.metadata.entries(RunRecord::NAME).map_or(Ok(()), |entries| check_version(from, entries))?;
        Ok(passed)
    });
    let passed = passed.map_err(RecoverError::Read);
    let report = passed.and_then(|passed| recovery.finish(from, passed).map_err(write_error));
    let report = report.and_then(|report| match report.n_messages == 0 && !report.is_recording() {
        true => {
            let why = report.damages.first().map_or("it holds no messages".into(), ToString::to_string);
            Err(RecoverError::Nothing(format!("{} is intact: {why}", from.display())))
        }
        false => Ok(report),
    });
    let report = report?;
    part.keep_new().map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => RecoverError::Exists(to.into()),
        _ => write_error(error),
    })?;
    Ok(report)
}

/// Copies a sound recording to `to`, which must not exist, with the texts of its metadata changed by `rename`: what the run was,
/// not its items.
///
/// # Errors
/// As [`recover`]; also if the recording is damaged.
pub fn copy_renamed(from: &Path, to: &Path, rename: &dyn Fn(&str) -> String) -> Result<(), RecoverError> {
    let recovery = Recovery { rename: Some(rename), ..Recovery::default() };
    match copy(from, to, recovery, &mut |_, _| {})? {
        report if report.is_whole() => Ok(()),
        report => {
            let _ = std::fs::remove_file(to);
            let damage = report.damages.first().map_or("it is not whole".into(), ToString::to_string);
            Err(RecoverError::Nothing(format!(
                "{} is copied as it is damaged: {damage}; recover it first",
                from.display()
            )))
        }
    }
}

/// The new file; its header is written by the first call of [`Output::writer`].
#[derive(Default)]
struct Output {
    file: Option<File>,
    writer: Option<Writer<File>>,
}

impl Output {
    fn writer(&mut self, profile: &str) -> io::Result<&mut Writer<File>> {
        if let Some(file) = self.file.take() {
            let library = concat!("osteoflow ", env!("CARGO_PKG_VERSION")).into();
            let options = WriteOptions { profile: profile.into(), library, ..WriteOptions::default() };
            self.writer = Some(Writer::new(file, options)?);
        }
        self.writer.as_mut().ok_or_else(|| io::Error::other("the header could not be written"))
    }
}

/// Name, encoding and data of a schema.
type Schema = (String, String, Vec<u8>);

#[derive(Default)]
struct Recovery<'a> {
    output: Output,
    /// Changes the texts of metadata.
    rename: Option<&'a dyn Fn(&str) -> String>,
    failed: Option<io::Error>,
    schemas: BTreeMap<u16, Schema>,
    /// Identifiers in the new file by those in the damaged one.
    ids: BTreeMap<u16, u16>,
    wires: BTreeMap<String, NumberSet>,
    before_damage: Option<BTreeMap<String, u64>>,
    /// Names of the metadata records in the new file.
    metadata: BTreeSet<String>,
    n_messages: u64,
    /// Messages whose channels could not be written.
    n_lost: u64,
}

impl Recovery<'_> {
    fn write(&mut self, record: &Record<'_>) -> io::Result<()> {
        match record {
            Record::Header { profile } => self.output.writer(profile).map(drop),
            Record::Schema { id, name, encoding, data } => {
                let schema = || ((*name).into(), (*encoding).into(), data.to_vec());
                self.schemas.entry(*id).or_insert_with(schema);
                Ok(())
            }
            Record::Channel(channel) => self.channel(channel),
            Record::Attachment(attachment) => self.output.writer("")?.write_attachment(attachment),
            // A record that damage has doubled is written once; what is missing is written anew.
            Record::Metadata { name, entries } if *name != Recovered::NAME && self.metadata.insert((*name).into()) => {
                let entries = match self.rename {
                    Some(rename) => &entries.iter().map(|(key, text)| (rename(key), rename(text))).collect(),
                    None => entries,
                };
                self.output.writer("")?.write_metadata(name, entries)
            }
            _ => Ok(()),
        }
    }

    fn flow(&mut self, written: io::Result<()>) -> ControlFlow<()> {
        match written {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                self.failed = Some(error);
                ControlFlow::Break(())
            }
        }
    }

    /// Adds a channel to the new file, unless its schema is lost.
    fn channel(&mut self, channel: &Channel) -> io::Result<()> {
        let id = channel.id;
        if self.ids.contains_key(&id) || channel.schema_id != 0 && !self.schemas.contains_key(&channel.schema_id) {
            return Ok(());
        }
        let writer = self.output.writer("")?;
        let schema_id = match self.schemas.get(&channel.schema_id) {
            Some((name, encoding, data)) => writer.add_schema(name, encoding, data)?,
            None => 0,
        };
        let new = writer.add_channel(schema_id, &channel.topic, &channel.message_encoding, &channel.metadata)?;
        self.ids.insert(id, new);
        Ok(())
    }

    fn leading(&self) -> BTreeMap<String, u64> {
        self.wires.iter().map(|(wire, numbers)| (wire.clone(), numbers.leading())).collect()
    }

    /// Writes what is missing, and the file's end.
    fn finish(mut self, from: &Path, mut passed: Passed) -> io::Result<RecoverReport> {
        if let Some(error) = self.failed.take() {
            return Err(error);
        }
        // What an earlier recovery no longer says is as if nothing lay before the damage.
        let recovered_before = passed.metadata.get::<Recovered>().map(Result::unwrap_or_default);
        let counts = passed.metadata.entries(WireCounts::NAME);
        let count = |wire: &String| Some(WireCounts::parse(counts?.get(wire)?)?.items);
        let mut before = self.before_damage.take().unwrap_or_else(|| self.leading());
        if let Some(recovered) = &recovered_before {
            let limits = &recovered.before_damage;
            before.iter_mut().for_each(|(wire, n)| *n = (*n).min(limits.get(wire).copied().unwrap_or(0)));
        }
        let counted = counts.is_some();
        let wires = self.wires.iter().map(|(wire, numbers)| RecoveredWire {
            wire: wire.clone(),
            n_items: numbers.len(),
            // A wire that the file described only behind the damage had nothing before it.
            before_damage: before.get(wire).copied().unwrap_or(0),
            missing: numbers.missing(count(wire)),
            open_end: !counted,
        });
        let wires = wires.collect();
        let is_ours = self.metadata.iter().any(|name| name.starts_with(RunRecord::NAME)) || !self.wires.is_empty();
        let parts = [
            (RunRecord::NAME, "the graph, its seed and the program"),
            (WireCounts::NAME, "how many items each wire had"),
            (Outcome::NAME, "the results"),
        ];
        // Where inputs are hashed at the end, they are lost with the counts.
        let inputs = (INPUT_HASHES, "the hashes of the inputs");
        let parts = parts.iter().chain((!counted).then_some(&inputs));
        let parts = parts.filter(|(name, _)| is_ours && !self.metadata.contains(*name));
        let lost = parts.map(|(name, what)| format!("{what} (\"{name}\")")).collect();
        let unsound = passed.unsound();
        if let End::Truncated(damage) = passed.end {
            passed.damages.push(damage);
        }
        let report = RecoverReport {
            n_bytes: passed.reader.n_bytes(),
            wires,
            damages: passed.damages,
            unsound,
            n_messages: self.n_messages,
            lost,
            n_unknown: passed.n_unknown + self.n_lost,
        };
        if is_ours && (!report.is_whole() || recovered_before.is_some()) {
            let metadata = recovered(&report, from, recovered_before).to_metadata();
            self.output.writer("")?.write_metadata(Recovered::NAME, &metadata)?;
        }
        self.output.writer("")?;
        if let Some(writer) = self.output.writer {
            writer.finish()?;
        }
        Ok(report)
    }
}

/// The metadata record of the new file.
fn recovered(report: &RecoverReport, from: &Path, earlier: Option<Recovered>) -> Recovered {
    let mut damage = earlier.unwrap_or_default().damage;
    let name = from.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    damage.extend(report.damages.iter().map(|damage| format!("{name}: {damage}")));
    damage.extend(report.unsound.iter().map(|finding| format!("{name}: {finding}")));
    let missing = report.wires.iter().filter(|wire| !wire.missing.is_empty());
    Recovered {
        damage,
        bytes_lost: report.bytes_lost(),
        before_damage: report.wires.iter().map(|wire| (wire.wire.clone(), wire.before_damage)).collect(),
        missing: missing.map(|wire| (wire.wire.clone(), wire.missing.clone())).collect(),
        lost: report.lost.clone(),
    }
}

impl Gather for Recovery<'_> {
    fn record(&mut self, record: &Record<'_>) -> ControlFlow<()> {
        let written = self.write(record);
        self.flow(written)
    }

    fn wire(&mut self, wire: &Wire) {
        self.wires.entry(wire.name.clone()).or_default();
    }

    fn message(&mut self, carried: Carried<'_>, state: &mut PassState) -> ControlFlow<()> {
        let Carried { carries, message, .. } = carried;
        let Some(&channel_id) = self.ids.get(&message.channel_id) else {
            self.n_lost += 1;
            return ControlFlow::Continue(());
        };
        if let (Carries::Exact(wire), Some(number)) = (carries, codec::number(message.data)) {
            let numbers = self.wires.entry(wire.name.clone()).or_default();
            // Numbers out of order are kept.
            if number > numbers.len() {
                state.allowance.take(0)?;
            }
            numbers.insert(number);
        }
        self.n_messages += 1;
        let Message { sequence, log_time, publish_time, data, .. } = *message;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        let data = Segments::from(data.to_vec());
        let data = if matches!(carries, Carries::Exact(_)) { codec::framed(data) } else { data };
        let written = self.output.writer("").and_then(|writer| writer.write_message(header, data));
        self.flow(written)
    }

    fn damage(&mut self) {
        if self.before_damage.is_none() {
            self.before_damage = Some(self.leading());
        }
    }
}
