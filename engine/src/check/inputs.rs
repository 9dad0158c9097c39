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
    graph::{Entry, Spanned, Value, extract, header::Header},
    names::nearest,
    plan::{Contract, Policy},
};
use osteoflow_node::{InputPort, Join, PortPayload};

/// An input as the graph wires it.
pub(super) struct Input {
    /// The port, with the join that the graph chose.
    pub(super) port: InputPort,
    /// Its wires, in the order of the graph; several only where it collects.
    pub(super) wires: Vec<Wire>,
    pub(super) capacity: usize,
    pub(super) max_bytes: u64,
    pub(super) policy: Policy,
    pub(super) contract: Contract,
}

/// A wire to an input.
pub(super) struct Wire {
    /// Where it is named.
    pub(super) at: Span,
    /// The output it leads from; `None` if the wire has a fault.
    pub(super) from: Option<OutputIndex>,
    /// The input of the module that feeds it, if a module is checked alone.
    pub(super) outside: Option<String>,
}

impl Input {
    /// The outputs that it is wired to, each with where it is named.
    pub(super) fn known_wires(&self) -> impl Iterator<Item = (OutputIndex, &Span)> {
        self.wires.iter().filter_map(|wire| Some((wire.from?, &wire.at)))
    }

    /// The nodes that feed it.
    pub(super) fn producers(&self) -> impl Iterator<Item = usize> {
        self.wires.iter().filter_map(|wire| wire.from).map(|(node, _)| node)
    }
}

