use crate::{FileError, input, kind::marked};
use osteoflow_container::{Damage, ReadError};

/// A recording that cannot be read, or not to its end.
#[derive(Debug, thiserror::Error)]
pub enum McapError {
    /// The path leads to no file that can be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file or folder is no recording that can be read: what was found, and what to do.
    #[error("{path}: {reason}")]
    Unreadable {
        /// The file or folder.
        path: String,
        /// What is wrong, and where.
        reason: String,
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
}

impl McapError {
    pub(super) fn of(path: &str, error: ReadError) -> Self {
        let start = match error {
            ReadError::Io(source) => return FileError::read(path.as_ref())(source).into(),
            ReadError::Empty => {
                let reason =
                    "the file is empty, an MCAP recording is expected; was it stopped before anything was written?";
                return Self::Unreadable { path: path.into(), reason: reason.into() };
            }
            ReadError::NotMcap { start } => start,
        };
        if osteoflow_container::MAGIC.starts_with(&start) {
            return Self::wrong_magic(path, &start, "; the file was cut short in its first bytes");
        }
        // Bytes in memory have no file.
        let head = input::head(path.as_ref(), 1 << 16).unwrap_or(start);
        match marked(path.as_ref(), &head) {
            Some(found) => found.refusal(path.as_ref(), "a recording").into(),
            None => Self::wrong_magic(path, &head[..head.len().min(8)], "; is it another kind of file, or damaged?"),
        }
    }

    /// Of a file whose header follows a damaged magic.
    pub(super) fn damaged_magic(path: &str, start: &[u8]) -> Self {
        let hint =
            "; an MCAP header follows, so copy the file again, or set allow_truncated = true to use what is intact";
        Self::wrong_magic(path, start, hint)
    }

    fn wrong_magic(path: &str, start: &[u8], hint: &str) -> Self {
        let start = start.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ");
        let reason =
            format!("byte 0: an MCAP begins with 89 4D 43 41 50 30 0D 0A, but this file begins with {start}{hint}");
        Self::Unreadable { path: path.into(), reason }
    }
}
