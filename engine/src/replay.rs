//! Runs a recording again: plays recorded wires, recomputes what follows from them and compares.

mod compare;
pub(crate) mod exchange;
mod foreign;
mod map;
mod range;
mod select;
#[cfg(test)]
mod tests;

use crate::{
    check::{check, check_recorded},
    diff,
    fault::{Fault, Faults},
    graph::{
        grammar::{REASONS, VERDICT},
        written::sets,
    },
    hash::Digest,
    options::RunOptions,
    partial::{self, Failing, NodeMode, Pace, Player},
    plan::{OutputId, Plan, Sources},
    plugin::{self, Kinds},
    recording::provenance::Provenance,
    recording::{Recording, RecordingError},
    run::{self, NOTHING_CAME, RunError, RunReport, Verdict},
    runtime::{Observer, Replayed, Sign, Substitutes},
};
use compare::Compare;
use foreign::Topics;
pub use map::Mapping;
use osteoflow_node::{Body, ClockReading, Item, Registry, Role, StampNs};
use range::{is_constant, play_what_does_not_change};
use serde::Deserialize;
use serde_json::json;
use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

/// Key of `results.json` for the node from which a replay computed.
const COMPUTED_FROM: &str = "computed_from";

/// What to change in a replay; nothing by default.
#[derive(Debug, Clone, Default)]
pub struct ReplayOptions {
    /// Recompute only this node and the nodes downstream of it.
    pub from: Option<String>,
    /// Settings of the graph, each `KEY=VALUE`.
    pub sets: Vec<String>,
    /// Graph file to play the recorded wires into, instead of the recorded graph.
    pub graph: Option<PathBuf>,
    /// Wires that are played under another name than that of the recording.
    pub maps: Vec<Mapping>,
    /// Whether plugins are run from the text that the recording carries.
    pub allows_plugins: bool,
    /// Reads recordings of other programs; `None` if this program reads none.
    pub reader: Option<TopicReader>,
    /// Seconds of the recording per second; `None`: as fast as possible. The result does not depend on it.
    pub rate: Option<f64>,
    /// Only items at or after this moment are played, constants excepted.
    pub start: Option<Moment>,
    /// Only items at or before this moment are played, constants excepted.
    pub end: Option<Moment>,
}

/// A source that gives the messages of another program's recording.
#[derive(Debug, Clone)]
pub struct TopicReader {
    /// Its kind: a source with declared outputs, a parameter `path`, and a parameter `topic` of each output.
    pub kind: String,
    /// Whether an output with this payload reads messages of this schema.
    pub reads: fn(payload: &str, schema: &str) -> bool,
}

/// A time in a recording: `12.5` means seconds after its first stamp, `1750000000418500000ns` is a stamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Moment {
    /// Seconds after the first stamp.
    Seconds(f64),
    /// A stamp.
    Stamp(StampNs),
}

impl FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("a time is seconds after the first stamp, such as 12.5, or a stamp such as 1750ns: {text}");
        match text.strip_suffix("ns") {
            Some(stamp) => stamp.trim().parse().map(Self::Stamp).map_err(|_| wrong()),
            None => {
                let seconds: f64 = text.trim().parse().map_err(|_| wrong())?;
                if seconds.is_finite() { Ok(Self::Seconds(seconds)) } else { Err(wrong()) }
            }
        }
    }
}

impl Moment {
    fn stamp(self, first_ns: StampNs) -> StampNs {
        match self {
            Self::Stamp(stamp_ns) => stamp_ns,
            // Saturates at the largest stamp.
            Self::Seconds(seconds) => first_ns.saturating_add((seconds * 1e9).round() as StampNs),
        }
    }
}

/// A recording that cannot be run again.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The graph has faults, or does not fit this program's kinds.
    #[error("{}:\n{faults}", if *.recorded { "the recorded graph does not fit this program" } else { "the graph has faults" })]
    Graph {
        /// What is wrong.
        faults: Faults,
        /// Whether it is the recorded graph without changes.
        recorded: bool,
    },
    /// The recording does not support what is asked for: no wire fits the graph, a wire has another payload, or there is no
    /// such node or setting to change.
    #[error("{0}")]
    Unfit(String),
    /// The data of a source is missing: its wire is not in the recording, or its file is not the one that the run read.
    #[error("{0}")]
    NoData(String),
    /// The run itself.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// Report of a replay.
