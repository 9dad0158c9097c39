//! The plan that `check` passes to `run`: a graph with all names resolved and no faults.

mod loads;

pub use loads::{LoadedFile, Loads, variable};

use osteoflow_container::Compression;
use osteoflow_node::{DeclaredPort, InputPort, Place, PortPayload, Role, StampNs, View};
use serde::{Deserialize, Serialize, Serializer};
use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    path::PathBuf,
    sync::Arc,
};

/// A checked graph, ready to be built.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The graph's name.
    pub name: String,
    /// The seed of everything random in the run.
    pub seed: u64,
    /// The graph file.
    pub path: PathBuf,
    /// The nodes in topological order, ties broken by the order of the file. Links joined by `previous` do not count.
    pub nodes: Vec<PlanNode>,
    /// The links, one for each consumer of an output.
    pub links: Vec<Link>,
    /// The outputs to record: those named by `[record]`, and those of all sources.
    pub record: Vec<OutputId>,
    /// How they are recorded.
    pub recording: RecordSettings,
    /// The entries of `results.json`, in the order of the file.
    pub results: Vec<ResultEntry>,
    /// The answer that the verdict on the results must give at least.
    pub require: Require,
    /// The files that parameters name, absolute.
    pub input_files: Vec<PathBuf>,
    /// The plugins that the graph names, and other plugins whose kinds it uses.
    pub plugins: Vec<PlanPlugin>,
    /// The frames that the graph may name; any if there are none.
    pub frames: Vec<String>,
    /// The resolved graph as the text of a graph file: after `extends`, `--set` and defaults, with absolute paths.
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
    /// The version of the plugin interface that it uses.
    pub abi: (u32, u32),
    /// The SDK it was built with.
    pub sdk: String,
    /// The compiler that built it.
    pub compiler: String,
    /// The interpreter that the graph names for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interpreter: Option<PathBuf>,
    /// The kinds of the plugin that the graph uses.
    pub kinds: Vec<String>,
    /// What it loads beside its file.
    #[serde(default, skip_serializing_if = "Loads::is_empty")]
    pub loads: Loads,
}

fn as_text<S: Serializer>(path: &std::path::Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

/// Recording settings: the keys of `[record]` other than the wires.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordSettings {
    /// How sources are recorded for a replay.
    pub sources: Sources,
    /// Compression of the file.
    pub compression: Compression,
    /// Whether payloads that viewers can show are also written in the viewers' format.
    pub views: bool,
    /// Whether the text of plugins in an interpreted language is recorded.
    pub plugins: bool,
}

impl Default for RecordSettings {
    fn default() -> Self {
        Self { sources: Sources::Wires, compression: Compression::default(), views: true, plugins: true }
    }
}

/// How sources are recorded for a replay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sources {
    /// Their items.
    #[default]
    Wires,
    /// The hashes of the files they read. A replay reads the files again, and reruns sources that read none.
    Hashes,
}

impl Sources {
    /// `wires` or `hashes`.
    pub fn name(self) -> &'static str {
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
    /// Identifies the plugin that the kind comes from, with what it loads and the environment variables that the node names;
    /// `None` for a kind of the program itself.
    pub plugin: Option<Arc<str>>,
    /// Checked parameters, paths absolute.
    pub params: serde_json::Value,
    /// Where each parameter is set, by its dotted path.
    pub param_places: BTreeMap<String, Location>,
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
    /// Where it fires.
    pub place: Place,
    /// How long a firing may take.
    pub deadline: Option<Deadline>,
}

impl PlanNode {
    /// The parameters that the graph sets, by their dotted paths; the others have their defaults.
    pub fn written(&self) -> BTreeSet<String> {
        self.param_places.keys().cloned().collect()
    }
}

/// An input of a plan's node.
#[derive(Debug, Clone)]
pub struct PlanInput {
    /// The port, with the join that the graph chose.
    pub port: InputPort,
    /// The links that feed it, as indices into [`Plan::links`], in the order of the graph: several where a port collects
    /// from several wires, none where an optional port is not wired.
    pub links: Vec<usize>,
    /// What the graph asks of the time of its values.
    pub contract: Contract,
}

