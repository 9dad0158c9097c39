//! What `check` hands to `run`: a graph whose every name has been resolved and every fault found.

use osteoflow_container::Compression;
use osteoflow_node::{DeclaredPort, InputPort, PortPayload, Role};
use serde::{Deserialize, Serialize, Serializer};
use std::{fmt, path::PathBuf, sync::Arc};

/// A checked graph, ready to be built.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The graph's name.
    pub name: String,
    /// The seed of everything random in the run.
    pub seed: u64,
    /// The graph file.
    pub path: PathBuf,
    /// The nodes in topological order; where that leaves a choice, in the order of the file.
    pub nodes: Vec<PlanNode>,
    /// Every output that has a consumer, once for each consumer.
    pub links: Vec<Link>,
    /// The outputs to record: those named by `[record]`, and every source's.
    pub record: Vec<OutputId>,
    /// How they are recorded.
    pub recording: RecordSettings,
    /// What `results.json` holds, in the order of the file.
    pub results: Vec<ResultEntry>,
    /// The files that parameters name, absolute.
    pub input_files: Vec<PathBuf>,
    /// The plugins that the graph names, and others whose kinds it has.
    pub plugins: Vec<PlanPlugin>,
    /// The graph as it runs, after `extends`, `--set` and defaults, as the text of a graph file with absolute paths.
    pub resolved: String,
}

/// A plugin of a graph.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanPlugin {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
    /// Its library, absolute.
    #[serde(serialize_with = "as_text")]
    pub path: PathBuf,
    /// The library's SHA-256.
    pub sha256: String,
    /// The version of the plugin interface that it speaks.
    pub abi: (u32, u32),
    /// What it was built with.
    pub sdk: String,
    /// The compiler that built it.
    pub compiler: String,
    /// Those of its kinds that the graph has.
    pub kinds: Vec<String>,
}

impl PlanPlugin {
    /// How `now` is another library, in words; `None` if it is the same.
    pub(crate) fn difference(&self, now: &Self) -> Option<String> {
        let (was, is) = (&self.sha256, &now.sha256);
        (was != is).then(|| {
            let (name, then, path) = (&self.name, &self.version, now.path.display());
            format!("plugin {name} {then} was another library: sha256 {was}, here is {} {is} ({path})", now.version)
        })
    }
}

fn as_text<S: Serializer>(path: &std::path::Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

/// How wires are recorded: what `[record]` says beside their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordSettings {
    /// What a replay has of the sources.
    pub sources: Sources,
    /// How the file is packed.
    pub compression: Compression,
    /// Whether payloads with a picture for viewers are written as pictures too.
    pub views: bool,
}

impl Default for RecordSettings {
    fn default() -> Self {
        Self { sources: Sources::Wires, compression: Compression::default(), views: true }
    }
}

/// What a replay has of the sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sources {
    /// Their items.
    #[default]
    Wires,
    /// The hashes of the files they read, which are read again; what reads no file is run again.
    Hashes,
}

impl Sources {
    /// `wires` or `hashes`.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Wires => "wires",
            Self::Hashes => "hashes",
        }
    }
}

/// A node of the plan.
#[derive(Debug, Clone)]
pub struct PlanNode {
    /// Its full name in the graph.
    pub name: Arc<str>,
    /// Its kind.
    pub kind: String,
    /// Node, source or live source.
    pub role: Role,
    /// Where its table begins.
    pub location: Location,
    /// The SHA-256 of the plugin library that the kind comes from; `None` for a kind of the program itself.
    pub plugin: Option<Arc<str>>,
    /// Checked parameters, paths absolute.
    pub params: serde_json::Value,
    /// The files that its parameters name, absolute.
    pub files: Vec<PathBuf>,
    /// The outputs that the graph declared by `out`, for sources that take such.
    pub declared: Arc<[DeclaredPort]>,
    /// Its inputs, in the order of the kind's ports.
    pub inputs: Vec<PlanInput>,
    /// Its outputs, in the order of the kind's ports or of `out`.
    pub outputs: Vec<PlanOutput>,
    /// What happens when a firing fails.
    pub on_error: OnError,
}

/// An input of a plan's node.
#[derive(Debug, Clone)]
pub struct PlanInput {
    /// The port, with the join that the graph chose.
    pub port: InputPort,
    /// The link that feeds it, as an index into [`Plan::links`]; an optional port may have none.
    pub link: Option<usize>,
}

/// An output of a plan's node.
#[derive(Debug, Clone)]
pub struct PlanOutput {
    /// The port's name.
    pub name: String,
    /// What it gives.
    pub payload: PortPayload,
    /// The frames of what it gives, as far as `check` could tell.
    pub frames: PortFrames,
    /// The links it feeds, as indices into [`Plan::links`].
    pub links: Vec<usize>,
}

/// The frames of what travels on a wire, as far as they are known before the run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PortFrames {
    /// Of anything but a pose.
    pub frame: Option<String>,
    /// Of a pose: the frame whose coordinates it gives.
    pub to: Option<String>,
    /// Of a pose: the frame whose coordinates it takes.
    pub from: Option<String>,
}

/// An output of a node, by index: the wire `node.port`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct OutputId {
    /// Index into [`Plan::nodes`].
    pub node: usize,
    /// Index into [`PlanNode::outputs`].
    pub port: usize,
}

/// One output led to one input over a bounded queue.
#[derive(Debug, Clone)]
pub struct Link {
    /// Where it comes from.
    pub from: OutputId,
    /// The consuming node, as an index into [`Plan::nodes`].
    pub to_node: usize,
    /// The consuming port, as an index into [`PlanNode::inputs`].
    pub to_port: usize,
    /// How many items wait at most, as long as the graph need not be let go on by a longer queue.
    pub capacity: usize,
    /// Beyond so many waiting bytes it is full, however long it is; an item that is larger by itself still passes.
    pub max_bytes: u64,
    /// What happens when it is full.
    pub policy: Policy,
}

/// What happens to an item that finds its link full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// The producer waits.
    Block,
    /// The oldest waiting item makes room.
    DropOld,
    /// The new item is dropped.
    DropNew,
    /// Every n-th item is kept, the others are dropped.
    Sample(u32),
    /// The run fails.
    Fail,
}

impl fmt::Display for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Block => f.write_str("block"),
            Self::DropOld => f.write_str("drop_old"),
            Self::DropNew => f.write_str("drop_new"),
            Self::Sample(n) => write!(f, "sample, one in {n}"),
            Self::Fail => f.write_str("fail"),
        }
    }
}

/// What happens when a firing fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OnError {
    /// The node ends; the run goes on without it and reports failure.
    #[default]
    Stop,
    /// The item becomes an empty, the node is built anew and goes on.
    Skip,
}

/// An entry of `[results]`.
#[derive(Debug, Clone)]
pub struct ResultEntry {
    /// The dotted key in `results.json`.
    pub key: String,
    /// The wire whose last value it is.
    pub from: OutputId,
    /// Whether all values of the wire are listed, not only the last.
    pub all: bool,
    /// Whether the run may end without it; if not, its absence refuses the run.
    pub optional: bool,
    /// Where the entry stands.
    pub location: Location,
}

/// A place in a graph file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Location {
    /// The file.
    pub file: PathBuf,
    /// Counted from 1.
    pub line: usize,
    /// Counted from 1, in characters.
    pub column: usize,
}

impl Plan {
    /// The wire's name, `node.port`.
    pub fn wire_name(&self, id: OutputId) -> String {
        let node = &self.nodes[id.node];
        format!("{}.{}", node.name, node.outputs[id.port].name)
    }
}
