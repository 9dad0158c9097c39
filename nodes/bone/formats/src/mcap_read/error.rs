use osteoflow_container::{Cause, Damage, Location, ReadError, TooLarge};
use std::io;

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
    /// The path leads to no file that can be read.
    #[error(transparent)]
    File(#[from] crate::FileError),
    /// The folder of a ROS 2 bag cannot be read.
    #[error("{path}: {reason}")]
    Bag {
        /// The folder.
        path: String,
        /// What is wrong, and what to do.
        reason: String,
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
        "{path}: byte {}: {}; set allow_truncated = true to use the {n_messages} messages before it",
        .damage.bytes.start, .damage.cause
    )]
    Truncated {
        /// The file.
        path: String,
        /// The unfinished record.
        damage: Damage,
        /// Number of messages before it.
        n_messages: usize,
    },
    /// Its messages take more memory than is allowed.
    #[error("{path}: at {place}: {source}")]
    TooLarge {
        /// The file.
        path: String,
        /// Where the allowed memory was full.
        place: Location,
        /// The limit.
        source: TooLarge,
    },
    /// Bytes of the file are damaged.
    #[error(
        "{path}: byte {}: {}; copy the file again, or set allow_truncated = true to use what is intact",
        .damage.bytes.start, .damage.cause
    )]
    Damaged {
        /// The file.
        path: String,
        /// The damaged bytes.
        damage: Damage,
    },
    /// A message of a channel that the file does not describe.
    #[error("{path}: {location}: a message belongs to channel {channel}, which the file does not describe")]
    UnknownChannel {
        /// The file.
        path: String,
        /// Location of the message.
        location: Location,
        /// The channel.
        channel: u16,
    },
}

impl McapError {
    pub(super) fn of(path: &str, error: ReadError) -> Self {
        let path = path.to_owned();
        let start = match error {
            ReadError::Io(source) => return Self::Io { path, source },
            ReadError::Empty => return Self::Empty { path },
            ReadError::NotMcap { start } => start,
        };
        let hint = match start.as_slice() {
            s if s.starts_with(b"#ROSBAG") => ", a ROS 1 bag; convert it with `mcap convert`",
            s if s.starts_with(b"SQLite") => ", a ROS 2 bag of the older kind; convert it with `ros2 bag convert`",
            s if osteoflow_container::MAGIC.starts_with(s) => "; the file was cut short in its first bytes",
            _ => "; is it another kind of file, or damaged?",
        };
        Self::WrongMagic { path, found: hex(&start), hint }
    }

    /// Of a file whose header follows a damaged magic.
    pub(super) fn damaged_magic(path: &str, start: &[u8]) -> Self {
        let hint =
            "; an MCAP header follows, so copy the file again, or set allow_truncated = true to use what is intact";
        Self::WrongMagic { path: path.into(), found: hex(start), hint }
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ")
}

/// The damage of a section whose CRC does not hold; its bytes are used all the same.
pub(super) fn section_damage(what: &'static str, bytes: std::ops::Range<u64>, stored: u32, computed: u32) -> Damage {
    Damage { bytes, cause: Cause::Crc { what, stored, computed } }
}
