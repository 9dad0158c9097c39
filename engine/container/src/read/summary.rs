//! Descriptions of schemas and channels that the summary of a file repeats.

use super::{Location, N_MAGIC, Reader, Visitor};
use crate::{
    MAGIC, MAX_RECORD_BYTES, op,
    record::{self, RECORD_HEAD, Record},
};
use crc32fast::Hasher;
use std::{
    collections::{BTreeMap, BTreeSet},
    io::{self, Read, Seek},
    ops::{ControlFlow, Range},
};

/// Bytes of the footer and the closing magic.
const N_TAIL: u64 = RECORD_HEAD + 20 + N_MAGIC;

/// Offsets of the schemas and channels in the summary, by identifier.
#[derive(Default)]
pub(super) struct Summary {
    pub(super) schemas: BTreeMap<u16, u64>,
    pub(super) channels: BTreeMap<u16, u64>,
}

/// Identifiers that are used before the file has described them.
#[derive(Default)]
pub(super) struct Unknown {
    pub(super) schemas: BTreeSet<u16>,
    pub(super) channels: BTreeSet<u16>,
}

impl Unknown {
    pub(super) fn is_empty(&self) -> bool {
        self.schemas.is_empty() && self.channels.is_empty()
    }
}

impl<R: Read + Seek> Reader<R> {
    /// Finds the schemas and channels that the summary repeats: a damaged chunk may be the only other one to describe a
    /// channel. A summary that is damaged itself is not believed.
    pub(super) fn index_summary(&mut self) -> io::Result<Summary> {
        let mut summary = Summary::default();
        let Some(end) = self.n_bytes().checked_sub(N_TAIL).filter(|end| *end >= N_MAGIC) else { return Ok(summary) };
        let tail = self.input.array::<{ N_TAIL as usize }>(end)?;
        let Ok(Record::Footer { summary_start: start, crc: stored, .. }) = record::parse(op::FOOTER, &tail[9..29])
        else {
            return Ok(summary);
        };
        let is_footer = tail[0] == op::FOOTER && tail[29..] == *MAGIC;
        if !is_footer || !(N_MAGIC..end).contains(&start) || stored != 0 && self.crc(start..end + 25)? != stored {
            return Ok(summary);
        }
        let mut at = start;
        while at + RECORD_HEAD <= end {
            let (opcode, length) = self.input.head(at)?;
            let Some(next) = (at + RECORD_HEAD).checked_add(length).filter(|next| *next <= end) else { break };
            let offsets = match opcode {
                op::SCHEMA => &mut summary.schemas,
                op::CHANNEL => &mut summary.channels,
                _ => {
                    at = next;
                    continue;
                }
            };
            if length >= 2 {
                let id = u16::from_le_bytes(self.input.array(at + RECORD_HEAD)?);
                offsets.entry(id).or_insert(at);
            }
            at = next;
        }
        Ok(summary)
    }

    /// Visits the schemas and channels that only the summary describes.
    pub(super) fn describe_from_summary(
        &mut self,
        unknown: &Unknown,
        visitor: &mut impl Visitor,
    ) -> io::Result<ControlFlow<()>> {
        let mut schemas = unknown.schemas.clone();
        let mut channels = Vec::new();
        for id in &unknown.channels {
            if let Some((offset, content)) = self.summary_record(self.summary.channels.get(id).copied())?
                && let Ok(Record::Channel(channel)) = record::parse(op::CHANNEL, &content)
            {
                schemas.insert(channel.schema_id);
                channels.push((offset, content));
            }
        }
        let mut described = Vec::new();
        schemas.retain(|id| !self.described.has_schema(*id));
        for id in schemas {
            let schema = self.summary_record(self.summary.schemas.get(&id).copied())?;
            described.extend(schema.map(|schema| (op::SCHEMA, schema)));
        }
        described.extend(channels.into_iter().map(|channel| (op::CHANNEL, channel)));
        for (opcode, (offset, content)) in &described {
            if let Ok(record) = record::parse(*opcode, content)
                && self.described.check(&record).is_ok()
            {
                self.described.add(&record);
                if visitor.record(Location::at(*offset), record).is_break() {
                    return Ok(ControlFlow::Break(()));
                }
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    fn summary_record(&mut self, offset: Option<u64>) -> io::Result<Option<(u64, Vec<u8>)>> {
        let Some(offset) = offset else { return Ok(None) };
        let (_, length) = self.input.head(offset)?;
        if length > MAX_RECORD_BYTES {
            return Ok(None);
        }
        Ok(Some((offset, self.input.read(offset + RECORD_HEAD, length)?)))
    }

    fn crc(&mut self, bytes: Range<u64>) -> io::Result<u32> {
        let mut crc = Hasher::new();
        self.input.hash(bytes.start, bytes.end, &mut crc)?;
        Ok(crc.finalize())
    }
}
