//! Runs a recording again: its sources' wires are played, everything downstream is computed anew and compared.

use crate::{
    check::check_recorded,
    codec,
    fault::Faults,
    plan::{OutputId, Plan},
    recording::{Recording, RecordingError},
    run::{self, Observer, Replayed, RunError, RunOptions, RunReport, Substitutes, Tap},
};
use osteoflow_node::{AnySource, Body, Context, Emission, Item, NodeError, PortPayload, Registry, Role, StampNs};
use std::{
    collections::{BTreeMap, VecDeque},
    path::Path,
    sync::{Mutex, PoisonError},
};

/// A recording that cannot be run again.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The file cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The graph in it does not fit the kinds of this program.
    #[error("the recorded graph does not fit this program:\n{0}")]
    Graph(Faults),
    /// A source's wire is not in it.
    #[error("the recording lacks the source wire {wire}, so nothing after it can be computed")]
    Missing {
        /// The wire.
        wire: String,
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
    /// Each recorded wire, by name.
    pub wires: Vec<WireComparison>,
    /// Whether the results are the recorded ones; `None` where the recording has none to compare with.
    pub results_equal: Option<bool>,
    /// What ended a recording that was cut short; then the items up to there are compared.
    pub truncated: Option<String>,
}

/// A wire as recorded and as computed anew.
#[derive(Debug, Clone, PartialEq)]
pub struct WireComparison {
    /// The wire, `node.port`.
    pub wire: String,
    /// Whether it was played, not computed.
    pub source: bool,
    /// Items in the recording.
    pub n_recorded: u64,
    /// Items in the replay.
    pub n_replayed: u64,
    /// The first item that differs in any bit, and how.
    pub first_difference: Option<(u64, String)>,
}

impl ReplayReport {
    /// Whether every wire and the results are, bit for bit, the recorded ones.
    pub fn is_equal(&self) -> bool {
        self.wires.iter().all(|wire| wire.first_difference.is_none()) && self.results_equal != Some(false)
    }
}

/// Runs the graph of a recording again, with the recorded items of its sources, and compares every recorded wire and the
/// results. The files that the graph names need not be there.
///
/// # Errors
/// [`ReplayError`] if the recording cannot be read or its graph cannot be run here.
pub fn replay(
    path: &Path,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
) -> Result<ReplayReport, ReplayError> {
    let recording = Recording::open(path)?;
    let plan = check_recorded(&recording.graph, &recording.graph_file, &[], registry).map_err(ReplayError::Graph)?.plan;
    replay_plan(plan, &recording, registry, options, observer)
}

/// The same with a graph that has been checked.
pub(crate) fn replay_plan(
    mut plan: Plan,
    recording: &Recording,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
) -> Result<ReplayReport, ReplayError> {
    // Their content went into the recording; the files themselves are not read.
    plan.input_files.clear();
    let replayed = Replayed { substitutes: played(&plan, recording, registry)?, ..Replayed::default() };
    let names = output_names(&plan);
    plan.record = recording.wires.keys().filter_map(|name| names.get(name).copied()).collect();
    let compare = Compare {
        wires: plan.record.iter().map(|id| (*id, Mutex::default())).collect(),
        payloads: plan.record.iter().map(|id| (*id, plan.nodes[id.node].outputs[id.port].payload)).collect(),
        recorded: plan.record.iter().map(|id| (*id, &recording.wires[&plan.wire_name(*id)].messages)).collect(),
    };
    let mut options = options.clone();
    options.fixed_results.clone_from(&recording.fixed_results);
    let report = run::run_with(&plan, registry, &options, observer, replayed, Some(&compare))?;
    let results_equal = match &recording.results {
        Some(recorded) if !recording.interrupted => Some(same_results(recorded, &report.results)),
        _ => None,
    };
    Ok(ReplayReport {
        run: report,
        wires: recording.wires.keys().map(|name| compare.of(name, recording, names.get(name).copied())).collect(),
        results_equal,
        truncated: recording.truncated.clone(),
    })
}

/// For each source one that gives the recorded items.
fn played(plan: &Plan, recording: &Recording, registry: &Registry) -> Result<Substitutes, ReplayError> {
    let mut substitutes = Substitutes::new();
    for (index, node) in plan.nodes.iter().enumerate().filter(|(_, node)| node.role != Role::Node) {
        let mut ports = Vec::new();
        for port in 0..node.outputs.len() {
            let wire = plan.wire_name(OutputId { node: index, port });
            if !recording.wires.contains_key(&wire) {
                return Err(ReplayError::Missing { wire });
            }
            ports.push(recording.items(&wire, registry)?.into());
        }
        substitutes.insert(index, Box::new(Player { ports }) as Box<dyn AnySource>);
    }
    Ok(substitutes)
}

fn output_names(plan: &Plan) -> BTreeMap<String, OutputId> {
    let nodes = plan.nodes.iter().enumerate();
    let ids = nodes.flat_map(|(node, n)| (0..n.outputs.len()).map(move |port| OutputId { node, port }));
    ids.map(|id| (plan.wire_name(id), id)).collect()
}

