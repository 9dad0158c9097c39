use crate::{Cause, fields::Fields, op};
use std::collections::BTreeMap;

/// Bytes of a record before its content: opcode and length.
pub(crate) const RECORD_HEAD: u64 = 9;
/// Bytes of a message record before its data.
pub const MESSAGE_HEADER_BYTES: u64 = RECORD_HEAD + 22;

/// A record of an MCAP file, borrowed from its bytes.
#[derive(Debug)]
pub enum Record<'a> {
    /// First record of a file.
    Header {
        /// How channels and metadata are used; empty for no profile.
        profile: &'a str,
    },
    /// Last record of a file.
    Footer {
        /// Offset of the summary; 0 for a file without one.
        summary_start: u64,
        /// CRC of the summary; 0 for none.
        crc: u32,
        /// CRC as [`Reader::with_section_crcs`](crate::Reader::with_section_crcs) computed it.
        computed: Option<u32>,
    },
    /// Schema of messages.
    Schema {
        /// Identifier, from 1.
        id: u16,
        /// Name, such as `foxglove.PointCloud`.
        name: &'a str,
        /// Encoding of `data`, such as `protobuf`.
        encoding: &'a str,
        /// The schema itself.
        data: &'a [u8],
    },
    /// Channel of messages.
    Channel(Channel),
    /// Message on a channel.
    Message(Message<'a>),
    /// Header of a chunk; the records of the chunk follow.
    Chunk(ChunkHeader),
    /// Index of a channel's messages in the chunk before it.
    MessageIndex {
        /// The channel.
        channel_id: u16,
        /// Log time and offset in the unpacked chunk of each message.
        entries: Vec<(u64, u64)>,
    },
    /// Index entry of a chunk in the summary.
    ChunkIndex(ChunkIndex),
    /// Attached file.
    Attachment(Attachment<'a>),
    /// Counts in the summary.
    Statistics(Statistics),
    /// Named key-value pairs.
    Metadata {
        /// Name of the record.
        name: &'a str,
        /// The key-value pairs.
        entries: BTreeMap<String, String>,
    },
    /// Index entry of a metadata record in the summary.
    MetadataIndex {
        /// Offset of the record.
        offset: u64,
        /// Name of the record.
        name: &'a str,
    },
    /// End of the data section.
    DataEnd {
        /// CRC of all bytes before this record; 0 for none.
        crc: u32,
        /// CRC as [`Reader::with_section_crcs`](crate::Reader::with_section_crcs) computed it.
        computed: Option<u32>,
    },
    /// Another record: an index that is not needed, or a record of a later version of the format.
    Other,
}

/// Channel of messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// Identifier.
    pub id: u16,
    /// Identifier of the schema; 0 for none.
    pub schema_id: u16,
    /// Topic, such as `/camera/scan`.
    pub topic: String,
    /// Encoding of the messages, such as `protobuf`.
    pub message_encoding: String,
    /// Key-value pairs of the writer.
    pub metadata: BTreeMap<String, String>,
}

/// Message on a channel.
#[derive(Debug, Clone, Copy)]
pub struct Message<'a> {
    /// The channel.
    pub channel_id: u16,
    /// Count of the sender.
    pub sequence: u32,
    /// Time at which the message was recorded, ns.
    pub log_time: u64,
    /// Time at which the message was sent, ns.
    pub publish_time: u64,
    /// The message itself.
    pub data: &'a [u8],
}

/// Header of a chunk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChunkHeader {
    /// Earliest log time of its messages; 0 for none.
    pub start_time: u64,
    /// Latest log time of its messages; 0 for none.
    pub end_time: u64,
    /// Bytes of the unpacked records.
    pub n_unpacked: u64,
    /// CRC of the unpacked records; 0 for none.
    pub crc: u32,
    /// Compression: empty, `lz4` or `zstd`.
    pub compression: String,
    /// Bytes of the packed records.
    pub n_packed: u64,
    /// Bytes of the chunk record before the packed records.
    pub n_head: u64,
    /// Bytes of the whole chunk record.
    pub n_record: u64,
}