#[derive(Debug)]
pub struct ReplayReport {
    /// The run.
    pub run: RunReport,
    /// Each recorded wire, in the topological order of the graph; then those that the graph does not have.
    pub wires: Vec<WireComparison>,
    /// Whether the results are the recorded ones; `None` if there are none to compare.
    pub results_equal: Option<bool>,
    /// Why nothing is compared; `None` if it is.
    pub not_compared: Option<String>,
    /// Why a truncated recording ends early; the items up to there are compared.
    pub truncated: Option<String>,
    /// What is not sound of a recording whose items are all there.
    pub unsound: Option<String>,
    /// Nodes computed in addition to the requested ones, because their wires were not recorded.
    pub computed_too: Vec<String>,
    /// Sources of another graph that no recorded wire plays, so that they were run.
    pub own_sources: Vec<String>,
    /// How program, machine and plugins differ from those of the run, as said before this one began.
    pub differences: Vec<String>,
    /// How what firings loaded and opened differs.
    pub late_differences: Vec<String>,
    /// Warnings about the graph.
    pub warnings: Vec<Fault>,
}

/// How a replay treats a wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum WirePart {
    /// Its recorded items were played.
    Played,
    /// It was recomputed.
    Computed,
    /// The graph does not have it.
    Absent,
}

/// A wire as recorded and as recomputed.
#[derive(Debug, Clone, PartialEq)]
pub struct WireComparison {
    /// The wire, `node.port`.
    pub wire: String,
    /// How the replay treated it.
    pub part: WirePart,
    /// Number of items in the recording.
    pub n_recorded: u64,
    /// Number of items in the replay.
    pub n_replayed: u64,
    /// Number of items compared, up to the first that differs.
    pub n_compared: u64,
    /// The first item that differs in any bit.
    pub first_difference: Option<Difference>,
    /// Why its items cannot be compared: another kind gives another payload.
    pub not_comparable: Option<String>,
}

/// First difference of a wire.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The item's number.
    pub item: u64,
    /// The recorded value (`a`), the replayed one (`b`), and their distance.
    pub what: diff::Difference,
}

impl ReplayReport {
    /// Whether every wire and the results are bit for bit the recorded ones.
    pub fn is_equal(&self) -> bool {
        let comparable = self.wires.iter().all(|wire| wire.not_comparable.is_none());
        comparable && self.first_divergence().is_none() && self.results_equal != Some(false)
    }

    /// The wire that differs first in the topological order of the graph; of one node's wires, the one that differs at
    /// the earliest item.
    pub fn first_divergence(&self) -> Option<&WireComparison> {
        let node = |wire: &WireComparison| wire.wire.split('.').next().unwrap_or_default().to_owned();
        let item = |wire: &&WireComparison| wire.first_difference.as_ref().map(|d| d.item);
        let first = self.wires.iter().find(|wire| wire.first_difference.is_some())?;
        let of_node = self.wires.iter().filter(|wire| wire.first_difference.is_some() && node(wire) == node(first));
        of_node.min_by_key(item)
    }
}

