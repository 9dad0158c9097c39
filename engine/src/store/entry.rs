//! The file of an entry: a header of 64 bytes, then the content.
//!
//! The header is `OSTEOST1`, the key's digest (32 bytes), the number of bytes (u64), their CRC-32 (u32), the CRC-32 of
//! the 52 bytes before (u32), and zeros; numbers are little-endian.

use super::Key;
use osteoflow_node::Buffer;
use std::{
    fs::File,
    io::{self, Read},
    ops::Range,
    sync::Arc,
};

const MAGIC: &[u8; 8] = b"OSTEOST1";
const HEADER_BYTES: usize = 64;

/// The content of an entry. A cheap handle; the bytes are aligned for any column type.
#[derive(Debug, Clone)]
pub struct StoreEntry {
    words: Arc<Vec<u64>>,
    n_bytes: usize,
}

/// Size of the whole entry for a content of these pieces.
pub(super) fn n_bytes(pieces: &[&[u8]]) -> u64 {
    (HEADER_BYTES + pieces.iter().map(|piece| piece.len()).sum::<usize>()) as u64
}

/// The header of an entry.
pub(super) fn header(key: &Key, pieces: &[&[u8]]) -> io::Result<[u8; HEADER_BYTES]> {
    let mut crc = crc32fast::Hasher::new();
    pieces.iter().for_each(|piece| crc.update(piece));
    let n_bytes = n_bytes(pieces) - HEADER_BYTES as u64;
    let mut header = Vec::with_capacity(HEADER_BYTES);
    header.extend_from_slice(MAGIC);
    header.extend_from_slice(&key.digest().0);
    header.extend_from_slice(&n_bytes.to_le_bytes());
    header.extend_from_slice(&crc.finalize().to_le_bytes());
    let of_head = crc32fast::hash(&header);
    header.extend_from_slice(&of_head.to_le_bytes());
    header.resize(HEADER_BYTES, 0);
    header.try_into().map_err(|_| io::Error::other("the header of an entry has another length"))
}

impl StoreEntry {
    /// Reads an entry from a file; `None` unless it is complete and belongs to the key. Allocates only what the file
    /// holds.
    pub(super) fn read(file: &mut File, key: &Key) -> io::Result<Option<Self>> {
        let mut header = [0; HEADER_BYTES];
        match file.read_exact(&mut header) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let word = |at: usize| u32::from_le_bytes(header[at..at + 4].try_into().expect("four bytes"));
        let n_bytes = u64::from_le_bytes(header[40..48].try_into().expect("eight bytes"));
        let (crc, of_head) = (word(48), word(52));
        let fits =
            header.starts_with(MAGIC) && header[8..40] == key.digest().0 && of_head == crc32fast::hash(&header[..52]);
        let in_file = file.metadata()?.len().checked_sub(HEADER_BYTES as u64);
        let Some(n_bytes) = usize::try_from(n_bytes).ok().filter(|n| fits && in_file == Some(*n as u64)) else {
            return Ok(None);
        };
        let mut words = vec![0_u64; n_bytes.div_ceil(8)];
        let bytes = &mut bytemuck::cast_slice_mut(&mut words)[..n_bytes];
        file.read_exact(bytes)?;
        let whole = crc32fast::hash(bytes) == crc;
        Ok(whole.then(|| Self { words: Arc::new(words), n_bytes }))
    }

    /// The content.
    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.n_bytes]
    }

    /// A range of the content as a column; it keeps the whole entry alive.
    pub(crate) fn part(&self, range: Range<usize>) -> Buffer {
        Arc::new(EntryRange { entry: self.clone(), range })
    }
}

struct EntryRange {
    entry: StoreEntry,
    range: Range<usize>,
}

impl AsRef<[u8]> for EntryRange {
    fn as_ref(&self) -> &[u8] {
        &self.entry.bytes()[self.range.clone()]
    }
}
