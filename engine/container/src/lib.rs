//! Reads and writes MCAP files.
//!
//! [`Reader`] passes over a file of any writer, whole or damaged: it guards every length before it allocates, checks the
//! CRC of every chunk and attachment, and resumes at the next record behind damage. [`Writer`] appends whole chunks and
//! never seeks, so a process that is killed leaves every chunk that was finished; the `mcap` crate makes its records
//! (`docs/decisions/0010`).
//!
//! The topics of a file:
#![doc = concat!("```\n", include_str!("../examples/read_mcap.rs"), "```")]

mod allowance;
mod chunk;
mod compression;
mod damage;
mod descriptions;
pub mod durable;
mod fields;
mod input;
pub mod op;
mod read;
mod record;
mod regular;
mod resync;
mod segments;
mod write;

pub use allowance::{Allowance, TooLarge};
pub use compression::Compression;
pub use damage::{Cause, Damage, End, damage_message};
pub use mcap::records::MessageHeader;
pub use read::{Location, Progress, ReadError, Reader, Visitor};
pub use record::{Attachment, Channel, ChunkHeader, ChunkIndex, MESSAGE_HEADER_BYTES, Message, Record, Statistics};
pub use regular::{irregular, regular};
pub use segments::{Segments, SharedBytes};
pub use write::{Sink, WriteOptions, Writer};

/// The first and the last bytes of an MCAP file.
pub const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// Longest record, and longest unpacked chunk: no recorder writes longer ones, so a greater length is damage.
pub const MAX_RECORD_BYTES: u64 = 1 << 30;