/// Runs the graph of a recording again and compares every recorded wire that is computed, and the results. Of the files
/// that the graph names, only those of sources recorded by hash are read.
///
/// # Errors
/// [`ReplayError`] if the recording cannot be read, or the requested replay cannot be run from it.
pub fn replay(
    path: &Path,
    changes: &ReplayOptions,
    kinds: impl Into<Kinds>,
    options: &RunOptions,
    observer: &dyn Observer,
) -> Result<ReplayReport, ReplayError> {
    let kinds: Kinds = kinds.into();
    let mut recording = match Recording::open(path) {
        Ok(recording) => recording,
        Err(error) => match Topics::of(path) {
            Some(topics) => return foreign::replay(path, &topics, changes, &kinds, options, observer),
            None => return Err(error.into()),
        },
    };
    if let (false, None) = (recording.run.functions.is_empty(), &changes.graph) {
        let nodes = recording.run.functions.join(", ");
        let message = format!(
            "{}: {nodes} were functions of the program that ran it, such as a notebook, which no file holds, so it cannot be \
             replayed; write them as a plugin, and run the graph with it",
            path.display()
        );
        return Err(ReplayError::Unfit(message));
    }
    let kinds = match changes.graph {
        // The user names this graph.
        Some(_) => kinds,
        None => kinds.recorded_by(&recording.provenance.plugins),
    };
    let kinds = kinds.over(recording.registry(kinds.registry())).with_moved(&recording.provenance.plugins);
    let Provenance { plugins, texts, .. } = &recording.provenance;
    // Holds the files for as long as the run.
    let (kinds, _folder) = match changes.allows_plugins {
        true if plugin::carried(plugins, texts).next().is_none() => {
            let message = "--allow-plugins: the recording carries the text of no plugin; name the file: --plugin FILE";
            return Err(ReplayError::Unfit(message.into()));
        }
        true => {
            let written = kinds.with_carried(plugins, texts);
            let error =
                |error| ReplayError::NoData(format!("the recorded plugins cannot be written to a folder: {error}"));
            let (kinds, folder) = written.map_err(error)?;
            (kinds, Some(folder))
        }
        false => (kinds.naming_carried(plugins, texts), None),
    };
    let kinds = &kinds;
    let sets = &changes.sets;
    let checked = match &changes.graph {
        // Files of played sources need not exist; a graph file that cannot be read is a fault.
        Some(graph) => match crate::regular(graph).and_then(std::fs::read_to_string) {
            Ok(text) => check_recorded(&text, graph, sets, kinds),
            Err(_) => check(graph, sets, kinds),
        },
        None => {
            let run = &recording.run;
            let exchanged = exchange::without_old_defaults(&run.graph, &run.written, sets);
            check_recorded(exchanged.as_deref().unwrap_or(&run.graph), &run.graph_file, sets, kinds)
        }
    };
    let recorded = changes.graph.is_none() && sets.is_empty();
    let mut checked = checked.map_err(|faults| ReplayError::Graph { faults, recorded })?;
    if changes.graph.is_none() {
        exchange::keep_written(&mut checked.plan, &recording.run, sets);
    }
    map::apply(&mut recording, &checked.plan, &changes.maps)?;
    let report = replay_plan(&checked.plan, &recording, changes, &checked.registry, options, observer)?;
    Ok(ReplayReport { warnings: checked.warnings, ..report })
}