/// What a graph asks of the time of an input's values.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Contract {
    /// Maximum age of a value at the firing that it is brought to: by stamps, and by arrival where its source is live.
    pub max_age_ns: Option<StampNs>,
    /// Expected time between two items.
    pub period_ns: Option<StampNs>,
    /// What happens where it is broken.
    pub otherwise: Otherwise,
}

/// How long a firing may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Deadline {
    /// Maximum duration.
    pub ns: StampNs,
    /// What happens to a firing that takes longer.
    pub otherwise: Otherwise,
}

/// What happens where a contract of time is broken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Otherwise {
    /// The value, or the answer of the firing, is unknown.
    #[default]
    Unknown,
    /// The whole firing is left out.
    Drop,
    /// As [`Otherwise::Unknown`], and the run is refused.
    Refuse,
}

impl Otherwise {
    /// `unknown`, `drop` or `refuse`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Drop => "drop",
            Self::Refuse => "refuse",
        }
    }
}

impl Contract {
    /// Silence of the wire after which its values are unknown: two periods, or the maximum age.
    pub fn silence_ns(&self) -> Option<StampNs> {
        self.rate_silence_ns().into_iter().chain(self.max_age_ns).min()
    }

    /// Silence of the wire by which its rate is broken: two periods.
    pub fn rate_silence_ns(&self) -> Option<StampNs> {
        self.period_ns.map(|ns| ns.saturating_mul(2))
    }
}

/// An output of a plan's node.
#[derive(Debug, Clone)]
pub struct PlanOutput {
    /// The port's name.
    pub name: String,
    /// What it gives.
    pub payload: PortPayload,
    /// The frames of the payload, as far as `check` knows them.
    pub frames: PortFrames,
    /// The links it feeds, as indices into [`Plan::links`].
    pub links: Vec<usize>,
}

/// The frames of a wire's payloads, as far as they are known before the run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PortFrames {
    /// The frame of a payload other than a pose.
    pub frame: Option<String>,
    /// The `to` frame of a pose: the frame of the coordinates it gives.
    pub to: Option<String>,
    /// The `from` frame of a pose: the frame of the coordinates it takes.
    pub from: Option<String>,
}

/// A frame of a value that the graph expects otherwise.
#[derive(Debug)]
pub struct FrameDifference {
    /// `frame`, `to` or `from`.
    pub key: &'static str,
    /// The frame of the value.
    pub found: String,
    /// The frame in the graph.
    pub expected: String,
}

impl PortFrames {
    /// The first frame of a value that differs, as far as they are known.
    pub fn difference(&self, value: &View) -> Option<FrameDifference> {
        let keys = [("frame", &self.frame), ("to", &self.to), ("from", &self.from)];
        keys.into_iter().find_map(|(key, expected)| {
            let (expected, found) = (expected.as_ref()?, value.shared_text(key).ok()?);
            let differs = *found != **expected;
            differs.then(|| FrameDifference { key, found: found.to_string(), expected: expected.clone() })
        })
    }

    /// Whether a frame is among them.
    pub(crate) fn has(&self, frame: &str) -> bool {
        [&self.frame, &self.to, &self.from].into_iter().flatten().any(|known| known == frame)
    }
}

/// An output of a node, by index: the wire `node.port`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct OutputId {
    /// Index into [`Plan::nodes`].
    pub node: usize,
    /// Index into [`PlanNode::outputs`].
    pub port: usize,
}

/// A bounded queue from one output to one input.
#[derive(Debug, Clone)]
pub struct Link {
    /// The output that feeds it.
    pub from: OutputId,
    /// The consuming node, as an index into [`Plan::nodes`].
    pub to_node: usize,
    /// The consuming port, as an index into [`PlanNode::inputs`].
    pub to_port: usize,
    /// Maximum number of waiting items, unless the queue must grow to resolve a deadlock.
    pub capacity: usize,
    /// Maximum number of waiting bytes, regardless of length; a single larger item still passes.
    pub max_bytes: u64,
    /// What happens when it is full.
    pub policy: Policy,
}

/// What happens to an item that finds its link full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Policy {
    /// The producer waits.
    Block,
    /// The oldest waiting item is dropped.
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
    /// Where the entry is written.
    pub location: Location,
}

