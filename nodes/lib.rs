//! The command `osteoflow` as a library: its `main`, and what other programs call of it.
//!
//! `main` reads the command line, starts logging and turns the result into an exit code; each subcommand is a file in
//! `commands/`. [`app`] does what the subcommands ask for, also for the Python package.

/// Returns the error that the request is impossible as stated, for this reason.
macro_rules! usage {
    ($($reason:tt)+) => {
        return Err($crate::app::UsageError(format!($($reason)+)).into())
    };
}

pub mod app;
mod commands;

/// Progress on a terminal, for programs that call [`app`].
pub mod progress {
    pub use crate::commands::common::progress::{Progress, SweepProgress};
}

use app::{UsageError, with_causes};
use clap::{ColorChoice, Parser, error::ErrorKind};
use commands::{
    command_line::Cli,
    common::{Exit, Format, Global, crash, log, usage},
};
use std::{ffi::OsString, io::IsTerminal};

/// Runs the command with these arguments, the program's name first, as all that this process does; returns its exit code.
///
/// A crash names the node that was called. A process that goes on afterwards has handlers of signals that it did not ask for.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    crash::install();
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    app::host::set_arguments(&arguments);
    let code = code_of(arguments);
    crash::leave();
    code
}

fn code_of(arguments: Vec<OsString>) -> u8 {
    let cli = match Cli::try_parse_from(&arguments) {
        Ok(cli) => cli,
        // Help and version are results, anything else is a fault of the command line.
        Err(message) => {
            // The list of commands by what one wants is made for whom it is shown.
            let again = || Cli::grouped().try_get_matches_from(&arguments).err();
            let message = if message.kind() == ErrorKind::DisplayHelp { again().unwrap_or(message) } else { message };
            let code = if message.use_stderr() { Exit::Usage } else { Exit::Done }.code();
            usage::print(message, &arguments);
            return code;
        }
    };
    if !cli.command.is_worker() {
        log::start(&cli.global);
    }
    let exit = match cli.command.execute(&cli.global) {
        Ok(exit) => exit,
        // A reader of stdout may stop reading, as `head` does.
        Err(error) if is_broken_pipe(&error) => Exit::Done,
        Err(error) => {
            let _ = cli.global.say("error", with_causes(&error));
            if error.chain().any(|cause| cause.is::<UsageError>()) { Exit::Usage } else { Exit::Failed }
        }
    };
    exit.code()
}

/// Starts logging to stderr for a program that calls [`app`]: warnings on a terminal, elsewhere errors.
pub fn start_log() {
    let quiet = !std::io::stderr().is_terminal();
    log::start(&Global { format: Format::Text, quiet, verbose: 0, color: ColorChoice::Auto });
}

/// Whether the reader of stdout has gone. A file that cannot be read or written is another matter.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    if error.chain().any(|cause| cause.is::<osteoflow_formats::FileError>()) {
        return false;
    }
    let io = error.chain().find_map(|cause| cause.downcast_ref::<std::io::Error>());
    io.is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_formats::FileError;
    use std::io::{Error, ErrorKind};

    #[test]
    fn a_broken_pipe_is_that_of_stdout_and_not_of_a_file() {
        let broken = || Error::from(ErrorKind::BrokenPipe);
        assert!(is_broken_pipe(&anyhow::Error::new(broken()).context("printing")));
        let file = FileError::Io { path: "scan.ply".into(), action: "written", source: broken() };
        assert!(!is_broken_pipe(&anyhow::Error::new(file).context("converting")));
    }
}
