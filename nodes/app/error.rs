//! Why a request has no result.

use osteoflow_engine::Faults;
use osteoflow_formats::FileError;
use serde_json::Value;
use std::fmt;

/// Why there is no answer. Each text is that of the command.
#[derive(Debug)]
pub enum Error {
    /// The options or the graph have a fault; nothing was run.
    Usage(String),
    /// There is no result, for this reason; with what is known nevertheless, as the command prints it as JSON.
    Refused(String, Value),
    /// It was stopped.
    Interrupted,
    /// A file could not be read or written, or there was an internal error.
    Failed(String),
}

impl From<anyhow::Error> for Error {
    fn from(error: anyhow::Error) -> Self {
        let is_usage = error.chain().any(|cause| cause.is::<UsageError>() || cause.is::<Faults>());
        let sentence = with_causes(&error);
        if is_usage { Self::Usage(sentence) } else { Self::Failed(sentence) }
    }
}

impl From<FileError> for Error {
    fn from(error: FileError) -> Self {
        anyhow::Error::from(error).into()
    }
}

/// The request is impossible as stated; another command line is needed.
#[derive(Debug)]
pub(crate) struct UsageError(pub(crate) String);

impl fmt::Display for UsageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UsageError {}

/// The error and its causes as one sentence, without causes that a message before them contains.
pub(crate) fn with_causes(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |all, cause| {
        if all.is_empty() {
            cause
        } else if all.contains(&cause) || is_said(&all, &cause) {
            all
        } else {
            format!("{all}: {cause}")
        }
    })
}

/// Whether the message says in its own words what the system says.
fn is_said(message: &str, cause: &str) -> bool {
    let is_missing = message.ends_with("there is no such file") || message.contains("there is no folder");
    is_missing && cause.starts_with("No such file or directory")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;

    #[test]
    fn a_cause_that_the_message_contains_is_said_once() {
        let cause = || io::Error::other("no disk");
        let repeated = anyhow::Error::new(cause()).context("cannot read a.mcap: no disk");
        assert_eq!(with_causes(&repeated), "cannot read a.mcap: no disk");
        assert_eq!(
            with_causes(&anyhow::Error::new(cause()).context("cannot read a.mcap")),
            "cannot read a.mcap: no disk"
        );
        assert_eq!(with_causes(&repeated.context("while comparing")), "while comparing: cannot read a.mcap: no disk");
    }
}
