//! One pass over a recording, as every reader of its items makes it.

use super::{
    container::{Soundness, summary_of},
    format::{MetadataRecords, RunRecord},
    read::{RecordingError, too_large},
    wires::{Carries, Channels, Wire},
};
use osteoflow_container::{Allowance, Damage, Location, Message, Progress, Reader, Record, Visitor, damage_message};
use std::{fs::File, ops::ControlFlow, path::Path};

/// Gathers what is wanted of a recording.
pub(crate) trait Gather {
    /// Whether reading stops at the first damage.
    const STOPS_AT_DAMAGE: bool = false;

    /// The exact channel of a wire, each time the file describes it.
    fn wire(&mut self, _wire: &Wire) {}

    /// A message, and what its channel carries. Breaks to read no more.
    fn message(
        &mut self,
        carries: &Carries,
        message: &Message<'_>,
        place: Location,
        allowance: &mut Allowance,
    ) -> ControlFlow<()>;
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
    /// Refuses a file without wires that does not say that it is a recording.
    pub(crate) fn refuse_foreign(&self, path: &Path, has_wires: bool) -> Result<(), RecordingError> {
        if has_wires || self.metadata.has::<RunRecord>() {
            return Ok(());
        }
        let reason = self.damage.clone().or_else(|| self.unsound.clone());
        let reason = reason.unwrap_or_else(|| "it has no exact channel".into());
        Err(RecordingError::foreign(path, reason))
    }
}

/// Reads a recording from its start to its end.
///
/// # Errors
/// [`RecordingError`] if it cannot be read, or takes more memory than is allowed.
pub(crate) fn scan(path: &Path, gather: &mut impl Gather, progress: Progress<'_>) -> Result<Scanned, RecordingError> {
    let failed = |error| RecordingError::of(path, error);
    let mut reader = Reader::open(path).map_err(|error| failed(error.into()))?.with_section_crcs();
    let mut pass = Pass {
        gather,
        progress,
        channels: Channels::default(),
        metadata: MetadataRecords::default(),
        damages: Vec::new(),
        soundness: Soundness::default(),
        allowance: Allowance::from_env(),
        stopped_at: None,
        n_unknown: 0,
    };
    let end = reader.read(&mut pass).map_err(failed)?;
    let Pass { metadata, damages, soundness, allowance, stopped_at, n_unknown, .. } = pass;
    too_large(path, &allowance, stopped_at, reader.n_bytes())?;
    let damage = damage_message(&damages, &end);
    let unsound = summary_of(&soundness.finish()).filter(|_| damage.is_none());
    Ok(Scanned { reader, metadata, damage, unsound, n_unknown })
}

struct Pass<'a, G> {
    gather: &'a mut G,
    progress: Progress<'a>,
    channels: Channels,
    metadata: MetadataRecords,
    damages: Vec<Damage>,
    soundness: Soundness,
    allowance: Allowance,
    /// The message after which no more was wanted.
    stopped_at: Option<Location>,
    n_unknown: u64,
}

impl<G: Gather> Visitor for Pass<'_, G> {
    fn record(&mut self, place: Location, record: Record<'_>) -> ControlFlow<()> {
        self.soundness.record(place, &record);
        match record {
            Record::Metadata { name, entries } => drop(self.metadata.insert(name, entries)),
            Record::Channel(channel) => {
                if let Carries::Exact(wire) = self.channels.add(channel) {
                    self.gather.wire(wire);
                }
            }
            Record::Message(message) => match self.channels.get(message.channel_id) {
                Some(carries) => {
                    let taken = self.gather.message(carries, &message, place, &mut self.allowance);
                    self.stopped_at = taken.is_break().then_some(place);
                    return taken;
                }
                None => self.n_unknown += 1,
            },
            _ => {}
        }
        ControlFlow::Continue(())
    }

    fn damage(&mut self, damage: Damage) -> ControlFlow<()> {
        self.soundness.damage(&damage);
        self.damages.push(damage);
        if G::STOPS_AT_DAMAGE { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn progress(&mut self, at: u64, of: u64) {
        (self.progress)(at, of);
    }
}
