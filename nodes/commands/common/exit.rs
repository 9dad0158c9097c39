use osteoflow_engine::run::Outcome;
use serde::Serialize;
use std::process::ExitCode;

/// The result of a command, which determines its exit code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Exit {
    /// Success.
    Done,
    /// A file could not be read or written, or there was an internal error.
    Failed,
    /// A checked file is not sound; all findings were reported.
    Unsound,
    /// The command line or the graph has a fault; nothing was run.
    #[serde(rename = "faulty")]
    Usage,
    /// A node failed, or the procedure could not be completed; `results.json` has `refused` with the reason.
    Refused,
    /// A replay differs from the recording.
    Differs,
    /// Runs of a sweep failed, so that its tables lack them.
    Incomplete,
    /// Stopped by Ctrl-C; everything written until then is valid.
    Interrupted,
}

impl Exit {
    /// That of a run.
    pub(crate) fn of(outcome: &Outcome) -> Self {
        match outcome {
            Outcome::Complete => Self::Done,
            Outcome::Refused(_) => Self::Refused,
            Outcome::Interrupted => Self::Interrupted,
        }
    }

    /// The exit code, as the help lists it.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Failed | Self::Unsound => 1,
            Self::Usage => 2,
            Self::Refused => 3,
            Self::Differs => 4,
            Self::Incomplete => 5,
            Self::Interrupted => 130,
        }
    }

    /// The result as JSON.
    pub(crate) fn to_json(self) -> serde_json::Value {
        serde_json::json!({ "status": self, "exit_code": self.code() })
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        exit.code().into()
    }
}
