//! Runs a recording again: recorded wires are played, what follows from them is computed anew and compared.

mod compare;
mod select;
#[cfg(test)]
mod tests;

use crate::{
    check::{check, check_recorded},
    diff,
    fault::Faults,
    partial::{self, Failing, NodeMode, Pace, Player},
    plan::{OutputId, Plan, Sources},
    plugin::Kinds,
    recording::{Recording, RecordingError},
    run::{self, RunError, RunReport},
    runtime::{Observer, Replayed, RunOptions, Substitutes},
};
use compare::Compare;
use osteoflow_node::{Body, ClockReading, Item, Join, PortPayload, Registry, Role, StampNs};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    str::FromStr,
    sync::Arc,
};

/// The key of `results.json` that names the node from which on a replay had computed.
const COMPUTED_FROM: &str = "computed_from";

/// What to change in a replay; by default nothing.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ReplayOptions {
    /// Only this node, and what follows from it, is computed anew.
    pub from: Option<String>,
    /// Settings of the graph, each `KEY=VALUE`.
    pub sets: Vec<String>,
    /// The graph file to play the recorded wires into, in the place of the recorded graph.
    pub graph: Option<PathBuf>,
    /// How many seconds of the recording go by in one; `None`: as fast as can be. The result does not depend on it.
    pub rate: Option<f64>,
    /// Nothing before it is played, constants excepted.
    pub start: Option<Moment>,
    /// Nothing after it is played, constants excepted.
    pub end: Option<Moment>,
}

/// A time in a recording: `12.5` is seconds after its first stamp, `1750000000418500000ns` a stamp.
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
            // Beyond what a stamp can tell it stays at the last one.
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
    /// The graph has faults, or does not fit the kinds of this program.
    #[error("{}:\n{faults}", if *.recorded { "the recorded graph does not fit this program" } else { "the graph has faults" })]
    Graph {
        /// What is wrong.
        faults: Faults,
        /// Whether it is the recorded graph as it was.
        recorded: bool,
    },
    /// A source's wire is not in it.
    #[error(
        "the recording lacks the source wire {wire}, so nothing after it can be computed; record it, or name a node \
         behind it that can be computed from recorded wires"
    )]
    Missing {
        /// The wire.
        wire: String,
    },
    /// Nothing that was recorded can be played into the graph.
    #[error("no recorded wire is an output of a source of {}; recorded are {recorded}", .graph.display())]
    NothingFits {
        /// The graph.
        graph: PathBuf,
        /// The recorded source wires.
        recorded: String,
    },
    /// A recorded wire has another payload in the graph.
    #[error("wire {wire} was recorded with {recorded}, and carries {found} in the graph")]
    Payload {
        /// The wire.
        wire: String,
        /// What was recorded.
        recorded: String,
        /// What the graph has.
        found: String,
    },
    /// There is no such node.
    #[error("there is no node \"{node}\" in the graph; it has {known}")]
    NoNode {
        /// What was asked for.
        node: String,
        /// The nodes there are.
        known: String,
    },
    /// A setting of a node that is not computed.
    #[error("--set {set} changes nothing: the wires of \"{node}\" are played from the recording")]
    NoEffect {
        /// The setting.
        set: String,
        /// The node.
        node: String,
    },
    /// A file that a source reads is not the one that the run had read.
    #[error("{} is not the file that the run had read: sha256 {expected} expected, {found} found", .path.display())]
    Input {
        /// The file.
        path: PathBuf,
        /// The hash in the recording.
        expected: String,
        /// The file's hash, or why it has none.
        found: String,
    },
    /// The run itself.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// What came of a replay.
#[derive(Debug)]
pub struct ReplayReport {
    /// The run.
    pub run: RunReport,
    /// Each recorded wire, in the topological order of the graph; last those that it does not have.
    pub wires: Vec<WireComparison>,
    /// Whether the results are the recorded ones; `None` where there are none to compare with.
    pub results_equal: Option<bool>,
    /// Why nothing is compared; `None` where it is.
    pub not_compared: Option<String>,
    /// What ended a recording that was cut short; then the items up to there are compared.
    pub truncated: Option<String>,
    /// Nodes that were computed beside those asked for, because their wires were not recorded.
    pub computed_too: Vec<String>,
    /// How the libraries of plugins differ from those that the run had.
    pub differences: Vec<String>,
}

