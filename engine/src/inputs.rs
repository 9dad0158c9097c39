//! Runs a graph with inputs from memory in place of nodes, and returns the items of its wires.

use crate::{
    partial::{NodeMode, Player, reduce_in_memory},
    plan::{Link, OutputId, Plan},
    run::{RunError, RunOptions, RunReport, run_with},
    runtime::{Observer, Replayed, Tap, names::nearest},
};
use osteoflow_node::{Body, Empty, Item, Join, PortPayload, Registry};
use std::{
    collections::{BTreeMap, VecDeque},
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

/// Items that replace those of a node, by wire: `scan.cloud`.
#[derive(Debug, Default)]
pub struct WireInputs {
    ports: BTreeMap<usize, Vec<Option<VecDeque<Item>>>>,
    /// Outputs of computed nodes that carry no value.
    without: Vec<OutputId>,
}

/// The output of a plan with the name `node.port`, or `node` if the node has one output.
///
/// # Errors
/// There is none; the message names the most similar one.
pub fn output(plan: &Plan, name: &str) -> Result<OutputId, String> {
    if let Some(id) = plan.all_outputs().find(|id| plan.wire_name(*id) == name) {
        return Ok(id);
    }
    let names = |ids: &[OutputId]| -> Vec<String> { ids.iter().map(|id| plan.wire_name(*id)).collect() };
    let of_node: Vec<_> = plan.node(name).into_iter().flat_map(|node| plan.outputs(node)).collect();
    match of_node[..] {
        [id] => Ok(id),
        [] => {
            let names = names(&plan.all_outputs().collect::<Vec<_>>());
            let names = || names.iter().map(String::as_str);
            let help = nearest::help(name, names()).or_else(|| nearest::list("wires here", names()));
            Err(format!("there is no wire \"{name}\"{}", help.map(|help| format!("; {help}")).unwrap_or_default()))
        }
        _ => Err(format!("node \"{name}\" has several outputs; name one of {}", names(&of_node).join(", "))),
    }
}

impl WireInputs {
    /// Whether there are no inputs.
    pub fn is_empty(&self) -> bool {
        self.ports.is_empty()
    }

    /// The wires that have inputs.
    pub fn wires(&self, plan: &Plan) -> Vec<String> {
        let has_inputs = |id: &OutputId| self.ports.get(&id.node).is_some_and(|ports| ports[id.port].is_some());
        plan.all_outputs().filter(has_inputs).map(|id| plan.wire_name(id)).collect()
    }

    /// States that an output of a computed node gives empties only.
    pub fn leave_out(&mut self, wire: OutputId) {
        self.without.push(wire);
    }

    /// Adds the items of a wire, in order.
    ///
    /// # Errors
    /// The payload of an item is not that of the wire, or a stamp is before that of its predecessor.
    pub fn add(&mut self, plan: &Plan, wire: OutputId, items: Vec<Item>) -> Result<(), String> {
        let output = &plan.nodes[wire.node].outputs[wire.port];
        let name = || plan.wire_name(wire);
        for item in &items {
            if let (PortPayload::Type(ty), Body::Value(value)) = (output.payload, &item.body)
                && value.ty().name != ty.name
            {
                return Err(format!("wire \"{}\" carries {}, but {} was given", name(), ty.name, value.ty().name));
            }
        }
        if let Some(pair) = items.windows(2).find(|pair| pair[1].stamp_ns < pair[0].stamp_ns) {
            let (before, after) = (pair[0].stamp_ns, pair[1].stamp_ns);
            return Err(format!("wire \"{}\": stamp {after} follows {before}; sort the items by stamp", name()));
        }
        let ports = self.ports.entry(wire.node).or_insert_with(|| vec![None; plan.nodes[wire.node].outputs.len()]);
        ports[wire.port] = Some(items.into());
        Ok(())
    }
}

/// Runs the graph as [`crate::run()`] does, with `inputs` in place of what their nodes would give, and returns the items
/// of the wires that `keeps` names. A run with inputs writes no recording, as a replay would not have them.
///
/// An output without inputs, of a node of which another has some, and one that is left out carry empties, and the results lack it.
///
/// # Errors
/// As [`crate::run()`]; [`RunError::Inject`] if a node needs what such an output would give.
pub fn run_with_inputs(
    plan: &Plan,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
    inputs: WireInputs,
    keeps: &(dyn Fn(&str) -> bool + Sync),
) -> Result<(RunReport, BTreeMap<String, Vec<Item>>), RunError> {
    let is_played: Vec<bool> = (0..plan.nodes.len()).map(|node| inputs.ports.contains_key(&node)).collect();
    let parts: Vec<_> = is_played.iter().map(|is| if *is { NodeMode::Played } else { NodeMode::Computed }).collect();
    let mut reduced = reduce_in_memory(plan, &parts);
    let reads = |file: &PathBuf| {
        let of = |played: bool| {
            plan.nodes.iter().zip(&is_played).any(|(node, is)| *is == played && node.files.contains(file))
        };
        of(false) || !of(true)
    };
    reduced.input_files.retain(reads);
    let mut replayed = Replayed::default();
    let mut without = inputs.without;
    for (node, ports) in inputs.ports {
        let missing: Vec<_> = plan.outputs(node).filter(|id| ports[id.port].is_none()).collect();
        let longest = ports.iter().flatten().max_by_key(|items| items.len());
        let empties: VecDeque<Item> = longest.into_iter().flatten().map(|item| not_given(plan, node, item)).collect();
        // An input that is taken once has no value where its wire ends without one.
        let is_stream = |id: OutputId| {
            reduced.consumers(id).any(|link| reduced.nodes[link.to_node].inputs[link.to_port].port.join != Join::Once)
        };
        let items = |port: usize, items: Option<VecDeque<Item>>| {
            items.unwrap_or_else(|| if is_stream(OutputId { node, port }) { empties.clone() } else { VecDeque::new() })
        };
        let ports = ports.into_iter().enumerate().map(|(port, given)| items(port, given)).collect();
        replayed.substitutes.insert(node, Box::new(Player { ports, failure: None, pace: None }));
        without.extend(missing);
    }
    for id in without {
        let needs = |link: &&Link| !reduced.nodes[link.to_node].inputs[link.to_port].port.optional;
        if let Some(link) = reduced.consumers(id).find(needs) {
            let (wire, node) = (plan.wire_name(id), &reduced.nodes[link.to_node].name);
            let message = format!(
                "wire \"{wire}\" is in use by node \"{node}\", but only other outputs of its node are given; give it, too"
            );
            return Err(RunError::Inject(message));
        }
        reduced.results.iter_mut().filter(|entry| entry.from == id).for_each(|entry| entry.optional = true);
    }
    let record = options.record && replayed.substitutes.is_empty();
    let options = RunOptions { record, ..options.clone() };
    let kept =
        Kept(reduced.all_outputs().filter(|id| keeps(&plan.wire_name(*id))).map(|id| (id, Mutex::default())).collect());
    let report = run_with(&reduced, registry, &options, observer, replayed, Some(&kept))?;
    let items = |items: Mutex<Vec<Item>>| items.into_inner().unwrap_or_else(PoisonError::into_inner);
    Ok((report, kept.0.into_iter().map(|(id, kept)| (plan.wire_name(id), items(kept))).collect()))
}

/// The empty in place of an item that is not given.
fn not_given(plan: &Plan, node: usize, item: &Item) -> Item {
    let empty = Empty { node: plan.nodes[node].name.to_string(), reason: "it was not given".into() };
    Item { number: item.number, stamp_ns: item.stamp_ns, body: Body::Empty(empty.into()) }
}

/// Tap that keeps the items of some wires.
struct Kept(BTreeMap<OutputId, Mutex<Vec<Item>>>);

impl Tap for Kept {
    fn listens(&self, wire: OutputId) -> bool {
        self.0.contains_key(&wire)
    }

    fn item(&self, wire: OutputId, item: &Item) {
        if let Some(items) = self.0.get(&wire) {
            items.lock().unwrap_or_else(PoisonError::into_inner).push(item.clone());
        }
    }
}
