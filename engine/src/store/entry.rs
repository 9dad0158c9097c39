//! The file of an entry: a head of 64 bytes, then the bytes that were put.
//!
//! The head is `OSTEOST1`, the key's digest (32 bytes), the number of bytes (u64), their CRC-32 (u32), the CRC-32 of the
//! 52 bytes before (u32), and zeros; numbers are little-endian.

use super::Key;
use osteoflow_node::Buffer;
use std::{
    fs::File,
    io::{self, Read},
    ops::Range,
    sync::Arc,
};

const MAGIC: &[u8; 8] = b"OSTEOST1";
const HEAD_BYTES: usize = 64;

/// What lies under a key. A cheap handle; its bytes begin at an address that any column type accepts.
#[derive(Debug, Clone)]
pub struct Entry {
    words: Arc<Vec<u64>>,
    n_bytes: usize,
}

/// Bytes of a whole entry made of these pieces.
pub(super) fn n_bytes(pieces: &[&[u8]]) -> u64 {
    (HEAD_BYTES + pieces.iter().map(|piece| piece.len()).sum::<usize>()) as u64
}

/// What stands before the bytes.
pub(super) fn head(key: &Key, pieces: &[&[u8]]) -> io::Result<[u8; HEAD_BYTES]> {
    let mut crc = crc32fast::Hasher::new();
    pieces.iter().for_each(|piece| crc.update(piece));
    let n_bytes = n_bytes(pieces) - HEAD_BYTES as u64;
    let mut head = Vec::with_capacity(HEAD_BYTES);
    head.extend_from_slice(MAGIC);
    head.extend_from_slice(&key.digest().0);
    head.extend_from_slice(&n_bytes.to_le_bytes());
    head.extend_from_slice(&crc.finalize().to_le_bytes());
    let of_head = crc32fast::hash(&head);
    head.extend_from_slice(&of_head.to_le_bytes());
    head.resize(HEAD_BYTES, 0);
    head.try_into().map_err(|_| io::Error::other("the head of an entry has another length"))
}

impl Entry {
    /// The entry that a file holds, if it is this key's and whole; no length is believed before the file has it.
    pub(super) fn read(file: &mut File, key: &Key) -> io::Result<Option<Self>> {
        let mut head = [0; HEAD_BYTES];
        match file.read_exact(&mut head) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let word = |at: usize| u32::from_le_bytes(head[at..at + 4].try_into().expect("four bytes"));
        let n_bytes = u64::from_le_bytes(head[40..48].try_into().expect("eight bytes"));
        let (crc, of_head) = (word(48), word(52));
        let fits = head.starts_with(MAGIC) && head[8..40] == key.digest().0 && of_head == crc32fast::hash(&head[..52]);
        let in_file = file.metadata()?.len().checked_sub(HEAD_BYTES as u64);
        let Some(n_bytes) = usize::try_from(n_bytes).ok().filter(|n| fits && in_file == Some(*n as u64)) else {
            return Ok(None);
        };
        let mut words = vec![0_u64; n_bytes.div_ceil(8)];
        let bytes = &mut bytemuck::cast_slice_mut(&mut words)[..n_bytes];
        file.read_exact(bytes)?;
        let whole = crc32fast::hash(bytes) == crc;
        Ok(whole.then(|| Self { words: Arc::new(words), n_bytes }))
    }

    /// The bytes that were put.
    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.n_bytes]
    }

    /// A part of them that keeps the whole alive, for a column.
    pub(crate) fn part(&self, range: Range<usize>) -> Buffer {
        Arc::new(EntryRange { entry: self.clone(), range })
    }
}

struct EntryRange {
    entry: Entry,
    range: Range<usize>,
}

impl AsRef<[u8]> for EntryRange {
    fn as_ref(&self) -> &[u8] {
        &self.entry.bytes()[self.range.clone()]
    }
}