/// What a replay did with a wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WirePart {
    /// Its recorded items were played.
    Played,
    /// It was computed anew.
    Computed,
    /// The graph does not have it.
    Absent,
}

/// A wire as recorded and as computed anew.
#[derive(Debug, Clone, PartialEq)]
pub struct WireComparison {
    /// The wire, `node.port`.
    pub wire: String,
    /// What was done with it.
    pub part: WirePart,
    /// Items in the recording.
    pub n_recorded: u64,
    /// Items in the replay.
    pub n_replayed: u64,
    /// Items that were compared, up to the first that differs.
    pub n_compared: u64,
    /// The first item that differs in any bit.
    pub first_difference: Option<Difference>,
}

/// Where a wire first differs, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The item's number.
    pub item: u64,
    /// What was recorded (`a`), what came (`b`), and how far they lie apart.
    pub what: diff::Difference,
}

impl ReplayReport {
    /// Whether every wire and the results are, bit for bit, the recorded ones.
    pub fn is_equal(&self) -> bool {
        self.first_divergence().is_none() && self.results_equal != Some(false)
    }

    /// The wire that differs first in the topological order of the graph; of one node's, the one that differs at the
    /// first item.
    pub fn first_divergence(&self) -> Option<&WireComparison> {
        let node = |wire: &WireComparison| wire.wire.split('.').next().unwrap_or_default().to_owned();
        let item = |wire: &&WireComparison| wire.first_difference.as_ref().map(|d| d.item);
        let first = self.wires.iter().find(|wire| wire.first_difference.is_some())?;
        let of_node = self.wires.iter().filter(|wire| wire.first_difference.is_some() && node(wire) == node(first));
        of_node.min_by_key(item)
    }
}

/// Runs the graph of a recording again and compares every recorded wire that is computed, and the results. Of the files
/// that the graph names only those are read whose sources were recorded by their hashes.
///
/// # Errors
/// [`ReplayError`] if the recording cannot be read, or what is asked for cannot be run from it.
pub fn replay(
    path: &Path,
    changes: &ReplayOptions,
    kinds: impl Into<Kinds>,
    options: &RunOptions,
    observer: &dyn Observer,
) -> Result<ReplayReport, ReplayError> {
    let recording = Recording::open(path)?;
    let kinds: Kinds = kinds.into();
    let kinds = &kinds.over(recording.registry(kinds.registry()));
    let sets = &changes.sets;
    let checked = match &changes.graph {
        // Files of sources that are played need not be there; a graph file that cannot be read is a fault.
        Some(graph) => match std::fs::read_to_string(graph) {
            Ok(text) => check_recorded(&text, graph, sets, kinds),
            Err(_) => check(graph, sets, kinds),
        },
        None => check_recorded(&recording.graph, &recording.graph_file, sets, kinds),
    };
    let recorded = changes.graph.is_none() && sets.is_empty();
    let checked = checked.map_err(|faults| ReplayError::Graph { faults, recorded })?;
    replay_plan(&checked.plan, &recording, changes, &checked.registry, options, observer)
}