/// Like [`replay()`], for a checked graph.
pub(crate) fn replay_plan(
    plan: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
) -> Result<ReplayReport, ReplayError> {
    let (recorded, of_another_payload) = recorded_outputs(plan, recording);
    if let Some(&id) = of_another_payload.iter().find(|id| plan.nodes[id.node].role != Role::Node) {
        let (wire, found) = (plan.wire_name(id), plan.nodes[id.node].outputs[id.port].payload.name());
        let recorded = &recording.wires[&wire].payload;
        let message = format!("wire {wire} was recorded with {recorded}, and carries {found} in the graph");
        return Err(ReplayError::Unfit(message));
    }
    let mut parts = parts(plan, recording, changes, &recorded)?;
    let unchanged = play_what_does_not_change(plan, recording, changes, registry, &recorded, &mut parts)?;
    sets_take_effect(plan, changes, &parts)?;
    let computed = |index: usize| parts[index] == NodeMode::Computed;
    let runs_sources = plan.nodes.iter().enumerate().any(|(i, node)| node.role != Role::Node && computed(i));
    if runs_sources && recording.run.sources == Sources::Hashes {
        inputs_are_the_same(plan, recording)?;
    }
    let computed_too = computed_too(plan, changes, &parts);
    let runs_itself = |(index, node): &(usize, &crate::plan::PlanNode)| node.role != Role::Node && computed(*index);
    let own_sources = plan.nodes.iter().enumerate().filter(|node| changes.graph.is_some() && runs_itself(node));
    let own_sources = own_sources.map(|(_, node)| node.name.to_string()).collect();

    let others = of_another_payload.iter().filter(|id| computed(id.node));
    let mut reduced =
        partial::reduce(&Plan { record: recorded.iter().chain(others).copied().collect(), ..plan.clone() }, &parts);
    if !runs_sources {
        // Their content is in the recording; the files themselves are not read.
        reduced.input_files.clear();
    }
    let modes: Vec<_> = parts.iter().filter(|mode| **mode != NodeMode::LeftOut).collect();
    let is_computed = |node: usize| *modes[node] == NodeMode::Computed;
    let (substitutes, cut) = players(&reduced, recording, changes, registry, &unchanged, is_computed)?;
    let replayed = Replayed {
        substitutes,
        drops: Some(drops(&reduced, recording, &cut)),
        // With items left out at the beginning, firings have other numbers, so readings come from the clock.
        signs: recorded_signs(recording, |node| reduced.node(node).is_some_and(|index| !is_computed(index))),
        readings: changes.start.is_none().then(|| readings(&reduced, recording)),
    };
    let not_compared = (changes.start.is_some() || changes.end.is_some())
        .then(|| "only a part of the recording was played, and a part of a run is another run".to_owned());
    let compare = Compare::new(&reduced, recording, is_computed, not_compared.is_none());
    let mut options = options.clone();
    // A replay verifies that recomputing gives the same; cached answers would not be recomputed.
    options.store = None;
    if changes.graph.is_none() {
        options.fixed_results.clone_from(&recording.fixed_results);
        options.fixed_results.retain(|(key, _)| key != COMPUTED_FROM);
    }
    if let Some(from) = &changes.from {
        // Some results of the graph are missing.
        options.fixed_results.push((COMPUTED_FROM.into(), from.as_str().into()));
    }
    if changes.rate.is_some() {
        // A paced player occupies a worker while it waits.
        options.workers += replayed.substitutes.len();
    }
    let differences = made_otherwise(plan, recording, changes, &options);
    differences.iter().for_each(|difference| tracing::warn!("{difference}"));
    let report = run::run_with(&reduced, registry, &options, observer, replayed, Some(&compare))?;

    let mut plugins = plugin::with_late_loads(&plan.plugins);
    for (_, node) in reduced.nodes.iter().enumerate().filter(|(index, _)| !is_computed(*index)) {
        // What nodes that are played would have loaded is taken for what they had.
        for plugin in plugins.iter_mut().filter(|plugin| plugin.kinds.contains(&node.kind)) {
            let then = recording.provenance.plugins.iter().find(|then| then.name == plugin.name);
            then.map(|then| plugin.loads.add(&then.loads));
        }
    }
    let now = Provenance::of(&json!({ "plugins": plugins }));
    let late_differences = recording.provenance.late_differences(&now, NAMES);

    // Part of a recording gives other results than the whole.
    let partial = recording.interrupted || recording.truncated.is_some();
    let whole = not_compared.is_none() && changes.graph.is_none() && changes.from.is_none() && !partial;
    let results_equal = recording.results.as_ref().filter(|results| whole && results.get(COMPUTED_FROM).is_none());
    let is_computed_node = |name: &str| reduced.node(name).is_some_and(is_computed);
    let results_equal =
        results_equal.map(|recorded| same_results(recorded, recording, &report.results, is_computed_node));
    Ok(ReplayReport {
        run: report,
        wires: comparisons(&reduced, recording, changes, &compare, is_computed),
        results_equal,
        not_compared,
        truncated: recording.truncated.clone(),
        unsound: recording.unsound.clone(),
        computed_too,
        own_sources,
        differences,
        late_differences,
        warnings: Vec::new(),
    })
}

/// Names of recording and replay in what differs between them.
const NAMES: [&str; 2] = ["the recording", "this replay"];

/// How program, machine and plugins differ from those of the recording, and the files that its firings opened.
fn made_otherwise(plan: &Plan, recording: &Recording, changes: &ReplayOptions, options: &RunOptions) -> Vec<String> {
    let then = &recording.provenance;
    let version = env!("CARGO_PKG_VERSION");
    let now = json!({ "command": options.command, "engine_version": version, "plugins": plan.plugins });
    let now = Provenance::of(&now);
    let mut differences = then.program_differences(&now, NAMES);
    // Another graph may use others.
    if changes.graph.is_none() {
        differences.extend(then.plugin_differences(&now, NAMES));
        differences.extend(then.changed_files());
    }
    differences
}

