//! Joins that never fire, or fire only once on a stream, as far as roles and descriptions prove it.

use super::{
    inputs::Input,
    parsed_nodes::ParsedNode,
    wires::{self, OutputIndex},
};
use crate::fault::{Fault, Span};
use osteoflow_node::{Join, Role};

/// Number of items that an output gives.
#[derive(Clone, Copy, PartialEq)]
enum Count {
    /// At most one, whatever the inputs give.
    One,
    /// More than one, as far as is known.
    Stream,
    Unknown,
}

/// Properties known of a node's outputs.
#[derive(Clone, Copy)]
struct Flow {
    count: Count,
    /// Whether every item has stamp 0, because it is derived from constants only; then there is at most one.
    timeless: bool,
    /// Whether every item has a time of its own.
    timed: bool,
}

const UNKNOWN: Flow = Flow { count: Count::Unknown, timeless: false, timed: false };

/// The faults, most of them warnings, in topological order of the nodes.
pub(super) fn faults(parsed_nodes: &[ParsedNode<'_>], inputs: &[Vec<Input>], order: &[usize]) -> Vec<Fault> {
    let mut flows = vec![UNKNOWN; parsed_nodes.len()];
    let mut faults = Vec::new();
    for &node in order {
        let node_of = Node { parsed_node: &parsed_nodes[node], inputs: &inputs[node], flows: &flows, parsed_nodes };
        if parsed_nodes[node].role() == Some(Role::Node) {
            faults.extend(node_of.warnings());
            faults.extend(node_of.without_a_time());
        }
        flows[node] = node_of.flow();
    }
    faults
}

/// A wire to an input.
#[derive(Clone, Copy)]
struct Fed<'a> {
    input: &'a Input,
    wire: OutputIndex,
    at: &'a Span,
    flow: Flow,
}

struct Node<'a, 'd> {
    parsed_node: &'a ParsedNode<'d>,
    inputs: &'a [Input],
    flows: &'a [Flow],
    parsed_nodes: &'a [ParsedNode<'d>],
}

