//! Runs a graph with items given in memory in place of nodes, and hands on the items of its wires.

use crate::{
    partial::{NodeMode, Player, reduce},
    plan::{OutputId, Plan, Policy},
    run::{RunError, RunOptions, RunReport, run_with},
    runtime::{Observer, Replayed, Tap, names::nearest},
};
use osteoflow_node::{Item, Join, PortPayload, Registry};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Mutex, PoisonError},
};

/// Items that replace those of a node, by wire: `scan.cloud`.
#[derive(Debug, Default)]
pub struct Given {
    ports: BTreeMap<usize, Vec<Option<VecDeque<Item>>>>,
}

/// The output of a plan with the name `node.port`, or `node` if the node has one output.
///
/// # Errors
/// There is none; the message names the most similar one.
pub fn output(plan: &Plan, name: &str) -> Result<OutputId, String> {
    let outputs = |node: usize| (0..plan.nodes[node].outputs.len()).map(move |port| OutputId { node, port });
    let mut all = (0..plan.nodes.len()).flat_map(outputs);
    if let Some(id) = all.clone().find(|id| plan.wire_name(*id) == name) {
        return Ok(id);
    }
    let of_node: Vec<_> = all.clone().filter(|id| *plan.nodes[id.node].name == *name).collect();
    let wires = |ids: &[OutputId]| ids.iter().map(|id| plan.wire_name(*id)).collect::<Vec<_>>().join(", ");
    match of_node[..] {
        [id] => Ok(id),
        [] => {
            let names: Vec<String> = all.by_ref().map(|id| plan.wire_name(id)).collect();
            let names = || names.iter().map(String::as_str);
            let help = nearest::help(name, names()).or_else(|| nearest::list("wires here", names()));
            Err(format!("there is no wire \"{name}\"{}", help.map(|help| format!("; {help}")).unwrap_or_default()))
        }
        _ => Err(format!("node \"{name}\" has several outputs; name one of {}", wires(&of_node))),
    }
}

impl Given {
    /// Whether nothing is given.
    pub fn is_empty(&self) -> bool {
        self.ports.is_empty()
    }

    /// The wires that are given.
    pub fn wires(&self, plan: &Plan) -> Vec<String> {
        let all = self
            .ports
            .iter()
            .flat_map(|(&node, ports)| (0..ports.len()).map(move |port| (OutputId { node, port }, ports)));
        all.filter(|(id, ports)| ports[id.port].is_some()).map(|(id, _)| plan.wire_name(id)).collect()
    }

    /// Adds the items of a wire, in order.
    ///
    /// # Errors
    /// The payload of an item is not that of the wire, or a stamp is before that of its predecessor.
    pub fn add(&mut self, plan: &Plan, wire: OutputId, items: Vec<Item>) -> Result<(), String> {
        let output = &plan.nodes[wire.node].outputs[wire.port];
        let name = || plan.wire_name(wire);
        for item in &items {
            if let (PortPayload::Type(ty), osteoflow_node::Body::Value(value)) = (output.payload, &item.body)
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

/// Runs the graph as [`crate::run()`] does, with `given` items in place of what their nodes would give, and returns the items
/// of the wires that `keeps` names. A run with given items writes no recording, as a replay would not have them.
///
/// # Errors
/// As [`crate::run()`]; [`RunError::Inject`] if only some of a node's outputs that are in use are given.
pub fn run_given(
    plan: &Plan,
    registry: &Registry,
    options: &RunOptions,
    observer: &dyn Observer,
    given: Given,
    keeps: &(dyn Fn(&str) -> bool + Sync),
) -> Result<(RunReport, BTreeMap<String, Vec<Item>>), RunError> {
    let is_given: Vec<bool> = (0..plan.nodes.len()).map(|node| given.ports.contains_key(&node)).collect();
    let parts: Vec<_> = is_given.iter().map(|is| if *is { NodeMode::Played } else { NodeMode::Computed }).collect();
    let mut reduced = reduce(plan, &parts);
    for link in reduced.links.iter_mut().filter(|link| is_given[link.from.node] && link.policy == Policy::Block) {
        // The items are in memory already.
        link.max_bytes = u64::MAX;
    }
    let reads = |file: &std::path::PathBuf| {
        let is_of =
            |given: bool| plan.nodes.iter().zip(&is_given).any(|(node, is)| *is == given && node.files.contains(file));
        is_of(false) || !is_of(true)
    };
    reduced.input_files.retain(reads);
    let mut replayed = Replayed::default();
    for (node, ports) in given.ports {
        // An optional input that is taken once has no value where its wire ends without one.
        let needs = |link: &usize| {
            let link = &reduced.links[*link];
            let input = &reduced.nodes[link.to_node].inputs[link.to_port].port;
            !(input.optional && input.join == Join::Once)
        };
        let in_use = |port: usize| {
            let id = OutputId { node, port };
            reduced.nodes[node].outputs[port].links.iter().any(needs)
                || plan.results.iter().any(|entry| entry.from == id)
        };
        if let Some(port) = (0..ports.len()).find(|&port| ports[port].is_none() && in_use(port)) {
            let wire = plan.wire_name(OutputId { node, port });
            let message =
                format!("wire \"{wire}\" is in use, but only other outputs of its node are given; give it, too");
            return Err(RunError::Inject(message));
        }
        let ports = ports.into_iter().map(Option::unwrap_or_default).collect();
        replayed.substitutes.insert(node, Box::new(Player { ports, failure: None, pace: None }));
    }
    let record = options.record && replayed.substitutes.is_empty();
    let options = RunOptions { record, ..options.clone() };
    let kept = Kept::new(&reduced, keeps);
    let report = run_with(&reduced, registry, &options, observer, replayed, Some(&kept))?;
    let wires = kept
        .0
        .into_iter()
        .map(|(id, items)| (plan.wire_name(id), items.into_inner().unwrap_or_else(PoisonError::into_inner)));
    Ok((report, wires.collect()))
}

/// Tap that keeps the items of some wires.
struct Kept(BTreeMap<OutputId, Mutex<Vec<Item>>>);

impl Kept {
    fn new(plan: &Plan, keeps: &(dyn Fn(&str) -> bool + Sync)) -> Self {
        let outputs = |node: usize| (0..plan.nodes[node].outputs.len()).map(move |port| OutputId { node, port });
        let all = (0..plan.nodes.len()).flat_map(outputs);
        Self(all.filter(|id| keeps(&plan.wire_name(*id))).map(|id| (id, Mutex::default())).collect())
    }
}

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