/// The recorded signs of nodes that are played. To whom nothing came is judged anew.
fn recorded_signs(recording: &Recording, is_played: impl Fn(&str) -> bool) -> Vec<Sign> {
    let reasons = recording.results.as_ref().and_then(|results| results[REASONS].as_array()).into_iter().flatten();
    let signs = reasons.filter_map(|reason| Sign::deserialize(reason).ok());
    signs.filter(|sign| is_played(&sign.node) && sign.rule != NOTHING_CAME).collect()
}

/// The outputs of a plan that the recording has, and those whose payload is another one in the graph, so that they can be
/// neither played nor compared.
fn recorded_outputs(plan: &Plan, recording: &Recording) -> (BTreeSet<OutputId>, BTreeSet<OutputId>) {
    let is_recorded = |id: &OutputId| recording.wires.contains_key(&plan.wire_name(*id));
    let is_comparable =
        |id: &OutputId| recording.wires[&plan.wire_name(*id)].is_of(plan.nodes[id.node].outputs[id.port].payload);
    plan.all_outputs().filter(is_recorded).partition(is_comparable)
}

fn parts(
    plan: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    recorded: &BTreeSet<OutputId>,
) -> Result<Vec<NodeMode>, ReplayError> {
    let is_recorded = |index: usize| plan.outputs(index).any(|id| recorded.contains(&id));
    if let Some(graph) = &changes.graph {
        let plays = |(index, node): (usize, &crate::plan::PlanNode)| node.role != Role::Node && is_recorded(index);
        if !plan.nodes.iter().enumerate().any(plays) && changes.from.is_none() {
            let sources = recording.wires.iter().filter(|(_, wire)| wire.source).map(|(name, _)| name.as_str());
            let (graph, recorded) = (graph.display(), map::listed(sources));
            let message = format!("no recorded wire is an output of a source of {graph}; recorded are {recorded}");
            let sources = plan.all_outputs().filter(|id| plan.nodes[id.node].role != Role::Node);
            let candidates = sources.map(|id| candidates(plan, recording, id)).collect::<Vec<_>>().join("; ");
            return Err(ReplayError::Unfit(format!("{message}; name them: {candidates}")));
        }
    }
    // Another graph may have sources of its own; a live source's items cannot be produced again.
    let runs = |index: usize| match plan.nodes[index].role {
        Role::LiveSource => false,
        _ => recording.run.sources == Sources::Hashes || (changes.graph.is_some() && !is_recorded(index)),
    };
    let parts = match &changes.from {
        None => select::all(plan, recorded, runs),
        Some(name) => {
            let Some(node) = plan.node(name) else {
                let known = plan.nodes.iter().map(|node| &*node.name).collect::<Vec<_>>().join(", ");
                return Err(ReplayError::Unfit(format!("there is no node \"{name}\" in the graph; it has {known}")));
            };
            select::from(plan, recorded, node, runs)
        }
    };
    parts.map_err(|id| {
        let wire = plan.wire_name(id);
        if changes.graph.is_some() {
            let candidates = candidates(plan, recording, id);
            return ReplayError::Unfit(format!("no recorded wire is called {wire}; name the one that plays it: {candidates}"));
        }
        ReplayError::NoData(format!(
            "the recording lacks the source wire {wire}, so nothing after it can be computed; record it, or name a node \
             behind it that can be computed from recorded wires"
        ))
    })
}

/// How a wire is named for an output, with those that fit.
fn candidates(plan: &Plan, recording: &Recording, id: OutputId) -> String {
    let output = &plan.nodes[id.node].outputs[id.port];
    let fit = map::fitting(recording, output);
    format!("--map {}=WIRE, of {}: {fit}", plan.wire_name(id), output.payload.name())
}

