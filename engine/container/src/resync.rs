//! Finds the next record behind damage.

use crate::{
    input::Input,
    op,
    record::{self, RECORD_HEAD},
};
use std::io::{self, Read, Seek};

/// Bytes that are searched at a time.
const WINDOW: u64 = 1 << 20;
/// Bytes of a record that must be in the window to recognise it: the name of a metadata record may be long.
const SIGHT: usize = 1 << 12;
/// Larger than any record of a file: a length above it is no length.
const MAX_PLAUSIBLE_LENGTH: u64 = 1 << 40;

/// Finds the first offset from `from` at which a record can begin.
///
/// Recognises only records whose own lengths agree with the record's, so that chance does not make one: chunks, message
/// indexes, metadata, attachments and the data's end. Records inside a damaged chunk are not recognised, because no CRC
/// confirms them. In a file without chunks, `has_channel` recognises messages of known channels as well, and schemas and
/// channels.
pub(crate) fn next_record<R: Read + Seek>(
    input: &mut Input<R>,
    from: u64,
    has_channel: Option<&dyn Fn(u16) -> bool>,
) -> io::Result<Option<u64>> {
    let n_bytes = input.n_bytes();
    let mut window = Vec::new();
    let mut start = from;
    while start + RECORD_HEAD <= n_bytes {
        let n_window = WINDOW.min(n_bytes - start);
        input.read_into(start, n_window, &mut window)?;
        let last = start + n_window >= n_bytes;
        let n_starts = if last { window.len() } else { window.len() - SIGHT };
        for at in 0..n_starts {
            let (bytes, offset) = (&window[at..], start + at as u64);
            if is_record(bytes, n_bytes - offset)
                || has_channel.is_some_and(|has| is_loose_record(bytes, n_bytes - offset, has))
                    && continues(input, offset, 2)?
            {
                return Ok(Some(offset));
            }
        }
        if last {
            return Ok(None);
        }
        start += n_starts as u64;
    }
    Ok(None)
}

/// Whether a record, or the end of the file, can be at `at`: one that a cut file ends in counts.
pub(crate) fn is_plausible<R: Read + Seek>(input: &mut Input<R>, at: u64) -> io::Result<bool> {
    let left = input.n_bytes().saturating_sub(at);
    if left < RECORD_HEAD {
        return Ok(left == 0 || (op::HEADER..=op::DATA_END).contains(&input.array::<1>(at)?[0]));
    }
    let (opcode, length) = input.head(at)?;
    Ok(match opcode {
        op::HEADER..=op::DATA_END => length < MAX_PLAUSIBLE_LENGTH,
        // Records of an application.
        0x80.. => length <= left - RECORD_HEAD,
        _ => false,
    })
}

/// Whether `n` plausible records, or the end of the file, follow the record at `at`.
fn continues<R: Read + Seek>(input: &mut Input<R>, mut at: u64, n: usize) -> io::Result<bool> {
    for _ in 0..n {
        if at.saturating_add(RECORD_HEAD) > input.n_bytes() {
            return Ok(true);
        }
        let (_, length) = input.head(at)?;
        at = at.saturating_add(RECORD_HEAD).saturating_add(length);
        if !is_plausible(input, at)? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Opcode, length and the visible content of a record that fits into the `left` bytes of the file.
fn split(bytes: &[u8], left: u64) -> Option<(u8, u64, &[u8])> {
    let (head, content) = bytes.split_at_checked(RECORD_HEAD as usize)?;
    let length = u64::from_le_bytes(head[1..].try_into().ok()?);
    (length <= left - RECORD_HEAD).then_some((head[0], length, content))
}

/// Reads the lengths of a record's fields.
struct Lengths<'a> {
    content: &'a [u8],
    at: u64,
}

impl Lengths<'_> {
    fn skip(mut self, n: u64) -> Option<Self> {
        self.at = self.at.checked_add(n)?;
        Some(self)
    }

    /// Skips a field behind its length in `N` bytes.
    fn field<const N: usize>(self) -> Option<Self> {
        let start = usize::try_from(self.at).ok()?;
        let mut length = [0; 8];
        length[..N].copy_from_slice(self.content.get(start..start.checked_add(N)?)?);
        self.skip(N as u64)?.skip(u64::from_le_bytes(length))
    }
}

/// Whether the bytes begin a record that is recognised anywhere; `left` bytes of the file are left.
fn is_record(bytes: &[u8], left: u64) -> bool {
    let Some((opcode, length, content)) = split(bytes, left) else { return false };
    let lengths = Lengths { content, at: 0 };
    let n_fields = match opcode {
        op::CHUNK => {
            return record::chunk_header(&content[..content.len().min(64)], length).is_ok() && follows(content, length);
        }
        // At least two entries: chance makes one, which is mostly zeros.
        op::MESSAGE_INDEX if length >= 6 + 32 && (length - 6).is_multiple_of(16) => {
            lengths.skip(2).and_then(Lengths::field::<4>)
        }
        op::METADATA if content.get(..4).is_some_and(|n| n != [0; 4]) => {
            lengths.field::<4>().and_then(Lengths::field::<4>)
        }
        op::ATTACHMENT => lengths
            .skip(16)
            .and_then(Lengths::field::<4>)
            .and_then(Lengths::field::<4>)
            .and_then(Lengths::field::<8>)
            .and_then(|l| l.skip(4)),
        op::DATA_END if length == 4 => {
            return content.get(4).is_some_and(|opcode| (op::FOOTER..=op::DATA_END).contains(opcode));
        }
        _ => None,
    };
    n_fields.is_some_and(|fields| fields.at == length) && follows(content, length)
}

/// Whether the bytes begin a record that is recognised in a file without chunks.
fn is_loose_record(bytes: &[u8], left: u64, has_channel: &dyn Fn(u16) -> bool) -> bool {
    let Some((opcode, length, content)) = split(bytes, left) else { return false };
    let lengths = Lengths { content, at: 0 };
    let fields = match opcode {
        op::MESSAGE => {
            let channel = content.get(..2).map(|id| u16::from_le_bytes([id[0], id[1]]));
            return length >= 22 && channel.is_some_and(has_channel);
        }
        op::SCHEMA if length > 14 => {
            lengths.skip(2).and_then(Lengths::field::<4>).and_then(Lengths::field::<4>).and_then(Lengths::field::<4>)
        }
        op::CHANNEL if length > 16 => {
            lengths.skip(4).and_then(Lengths::field::<4>).and_then(Lengths::field::<4>).and_then(Lengths::field::<4>)
        }
        _ => None,
    };
    fields.is_some_and(|fields| fields.at == length)
}

/// Whether the bytes after the record, if they are in sight, can begin another one.
fn follows(content: &[u8], length: u64) -> bool {
    let next = usize::try_from(length).ok().and_then(|at| content.get(at));
    next.is_none_or(|opcode| *opcode != 0)
}

#[cfg(test)]
mod tests;
