//! `experiment.json`: the files of an archive.

use serde::{Deserialize, Serialize};

/// Increase when the layout of an archive changes.
pub(super) const FORMAT: u64 = 1;

/// The content of `experiment.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Index {
    pub(super) format: u64,
    /// Version of the program that wrote it.
    pub(super) version: String,
    pub(super) what: What,
    /// Name of the graph.
    pub(super) name: String,
    /// All other files, by path.
    pub(super) files: Vec<Entry>,
}

/// What an archive holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum What {
    Run,
    Sweep,
}

impl What {
    /// The subcommand that runs it again.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Run => "run",
            Self::Sweep => "sweep",
        }
    }
}

/// A file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Entry {
    pub(super) path: String,
    pub(super) role: Role,
    pub(super) bytes: u64,
    pub(super) sha256: String,
    /// Whether the archive holds it; inputs may be left out.
    pub(super) included: bool,
}

/// What a file is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Role {
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
    pub(super) fn of(&self, role: Role) -> impl Iterator<Item = &Entry> {
        self.files.iter().filter(move |entry| entry.role == role)
    }
}
