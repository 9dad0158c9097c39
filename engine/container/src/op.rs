//! Opcodes of MCAP records.

/// Profile and library of the file; the first record.
pub const HEADER: u8 = 0x01;
/// Offsets of the summary; the last record.
pub const FOOTER: u8 = 0x02;
/// Schema of messages.
pub const SCHEMA: u8 = 0x03;
/// Channel with its topic.
pub const CHANNEL: u8 = 0x04;
/// Message on a channel.
pub const MESSAGE: u8 = 0x05;
/// Compressed schemas, channels and messages.
pub const CHUNK: u8 = 0x06;
/// Offsets of a channel's messages in the chunk before it.
pub const MESSAGE_INDEX: u8 = 0x07;
/// Offset of a chunk.
pub const CHUNK_INDEX: u8 = 0x08;
/// Attached file.
pub const ATTACHMENT: u8 = 0x09;
/// Offset of an attachment.
pub const ATTACHMENT_INDEX: u8 = 0x0a;
/// Counts of records and messages.
pub const STATISTICS: u8 = 0x0b;
/// Named key-value pairs.
pub const METADATA: u8 = 0x0c;
/// Offset of a metadata record.
pub const METADATA_INDEX: u8 = 0x0d;
/// Offset of the summary's records of one kind.
pub const SUMMARY_OFFSET: u8 = 0x0e;
/// End of the data section.
pub const DATA_END: u8 = 0x0f;

/// Name of a record for messages.
pub(crate) fn name(opcode: u8) -> &'static str {
    match opcode {
        HEADER => "header",
        FOOTER => "footer",
        SCHEMA => "schema",
        CHANNEL => "channel",
        MESSAGE => "message",
        CHUNK => "chunk",
        MESSAGE_INDEX => "message index",
        CHUNK_INDEX => "chunk index",
        ATTACHMENT => "attachment",
        ATTACHMENT_INDEX => "attachment index",
        STATISTICS => "statistics",
        METADATA => "metadata",
        METADATA_INDEX => "metadata index",
        SUMMARY_OFFSET => "summary offset",
        DATA_END => "data end",
        _ => "unknown record",
    }
}