/// Refuses settings of played nodes, which would have no effect.
fn sets_take_effect(plan: &Plan, changes: &ReplayOptions, parts: &[NodeMode]) -> Result<(), ReplayError> {
    for set in &changes.sets {
        let node = plan.nodes.iter().zip(parts).find(|(node, _)| sets(set, &node.name));
        if let Some((node, NodeMode::Played | NodeMode::LeftOut)) = node {
            let node = &node.name;
            let message = format!("--set {set} changes nothing: the wires of \"{node}\" are played from the recording");
            return Err(ReplayError::Unfit(message));
        }
    }
    Ok(())
}

/// Checks that the input files of computed sources are those that the run read.
fn inputs_are_the_same(plan: &Plan, recording: &Recording) -> Result<(), ReplayError> {
    for input in crate::hash::files::hashes(&plan.input_files) {
        let text = |key: &str| input[key].as_str().unwrap_or_default().to_owned();
        let (path, hash) = (text("path"), text("sha256"));
        let expected = match recording.provenance.inputs.get(&path) {
            Some(expected) => expected.clone(),
            // The file has moved: any file with that hash is accepted.
            None if recording.provenance.inputs.values().any(|expected| *expected == hash) => continue,
            None => "of one of the recorded files".into(),
        };
        if expected != hash {
            let found = if hash.is_empty() { text("error") } else { hash };
            return Err(ReplayError::NoData(format!(
                "{path} is not the file that the run had read: sha256 {expected} expected, {found} found"
            )));
        }
    }
    Ok(())
}

/// Nodes computed upstream of the requested one because their outputs were not recorded.
fn computed_too(plan: &Plan, changes: &ReplayOptions, parts: &[NodeMode]) -> Vec<String> {
    let Some(from) = changes.from.as_ref().and_then(|name| plan.node(name)) else {
        return Vec::new();
    };
    let mut follows = vec![false; plan.nodes.len()];
    follows[from] = true;
    plan.mark_downstream(&mut follows);
    let nodes = plan.nodes.iter().enumerate();
    let too = nodes.filter(|(index, _)| parts[*index] == NodeMode::Computed && !follows[*index]);
    too.map(|(_, node)| node.name.to_string()).collect()
}

/// Creates a player for each played node; with the number of items left out at the beginning of each wire.
fn players(
    plan: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    registry: &Registry,
    unchanged: &BTreeSet<Arc<str>>,
    is_computed: impl Fn(usize) -> bool,
) -> Result<(Substitutes, BTreeMap<OutputId, u64>), ReplayError> {
    let mut cut = BTreeMap::new();
    let mut items: BTreeMap<OutputId, Vec<Item>> = BTreeMap::new();
    for &id in plan.record.iter().filter(|id| !is_computed(id.node)) {
        items.insert(id, recording.items(&plan.wire_name(id), registry)?);
    }
    let stamps = items.values().flatten().map(|item| item.stamp_ns).filter(|stamp_ns| *stamp_ns > 0);
    let first_ns = stamps.min().unwrap_or(0);
    let start = changes.start.map_or(StampNs::MIN, |start| start.stamp(first_ns));
    let end = changes.end.map_or(StampNs::MAX, |end| end.stamp(first_ns));
    for (id, items) in &mut items {
        let is_single_result = items.len() == 1 && plan.consumers(*id).next().is_none();
        if !is_constant(plan, *id) && !is_single_result && !unchanged.contains(&plan.nodes[id.node].name) {
            let before = items.iter().filter(|item| item.stamp_ns > 0 && item.stamp_ns < start);
            cut.insert(*id, before.count() as u64);
            // An item without a time is a constant too.
            items.retain(|item| item.stamp_ns <= 0 || (start..=end).contains(&item.stamp_ns));
        }
    }
    let first_ns = first_ns.max(start);
    let pace = changes.rate.map(|rate| Arc::new(Pace { rate, first_ns, began: Default::default() }));
    let mut players = Substitutes::new();
    for (index, node) in plan.nodes.iter().enumerate().filter(|(index, _)| !is_computed(*index)) {
        let ports = plan.outputs(index).map(|id| items.remove(&id).unwrap_or_default());
        let mut ports: Vec<_> = ports.collect();
        let failed = recording.failures.iter().find(|failure| *failure.node == *node.name && !failure.skipped);
        let failure = failed.and_then(|failed| failing(&mut ports, &failed.node, &failed.reason));
        let ports = ports.into_iter().map(Into::into).collect();
        players.insert(index, Box::new(Player { ports, failure, pace: pace.clone() }));
    }
    Ok((players, cut))
}

