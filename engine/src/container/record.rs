use super::fields::Fields;
use mcap::records::op;
use std::collections::BTreeMap;

/// A record's own bytes in front of its content: opcode and length.
pub(crate) const RECORD_HEAD: u64 = 9;
/// The bytes of a message's record in front of its data.
pub(crate) const MESSAGE_HEAD: u64 = RECORD_HEAD + 22;

/// A record of an MCAP file, borrowed from its bytes.
#[derive(Debug)]
pub(crate) enum Record<'a> {
    Header {
        profile: &'a str,
    },
    Footer {
        summary_start: u64,
        crc: u32,
    },
    Schema {
        id: u16,
        name: &'a str,
        encoding: &'a str,
        data: &'a [u8],
    },
    Channel(Channel),
    Message(Message<'a>),
    /// What a chunk says of itself; its records follow.
    Chunk(ChunkHead),
    /// Log times and places in the chunk.
    MessageIndex {
        channel_id: u16,
        entries: Vec<(u64, u64)>,
    },
    ChunkIndex(ChunkIndex),
    Attachment(Attachment<'a>),
    Statistics(Statistics),
    Metadata {
        name: &'a str,
        entries: BTreeMap<String, String>,
    },
    MetadataIndex {
        offset: u64,
        name: &'a str,
    },
    DataEnd {
        crc: u32,
    },
    /// What this program has no use for: other indexes, and what later versions of the format may add.
    Other,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Channel {
    pub(crate) id: u16,
    pub(crate) schema_id: u16,
    pub(crate) topic: String,
    pub(crate) message_encoding: String,
    pub(crate) metadata: BTreeMap<String, String>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Message<'a> {
    pub(crate) channel_id: u16,
    pub(crate) sequence: u32,
    pub(crate) log_time: u64,
    pub(crate) publish_time: u64,
    pub(crate) data: &'a [u8],
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ChunkHead {
    pub(crate) start_time: u64,
    pub(crate) end_time: u64,
    pub(crate) n_unpacked: u64,
    pub(crate) crc: u32,
    pub(crate) compression: String,
    pub(crate) n_packed: u64,
    /// Bytes of the record in front of the packed ones.
    pub(crate) n_head: u64,
    /// Bytes of the whole record.
    pub(crate) n_record: u64,
}

#[derive(Debug)]
pub(crate) struct ChunkIndex {
    pub(crate) start_time: u64,
    pub(crate) end_time: u64,
    pub(crate) offset: u64,
    pub(crate) length: u64,
    pub(crate) compression: String,
    pub(crate) n_packed: u64,
    pub(crate) n_unpacked: u64,
}

#[derive(Debug)]
pub(crate) struct Attachment<'a> {
    pub(crate) log_time: u64,
    pub(crate) create_time: u64,
    pub(crate) name: &'a str,
    pub(crate) media_type: &'a str,
    pub(crate) data: &'a [u8],
}

#[derive(Debug, Clone)]
pub(crate) struct Statistics {
    pub(crate) n_messages: u64,
    pub(crate) n_schemas: u16,
    pub(crate) n_channels: u32,
    pub(crate) n_attachments: u32,
    pub(crate) n_metadata: u32,
    pub(crate) n_chunks: u32,
    pub(crate) by_channel: BTreeMap<u16, u64>,
}

/// The name of a kind of record, as messages tell it.
pub(crate) fn name(opcode: u8) -> &'static str {
    match opcode {
        op::HEADER => "header",
        op::FOOTER => "footer",
        op::SCHEMA => "schema",
        op::CHANNEL => "channel",
        op::MESSAGE => "message",
        op::CHUNK => "chunk",
        op::MESSAGE_INDEX => "message index",
        op::CHUNK_INDEX => "chunk index",
        op::ATTACHMENT => "attachment",
        op::ATTACHMENT_INDEX => "attachment index",
        op::STATISTICS => "statistics",
        op::METADATA => "metadata",
        op::METADATA_INDEX => "metadata index",
        op::SUMMARY_OFFSET => "summary offset",
        op::DATA_END => "data end",
        _ => "unknown record",
    }
}

/// The record of these bytes; chunks are read elsewhere, since they may be large.
pub(crate) fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, String> {
    let mut fields = Fields::new(body);
    Ok(match opcode {
        op::HEADER => {
            let profile = fields.text()?;
            fields.text()?;
            Record::Header { profile }
        }
        op::FOOTER => {
            let summary_start = fields.u64()?;
            fields.u64()?;
            let crc = fields.u32()?;
            fields.end()?;
            Record::Footer { summary_start, crc }
        }
        op::SCHEMA => {
            let (id, name, encoding) = (fields.u16()?, fields.text()?, fields.text()?);
            let data = fields.entries()?;
            fields.end()?;
            Record::Schema { id, name, encoding, data }
        }
        op::CHANNEL => {
            let (id, schema_id) = (fields.u16()?, fields.u16()?);
            let (topic, message_encoding) = (fields.text()?.to_owned(), fields.text()?.to_owned());
            let metadata = fields.map()?;
            fields.end()?;
            Record::Channel(Channel { id, schema_id, topic, message_encoding, metadata })
        }
        op::MESSAGE => {
            let (channel_id, sequence) = (fields.u16()?, fields.u32()?);
            let (log_time, publish_time) = (fields.u64()?, fields.u64()?);
            Record::Message(Message { channel_id, sequence, log_time, publish_time, data: fields.rest() })
        }
        op::MESSAGE_INDEX => {
            let channel_id = fields.u16()?;
            let mut entries = Fields::new(fields.entries()?);
            fields.end()?;
            let mut list = Vec::new();
            while entries.at() < body.len() - 6 {
                list.push((entries.u64()?, entries.u64()?));
            }
            Record::MessageIndex { channel_id, entries: list }
        }
        op::CHUNK_INDEX => {
            let (start_time, end_time) = (fields.u64()?, fields.u64()?);
            let (offset, length) = (fields.u64()?, fields.u64()?);
            fields.entries()?;
            fields.u64()?;
            let compression = fields.text()?.to_owned();
            let (n_packed, n_unpacked) = (fields.u64()?, fields.u64()?);
            Record::ChunkIndex(ChunkIndex { start_time, end_time, offset, length, compression, n_packed, n_unpacked })
        }
        op::ATTACHMENT => {
            let (log_time, create_time) = (fields.u64()?, fields.u64()?);
            let (name, media_type) = (fields.text()?, fields.text()?);
            let n_bytes = fields.u64()?;
            let data = fields.take(n_bytes)?;
            let n_checked = fields.at();
            let stored = fields.u32()?;
            check_crc("the attachment", stored, || crc32fast::hash(&body[..n_checked]))?;
            Record::Attachment(Attachment { log_time, create_time, name, media_type, data })
        }
        op::STATISTICS => {
            let (n_messages, n_schemas) = (fields.u64()?, fields.u16()?);
            let (n_channels, n_attachments) = (fields.u32()?, fields.u32()?);
            let (n_metadata, n_chunks) = (fields.u32()?, fields.u32()?);
            fields.take(16)?;
            let list = fields.entries()?;
            if !list.len().is_multiple_of(10) {
                return Err("its counts by channel end within an entry".into());
            }
            let mut counts = Fields::new(list);
            let mut by_channel = BTreeMap::new();
            while counts.at() < list.len() {
                let channel = counts.u16()?;
                by_channel.insert(channel, counts.u64()?);
            }
            Record::Statistics(Statistics {
                n_messages,
                n_schemas,
                n_channels,
                n_attachments,
                n_metadata,
                n_chunks,
                by_channel,
            })
        }
        op::METADATA => {
            let name = fields.text()?;
            let entries = fields.map()?;
            fields.end()?;
            Record::Metadata { name, entries }
        }
        op::METADATA_INDEX => {
            let offset = fields.u64()?;
            fields.u64()?;
            Record::MetadataIndex { offset, name: fields.text()? }
        }
        op::DATA_END => {
            let crc = fields.u32()?;
            fields.end()?;
            Record::DataEnd { crc }
        }
        _ => Record::Other,
    })
}

/// The head of a chunk from the first bytes of its record's content; `length` is the content's as the record claims it.
pub(super) fn chunk_head(bytes: &[u8], length: u64) -> Result<ChunkHead, String> {
    let mut fields = Fields::new(bytes);
    let (start_time, end_time, n_unpacked) = (fields.u64()?, fields.u64()?, fields.u64()?);
    let (crc, compression, n_packed) = (fields.u32()?, fields.text()?.to_owned(), fields.u64()?);
    let n_head = fields.at() as u64;
    if n_packed.checked_add(n_head) != Some(length) {
        return Err(format!("its record claims {length} bytes, its head {n_head} and {n_packed} packed ones"));
    }
    let n_record = RECORD_HEAD + length;
    let n_head = RECORD_HEAD + n_head;
    Ok(ChunkHead { start_time, end_time, n_unpacked, crc, compression, n_packed, n_head, n_record })
}

/// A CRC of zero says that the writer did not compute one.
pub(super) fn check_crc(what: &str, stored: u32, calculated: impl FnOnce() -> u32) -> Result<(), String> {
    if stored == 0 {
        return Ok(());
    }
    let calculated = calculated();
    if stored == calculated {
        return Ok(());
    }
    Err(format!("the CRC of {what} is {calculated:08x}, but {stored:08x} was recorded, so bytes have changed"))
}