/// The same with a graph that has been checked.
pub(crate) fn replay_plan(
    plan: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
) -> Result<ReplayReport, ReplayError> {
    let recorded = recorded_outputs(plan, recording)?;
    let parts = parts(plan, recording, changes, &recorded)?;
    sets_take_effect(plan, changes, &parts)?;
    let computed = |index: usize| parts[index] == NodeMode::Computed;
    let runs_sources = plan.nodes.iter().enumerate().any(|(i, node)| node.role != Role::Node && computed(i));
    if runs_sources && recording.sources == Sources::Hashes {
        inputs_are_the_same(plan, recording)?;
    }
    let differences = recording.plugins.iter().filter_map(|then| {
        let now = plan.plugins.iter().find(|now| now.name == then.name)?;
        then.difference(now)
    });
    let differences = differences.collect();
    let computed_too = computed_too(plan, changes, &parts);

    let mut reduced = partial::reduce(&Plan { record: recorded.iter().copied().collect(), ..plan.clone() }, &parts);
    if !runs_sources {
        // Their content went into the recording; the files themselves are not read.
        reduced.input_files.clear();
    }
    let computes: BTreeSet<_> =
        plan.nodes.iter().enumerate().filter(|(i, _)| computed(*i)).map(|(_, n)| &*n.name).collect();
    let is_computed = |node: usize| computes.contains(&*reduced.nodes[node].name);
    let Players { substitutes, cut } = players(&reduced, recording, changes, registry, is_computed)?;
    let replayed = Replayed {
        substitutes,
        drops: Some(drops(&reduced, recording, &cut)),
        // Where the beginning is left out, firings are numbered otherwise, and the clock answers.
        readings: changes.start.is_none().then(|| readings(&reduced, recording)),
    };
    let not_compared = (changes.start.is_some() || changes.end.is_some())
        .then(|| "only a part of the recording was played, and a part of a run is another run".to_owned());
    let compare = Compare::new(&reduced, recording, is_computed, not_compared.is_none());
    let mut options = options.clone();
    // A replay shows that computing again gives the same; what is taken from the store is not computed.
    options.store = None;
    if changes.graph.is_none() {
        options.fixed_results.clone_from(&recording.fixed_results);
        options.fixed_results.retain(|(key, _)| key != COMPUTED_FROM);
    }
    if let Some(from) = &changes.from {
        // Not all results of the graph are among them.
        options.fixed_results.push((COMPUTED_FROM.into(), from.as_str().into()));
    }
    if changes.rate.is_some() {
        // A player that waits for its time holds a worker.
        options.workers += replayed.substitutes.len();
    }
    let report = run::run_with(&reduced, registry, &options, observer, replayed, Some(&compare))?;

    // Of a part of a recording other results come than of the whole.
    let partial = recording.interrupted || recording.truncated.is_some();
    let whole = not_compared.is_none() && changes.graph.is_none() && changes.from.is_none() && !partial;
    let results_equal = recording.results.as_ref().filter(|results| whole && results.get(COMPUTED_FROM).is_none());
    let results_equal =
        results_equal.map(|recorded| same_results(recorded, &report.results, is_computed_name(&computes)));
    Ok(ReplayReport {
        run: report,
        wires: comparisons(&reduced, recording, changes, &compare, &computes),
        results_equal,
        not_compared,
        truncated: recording.truncated.clone(),
        computed_too,
        differences,
    })
}

fn is_computed_name<'a>(computes: &'a BTreeSet<&str>) -> impl Fn(&str) -> bool + 'a {
    |name| computes.contains(name)
}

/// The outputs of the plan that were recorded.
fn recorded_outputs(plan: &Plan, recording: &Recording) -> Result<BTreeSet<OutputId>, ReplayError> {
    let mut recorded = BTreeSet::new();
    for id in (0..plan.nodes.len()).flat_map(|node| partial::outputs(plan, node)) {
        let name = plan.wire_name(id);
        let Some(wire) = recording.wires.get(&name) else { continue };
        if let PortPayload::Type(ty) = plan.nodes[id.node].outputs[id.port].payload
            && ty.name != wire.payload
        {
            return Err(ReplayError::Payload { wire: name, recorded: wire.payload.clone(), found: ty.name.into() });
        }
        recorded.insert(id);
    }
    Ok(recorded)
}

