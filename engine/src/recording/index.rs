//! Index of a recording: position and digest of each item, so that recordings are digested and compared without loading them.

use super::{
    RecordingError, codec,
    format::{MetadataRecords, Recovered, RunRecord, WireCounts},
    run_record,
    scan::{Carried, Gather, PassState, Scanned, scan},
    wires::{Carries, Wire},
};
use crate::hash::Digest;
use osteoflow_container::{Location, MESSAGE_HEADER_BYTES, Progress, Reader};
use std::{
    collections::{BTreeMap, VecDeque},
    fs::File,
    io,
    ops::ControlFlow,
    path::{Path, PathBuf},
    rc::Rc,
};

/// Size of the cache of decompressed chunks.
const KEPT_BYTES: usize = 64 << 20;

/// Position and digest of an item.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IndexEntry {
    pub(crate) number: u64,
    pub(crate) digest: Digest,
    pub(crate) place: Location,
    /// Bytes between the head of the message and the item.
    n_before: u32,
    n_bytes: u32,
}

/// The items of a wire, by number; those of one number in the order of the file.
pub(crate) struct Indexed {
    pub(crate) about: Wire,
    pub(crate) entries: Vec<IndexEntry>,
    /// Number of values; the other items are empties.
    pub(crate) n_values: u64,
}

impl Indexed {
    /// A number that occurs twice.
    pub(crate) fn doubled(&self) -> Option<u64> {
        self.entries.windows(2).find(|pair| pair[0].number == pair[1].number).map(|pair| pair[0].number)
    }
}

/// An indexed recording.
pub(crate) struct Index {
    path: PathBuf,
    reader: Reader<File>,
    pub(crate) run: Option<RunRecord>,
    pub(crate) wires: BTreeMap<String, Indexed>,
    /// What is damaged or not sound.
    pub(crate) damage: Option<String>,
    pub(crate) metadata: MetadataRecords,
    /// Number of messages whose channels nothing in the file describes, and of those on exact channels that are no items.
    pub(crate) n_unread: [u64; 2],
    chunks: VecDeque<(u64, Rc<Vec<u8>>)>,
}

impl Index {
    /// Reads a recording. Memory: 72 bytes an item.
    pub(crate) fn of(path: &Path, progress: Progress<'_>) -> Result<Self, RecordingError> {
        let mut gathered = Gathered::default();
        let scanned = scan(path, &mut gathered, progress)?;
        let Gathered { mut wires, n_no_items } = gathered;
        scanned.refuse_foreign(path, !wires.is_empty())?;
        let Scanned { reader, metadata, damage, unsound, n_unknown } = scanned;
        wires.values_mut().for_each(|wire| wire.entries.sort_by_key(|entry| entry.number));
        let run = run_record(path, &metadata, None).ok();
        let (path, damage, n_unread) = (path.into(), damage.or(unsound), [n_unknown, n_no_items]);
        Ok(Self { path, reader, run, wires, damage, metadata, n_unread, chunks: VecDeque::new() })
    }

    /// Refuses a recording in which a number occurs twice: no item is the one to compare.
    pub(crate) fn without_doubles(self) -> Result<Self, RecordingError> {
        let reason = "the number stands there twice; `osteoflow validate` tells all that is wrong";
        match self.wires.iter().find_map(|(name, wire)| Some((name, wire.doubled()?))) {
            Some((name, number)) => Err(RecordingError::item(name, number, reason)),
            None => Ok(self),
        }
    }

    /// Whether it was recovered from a damaged file.
    pub(crate) fn is_recovered(&self) -> bool {
        self.metadata.has::<Recovered>()
    }

    /// Why it is not whole, if it is not.
    pub(crate) fn incomplete(&self) -> Option<String> {
        let why = match (self.is_recovered(), self.metadata.has::<WireCounts>()) {
            (true, _) => Some("it was recovered from a damaged file".into()),
            (false, has_ended) => (!has_ended).then(|| "the run did not finish it".into()),
        };
        self.damage.clone().or(why)
    }

    pub(crate) fn n_bytes(&self) -> u64 {
        self.reader.n_bytes()
    }

    /// Reads the message of an item.
    pub(crate) fn message(&mut self, entry: &IndexEntry) -> Result<Vec<u8>, RecordingError> {
        self.read(entry).map_err(|error| RecordingError::read(&self.path, error))
    }

    fn read(&mut self, entry: &IndexEntry) -> io::Result<Vec<u8>> {
        let Some(at) = entry.place.in_chunk else {
            let start = entry.place.offset + MESSAGE_HEADER_BYTES + u64::from(entry.n_before);
            return self.reader.bytes_at(start, entry.n_bytes.into());
        };
        let chunk = self.chunk(entry.place.offset)?;
        let start = usize::try_from(at + MESSAGE_HEADER_BYTES + u64::from(entry.n_before)).unwrap_or(usize::MAX);
        let bytes = start.checked_add(entry.n_bytes as usize).and_then(|end| chunk.get(start..end));
        bytes.map(<[u8]>::to_vec).ok_or_else(|| io::Error::other("the file has changed while it was read"))
    }

    fn chunk(&mut self, at: u64) -> io::Result<Rc<Vec<u8>>> {
        if let Some(found) = self.chunks.iter().position(|(offset, _)| *offset == at)
            && let Some(kept) = self.chunks.remove(found)
        {
            let chunk = kept.1.clone();
            self.chunks.push_back(kept);
            return Ok(chunk);
        }
        let chunk = Rc::new(self.reader.chunk_at(at)?);
        self.chunks.push_back((at, chunk.clone()));
        let kept = |chunks: &VecDeque<(u64, Rc<Vec<u8>>)>| chunks.iter().map(|(_, chunk)| chunk.len()).sum::<usize>();
        while self.chunks.len() > 1 && kept(&self.chunks) > KEPT_BYTES {
            self.chunks.pop_front();
        }
        Ok(chunk)
    }
}

#[derive(Default)]
struct Gathered {
    wires: BTreeMap<String, Indexed>,
    n_no_items: u64,
}

impl Gather for Gathered {
    fn wire(&mut self, wire: &Wire) {
        let indexed = || Indexed { about: wire.clone(), entries: Vec::new(), n_values: 0 };
        self.wires.entry(wire.name.clone()).or_insert_with(indexed);
    }

    fn message(&mut self, carried: Carried<'_>, state: &mut PassState) -> ControlFlow<()> {
        let Carried { carries, message, place, n_before } = carried;
        let Carries::Exact(wire) = carries else { return ControlFlow::Continue(()) };
        let n_bytes = message.data.len().try_into();
        if let (Some(head), Some(indexed), Ok(n_bytes)) =
            (codec::head(message.data), self.wires.get_mut(&wire.name), n_bytes)
        {
            state.allowance.take(size_of::<IndexEntry>())?;
            let (number, digest) = (head.number, Digest::of(message.data));
            indexed.n_values += u64::from(!head.is_empty);
            indexed.entries.push(IndexEntry { number, digest, place, n_before, n_bytes });
        } else {
            self.n_no_items += 1;
        }
        ControlFlow::Continue(())
    }
}
