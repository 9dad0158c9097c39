use std::{fmt, ops::Range};

/// Bytes of a file that could not be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// Offsets of the bytes.
    pub bytes: Range<u64>,
    /// What is wrong with them.
    pub cause: Cause,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "bytes {} to {}: {}", self.bytes.start, self.bytes.end, self.cause)
    }
}

/// Cause of a damage.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Cause {
    /// The magic at the start has changed, but a header follows it.
    #[error("the magic of MCAP is damaged")]
    Magic {
        /// The first bytes of the file.
        start: Vec<u8>,
    },
    /// The file ends without footer and closing magic.
    #[error("the file ends without its footer")]
    NoFooter,
    /// The file ends inside a record.
    #[error("the file ends inside {what}: {needed} bytes are needed, {available} are left")]
    Truncated {
        /// The record.
        what: &'static str,
        /// Bytes of the record.
        needed: u64,
        /// Bytes that are left of the file.
        available: u64,
    },
    /// A length that cannot be true.
    #[error("{what} claims {length} bytes, but at most {limit} are possible")]
    Length {
        /// The record, or the part of it.
        what: &'static str,
        /// The length.
        length: u64,
        /// The largest length that is possible.
        limit: u64,
    },
    /// The bytes have changed since they were written.
    #[error("the CRC of {what} is {computed:08x}, but {stored:08x} was recorded, so bytes have changed")]
    Crc {
        /// What the CRC is of.
        what: &'static str,
        /// The CRC in the file.
        stored: u32,
        /// The CRC of the bytes.
        computed: u32,
    },
    /// A chunk cannot be unpacked.
    #[error("the chunk's \"{name}\" data cannot be unpacked: {reason}")]
    Compression {
        /// The compression that the chunk names.
        name: String,
        /// Why it cannot be unpacked.
        reason: String,
    },
    /// A record does not follow the format, or contradicts another one.
    #[error("{what}: {reason}")]
    Malformed {
        /// The record.
        what: &'static str,
        /// What is wrong with it.
        reason: String,
    },
}

impl Cause {
    pub(crate) fn malformed(what: &'static str) -> impl Fn(String) -> Self {
        move |reason| Self::Malformed { what, reason }
    }
}

/// End of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// The file ends with its footer and magic.
    Complete {
        /// Bytes after the closing magic.
        trailing: u64,
    },
    /// The file ends without footer and magic.
    Truncated(Damage),
    /// The visitor stopped.
    Stopped,
}

/// Warning about a file that is damaged or truncated; `None` for a complete one.
pub fn damage_message(damages: &[Damage], end: &End) -> Option<String> {
    let truncated = match end {
        End::Truncated(damage) => Some(format!("the file was cut short: {damage}")),
        End::Complete { .. } | End::Stopped => None,
    };
    let damaged = damages.first().map(|first| match damages.len() {
        1 => format!("the file is damaged: {first}"),
        n => format!("the file is damaged in {n} places, first {first}"),
    });
    match (damaged, truncated) {
        (Some(damaged), Some(truncated)) => Some(format!("{damaged}; {truncated}")),
        (damaged, truncated) => damaged.or(truncated),
    }
}
