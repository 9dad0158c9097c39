//! Finds the next record behind damage.

use crate::{op, record::RECORD_HEAD};
use std::io::{self, Read, Seek, SeekFrom};

/// How much is looked through at a time.
const WINDOW: usize = 1 << 20;
/// How much of a record must be in sight to tell whether it is one: a metadata's name may be long.
const SIGHT: usize = 1 << 12;

/// The first place at or after `from` at which a record can begin.
///
/// Only such records are looked for whose own lengths must agree with the record's, so that chance does not make one:
/// chunks, message indexes, metadata and the data's end. What lies inside a damaged chunk is not taken for records of
/// the file, since no CRC would vouch for it.
pub(super) fn next_record<R: Read + Seek>(reader: &mut R, from: u64, n_bytes: u64) -> io::Result<Option<u64>> {
    let mut window = Vec::with_capacity(WINDOW.min(usize::try_from(n_bytes).unwrap_or(WINDOW)));
    let mut start = from;
    while start + RECORD_HEAD <= n_bytes {
        reader.seek(SeekFrom::Start(start))?;
        window.clear();
        reader.take(WINDOW as u64).read_to_end(&mut window)?;
        let last = start + window.len() as u64 >= n_bytes;
        let n_starts = if last { window.len() } else { window.len().saturating_sub(SIGHT) };
        let found = (0..n_starts).find(|&at| {
            let left = n_bytes - start - at as u64;
            is_record(&window[at..], left)
        });
        if let Some(at) = found {
            return Ok(Some(start + at as u64));
        }
        if last || n_starts == 0 {
            return Ok(None);
        }
        start += n_starts as u64;
    }
    Ok(None)
}

/// Whether a record that can be told from chance begins here; `left` bytes of the file are left.
fn is_record(bytes: &[u8], left: u64) -> bool {
    let Some(head) = bytes.get(..RECORD_HEAD as usize) else { return false };
    let length = u64::from_le_bytes(head[1..].try_into().expect("eight bytes follow the opcode"));
    if length > left - RECORD_HEAD {
        return false;
    }
    let content = &bytes[RECORD_HEAD as usize..];
    let word = |at: usize| Some(u32::from_le_bytes(content.get(at..at + 4)?.try_into().ok()?));
    let agrees = match head[0] {
        op::CHUNK => crate::record::chunk_head(&content[..content.len().min(64)], length).is_ok(),
        op::MESSAGE_INDEX => {
            let n = word(2).map(u64::from);
            // Two entries at least: one alone has so many zeros that chance makes it.
            n.is_some_and(|n| n >= 16 && n.is_multiple_of(16) && n + 6 == length)
        }
        op::METADATA => (|| {
            let name = u64::from(word(0)?);
            let map = u64::from(word(4 + usize::try_from(name).ok().filter(|n| *n < SIGHT)?)?);
            Some(name > 0 && 8 + name + map == length)
        })()
        .unwrap_or(false),
        op::DATA_END => {
            length == 4 && content.get(4).is_some_and(|opcode| (op::FOOTER..=op::DATA_END).contains(opcode))
        }
        _ => false,
    };
    agrees && follows(content, length)
}

/// Whether what follows the record, as far as it is in sight, can begin one.
fn follows(content: &[u8], length: u64) -> bool {
    let next = usize::try_from(length).ok().and_then(|at| content.get(at));
    next.is_none_or(|opcode| *opcode != 0)
}
