use super::{
    DEFAULT_CAPACITY, DEFAULT_MAX_BYTES,
    context::Check,
    missing_trigger,
    parsed_nodes::{Output, ParsedNode},
    producers::ProducerSearch,
    schema::first_paragraph,
    wires::{self, OutputIndex},
};
use crate::{
    fault::{Fault, Span},
    graph::{Entry, Value, extract, header::Header},
    names::nearest,
    plan::Policy,
};
use osteoflow_node::{InputPort, PortPayload};

/// An input as the graph wires it.
pub(super) struct Input {
    /// The port, with the join that the graph chose.
    pub(super) port: InputPort,
    /// Where it is wired; `None` if it is not wired.
    pub(super) at: Option<Span>,
    /// The output it is wired to; `None` if the wire has a fault.
    pub(super) from: Option<OutputIndex>,
    /// The input of the module that feeds it, if a module is checked alone.
    pub(super) outside: Option<String>,
    pub(super) capacity: usize,
    pub(super) max_bytes: u64,
    pub(super) policy: Policy,
}

impl Check<'_> {
    /// The inputs of each parsed node, in the order of its kind's ports.
    pub(super) fn inputs(&mut self, parsed_nodes: &[ParsedNode<'_>], header: &Header) -> Vec<Vec<Input>> {
        let inputs: Vec<_> =
            parsed_nodes.iter().map(|parsed_node| self.node_inputs(parsed_node, parsed_nodes, header)).collect();
        for (index, parsed_node) in parsed_nodes.iter().enumerate() {
            let missing: Vec<_> = inputs[index].iter().filter(|i| i.at.is_none() && !i.port.optional).collect();
            for input in &missing {
                let feed = ProducerSearch {
                    parsed_nodes,
                    inputs: &inputs,
                    registry: &self.known.registry,
                    removed: &self.names.removed,
                };
                self.faults.push(feed.missing(index, &input.port));
            }
            if missing.is_empty() {
                self.faults.extend(missing_trigger::fault(parsed_node, &inputs[index]));
            }
        }
        inputs
    }

    fn node_inputs(
        &mut self,
        parsed_node: &ParsedNode<'_>,
        parsed_nodes: &[ParsedNode<'_>],
        header: &Header,
    ) -> Vec<Input> {
        let ports = parsed_node.kind.map_or(&[] as &[InputPort], |kind| &kind.description.inputs);
        let blank = |port: &InputPort| Input {
            port: port.clone(),
            at: None,
            from: None,
            outside: None,
            capacity: DEFAULT_CAPACITY,
            max_bytes: DEFAULT_MAX_BYTES,
            policy: Policy::Block,
        };
        let mut inputs: Vec<_> = ports.iter().map(blank).collect();
        let Some(table) = parsed_node.table.get("in") else { return inputs };
        let Some(table) = extract::table(&table.value, &format!("node \"{}\": in", parsed_node.name), &mut self.faults)
        else {
            // The kind is unknown, so no input can be missing.
            return Vec::new();
        };
        for entry in &table.0 {
            let owner = format!("node \"{}\": input \"{}\"", parsed_node.name, entry.key);
            let index = inputs.iter().position(|input| input.port.name == entry.key);
            let outside = outside(entry);
            let (from, from_at) = match outside.is_none().then(|| self.from(entry, &owner)).flatten() {
                Some((text, at)) => (wires::find(text, at, &owner, parsed_nodes, &self.names, &mut self.faults), at),
                None => (None, &entry.value.at),
            };
            match index {
                Some(index) => {
                    let input = &mut inputs[index];
                    (input.from, input.at, input.outside) = (from, Some(from_at.clone()), outside);
                    self.fits(input, &owner, parsed_nodes);
                    self.options(input, entry, &owner, parsed_nodes, header);
                }
                None if parsed_node.kind.is_some() => {
                    self.faults.push(no_port(parsed_node, entry, table.keys()));
                    let names = ports.iter().map(|port| port.name).filter(|name| table.get(name).is_none());
                    let meant = nearest::name(&entry.key, names);
                    // An input with a misspelt name is not reported as missing too.
                    if let Some(input) = inputs.iter_mut().find(|input| Some(input.port.name) == meant) {
                        input.at = Some(from_at.clone());
                    }
                }
                None => {}
            }
        }
        inputs
    }

    /// The name of the producer's output.
    fn from<'a>(&mut self, entry: &'a Entry, owner: &str) -> Option<(&'a str, &'a Span)> {
        if let Value::Array(items) = &entry.value.value {
            let fault = Fault::new(format!("{owner} is given {} producers", items.len()));
            let fault = fault.at(&entry.value.at, "one is needed");
            let help = "an input has one producer; let a node of its own bring several wires together";
            self.faults.push(fault.help(help));
            return None;
        }
        wires::named(entry, owner, "producer", &mut self.faults)
    }

    /// Checks that the producer gives what the port takes.
    fn fits(&mut self, input: &Input, owner: &str, parsed_nodes: &[ParsedNode<'_>]) {
        let (Some(wire), Some(at)) = (input.from, &input.at) else { return };
        let Some(output) = output(wire, parsed_nodes) else { return };
        let Some(gives) = output.payload else { return };
        if fits(&input.port.payload, &gives) {
            return;
        }
        let (takes, gives) = (input.port.payload.name(), gives.name());
        let message = format!("{owner} takes {takes}, but \"{}\" gives {gives}", wires::name(wire, parsed_nodes));
        let fault = Fault::new(message).at(at, format!("gives {gives}"));
        let help = ProducerSearch::others(&input.port.payload, wire.0, parsed_nodes);
        self.faults.push(fault.note_if(doc_of(&input.port)).help_if(help));
    }
}

/// The module's input that feeds the port, where a module is checked alone.
fn outside(entry: &Entry) -> Option<String> {
    let from = match &entry.value.value {
        Value::Table(table) => &table.get("from")?.value.value,
        value => value,
    };
    match from {
        Value::Outside(name) => Some(name.clone()),
        _ => None,
    }
}

/// The output of a wire.
pub(super) fn output<'d>((node, port): OutputIndex, parsed_nodes: &'d [ParsedNode<'_>]) -> Option<&'d Output> {
    parsed_nodes[node].outputs.as_ref()?.get(port)
}

/// Whether a port takes the payload of an output. Types known only at run time are accepted.
pub(super) fn fits(takes: &PortPayload, gives: &PortPayload) -> bool {
    takes == gives || matches!(takes, PortPayload::Any) || matches!(gives, PortPayload::Any)
}

/// Describes a port: `source: its doc`.
pub(super) fn doc_of(port: &InputPort) -> Option<String> {
    let text = first_paragraph(port.doc);
    (!text.is_empty()).then(|| format!("{}: {text}", port.name))
}

fn no_port<'a>(parsed_node: &ParsedNode<'_>, entry: &Entry, given: impl Iterator<Item = &'a str>) -> Fault {
    let kind = parsed_node.kind_name();
    let fault = Fault::new(format!("node \"{}\": {kind} has no input \"{}\"", parsed_node.name, entry.key));
    let fault = fault.at(&entry.key_at, "unknown");
    if parsed_node.is_source() {
        return fault.help("it is a source: take in away");
    }
    let names = || parsed_node.kind.into_iter().flat_map(|kind| kind.description.inputs.iter().map(|port| port.name));
    let given: Vec<_> = given.collect();
    let help = nearest::help(&entry.key, names().filter(|name| !given.contains(name)));
    let help = help.or_else(|| nearest::help(&entry.key, names()));
    fault.help_if(help).note_if(nearest::list("its inputs", names()))
}