impl<'a> Node<'a, '_> {
    /// The wires to inputs that are in use.
    fn wired(&self) -> impl Iterator<Item = Fed<'a>> {
        let flow = |(node, port): OutputIndex| {
            let output = self.parsed_nodes[node].outputs.as_ref().map(|outputs| &outputs[port]);
            let flow = self.flows[node];
            Flow { timed: flow.timed || output.is_some_and(|output| output.is_timed), ..flow }
        };
        let used = self.inputs.iter().filter(|input| !input.port.unused);
        used.flat_map(move |input| input.known_wires().map(move |(wire, at)| Fed { input, wire, at, flow: flow(wire) }))
    }

    fn triggers(&self) -> impl Iterator<Item = Fed<'a>> {
        self.wired().filter(|fed| fed.input.port.join.triggers())
    }

    fn flow(&self) -> Flow {
        match self.parsed_node.role() {
            // With several outputs, some may give a single item; the only output of a live source is a stream.
            Some(Role::LiveSource) if self.has_one_output_of_its_own() => {
                return Flow { count: Count::Stream, ..UNKNOWN };
            }
            Some(Role::Source) if self.parsed_node.kind.is_some_and(|kind| kind.description.constant) => {
                return Flow { count: Count::One, timeless: true, timed: false };
            }
            Some(Role::Node) => {}
            _ => return UNKNOWN,
        }
        // Inputs fed from outside a module, and faulty ones, may carry anything.
        if self.inputs.iter().flat_map(|input| &input.wires).any(|wire| wire.from.is_none()) {
            return UNKNOWN;
        }
        let fires: Vec<_> = self.triggers().collect();
        if fires.is_empty() {
            return Flow { count: Count::One, timeless: self.wired().all(|fed| fed.flow.timeless), timed: false };
        }
        // An optional port that has ended is ignored, so only the other ports limit how often the node fires.
        let bounds = |fed: &Fed<'_>| fed.input.port.join == Join::Collect { n: None } || fed.flow.count == Count::One;
        let one = fires.iter().any(|fed| !fed.input.port.optional && bounds(fed)) || fires.iter().all(bounds);
        let each_of_a_stream = |fed: &Fed<'_>| fed.input.port.join == Join::Each && fed.flow.count == Count::Stream;
        let count = match one {
            true => Count::One,
            false if fires.iter().all(each_of_a_stream) => Count::Stream,
            false => Count::Unknown,
        };
        let of_all = |is: fn(&Flow) -> bool| fires.iter().all(|fed| is(&fed.flow));
        Flow { count, timeless: of_all(|flow| flow.timeless), timed: of_all(|flow| flow.timed) }
    }

    fn has_one_output_of_its_own(&self) -> bool {
        self.parsed_node.kind.is_some_and(|kind| kind.description.outputs.fixed().len() == 1)
    }

    /// Inputs that are looked up at the time of a firing, which has none.
    fn without_a_time(&self) -> Vec<Fault> {
        let triggers: Vec<_> = self.triggers().collect();
        let Some(trigger) = triggers.first().filter(|_| triggers.iter().all(|fed| fed.flow.timeless)) else {
            return Vec::new();
        };
        let is_looked_up = |fed: &Fed<'_>| {
            matches!(fed.input.port.join, Join::Interpolate { .. } | Join::Latest) && !fed.input.port.optional
        };
        let fault = |Fed { input, wire, at, .. }: Fed<'_>| {
            let [wire, constant] = [wire, trigger.wire].map(|wire| wires::name(wire, self.parsed_nodes));
            let (node, port) = (self.parsed_node.name, input.port.name);
            let what = format!(
                "node \"{node}\": input \"{port}\" takes \"{wire}\" at the time of \"{constant}\", which has none"
            );
            Fault::new(what)
                .at(at, "each item has a time")
                .also(trigger.at, "a constant, at stamp 0")
                .note("the node never has a result: no item is as old as stamp 0")
                .help(format!("give the node the item of a source that states times, or wire a constant to {port}"))
        };
        self.wired().filter(|fed| fed.flow.timed && is_looked_up(fed)).map(fault).collect()
    }

    fn warnings(&self) -> Vec<Fault> {
        // Its stamps follow a clock, so they are not all 0.
        let stream = self.triggers().find(|fed| fed.flow.count == Count::Stream);
        let mut faults = Vec::new();
        for Fed { input, wire, at, flow } in self.wired() {
            let (wire, port) = (wires::name(wire, self.parsed_nodes), input.port.name);
            let warn = |what: String| Fault::new(format!("node \"{}\": {what}", self.parsed_node.name)).warning();
            let never = if input.port.optional { "it never has a value" } else { "the node never has a result" };
            faults.extend(match input.port.join {
                Join::Once if flow.count == Count::Stream => Some(
                    warn(format!("input \"{port}\" takes one item for the whole run, but \"{wire}\" is a stream"))
                        .at(at, "gives more than one item")
                        .note("a second item on an input that joins by once fails the run")
                        .help("write join = \"latest\" for the newest, or join = \"each\" to go in step"),
                ),
                Join::Collect { n: Some(n) } | Join::CollectEvery { n, .. } if n > 1 && flow.count == Count::One => {
                    Some(
                        warn(format!("input \"{port}\" collects {n} items, but \"{wire}\" gives one"))
                            .at(at, format!("{n} never come"))
                            .note(format!("{never}: 1 of {n} items came before the end"))
                            .help("write n = 1, or take n away to collect all until the end"),
                    )
                }
                Join::Each if flow.count == Count::One && !input.port.optional => stream.map(|other| {
                    let other_wire = wires::name(other.wire, self.parsed_nodes);
                    let fault =
                        warn(format!("fires once: input \"{port}\" takes each item of \"{wire}\", which gives one"));
                    let fault = fault.at(at, "one item");
                    let fault = fault.also(other.at, "a stream, of which the rest has no partner");
                    let note = format!(
                        "inputs that join by each go in step, so all but one of \"{other_wire}\" are left over"
                    );
                    fault
                        .note(note)
                        .help(format!("write join = \"once\" for {port}: a constant is there at every firing"))
                }),
                Join::Stamp { .. } if flow.timeless => stream.map(|_| {
                    warn(format!("input \"{port}\" joins by stamp, but \"{wire}\" is a constant without a time"))
                        .at(at, "its stamp is 0")
                        .note(format!("{never}: no item of a stream that follows a clock has that stamp"))
                        .help("write join = \"once\": a constant is there at every firing")
                }),
                Join::Interpolate { .. } if flow.timeless => stream.map(|_| {
                    warn(format!("input \"{port}\" joins by interpolate, but \"{wire}\" is a constant without a time"))
                        .at(at, "one sample, at stamp 0")
                        .note(format!("{never}: a constant has no neighbours to read between"))
                        .help("write join = \"once\": a constant is there at every firing")
                }),
                _ => None,
            });
        }
        faults
    }
}
