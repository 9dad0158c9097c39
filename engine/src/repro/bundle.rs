//! `repro.json`: description of a failed firing.

use crate::{
    plan::PlanPlugin,
    recording::{RecordingError, provenance::Provenance},
    runtime::Injected,
};
use osteoflow_node::{Role, StampNs};
use serde::{Deserialize, Serialize};
use serde_json::{Value as Json, json};
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

/// Version of the bundle; increased when older readers cannot read it. No release wrote versions 1 and 2.
pub(super) const FORMAT_VERSION: u32 = 3;
/// The file that describes the failed firing.
pub const BUNDLE: &str = "repro.json";
/// The recording of the items that the ports had joined.
pub const INPUTS: &str = "inputs.mcap";
/// An explanation for people.
pub(super) const README: &str = "README.txt";
/// Maximum size of a `repro.json`; a longer file is something else.
const MAX_BYTES: u64 = 256 << 20;

/// A failed firing.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bundle {
    /// Version of this format.
    pub format_version: u32,
    /// The graph's name.
    pub graph: String,
    /// Position of the node: `file:line`.
    pub location: String,
    /// The node.
    pub node: Node,
    /// Number of the firing, from 0; for a source, of the call.
    pub item: u64,
    /// The stamp of the firing.
    pub stamp_ns: StampNs,
    /// The run's seed.
    pub seed: u64,
    /// What each port brought, in the order of the kind's ports; empty for a source.
    pub inputs: Vec<Input>,
    /// How it failed.
    pub failure: Failure,
    /// How the failure was injected, if it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub injected: Option<Injected>,
    /// The run's folder, where nodes that write files write them.
    pub out_dir: PathBuf,
    /// The program that failed.
    pub program: Program,
}

/// The node of a bundle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Its full name.
    pub name: String,
    /// Its kind.
    pub kind: String,
    /// Whether it is a source.
    pub role: Role,
    /// Its table in the resolved graph, in the text of a graph file, with all parameters and absolute paths.
    pub table: String,
    /// The parameters that the user wrote.
    pub written: BTreeSet<String>,
    /// The plugin that provides its kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plugin: Option<PlanPlugin>,
}

/// What a port brought.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Input {
    /// The port.
    pub port: String,
    /// The join that chose it.
    pub join: String,
    /// The wire that feeds it, if any.
    pub wire: Option<String>,
    /// What it brought.
    pub given: Given,
    /// Summary of the items; the items themselves are in `inputs.mcap`.
    pub items: Vec<Shown>,
}

/// What a port brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Given {
    /// One item.
    Item,
    /// A list.
    Items,
    /// No value; the only item says why.
    Absent,
}

/// Summary of an item.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// Its number on its wire.
    pub number: u64,
    /// Its stamp.
    pub stamp_ns: StampNs,
    /// Its size in `inputs.mcap`.
    pub bytes: u64,
    /// The payload with its sizes and texts, such as the names of frames; or why there is no value.
    pub about: String,
}

/// How a firing failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// The message; for a panic with file and line.
    pub reason: String,
    /// Whether it panicked.
    pub panicked: bool,
}

impl Failure {
    /// File and line of a panic, and its message.
    pub fn place(&self) -> (Option<&str>, &str) {
        let placed = self.reason.strip_prefix("panicked at ").filter(|_| self.panicked);
        match placed.and_then(|rest| rest.split_once(": ")) {
            Some((place, message)) => (Some(place), message),
            None => (None, &self.reason),
        }
    }

    /// Whether both are the same failure. In another program a panic's line may have moved; its file and message have
    /// not.
    pub(super) fn is(&self, other: &Self, same_program: bool) -> bool {
        if same_program || self.panicked != other.panicked {
            return self == other;
        }
        let ((own, message), (others, other_message)) = (self.place(), other.place());
        let file = |place: Option<&str>| place.and_then(|p| p.rsplit_once(':')).map(|(file, _)| file.to_owned());
        message == other_message && file(own) == file(others)
    }
}

/// Properties of a program that its failures may depend on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Program {
    /// The engine's version.
    pub engine_version: String,
    /// SHA-256 of the executable, where it could be read.
    pub sha256: Option<String>,
    /// Description of the command and the machine, including CPU features.
    pub command: Json,
}

impl Program {
    /// This program, with the description of the command.
    pub fn current(command: Json) -> Self {
        let sha256 = crate::hash::program::digest().map(|hash| hash.to_string());
        Self { engine_version: env!("CARGO_PKG_VERSION").into(), sha256, command }
    }

    /// What made the failure: this program, and the node's plugin.
    pub(super) fn provenance(&self, plugin: Option<&PlanPlugin>) -> Provenance {
        Provenance::of(&json!({
            "engine_version": self.engine_version,
            "program_sha256": self.sha256,
            "command": self.command,
            "plugins": plugin.into_iter().collect::<Vec<_>>(),
        }))
    }
}

impl Bundle {
    /// Reads a bundle's description; `dir` is its folder or its `repro.json`.
    ///
    /// # Errors
    /// [`ReproError`] if it is missing, damaged, or of a later version.
    pub fn open(dir: &Path) -> Result<Self, ReproError> {
        let path = dir.join(BUNDLE);
        let file = path.display();
        let read = |error: std::io::Error| {
            let hint = "a repro bundle is a folder repro/NODE-ITEM of a run";
            ReproError::Files(format!("cannot read {file}: {error}; {hint}"))
        };
        let foreign = |reason: String| ReproError::Files(format!("{file} describes no failed firing: {reason}"));
        if std::fs::metadata(&path).map_err(read)?.len() > MAX_BYTES {
            return Err(foreign("it is too long".into()));
        }
        let json: Json = serde_json::from_slice(&crate::regular(&path).and_then(std::fs::read).map_err(read)?)
            .map_err(|error| foreign(error.to_string()))?;
        match json.get("format_version").and_then(Json::as_u64) {
            Some(version) if version == u64::from(FORMAT_VERSION) => {}
            Some(found) => {
                return Err(foreign(format!("it has version {found}, this program reads version {FORMAT_VERSION}")));
            }
            None => return Err(foreign("it has no format_version".into())),
        }
        serde_json::from_value(json).map_err(|error| foreign(error.to_string()))
    }

    /// Possible causes if the failure does not recur.
    pub fn why_not_again(&self) -> &'static str {
        match self.node.role {
            Role::Node if self.item > 0 => {
                "a node that remembers earlier items may need them; run the graph again from the recording of its run: \
                 osteoflow replay RUN/run.mcap"
            }
            Role::Node => "its files, the program or the machine may have changed",
            Role::Source => "the files that it reads may have changed",
            Role::LiveSource => "a live source reads the outside world, which gave other data this time",
        }
    }
}

/// A bundle that cannot be run again.
#[derive(Debug, thiserror::Error)]
pub enum ReproError {
    /// This program lacks the kind, its plugin, a payload or a port, or cannot build it from the bundle's parameters.
    #[error("{0}")]
    Unfit(String),
    /// A file of the bundle cannot be read, or no folder can be made for what the node writes.
    #[error("{0}")]
    Files(String),
    /// Its items cannot be read.
    #[error(transparent)]
    Items(#[from] RecordingError),
}
