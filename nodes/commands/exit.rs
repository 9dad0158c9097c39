use std::{error::Error, fmt, process::ExitCode};

/// How a command ended, as its exit code says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Exit {
    /// Everything asked for was done.
    Done,
    /// A file could not be read or written, or something of ours broke.
    Failed,
    /// A file that was to be checked is not sound; everything that is wrong was told.
    Unsound,
    /// The command line or the graph has a fault; nothing was run.
    Usage,
    /// A node failed, or the procedure could not be completed; `results.json` says `refused` and why.
    Refused,
    /// A replay differs from what was recorded.
    Differs,
    /// Stopped by Ctrl-C; what was written until then is valid.
    Interrupted,
}

impl Exit {
    /// The code, as the help lists it.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Failed | Self::Unsound => 1,
            Self::Usage => 2,
            Self::Refused => 3,
            Self::Differs => 4,
            Self::Interrupted => 130,
        }
    }

    /// The word for it.
    fn word(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Unsound => "unsound",
            Self::Usage => "faulty",
            Self::Refused => "refused",
            Self::Differs => "differs",
            Self::Interrupted => "interrupted",
        }
    }

    /// The same for machines.
    pub(crate) fn to_json(self) -> serde_json::Value {
        serde_json::json!({ "status": self.word(), "exit_code": self.code() })
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        exit.code().into()
    }
}

/// What was asked for cannot be done as it was asked: the answer is another command line.
#[derive(Debug)]
pub(crate) struct UsageError(pub(crate) String);

impl fmt::Display for UsageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Error for UsageError {}