/// Index entry of a chunk in the summary.
#[derive(Debug)]
pub struct ChunkIndex {
    /// Earliest log time of its messages.
    pub start_time: u64,
    /// Latest log time of its messages.
    pub end_time: u64,
    /// Offset of the chunk record.
    pub offset: u64,
    /// Bytes of the chunk record.
    pub length: u64,
    /// Compression of the chunk.
    pub compression: String,
    /// Bytes of the packed records.
    pub n_packed: u64,
    /// Bytes of the unpacked records.
    pub n_unpacked: u64,
}

/// Attached file.
#[derive(Debug)]
pub struct Attachment<'a> {
    /// Time at which it was recorded, ns.
    pub log_time: u64,
    /// Time at which it was created, ns; 0 if unknown.
    pub create_time: u64,
    /// File name.
    pub name: &'a str,
    /// Media type, such as `application/json`.
    pub media_type: &'a str,
    /// Content of the file.
    pub data: &'a [u8],
}

/// Counts in the summary.
#[derive(Debug, Clone)]
pub struct Statistics {
    /// Messages of all channels.
    pub n_messages: u64,
    /// Schemas.
    pub n_schemas: u16,
    /// Channels.
    pub n_channels: u32,
    /// Attachments.
    pub n_attachments: u32,
    /// Metadata records.
    pub n_metadata: u32,
    /// Chunks.
    pub n_chunks: u32,
    /// Messages of each channel.
    pub by_channel: BTreeMap<u16, u64>,
}

/// Inlined, as are the fields: a chunk can hold 34 million messages.
#[inline]
fn message(body: &[u8]) -> Result<Message<'_>, String> {
    let mut fields = Fields::new(body);
    let (channel_id, sequence) = (fields.u16()?, fields.u32()?);
    let (log_time, publish_time) = (fields.u64()?, fields.u64()?);
    Ok(Message { channel_id, sequence, log_time, publish_time, data: fields.rest() })
}

/// Parses a record other than a chunk, and checks the CRC of an attachment.
#[inline]
pub(crate) fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, Cause> {
    match opcode {
        op::MESSAGE => message(body).map(Record::Message).map_err(Cause::malformed(op::name(opcode))),
        _ => parse_other(opcode, body),
    }
}

fn parse_other(opcode: u8, body: &[u8]) -> Result<Record<'_>, Cause> {
    let record = parse_fields(opcode, body).map_err(Cause::malformed(op::name(opcode)))?;
    if let (Record::Attachment(_), Some((checked, stored))) = (&record, body.split_last_chunk()) {
        check_crc("the attachment", u32::from_le_bytes(*stored), crc32fast::hash(checked))?;
    }
    Ok(record)
}

fn parse_fields(opcode: u8, body: &[u8]) -> Result<Record<'_>, String> {
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
            Record::Footer { summary_start, crc, computed: None }
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
        op::MESSAGE => Record::Message(message(body)?),
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
            fields.u32()?;
            fields.end()?;
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
            Record::DataEnd { crc, computed: None }
        }
        _ => Record::Other,
    })
}

/// Parses the header of a chunk from the first bytes of its content; `length` is the length of the content.
pub(crate) fn chunk_header(bytes: &[u8], length: u64) -> Result<ChunkHeader, Cause> {
    parse_chunk_header(bytes, length).map_err(Cause::malformed("chunk"))
}

fn parse_chunk_header(bytes: &[u8], length: u64) -> Result<ChunkHeader, String> {
    let mut fields = Fields::new(bytes);
    let (start_time, end_time, n_unpacked) = (fields.u64()?, fields.u64()?, fields.u64()?);
    let (crc, compression, n_packed) = (fields.u32()?, fields.text()?.to_owned(), fields.u64()?);
    let n_head = fields.at() as u64;
    if n_packed.checked_add(n_head) != Some(length) {
        return Err(format!("its record claims {length} bytes, but its header {n_head} and its records {n_packed}"));
    }
    let n_record = RECORD_HEAD + length;
    let n_head = RECORD_HEAD + n_head;
    Ok(ChunkHeader { start_time, end_time, n_unpacked, crc, compression, n_packed, n_head, n_record })
}

/// Compares a stored CRC with the computed one; 0 means that the writer stored none.
pub(crate) fn check_crc(what: &'static str, stored: u32, computed: u32) -> Result<(), Cause> {
    if stored == 0 || stored == computed { Ok(()) } else { Err(Cause::Crc { what, stored, computed }) }
}

#[cfg(test)]
mod tests;
