//! Talk with a process in which a node fires: messages over a socket, and items in shared memory.
//!
//! Every message is its length (u32, little-endian) and JSON: [`wire::ToWorker`] one way, [`wire::FromWorker`] the other.
//! Descriptors of shared memory travel with the message that first names their segment (`SCM_RIGHTS`). Items lie in the
//! segments in the encoding of recordings, so that columns are read where they are. A segment is written by the process
//! that made it; the other maps it for reading, and says with each message which of them it still uses.
//!
//! docs/extend/processes.md has the protocol for authors of workers in other languages.

#[cfg(unix)]
pub(crate) mod child;
#[cfg(unix)]
pub mod hostile;
#[cfg(unix)]
pub(crate) mod segment;
#[cfg(unix)]
pub(crate) mod socket;
#[cfg(unix)]
pub(crate) mod wire;

use std::{ffi::OsString, path::PathBuf, process::Command};

/// Why a node cannot have a process of its own on this system, if it cannot: descriptors of shared memory cross Unix sockets.
pub(crate) const REFUSED_HERE: Option<&str> =
    if cfg!(unix) { None } else { Some("nodes fire in processes of their own on Linux and macOS only") };

/// A program that runs nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Launcher {
    /// The program.
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
    /// Variables that are set for it.
    pub environment: Vec<(&'static str, String)>,
}

impl Launcher {
    /// A program with its arguments, in the environment of this one.
    pub fn new(program: PathBuf, arguments: Vec<OsString>) -> Self {
        Self { program, arguments, environment: Vec::new() }
    }

    pub(crate) fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).envs(self.environment.iter().map(|(name, value)| (name, value)));
        command
    }
}
