//! What the subcommands do, with values in memory instead of files and text: the foundation of the Python package.
//!
//! The options of each function are those of its subcommand, as on the command line, so that defaults, checks and messages
//! are the same.

use crate::{
    app::{Error, MeshOrCloud},
    commands::{
        command_line::{Cli, Command},
        common::{Format, Global, global::Colour, log},
        register::{self, align::Ended},
    },
};
use clap::{Parser, error::ErrorKind};
use osteoflow_geometry::nalgebra::Isometry3;
use serde_json::Value;
use std::{
    io::IsTerminal,
    sync::{Arc, Once, atomic::AtomicBool},
};

/// Reads the options of a subcommand.
fn parsed(subcommand: &str, options: &[String]) -> Result<Command, Error> {
    static LOG: Once = Once::new();
    LOG.call_once(|| log::start(&global(true)));
    let words = ["osteoflow", subcommand].into_iter().map(String::from).chain(options.iter().cloned());
    Cli::try_parse_from(words).map(|cli| cli.command).map_err(|error| {
        debug_assert!(error.kind() != ErrorKind::DisplayHelp, "no caller asks for help");
        let text = error.render().to_string();
        let text = text.strip_prefix("error: ").unwrap_or(&text);
        Error::Usage(text.split("\n\nUsage:").next().unwrap_or(text).trim_end().to_owned())
    })
}

/// The switches: progress only on a terminal.
fn global(shows_progress: bool) -> Global {
    let quiet = !(shows_progress && std::io::stderr().is_terminal());
    Global { format: Format::Text, quiet, verbose: 0, color: Colour::Auto }
}

fn not_parsed() -> Error {
    Error::Failed("the options were taken for those of another subcommand, which is a bug".into())
}

/// Inputs of a registration that are in memory, and replace its files.
#[derive(Debug, Default)]
pub struct RegisterInputs {
    /// What stays, in mm.
    pub target: Option<MeshOrCloud>,
    /// What moves, in mm.
    pub source: Option<MeshOrCloud>,
    /// The start, source to target.
    pub init: Option<Isometry3<f64>>,
}

/// Registers as `osteoflow register` does, and returns its JSON. `options` name files also for inputs in memory, which are not
/// opened.
///
/// # Errors
/// [`Error`]; refused if the pose is, or if there is none.
pub fn register(
    options: &[String],
    inputs: RegisterInputs,
    with_trace: bool,
    shows_progress: bool,
    cancelled: &Arc<AtomicBool>,
) -> Result<Value, Error> {
    let Command::Register(asked) = parsed("register", options)? else { return Err(not_parsed()) };
    let RegisterInputs { target, source, init } = inputs;
    let ready = asked.ready(register::inputs::Given { target, source, init })?;
    let work = ready.work(cancelled, &global(shows_progress));
    let ended = ready.pool.install(|| work.run());
    let answered = ready.answer().answered(&ended, with_trace)?;
    match (&ended, answered.json["refused"]["reason"].as_str()) {
        (Ended::Interrupted, _) => Err(Error::Interrupted),
        (_, Some(why)) => Err(Error::Refused(why.to_owned(), answered.json)),
        _ => Ok(answered.json),
    }
}
