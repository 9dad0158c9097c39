//! `experiment.json`: the files of an archive.

use serde::{Deserialize, Serialize};

/// Increase when the layout of an archive changes.
pub(crate) const FORMAT: u64 = 1;

/// The content of `experiment.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Index {
    pub(crate) format: u64,
    /// Version of the program that wrote it.
    pub(crate) version: String,
    pub(crate) what: What,
    /// Name of the graph.
    pub(crate) name: String,
    /// All other files, by path.
    pub(crate) files: Vec<Entry>,
}

/// What an archive holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum What {
    Run,
    Sweep,
}

impl What {
    /// The subcommand that runs it again.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Run => "run",
            Self::Sweep => "sweep",
        }
    }
}

/// A file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Entry {
    pub(crate) path: String,
    pub(crate) role: Role,
    pub(crate) bytes: u64,
    pub(crate) sha256: String,
    /// Whether the archive holds it; inputs may be left out.
    pub(crate) included: bool,
}

/// What a file is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Role {
    /// The graph that is run again.
    Graph,
    /// A file that the graph was written in.
    Source,
    Plugin,
    /// A module or library that a plugin loads.
    Module,
    Input,
    Result,
    /// Words about the rest.
    About,
}

impl Index {
    pub(crate) fn of(&self, role: Role) -> impl Iterator<Item = &Entry> {
        self.files.iter().filter(move |entry| entry.role == role)
    }
}