fn parts(
    plan: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    recorded: &BTreeSet<OutputId>,
) -> Result<Vec<NodeMode>, ReplayError> {
    let is_recorded = |index: usize| partial::outputs(plan, index).any(|id| recorded.contains(&id));
    if let Some(graph) = &changes.graph {
        let plays = |(index, node): (usize, &crate::plan::PlanNode)| node.role != Role::Node && is_recorded(index);
        if !plan.nodes.iter().enumerate().any(plays) && changes.from.is_none() {
            let sources = recording.wires.iter().filter(|(_, wire)| wire.source).map(|(name, _)| name.as_str());
            let recorded = sources.collect::<Vec<_>>().join(", ");
            return Err(ReplayError::NothingFits { graph: graph.clone(), recorded });
        }
    }
    // Another graph may have sources of its own; what a live source gave comes only once.
    let runs = |index: usize| match plan.nodes[index].role {
        Role::LiveSource => false,
        _ => recording.sources == Sources::Hashes || (changes.graph.is_some() && !is_recorded(index)),
    };
    let parts = match &changes.from {
        None => select::all(plan, recorded, runs),
        Some(name) => {
            let Some(node) = plan.nodes.iter().position(|node| *node.name == **name) else {
                let known = plan.nodes.iter().map(|node| &*node.name).collect::<Vec<_>>().join(", ");
                return Err(ReplayError::NoNode { node: name.clone(), known });
            };
            select::from(plan, recorded, node, runs)
        }
    };
    parts.map_err(|wire| ReplayError::Missing { wire: plan.wire_name(wire) })
}

/// What a setting says of a node that is played has no effect, and is hardly meant.
fn sets_take_effect(plan: &Plan, changes: &ReplayOptions, parts: &[NodeMode]) -> Result<(), ReplayError> {
    for set in &changes.sets {
        let key = set.split('=').next().unwrap_or_default().trim();
        let key = key.strip_prefix("node.").unwrap_or(key);
        let named = |name: &str| key.strip_prefix(name).is_some_and(|rest| rest.starts_with('.'));
        let node = plan.nodes.iter().zip(parts).find(|(node, _)| named(&node.name));
        if let Some((node, NodeMode::Played | NodeMode::LeftOut)) = node {
            return Err(ReplayError::NoEffect { set: set.clone(), node: node.name.to_string() });
        }
    }
    Ok(())
}

/// The files that sources are going to read are those that the run had read.
fn inputs_are_the_same(plan: &Plan, recording: &Recording) -> Result<(), ReplayError> {
    for input in crate::hash::files::hashes(&plan.input_files) {
        let text = |key: &str| input[key].as_str().unwrap_or_default().to_owned();
        let (path, hash) = (text("path"), text("sha256"));
        let expected = match recording.inputs.get(&path) {
            Some(expected) => expected.clone(),
            // A file that has moved: any of the files will do.
            None if recording.inputs.values().any(|expected| *expected == hash) => continue,
            None => "of one of the recorded files".into(),
        };
        if expected != hash {
            let found = if hash.is_empty() { text("error") } else { hash };
            return Err(ReplayError::Input { path: path.into(), expected, found });
        }
    }
    Ok(())
}

/// Nodes before the one asked for that are computed, because what they give was not recorded.
fn computed_too(plan: &Plan, changes: &ReplayOptions, parts: &[NodeMode]) -> Vec<String> {
    let Some(from) = changes.from.as_ref().and_then(|name| plan.nodes.iter().position(|n| *n.name == **name)) else {
        return Vec::new();
    };
    let mut follows = vec![false; plan.nodes.len()];
    follows[from] = true;
    partial::follow(plan, &mut follows);
    let nodes = plan.nodes.iter().enumerate();
    let too = nodes.filter(|(index, _)| parts[*index] == NodeMode::Computed && !follows[*index]);
    too.map(|(_, node)| node.name.to_string()).collect()
}

/// What is played.
struct Players {
    substitutes: Substitutes,
    /// How many items are left out at the beginning of a wire.
    cut: BTreeMap<OutputId, u64>,
}

