use super::{
    inputs::{Input, doc_of, fits},
    parsed_nodes::ParsedNode,
};
use crate::{fault::Fault, graph::Removed};
use osteoflow_node::{FrameExpr, InputPort, PortPayload, Registry};

const LIST: usize = 8;

/// Finds outputs that could feed an input.
pub(super) struct ProducerSearch<'a, 'd> {
    pub(super) parsed_nodes: &'a [ParsedNode<'d>],
    pub(super) inputs: &'a [Vec<Input>],
    pub(super) registry: &'a Registry,
    pub(super) removed: &'a Removed,
}

impl ProducerSearch<'_, '_> {
    /// The fault of an input without a producer.
    pub(super) fn missing(&self, node: usize, port: &InputPort) -> Fault {
        let (parsed_node, takes) = (&self.parsed_nodes[node], port.payload.name());
        let message = format!("node \"{}\": input \"{}\" is wired to nothing", parsed_node.name, port.name);
        let fault =
            Fault::new(message).at(parsed_node.inputs_at(), format!("needs {}, which takes {takes}", port.name));
        let behind = self.behind(node);
        let wires = self.ranked(port, &behind);
        let help = match wires.as_slice() {
            [only] => Some(format!("wire {} = {only}", port.name)),
            [_, ..] => Some(format!("wire one of these to it: {}", wires.join(", "))),
            [] => self.kinds(&port.payload).map(|kinds| format!("nothing gives {takes} here; kinds that do: {kinds}")),
        };
        let fault = match self.removed.at(&format!("node.{}.in.{}", parsed_node.name, port.name)) {
            Some(removed) => fault.also(removed, "removed here"),
            None => fault,
        };
        fault.note_if(doc_of(port)).help_if(help).follows()
    }

    /// Lists outputs that fit; those of the same producer if there are any, otherwise those of other nodes.
    pub(super) fn others(takes: &PortPayload, producer: usize, parsed_nodes: &[ParsedNode<'_>]) -> Option<String> {
        let same = wires_of(takes, parsed_nodes, |index| index == producer);
        let wires = if same.is_empty() { wires_of(takes, parsed_nodes, |index| index != producer) } else { same };
        match wires.as_slice() {
            [] => None,
            [only] => Some(format!("{only} gives it")),
            several => Some(format!("these give it: {}", several.join(", "))),
        }
    }

    /// Marks the node and all nodes downstream of it, from which a wire would close a cycle.
    fn behind(&self, node: usize) -> Vec<bool> {
        let mut behind = vec![false; self.parsed_nodes.len()];
        let mut open = vec![node];
        while let Some(index) = open.pop() {
            if std::mem::replace(&mut behind[index], true) {
                continue;
            }
            let fed = |inputs: &Vec<Input>| inputs.iter().any(|input| input.producers().any(|from| from == index));
            open.extend((0..self.parsed_nodes.len()).filter(|&other| fed(&self.inputs[other])));
        }
        behind
    }

    /// Outputs that fit: first those with the port's name, then those with the port's frames.
    fn ranked(&self, port: &InputPort, behind: &[bool]) -> Vec<String> {
        let mut wires: Vec<(u8, String)> = Vec::new();
        for (parsed_node, _) in self.parsed_nodes.iter().zip(behind).filter(|(_, behind)| !**behind) {
            for output in parsed_node.outputs.iter().flatten() {
                if output.payload.is_some_and(|gives| fits(&port.payload, &gives)) {
                    let alike = output.exprs == port.frames && port.frames != FrameExpr::default();
                    let rank = if output.name == port.name { 0 } else { 2 - u8::from(alike) };
                    wires.push((rank, format!("\"{}.{}\"", parsed_node.name, output.name)));
                }
            }
        }
        wires.sort_by_key(|(rank, _)| *rank);
        wires.truncate(LIST);
        wires.into_iter().map(|(_, wire)| wire).collect()
    }

    fn kinds(&self, takes: &PortPayload) -> Option<String> {
        let gives =
            |kind: &&osteoflow_node::Kind| kind.description.outputs.fixed().iter().any(|port| port.payload == *takes);
        let kinds: Vec<_> = self.registry.kinds().filter(gives).map(|kind| kind.description.kind).take(LIST).collect();
        (!kinds.is_empty()).then(|| kinds.join(", "))
    }
}

fn wires_of(takes: &PortPayload, parsed_nodes: &[ParsedNode<'_>], of: impl Fn(usize) -> bool) -> Vec<String> {
    let mut wires = Vec::new();
    for (_, parsed_node) in parsed_nodes.iter().enumerate().filter(|(index, _)| of(*index)) {
        let outputs = parsed_node.outputs.iter().flatten();
        let fitting = outputs.filter(|output| output.payload.is_some_and(|gives| fits(takes, &gives)));
        wires.extend(fitting.map(|output| format!("\"{}.{}\"", parsed_node.name, output.name)));
    }
    wires.truncate(LIST);
    wires
}
