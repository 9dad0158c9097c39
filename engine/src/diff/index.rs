//! Index of a recording: position and digest of each item, so that two recordings are compared without loading either.

use crate::{
    hash::Digest,
    recording::{
        RecordingError, codec,
        format::{MetadataRecords, Recovered, RunRecord, WireCounts},
        run_record,
        scan::{Carried, Gather, PassState, Scanned, scan},
        wires::{Carries, Wire},
    },
};
use osteoflow_container::{Location, MESSAGE_HEADER_BYTES, Reader};
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
pub(super) struct IndexEntry {
    pub(super) number: u64,
    pub(super) digest: Digest,
    pub(super) place: Location,
    /// Bytes between the head of the message and the item.
    n_before: u32,
    n_bytes: u32,
}

/// The items of a wire, by number.
pub(super) struct Indexed {
    pub(super) about: Wire,
    pub(super) entries: Vec<IndexEntry>,
}

/// An indexed recording.
pub(super) struct Index {
    path: PathBuf,
    reader: Reader<File>,
    pub(super) run: Option<RunRecord>,
    pub(super) wires: BTreeMap<String, Indexed>,
    pub(super) incomplete: Option<String>,
    pub(super) metadata: MetadataRecords,
    chunks: VecDeque<(u64, Rc<Vec<u8>>)>,
}

impl Index {
    pub(super) fn of(path: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Self, RecordingError> {
        let mut wires = Wires::default();
        let scanned = scan(path, &mut wires, progress)?;
        scanned.refuse_foreign(path, !wires.0.is_empty())?;
        let (Wires(mut wires), Scanned { reader, metadata, damage, unsound, .. }) = (wires, scanned);
        let mut incomplete = damage.or(unsound);
        if incomplete.is_none() {
            incomplete = match metadata {
                ref m if m.has::<Recovered>() => Some("it was recovered from a damaged file".into()),
                ref m if !m.has::<WireCounts>() => Some("the run did not finish it".into()),
                _ => None,
            };
        }
        for (name, wire) in &mut wires {
            wire.entries.sort_by_key(|entry| entry.number);
            if let Some(pair) = wire.entries.windows(2).find(|pair| pair[0].number == pair[1].number) {
                let reason = "the number stands there twice; `osteoflow validate` tells all that is wrong";
                return Err(RecordingError::item(name, pair[0].number, reason));
            }
        }
        let run = run_record(path, &metadata, None).ok();
        Ok(Self { path: path.into(), reader, run, wires, incomplete, metadata, chunks: VecDeque::new() })
    }

    pub(super) fn n_bytes(&self) -> u64 {
        self.reader.n_bytes()
    }

    /// Reads the message of an item.
    pub(super) fn message(&mut self, entry: &IndexEntry) -> Result<Vec<u8>, RecordingError> {
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
struct Wires(BTreeMap<String, Indexed>);

impl Gather for Wires {
    fn wire(&mut self, wire: &Wire) {
        let indexed = || Indexed { about: wire.clone(), entries: Vec::new() };
        self.0.entry(wire.name.clone()).or_insert_with(indexed);
    }

    fn message(&mut self, carried: Carried<'_>, state: &mut PassState) -> ControlFlow<()> {
        let Carried { carries, message, place, n_before } = carried;
        if let Carries::Exact(wire) = carries
            && let Some(indexed) = self.0.get_mut(&wire.name)
            && let Some(number) = codec::number(message.data)
            && let Ok(n_bytes) = message.data.len().try_into()
        {
            state.allowance.take(size_of::<IndexEntry>())?;
            let digest = Digest::of(message.data);
            indexed.entries.push(IndexEntry { number, digest, place, n_before, n_bytes });
        }
        ControlFlow::Continue(())
    }
}
