use std::{fmt, io};

/// A recording that cannot be read, or not to its end.
#[derive(Debug, thiserror::Error)]
pub enum McapError {
    /// The file is missing or may not be read.
    #[error("{path}: cannot be read: {source}")]
    Io {
        /// The file.
        path: String,
        /// What the system said.
        source: io::Error,
    },
    /// The file has no bytes.
    #[error("{path}: the file is empty, an MCAP recording is expected; was it stopped before anything was written?")]
    Empty {
        /// The file.
        path: String,
    },
    /// The file is something else.
    #[error("{path}: byte 0: an MCAP begins with 89 4D 43 41 50 30 0D 0A, but this file begins with {found}{hint}")]
    WrongMagic {
        /// The file.
        path: String,
        /// Its first bytes.
        found: String,
        /// What it may be instead.
        hint: &'static str,
    },
    /// The file ends too early.
    #[error(
        "{path}: {place}: the file ends inside {what}: {needed} bytes are needed, {available} are left; \
         set allow_truncated = true to use the {n_messages} messages before it"
    )]
    Truncated {
        /// The file.
        path: String,
        /// Where the unfinished part begins.
        place: Place,
        /// What is unfinished.
        what: &'static str,
        /// How many bytes it should have.
        needed: u64,
        /// How many it has.
        available: u64,
        /// How many messages lie before it.
        n_messages: usize,
    },
    /// Bytes have changed since they were written.
    #[error(
        "{path}: {place}: the CRC of {what} is {calculated:08x}, but {stored:08x} was recorded, so bytes have changed; \
         copy the file again, or set allow_truncated = true to use what is intact"
    )]
    BadCrc {
        /// The file.
        path: String,
        /// Where the part begins.
        place: Place,
        /// What was checked.
        what: &'static str,
        /// The CRC in the file.
        stored: u32,
        /// The CRC of the bytes as they are.
        calculated: u32,
    },
    /// A length field that cannot be true.
    #[error(
        "{path}: {place}: {what} claims {length} bytes, but at most {limit} are possible; \
         copy the file again, or set allow_truncated = true to use what is intact"
    )]
    Length {
        /// The file.
        path: String,
        /// Where the record begins.
        place: Place,
        /// Which length it is.
        what: &'static str,
        /// What it claims.
        length: u64,
        /// What is possible.
        limit: u64,
    },
    /// A record that does not follow the format.
    #[error("{path}: {place}: {what}: {reason}; set allow_truncated = true to use what is intact")]
    Malformed {
        /// The file.
        path: String,
        /// Where the record begins.
        place: Place,
        /// What kind of record it is.
        what: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// A chunk that cannot be unpacked.
    #[error(
        "{path}: {place}: the chunk's \"{compression}\" data cannot be unpacked: {reason}; none, lz4 and zstd are known"
    )]
    Compression {
        /// The file.
        path: String,
        /// Where the chunk begins.
        place: Place,
        /// The compression it names.
        compression: String,
        /// What went wrong.
        reason: String,
    },
    /// A message of a channel that the file does not describe.
    #[error("{path}: {place}: a message belongs to channel {channel}, which the file does not describe")]
    UnknownChannel {
        /// The file.
        path: String,
        /// Where the message begins.
        place: Place,
        /// The channel.
        channel: u16,
    },
}

/// Where in a file something lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// The byte of the file at which the record, or the chunk around it, begins.
    pub offset: u64,
    /// The byte within the unpacked chunk, for a record in a chunk.
    pub in_chunk: Option<u64>,
}

impl Place {
    pub(super) fn at(offset: u64) -> Self {
        Self { offset, in_chunk: None }
    }

    pub(super) fn inside(self, position: usize) -> Self {
        Self { in_chunk: Some(position as u64), ..self }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.in_chunk {
            None => write!(f, "byte {}", self.offset),
            Some(position) => write!(f, "byte {position} of the unpacked chunk at byte {}", self.offset),
        }
    }
}