/// For each node that is played one that gives the recorded items.
fn players(
    plan: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    registry: &Registry,
    is_computed: impl Fn(usize) -> bool,
) -> Result<Players, ReplayError> {
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
        if !is_constant(plan, *id) {
            let before = items.iter().filter(|item| item.stamp_ns > 0 && item.stamp_ns < start);
            cut.insert(*id, before.count() as u64);
            // What has no time is a constant too.
            items.retain(|item| item.stamp_ns <= 0 || (start..=end).contains(&item.stamp_ns));
        }
    }
    let first_ns = first_ns.max(start);
    let pace = changes.rate.map(|rate| Arc::new(Pace { rate, first_ns, began: Default::default() }));
    let mut players = Substitutes::new();
    for (index, node) in plan.nodes.iter().enumerate().filter(|(index, _)| !is_computed(*index)) {
        let ports = partial::outputs(plan, index).map(|id| items.remove(&id).unwrap_or_default());
        let mut ports: Vec<_> = ports.collect();
        let failed = recording.failures.iter().find(|failure| *failure.node == *node.name && !failure.skipped);
        let failure = failed.and_then(|failed| failing(&mut ports, &failed.node, &failed.reason));
        let ports = ports.into_iter().map(Into::into).collect();
        players.insert(index, Box::new(Player { ports, failure, pace: pace.clone() }));
    }
    Ok(Players { substitutes: players, cut })
}

/// Takes away the empties with which a failing node had ended its wires: its failure is played in their place.
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

/// Whether all that takes the output takes one item for the whole run.
fn is_constant(plan: &Plan, id: OutputId) -> bool {
    let mut links = partial::consumers(plan, id).peekable();
    links.peek().is_some() && links.all(|link| plan.nodes[link.to_node].inputs[link.to_port].port.join == Join::Once)
}

/// What policies had dropped, by the index of the link; numbers are those of the items as they are played.
fn drops(plan: &Plan, recording: &Recording, cut: &BTreeMap<OutputId, u64>) -> BTreeMap<usize, BTreeSet<u64>> {
    let of = |index: usize| {
        let link = &plan.links[index];
        let to = &plan.nodes[link.to_node];
        let ends = (plan.wire_name(link.from), format!("{}.{}", to.name, to.inputs[link.to_port].port.name));
        let n_cut = cut.get(&link.from).copied().unwrap_or(0);
        let numbers = recording.drops.get(&ends)?.iter().filter_map(|number| number.checked_sub(n_cut));
        Some((index, numbers.collect()))
    };
    (0..plan.links.len()).filter_map(of).collect()
}

/// What firings had taken from the clock, by the index of the node.
fn readings(plan: &Plan, recording: &Recording) -> BTreeMap<(usize, u64), Vec<ClockReading>> {
    let place = |name: &str| plan.nodes.iter().position(|node| *node.name == *name);
    let all = recording.readings.iter();
    all.filter_map(|((node, item), readings)| Some(((place(node)?, *item), readings.clone()))).collect()
}

/// Each recorded wire, in the order of the plan.
fn comparisons(
    reduced: &Plan,
    recording: &Recording,
    changes: &ReplayOptions,
    compare: &Compare<'_>,
    computes: &BTreeSet<&str>,
) -> Vec<WireComparison> {
    let mut left: BTreeSet<_> = recording.wires.keys().map(String::as_str).collect();
    let mut wires = Vec::new();
    for &id in &reduced.record {
        let name = reduced.wire_name(id);
        left.remove(name.as_str());
        let computed = computes.contains(&*reduced.nodes[id.node].name);
        let part = if computed { WirePart::Computed } else { WirePart::Played };
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

/// Results are compared whole. Of a refusal by a node that is played, node and reason: its activations are counted
/// otherwise.
fn same_results(
    recorded: &serde_json::Value,
    replayed: &serde_json::Value,
    is_computed: impl Fn(&str) -> bool,
) -> bool {
    let node = recorded["refused"]["node"].as_str();
    if node.is_none_or(is_computed) {
        return recorded == replayed;
    }
    let refused =
        |results: &serde_json::Value| (results["refused"]["node"].clone(), results["refused"]["reason"].clone());
    refused(recorded) == refused(replayed)
}