/// Removes the empties with which a failed node ended its wires; its failure is played instead.
fn failing(ports: &mut [Vec<Item>], node: &str, reason: &str) -> Option<Failing> {
    let last = |item: &Item| matches!(&item.body, Body::Empty(e) if *e.node == *node && *e.reason == *reason);
    let mut stamp_ns = None;
    for items in ports {
        if let Some(item) = items.pop_if(|item| last(item)) {
            stamp_ns = stamp_ns.max(Some(item.stamp_ns));
        }
    }
    Some(Failing { reason: reason.into(), stamp_ns: stamp_ns?, promised: false })
}

/// Recorded drops, by the index of the link, with the numbers of the items as played.
fn drops(plan: &Plan, recording: &Recording, cut: &BTreeMap<OutputId, u64>) -> BTreeMap<usize, BTreeSet<u64>> {
    let of = |index: usize| {
        let link = &plan.links[index];
        let ends = plan.link_names(link);
        let n_cut = cut.get(&link.from).copied().unwrap_or(0);
        let numbers = recording.drops.get(&ends)?.iter().filter_map(|number| number.checked_sub(n_cut));
        Some((index, numbers.collect()))
    };
    (0..plan.links.len()).filter_map(of).collect()
}

/// Recorded clock readings, by the index of the node and the number of the firing.
fn readings(plan: &Plan, recording: &Recording) -> BTreeMap<(usize, u64), Vec<ClockReading>> {
    let all = recording.readings.iter();
    all.filter_map(|((node, item), readings)| Some(((plan.node(node)?, *item), readings.clone()))).collect()
}

/// Comparison of each recorded wire, in the order of the plan.
fn comparisons(
    reduced: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    compare: &Compare<'_>,
    is_computed: impl Fn(usize) -> bool,
) -> Vec<WireComparison> {
    let mut left: BTreeSet<_> = recording.wires.keys().map(String::as_str).collect();
    let mut wires = Vec::new();
    for &id in &reduced.record {
        let name = reduced.wire_name(id);
        left.remove(name.as_str());
        let part = if is_computed(id.node) { WirePart::Computed } else { WirePart::Played };
        wires.push(compare.of(&name, recording, Some(id), part));
    }
    for name in left {
        let mut wire = compare.of(name, recording, None, WirePart::Absent);
        if changes.graph.is_none() && changes.sets.is_empty() {
            let what = diff::Difference::other("wire", "recorded", "not in the graph of this program");
            wire.first_difference = Some(Difference { item: 0, what });
        }
        wires.push(wire);
    }
    wires
}

/// The results without the verdict of a run that failed: it repeats the refusal, with a remedy that depends on whether
/// the failed item was saved.
fn without_failure(results: &serde_json::Value) -> Cow<'_, serde_json::Value> {
    match Verdict::of(results) {
        Some(verdict) if !verdict.is_judged() => {
            let mut results = results.clone();
            results.as_object_mut().map(|results| results.shift_remove(VERDICT));
            Cow::Owned(results)
        }
        _ => Cow::Borrowed(results),
    }
}

/// Compares the results. Where paths in them were recorded as they are shown, the digest tells whether they are the same;
/// of a refusal by a played node only node and reason are compared, since its activations are numbered differently.
fn same_results(
    recorded: &serde_json::Value,
    recording: &Recording,
    replayed: &serde_json::Value,
    is_computed: impl Fn(&str) -> bool,
) -> bool {
    if recording.results_digest.as_ref().is_some_and(|digest| *digest == Digest::of_json(replayed).to_string()) {
        return true;
    }
    let node = recorded["refused"]["node"].as_str();
    if node.is_none_or(is_computed) {
        return without_failure(recorded) == without_failure(replayed);
    }
    let refused =
        |results: &serde_json::Value| (results["refused"]["node"].clone(), results["refused"]["reason"].clone());
    refused(recorded) == refused(replayed)
}
