//! The command `osteoflow`: checks, runs, records and replays graphs of nodes.
//!
//! `main` reads the command line, starts logging and turns the result into an exit code; each subcommand is a file in
//! `commands/`.

mod commands;

use clap::Parser;
use commands::{Cli, Exit, UsageError};
use std::{io::Write, process::ExitCode};

fn main() -> ExitCode {
    commands::crash::install();
    let exit = execute();
    commands::crash::leave();
    exit
}

fn execute() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        // Help and version are results, anything else is a fault of the command line; clap formats both.
        Err(said) => {
            let _ = said.print();
            return if said.use_stderr() { Exit::Usage.into() } else { Exit::Done.into() };
        }
    };
    if !cli.command.is_worker() {
        commands::log::start(&cli.global);
    }
    match cli.command.execute(&cli.global) {
        Ok(exit) => exit.into(),
        // A reader of stdout may stop reading, as `head` does.
        Err(error) if is_broken_pipe(&error) => Exit::Done.into(),
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "{}: {error:#}", cli.global.paint_err("error", "1;31"));
            if error.chain().any(|cause| cause.is::<UsageError>()) { Exit::Usage.into() } else { Exit::Failed.into() }
        }
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let io = error.chain().find_map(|cause| cause.downcast_ref::<std::io::Error>());
    io.is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}
