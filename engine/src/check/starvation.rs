//! Warnings of joins that never fire, or fire only once on a stream, as far as roles and descriptions prove it.

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
}

/// The warnings, in topological order of the nodes.
pub(super) fn warnings(parsed_nodes: &[ParsedNode<'_>], inputs: &[Vec<Input>], order: &[usize]) -> Vec<Fault> {
    let mut flows = vec![Flow { count: Count::Unknown, timeless: false }; parsed_nodes.len()];
    let mut faults = Vec::new();
    for &node in order {
        let node_of = Node { parsed_node: &parsed_nodes[node], inputs: &inputs[node], flows: &flows, parsed_nodes };
        if parsed_nodes[node].role() == Some(Role::Node) {
            faults.extend(node_of.warnings());
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
        let flows = self.flows;
        let used = self.inputs.iter().filter(|input| !input.port.unused);
        used.flat_map(move |input| {
            input.known_wires().map(move |(wire, at)| Fed { input, wire, at, flow: flows[wire.0] })
        })
    }

    fn triggers(&self) -> impl Iterator<Item = Fed<'a>> {
        self.wired().filter(|fed| fed.input.port.join.triggers())
    }

    fn flow(&self) -> Flow {
        let unknown = Flow { count: Count::Unknown, timeless: false };
        match self.parsed_node.role() {
            // With several outputs, some may give a single item; the only output of a live source is a stream.
            Some(Role::LiveSource) if self.has_one_output_of_its_own() => {
                return Flow { count: Count::Stream, timeless: false };
            }
            Some(Role::Source) if self.parsed_node.kind.is_some_and(|kind| kind.description.constant) => {
                return Flow { count: Count::One, timeless: true };
            }
            Some(Role::Node) => {}
            _ => return unknown,
        }
        // Inputs fed from outside a module, and faulty ones, may carry anything.
        if self.inputs.iter().flat_map(|input| &input.wires).any(|wire| wire.from.is_none()) {
            return unknown;
        }
        let fires: Vec<_> = self.triggers().collect();
        if fires.is_empty() {
            return Flow { count: Count::One, timeless: self.wired().all(|fed| fed.flow.timeless) };
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
        Flow { count, timeless: fires.iter().all(|fed| fed.flow.timeless) }
    }

    fn has_one_output_of_its_own(&self) -> bool {
        self.parsed_node.kind.is_some_and(|kind| kind.description.outputs.fixed().len() == 1)
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
