//! One pass over a recording, as every reader of its items makes it.

use super::{
    container::{Container, summary_of},
    findings::{Finding, Findings},
    format::{MetadataRecords, RunRecord},
    read::{RecordingError, run_record},
    wires::{Carries, Channels, Wire},
};
use osteoflow_container::{
    Allowance, Damage, End, Location, Message, Progress, Reader, Record, Visitor, damage_message,
};
use std::{fs::File, ops::ControlFlow, path::Path};

/// Gathers what is wanted of a recording.
pub(crate) trait Gather {
    /// Whether reading stops at the first damage.
    const STOPS_AT_DAMAGE: bool = false;

    /// An intact record, before it is taken for a wire or a message. Breaks to read no more.
    fn record(&mut self, _record: &Record<'_>) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    /// The exact channel of a wire, each time the file describes it.
    fn wire(&mut self, _wire: &Wire) {}

    /// A message. Breaks to read no more.
    fn message(&mut self, carried: Carried<'_>, state: &mut PassState) -> ControlFlow<()>;

    /// Lost bytes, behind which reading goes on.
    fn damage(&mut self) {}
}

/// A message, where it lies, and what its channel carries.
pub(crate) struct Carried<'a> {
    pub(crate) carries: &'a Carries,
    /// With the item alone as its data, where that is in a sequence of bytes.
    pub(crate) message: &'a Message<'a>,
    pub(crate) place: Location,
    /// Number of bytes between the head of the message and its data.
    pub(crate) n_before: u32,
}

/// The memory that may still be taken, and what is wrong in the file.
pub(crate) struct PassState {
    pub(crate) allowance: Allowance,
    pub(crate) findings: Findings,
}

/// A file that has been read, apart from what was gathered.
pub(crate) struct Passed {
    pub(crate) reader: Reader<File>,
    pub(crate) metadata: MetadataRecords,
    /// Checks of the container that wait for the end of the file.
    pub(crate) container: Container,
    pub(crate) findings: Findings,
    pub(crate) damages: Vec<Damage>,
    pub(crate) end: End,
    /// Number of messages whose channels nothing in the file describes.
    pub(crate) n_unknown: u64,
}

impl Passed {
    /// What is not sound of a file without damage; damage has been reported, and explains the rest.
    pub(crate) fn unsound(&mut self) -> Vec<Finding> {
        let lost = std::mem::take(&mut self.container).finish(&mut self.findings);
        if lost.is_some() || matches!(self.end, End::Truncated(_)) {
            return Vec::new();
        }
        self.findings.take(&["habit"]);
        std::mem::take(&mut self.findings).into_listed()
    }
}

/// A recording that has been read, apart from what was gathered.
pub(crate) struct Scanned {
    pub(crate) reader: Reader<File>,
    pub(crate) metadata: MetadataRecords,
    /// Why the file is not whole.
    pub(crate) damage: Option<String>,
    /// What is not sound of a whole file.
    pub(crate) unsound: Option<String>,
    /// Number of messages whose channels nothing in the file describes.
    pub(crate) n_unknown: u64,
}

impl Scanned {
    /// Refuses a file without wires that does not say that it is a recording, or is one of a version that is not read.
    pub(crate) fn refuse_foreign(&self, path: &Path, has_wires: bool) -> Result<(), RecordingError> {
        if has_wires {
            return Ok(());
        }
        if self.metadata.has::<RunRecord>() {
            return run_record(path, &self.metadata, None).map(drop);
        }
        let reason = self.damage.clone().or_else(|| self.unsound.clone());
        let reason = reason.unwrap_or_else(|| "it has no exact channel".into());
        Err(RecordingError::foreign(path, reason))
    }
}

/// Reads a recording from its start to its end.
///
/// # Errors
/// As [`pass`].
pub(crate) fn scan(path: &Path, gather: &mut impl Gather, progress: Progress<'_>) -> Result<Scanned, RecordingError> {
    let mut passed = pass(path, gather, progress)?;
    let unsound = summary_of(&passed.unsound());
    let Passed { reader, metadata, damages, end, n_unknown, .. } = passed;
    Ok(Scanned { reader, metadata, damage: damage_message(&damages, &end), unsound, n_unknown })
}

/// Reads a file from its start to its end, and checks its container.
///
/// # Errors
/// [`RecordingError`] if it cannot be read, or takes more memory than is allowed.
pub(crate) fn pass(path: &Path, gather: &mut impl Gather, progress: Progress<'_>) -> Result<Passed, RecordingError> {
    let failed = |error| RecordingError::of(path, error);
    let mut reader = Reader::open(path).map_err(|error| failed(error.into()))?.with_section_crcs();
    let mut pass = Pass {
        gather,
        progress,
        channels: Channels::default(),
        metadata: MetadataRecords::default(),
        damages: Vec::new(),
        container: Container::default(),
        state: PassState { allowance: Allowance::from_env(), findings: Findings::default() },
        stopped_at: 0,
        n_unknown: 0,
    };
    let end = reader.read(&mut pass).map_err(failed)?;
    let Pass { metadata, damages, container, state, stopped_at, n_unknown, .. } = pass;
    match state.allowance.exceeded() {
        Some(error) => Err(RecordingError::too_large(path, stopped_at, reader.n_bytes(), &error)),
        None => Ok(Passed { reader, metadata, container, findings: state.findings, damages, end, n_unknown }),
    }
}

struct Pass<'a, G> {
    gather: &'a mut G,
    progress: Progress<'a>,
    channels: Channels,
    metadata: MetadataRecords,
    damages: Vec<Damage>,
    container: Container,
    state: PassState,
    /// Offset of the message after which no more was wanted.
    stopped_at: u64,
    n_unknown: u64,
}

impl<G: Gather> Visitor for Pass<'_, G> {
    fn record(&mut self, place: Location, record: Record<'_>) -> ControlFlow<()> {
        self.container.record(place, &record, &mut self.state.findings);
        self.gather.record(&record)?;
        match record {
            Record::Metadata { name, entries } => {
                let is_new = self.metadata.insert(name, entries);
                if !is_new {
                    let what = format!("a second metadata record \"{name}\"");
                    self.state.findings.add("habit", Finding::new(place, what));
                }
            }
            Record::Channel(channel) => {
                if let Carries::Exact(wire) = self.channels.add(channel) {
                    self.gather.wire(wire);
                }
            }
            Record::Message(message) => match self.channels.get(message.channel_id) {
                Some(carries) => {
                    self.stopped_at = place.offset;
                    let data = carries.content(message.data);
                    let n_before = (message.data.len() - data.len()) as u32;
                    let message = Message { data, ..message };
                    return self
                        .gather
                        .message(Carried { carries, message: &message, place, n_before }, &mut self.state);
                }
                None => self.n_unknown += 1,
            },
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        self.gather.damage();
        self.container.damage();
        self.state.findings.add("damage", Finding::new(None, damage.to_string()));
        self.damages.push(damage);
        if G::STOPS_AT_DAMAGE { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn progress(&mut self, at: u64, of: u64) {
        (self.progress)(at, of);
    }
}