/// Results are compared whole. Of a refusal, node and reason: a source that had failed is played, and plays on to its
/// end, so that its activations are counted otherwise.
fn same_results(recorded: &serde_json::Value, replayed: &serde_json::Value) -> bool {
    let refused = |results: &serde_json::Value| {
        let refused = results.get("refused")?;
        Some((refused.get("node").cloned(), refused.get("reason").cloned()))
    };
    match (refused(recorded), refused(replayed)) {
        (None, None) => recorded == replayed,
        (recorded, replayed) => recorded == replayed,
    }
}

/// Gives recorded items in the order of their stamps. In which order wires of one stamp are given does not matter: what
/// is computed depends on items and stamps alone.
struct Player {
    ports: Vec<VecDeque<Item>>,
}

impl AnySource for Player {
    fn next(&mut self, out: &mut [Emission], ctx: &mut Context) -> Result<bool, NodeError> {
        let heads = self.ports.iter().filter_map(|port| port.front());
        let Some(stamp_ns) = heads.map(|item| item.stamp_ns).min() else { return Ok(false) };
        ctx.set_stamp_ns(stamp_ns);
        for (port, emission) in self.ports.iter_mut().zip(out) {
            if port.front().is_some_and(|item| item.stamp_ns == stamp_ns)
                && let Some(item) = port.pop_front()
            {
                *emission = match item.body {
                    Body::Value(value) => Emission::Value(value),
                    Body::Empty(empty) => Emission::Empty(empty.reason.clone()),
                };
            }
        }
        Ok(true)
    }
}

/// Compares items as they come.
struct Compare<'a> {
    wires: BTreeMap<OutputId, Mutex<Seen>>,
    recorded: BTreeMap<OutputId, &'a Vec<Vec<u8>>>,
    payloads: BTreeMap<OutputId, PortPayload>,
}

#[derive(Default)]
struct Seen {
    n_items: u64,
    first_difference: Option<(u64, String)>,
}

impl Tap for Compare<'_> {
    fn item(&self, wire: OutputId, item: &Item) {
        let (Some(seen), Some(recorded)) = (self.wires.get(&wire), self.recorded.get(&wire)) else { return };
        let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
        seen.n_items += 1;
        if seen.first_difference.is_some() {
            return;
        }
        let bytes = codec::encode_on(self.payloads[&wire], item);
        let recorded = usize::try_from(item.number).ok().and_then(|number| recorded.get(number));
        if let Some(recorded) = recorded.filter(|recorded| **recorded != bytes) {
            seen.first_difference = Some((item.number, difference(recorded, &bytes)));
        }
    }
}

impl Compare<'_> {
    fn of(&self, name: &str, recording: &Recording, id: Option<OutputId>) -> WireComparison {
        let wire = &recording.wires[name];
        let n_recorded = wire.messages.len() as u64;
        let (n_replayed, mut first_difference) = match id.and_then(|id| self.wires.get(&id)) {
            Some(seen) => {
                let seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                (seen.n_items, seen.first_difference.clone())
            }
            None => (0, Some((0, "the graph of this program has no such wire".into()))),
        };
        // Of a recording cut short, wires end at different times, and nothing follows from that.
        if n_recorded != n_replayed && recording.truncated.is_none() && first_difference.is_none() {
            let said = format!("{n_recorded} items were recorded, {n_replayed} came");
            first_difference = Some((n_recorded.min(n_replayed), said));
        }
        WireComparison { wire: name.into(), source: wire.source, n_recorded, n_replayed, first_difference }
    }
}

/// What differs first in two messages of one number.
fn difference(recorded: &[u8], replayed: &[u8]) -> String {
    let (Ok(a), Ok(b)) = (codec::decode(recorded), codec::decode(replayed)) else {
        return "the recorded item is damaged".into();
    };
    let stamp = |stamp_ns: StampNs| format!("stamp {stamp_ns} ns");
    if a.stamp_ns != b.stamp_ns {
        return format!("{} was recorded, {} came", stamp(a.stamp_ns), stamp(b.stamp_ns));
    }
    match (a.body, b.body) {
        (Ok(a), Ok(b)) => {
            let field = a.head.iter().zip(&b.head).find(|(a, b)| a != b);
            let column = a.columns.iter().zip(&b.columns).find(|(a, b)| a != b);
            match (field, column) {
                (Some(((name, a), (_, b))), _) => format!("{name} was {a:?}, is {b:?}"),
                (None, Some((a, b))) => {
                    format!("column {} differs: {} rows were recorded, {} came", a.name, a.rows(), b.rows())
                }
                (None, None) => {
                    "the views have different parts, or differ in the sign of a zero or the bits of a NaN".into()
                }
            }
        }
        (Err(a), Err(b)) => format!("it was empty ({}), and is for another reason ({})", a.reason, b.reason),
        (Ok(_), Err(empty)) => format!("a value was recorded, none came: {}", empty.reason),
        (Err(empty), Ok(_)) => format!("a value came where none was recorded: {}", empty.reason),
    }
}
