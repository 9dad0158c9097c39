//! Inputs that join by `previous`: their wires carry one item for each firing of the node.

use super::{
    context::Check,
    inputs::Input,
    order::Order,
    parsed_nodes::ParsedNode,
    wires::{self, OutputIndex},
};
use crate::{fault::Fault, plan::Policy};
use osteoflow_node::{Join, Role};

/// How often something comes.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Rate {
    /// Once for each item of an output of a source.
    Items(OutputIndex),
    /// Once for each firing of a node that fires at a rate of its own.
    Firings(usize),
    /// Decided outside of the module, or by a wire with a fault.
    Unknown,
}

impl Check<'_> {
    /// Faults of inputs that join by `previous` where the wire may carry more or fewer items than the node fires.
    pub(super) fn feedback(&mut self, parsed_nodes: &[ParsedNode<'_>], inputs: &[Vec<Input>], order: &Order) {
        if !inputs.iter().flatten().any(|input| input.port.join == Join::Previous) {
            return;
        }
        let rates = rates(parsed_nodes, inputs, order);
        for (node, parsed_node) in parsed_nodes.iter().enumerate() {
            let cycle = order.cycles.iter().find(|cycle| cycle.contains(&node));
            // A required input cannot join by previous, which is a fault already.
            let used =
                |input: &&Input| !input.port.unused && (input.port.optional || input.port.join != Join::Previous);
            for input in inputs[node].iter().filter(used) {
                let owner = format!("node \"{}\": input \"{}\"", parsed_node.name, input.port.name);
                let join = input.port.join;
                for (wire, at) in input.known_wires() {
                    let within = cycle.is_some_and(|cycle| cycle.contains(&wire.0));
                    if within && !matches!(join, Join::Each | Join::Previous) {
                        let message = format!("{owner} is part of a cycle, and joins by {}", join.name());
                        let fault = Fault::new(message).at(at, "waits for what comes after it, or leaves items out");
                        let help = "write join = \"each\": in a cycle each node takes each item of the node before it";
                        self.faults.push(fault.help(help));
                    }
                    if within && input.policy != Policy::Block {
                        let fault = Fault::new(format!("{owner} is part of a cycle, and may lose items"));
                        let fault = fault.at(at, "a lost item is known once the next has come, which waits for it");
                        self.faults
                            .push(fault.help("take policy away: in a cycle at most one item waits on each wire"));
                    }
                    let (carries, fires) = (rate_of(wire, parsed_nodes, &rates), rates[node]);
                    if join != Join::Previous || carries == fires || [carries, fires].contains(&Rate::Unknown) {
                        continue;
                    }
                    let wire = wires::name(wire, parsed_nodes);
                    let (carries, fires) = (carries.describe(parsed_nodes), fires.describe(parsed_nodes));
                    let message = format!(
                        "{owner} joins by previous, but \"{wire}\" does not carry one item for each firing of the node"
                    );
                    let fault = Fault::new(message).at(at, format!("carries one for {carries}"));
                    let fault = fault.note(format!("\"{}\" fires once for {fires}", parsed_node.name));
                    let help = "wire what is made from each firing by inputs that join by each, or join by \"latest\" what \
                                is not made from this node";
                    self.faults.push(fault.help(help));
                }
            }
        }
    }
}

impl Rate {
    fn describe(self, parsed_nodes: &[ParsedNode<'_>]) -> String {
        match self {
            Self::Items(wire) => format!("each item of \"{}\"", wires::name(wire, parsed_nodes)),
            Self::Firings(node) => format!("each firing of \"{}\"", parsed_nodes[node].name),
            Self::Unknown => "what is not known here".into(),
        }
    }
}

/// How often each node fires.
pub(super) fn rates(parsed_nodes: &[ParsedNode<'_>], inputs: &[Vec<Input>], order: &Order) -> Vec<Rate> {
    let mut rates = vec![Rate::Unknown; parsed_nodes.len()];
    for &node in &order.nodes {
        if parsed_nodes[node].role() != Some(Role::Node) {
            continue;
        }
        let triggers = || inputs[node].iter().filter(|input| !input.port.unused && input.port.join.triggers());
        let wires: Vec<_> = triggers().flat_map(|input| &input.wires).map(|wire| wire.from).collect();
        let of_wires = wires.iter().map(|wire| wire.map_or(Rate::Unknown, |wire| rate_of(wire, parsed_nodes, &rates)));
        let of_wires: Vec<_> = of_wires.collect();
        let in_step = triggers().all(|input| input.port.join == Join::Each);
        rates[node] = match of_wires.first() {
            Some(_) if of_wires.contains(&Rate::Unknown) => Rate::Unknown,
            Some(first) if in_step && of_wires.iter().all(|rate| rate == first) => *first,
            _ => Rate::Firings(node),
        };
    }
    rates
}

/// How often a wire carries an item: a node answers each firing on every output.
pub(super) fn rate_of(wire: OutputIndex, parsed_nodes: &[ParsedNode<'_>], rates: &[Rate]) -> Rate {
    match parsed_nodes[wire.0].role() {
        Some(Role::Source | Role::LiveSource) => Rate::Items(wire),
        _ => rates[wire.0],
    }
}