impl Check<'_> {
    /// The inputs of each parsed node, in the order of its kind's ports.
    pub(super) fn inputs(&mut self, parsed_nodes: &[ParsedNode<'_>], header: &Header) -> Vec<Vec<Input>> {
        let inputs: Vec<_> =
            parsed_nodes.iter().map(|parsed_node| self.node_inputs(parsed_node, parsed_nodes, header)).collect();
        for (index, parsed_node) in parsed_nodes.iter().enumerate() {
            let missing: Vec<_> = inputs[index].iter().filter(|i| i.wires.is_empty() && !i.port.optional).collect();
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
            wires: Vec::new(),
            capacity: DEFAULT_CAPACITY,
            max_bytes: DEFAULT_MAX_BYTES,
            policy: Policy::Block,
            contract: Contract::default(),
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
            if index.is_some_and(|index| self.is_left_out(parsed_node, entry, &inputs[index].port, parsed_nodes)) {
                continue;
            }
            let wires = self.wires(entry, &owner, parsed_nodes);
            match index {
                Some(index) => {
                    let input = &mut inputs[index];
                    input.wires = wires;
                    self.options(input, entry, &owner, parsed_nodes, header);
                    self.several(input, entry, &owner, parsed_nodes);
                    self.fits(input, &owner, parsed_nodes);
                    self.previous(input, entry, &owner);
                }
                None if parsed_node.kind.is_some() => {
                    self.faults.push(no_port(parsed_node, entry, table.keys()));
                    let names = ports.iter().map(|port| port.name).filter(|name| table.get(name).is_none());
                    let meant = nearest::name(&entry.key, names);
                    // An input with a misspelt name is not reported as missing too.
                    if let Some(input) = inputs.iter_mut().find(|input| Some(input.port.name) == meant) {
                        input.wires = wires.into_iter().map(|wire| Wire { from: None, ..wire }).collect();
                    }
                }
                None => {}
            }
        }
        inputs
    }

    /// The wires of an input; at least one, which has a fault where none is named.
    fn wires(&mut self, entry: &Entry, owner: &str, parsed_nodes: &[ParsedNode<'_>]) -> Vec<Wire> {
        let from = from_of(entry);
        match &from.value {
            Value::Outside(_) => vec![self.wire(None, from, owner, parsed_nodes)],
            Value::Array(items) if !items.is_empty() => {
                let mut wires = Vec::new();
                for item in items {
                    let text = match &item.value {
                        Value::Outside(_) => None,
                        _ => extract::text(item, &format!("{owner}: from"), &mut self.faults)
                            .map(|text| (text, &item.at)),
                    };
                    wires.push(self.wire(text, item, owner, parsed_nodes));
                }
                wires
            }
            Value::Array(_) => {
                let fault = Fault::new(format!("{owner} is given no producer"));
                self.faults.push(fault.at(&from.at, "an empty list").help("name a wire, or take the input away"));
                vec![self.wire(None, from, owner, parsed_nodes)]
            }
            _ => {
                let text = wires::named(entry, owner, "producer", &mut self.faults);
                vec![self.wire(text, from, owner, parsed_nodes)]
            }
        }
    }

    fn wire(&mut self, text: Option<(&str, &Span)>, here: &Spanned, owner: &str, nodes: &[ParsedNode<'_>]) -> Wire {
        let outside = match &here.value {
            Value::Outside(name) => Some(name.clone()),
            _ => None,
        };
        let from = text.and_then(|(text, at)| wires::find(text, at, owner, nodes, &self.names, &mut self.faults));
        Wire { at: here.at.clone(), from, outside }
    }

    /// Checks that the producers give what the port takes.
    fn fits(&mut self, input: &mut Input, owner: &str, parsed_nodes: &[ParsedNode<'_>]) {
        let mut misfits = Vec::new();
        for (wire, at) in input.known_wires() {
            let Some(output) = output(wire, parsed_nodes) else { continue };
            let Some(gives) = output.payload.filter(|gives| !fits(&input.port.payload, gives)) else { continue };
            let (takes, gives) = (input.port.payload.name(), gives.name());
            let message = format!("{owner} takes {takes}, but \"{}\" gives {gives}", wires::name(wire, parsed_nodes));
            let fault = Fault::new(message).at(at, format!("gives {gives}"));
            let help = ProducerSearch::others(&input.port.payload, wire.0, parsed_nodes);
            self.faults.push(fault.note_if(doc_of(&input.port)).help_if(help));
            misfits.push(wire);
        }
        // What it carries is of another kind, so its frames say nothing more.
        for wire in &mut input.wires {
            wire.from = wire.from.filter(|from| !misfits.contains(from));
        }
    }

    /// Checks that a port with a list of wires collects, and each of them once. One that does not keeps no wire.
    fn several(&mut self, input: &mut Input, entry: &Entry, owner: &str, parsed_nodes: &[ParsedNode<'_>]) {
        let Value::Array(_) = from_of(entry).value else { return };
        if !input.port.join.collects() {
            let fault = Fault::new(format!("{owner} is given {} producers", input.wires.len()));
            let help = "an input has one producer, but for one that collects; let a node of its own bring several wires together";
            self.faults.push(fault.at(&entry.value.at, "one is needed").help(help));
            input.wires.truncate(1);
            input.wires.iter_mut().for_each(|wire| wire.from = None);
        }
        if input.wires.len() < 2 {
            return;
        }
        if let Join::CollectSpan { .. } = input.port.join {
            let fault =
                Fault::new(format!("{owner} takes windows in time of one wire, and is given {}", input.wires.len()));
            let help = "each wire has windows from its own first item on; write n, or let a node of its own bring the wires together";
            self.faults.push(fault.at(&entry.value.at, "several wires").help(help));
        }
        let wires: Vec<_> = input.known_wires().collect();
        for (index, (wire, at)) in wires.iter().enumerate() {
            if let Some((_, first)) = wires[..index].iter().find(|(before, _)| before == wire) {
                let fault = Fault::new(format!("{owner} is given \"{}\" twice", wires::name(*wire, parsed_nodes)));
                let fault = fault.at(at, "the second time").also(first, "the first time");
                self.faults.push(fault.help("take one of them away: every item would come twice"));
            }
        }
    }

    /// Checks that a port which has nothing at the first firing is optional.
    fn previous(&mut self, input: &Input, entry: &Entry, owner: &str) {
        if input.port.join != Join::Previous || input.port.optional || input.port.unused {
            return;
        }
        let fault = Fault::new(format!("{owner} needs an item at every firing, and cannot join by \"previous\""));
        let join = entry.value.as_table().and_then(|table| table.get("join"));
        let at = join.map_or(&entry.value.at, |join| &join.value.at);
        let fault = fault.at(at, "brings nothing to the first firing");
        let help =
            "only an optional input may; let a kind with such an input choose the start, as track.last_pose does";
        self.faults.push(fault.help(help));
    }
}

/// What names the wires of an input: the entry, or `from` of its table.
pub(super) fn from_of(entry: &Entry) -> &Spanned {
    match &entry.value.value {
        Value::Table(table) => table.get("from").map_or(&entry.value, |from| &from.value),
        _ => &entry.value,
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