/// The answer that the verdict on the results must give at least: the setting `require` of `[results]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Require {
    /// Doubtful results pass.
    #[default]
    Doubtful,
    /// Doubtful results are refused.
    Trusted,
}

/// A place in a graph file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Location {
    /// The file.
    pub file: PathBuf,
    /// Line, counted from 1.
    pub line: usize,
    /// Column, counted from 1 in characters.
    pub column: usize,
}

impl Plan {
    /// The wire's name, `node.port`.
    pub fn wire_name(&self, id: OutputId) -> String {
        let node = &self.nodes[id.node];
        format!("{}.{}", node.name, node.outputs[id.port].name)
    }

    /// The index of the node with this name.
    pub fn node(&self, name: &str) -> Option<usize> {
        self.nodes.iter().position(|node| *node.name == *name)
    }

    /// The outputs of a node.
    pub fn outputs(&self, node: usize) -> impl Iterator<Item = OutputId> + Clone + use<> {
        (0..self.nodes[node].outputs.len()).map(move |port| OutputId { node, port })
    }

    /// The outputs of all nodes.
    pub fn all_outputs(&self) -> impl Iterator<Item = OutputId> + Clone + '_ {
        (0..self.nodes.len()).flat_map(|node| self.outputs(node))
    }

    /// The links that an output feeds.
    pub fn consumers(&self, id: OutputId) -> impl Iterator<Item = &Link> {
        self.nodes[id.node].outputs[id.port].links.iter().map(|link| &self.links[*link])
    }

    /// The names of the wire and of the input that a link joins: `node.port` each.
    pub fn link_names(&self, link: &Link) -> (String, String) {
        let to = &self.nodes[link.to_node];
        (self.wire_name(link.from), format!("{}.{}", to.name, to.inputs[link.to_port].port.name))
    }

    /// The links that feed a node.
    pub fn links_into(&self, node: usize) -> impl Iterator<Item = &Link> {
        self.nodes[node].inputs.iter().flat_map(|input| &input.links).map(|link| &self.links[*link])
    }

    /// The names of the wires that feed an input, separated by commas; `None` if it is not wired.
    pub fn wires_of(&self, input: &PlanInput) -> Option<String> {
        let wires: Vec<_> = input.links.iter().map(|link| self.wire_name(self.links[*link].from)).collect();
        (!wires.is_empty()).then(|| wires.join(", "))
    }

    /// Marks all nodes downstream of marked ones.
    pub fn mark_downstream(&self, marked: &mut [bool]) {
        // Nodes are in topological order but for links that close a cycle.
        loop {
            for index in 0..self.nodes.len() {
                marked[index] = marked[index] || self.links_into(index).any(|link| marked[link.from.node]);
            }
            if !self.closing_links().any(|link| marked[link.from.node] && !marked[link.to_node]) {
                return;
            }
        }
    }

    /// Marks a node and all nodes upstream of it.
    pub fn upstream(&self, node: usize) -> Vec<bool> {
        let (mut upstream, mut open) = (vec![false; self.nodes.len()], vec![node]);
        while let Some(node) = open.pop() {
            if !std::mem::replace(&mut upstream[node], true) {
                open.extend(self.links_into(node).map(|link| link.from.node));
            }
        }
        upstream
    }

    /// The cycle that each node is part of, as the index of its first node; a node in no cycle is its own.
    pub fn cycles(&self) -> Vec<usize> {
        let mut cycles: Vec<usize> = (0..self.nodes.len()).collect();
        for closing in self.closing_links() {
            let (first, last) = (closing.to_node, closing.from.node);
            let mut after = vec![false; self.nodes.len()];
            after[first] = true;
            self.mark_downstream(&mut after);
            let before = self.upstream(last);
            let members: Vec<_> = (0..self.nodes.len()).filter(|node| after[*node] && before[*node]).collect();
            let joined: BTreeSet<_> = members.iter().map(|node| cycles[*node]).collect();
            let Some(&cycle) = joined.first() else { continue };
            cycles.iter_mut().filter(|of| joined.contains(of)).for_each(|of| *of = cycle);
        }
        cycles
    }

    /// The links that close a cycle.
    fn closing_links(&self) -> impl Iterator<Item = &Link> {
        self.links.iter().filter(|link| link.from.node >= link.to_node)
    }
}
