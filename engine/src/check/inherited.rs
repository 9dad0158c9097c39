//! Inherited wires from what a graph has removed or replaced.

use super::{context::Check, inputs::from_of, parsed_nodes::ParsedNode, schema::first_paragraph, wires::Names};
use crate::{
    fault::{Fault, Span},
    graph::{Entry, Graph, Table, Value},
};
use osteoflow_node::InputPort;

/// A wire of an extended file whose producer is gone in the graph that extends it.
struct Lost<'a> {
    wire: &'a str,
    at: &'a Span,
    /// What is gone, and where the graph says so.
    why: String,
    by: Span,
}

impl<'a> Lost<'a> {
    /// `None` if the producer is there, or if the wire is written by whoever removed or replaced it, or over that.
    fn of(entry: &'a Entry, parsed_nodes: &[ParsedNode<'_>], names: &Names) -> Option<Self> {
        let from = from_of(entry);
        let wire = from.as_text()?;
        let (node, port) = wire.rsplit_once('.').filter(|(node, _)| names.module(node).is_none())?;
        let (why, by) = match parsed_nodes.iter().find(|parsed| parsed.name == node) {
            None => (format!("node \"{node}\" is gone"), names.removed.at(&format!("node.{node}"))?),
            Some(producer) if producer.outputs.as_ref()?.iter().any(|output| output.name == port) => return None,
            Some(producer) => {
                let removed = names.removed.at(&format!("node.{node}.out.{port}"));
                let by = removed.or_else(|| Some(&producer.table.get("kind")?.value.at))?;
                (format!("{} has no output \"{port}\"", producer.kind_name()), by)
            }
        };
        by.source.is_over(&from.at.source).then(|| Self { wire, at: &from.at, why, by: by.clone() })
    }

    /// The fault that `what` has no producer; whatever is left out for it is a warning.
    fn fault(&self, what: &str, lost: Option<String>, path: &str) -> Fault {
        let Self { wire, at, why, by } = self;
        let message = format!("{what}: it is wired to \"{wire}\" in {}, but {why}", at.source.name.display());
        let fault = Fault::new(message).at(at, "inherited").also(by, "gone by this").note_if(lost);
        fault.help(format!("wire another producer to it, or write remove = [\"{path}\"]"))
    }
}

impl Check<'_> {
    /// Whether an inherited wire to an optional input is left out since its producer is gone, with a warning if so.
    pub(super) fn is_left_out(
        &mut self,
        parsed_node: &ParsedNode<'_>,
        entry: &Entry,
        port: &InputPort,
        parsed_nodes: &[ParsedNode<'_>],
    ) -> bool {
        let Some(lost) = Lost::of(entry, parsed_nodes, &self.names).filter(|_| port.optional) else { return false };
        let what = format!("node \"{}\": input \"{}\" is left unwired", parsed_node.name, port.name);
        let path = format!("node.{}.in.{}", parsed_node.name, port.name);
        let without = first_paragraph(port.doc);
        let without = (!without.is_empty()).then(|| format!("the run is without {}: {without}", port.name));
        self.faults.push(lost.fault(&what, without, &path).warning());
        true
    }

    /// The fault of an inherited result whose producer is gone. It is never left out by itself: a table would lack its column.
    pub(super) fn lost_result(&self, entry: &Entry, parsed_nodes: &[ParsedNode<'_>]) -> Option<Fault> {
        let lost = Lost::of(entry, parsed_nodes, &self.names)?;
        Some(lost.fault(&format!("result \"{}\" is gone", entry.key), None, &format!("results.{}", entry.key)))
    }

    /// Leaves out inherited nodes that a removed or replaced producer no longer feeds, if nothing takes what they give but inherited wires to
    /// optional inputs; a warning names each.
    pub(super) fn without_unfed<'a>(
        &mut self,
        mut parsed_nodes: Vec<ParsedNode<'a>>,
        graph: &Graph,
    ) -> Vec<ParsedNode<'a>> {
        while let Some((index, fault, by)) = self.unfed(&parsed_nodes, graph) {
            let node = parsed_nodes.remove(index);
            self.names.removed.leave_out(&format!("node.{}", node.name), &by);
            self.faults.push(fault);
        }
        parsed_nodes
    }

    /// The first such node, its warning, and what removed or replaced the producer.
    fn unfed(&self, parsed_nodes: &[ParsedNode<'_>], graph: &Graph) -> Option<(usize, Fault, Span)> {
        parsed_nodes.iter().enumerate().find_map(|(index, node)| {
            let lost = inputs(node)
                .find_map(|(entry, port)| Lost::of(entry, parsed_nodes, &self.names).filter(|_| !port.optional))?;
            let takers: Vec<_> = parsed_nodes.iter().flat_map(|taker| takes(taker, node.name)).collect();
            let is_spare = takers.iter().all(|(_, at, is_optional)| *is_optional && lost.by.source.is_over(&at.source));
            // A node without outputs is there for what it does.
            let gives = node.outputs.as_ref().is_some_and(|outputs| !outputs.is_empty());
            let is_named = ["results", "record"]
                .iter()
                .any(|key| graph.table.get(key).is_some_and(|entry| names_node(&entry.value.value, node.name)));
            (is_spare && gives && !is_named).then(|| {
                let fed: Vec<_> = takers.iter().map(|(input, ..)| input.as_str()).collect();
                let fed = (!fed.is_empty()).then(|| format!("the run is without what it gives to {}", fed.join(", ")));
                let what = format!("node \"{}\" is left out", node.name);
                let by = lost.by.clone();
                (index, lost.fault(&what, fed, &format!("node.{}", node.name)).warning(), by)
            })
        })
    }
}

/// The inputs that a node's table wires, with their ports.
fn inputs<'a>(node: &'a ParsedNode<'_>) -> impl Iterator<Item = (&'a Entry, &'a InputPort)> {
    let table = node.table.get("in").and_then(|entry| entry.value.as_table());
    let ports = node.kind.map_or(&[] as &[InputPort], |kind| &kind.description.inputs);
    let entries = table.into_iter().flat_map(|table| &table.0);
    entries.filter_map(|entry| Some((entry, ports.iter().find(|port| port.name == entry.key)?)))
}

/// The inputs of `taker` that are wired to `node`: name, place of the wire, and whether the input is optional and the wire is one alone.
fn takes<'a>(taker: &'a ParsedNode<'_>, node: &str) -> Vec<(String, &'a Span, bool)> {
    let table: Option<&Table> = taker.table.get("in").and_then(|entry| entry.value.as_table());
    let entries = table.into_iter().flat_map(|table| &table.0);
    let wired = entries.filter(|entry| names_node(&from_of(entry).value, node));
    let is_optional = |entry: &Entry| {
        let port = inputs(taker).find(|(other, _)| other.key == entry.key);
        from_of(entry).as_text().is_some() && port.is_some_and(|(_, port)| port.optional)
    };
    wired.map(|entry| (format!("{}.{}", taker.name, entry.key), &from_of(entry).at, is_optional(entry))).collect()
}

/// Whether a value names an output of a node.
fn names_node(value: &Value, node: &str) -> bool {
    match value {
        Value::Text(text) => text.rsplit_once('.').is_some_and(|(named, _)| named == node),
        Value::Array(items) => items.iter().any(|item| names_node(&item.value, node)),
        Value::Table(table) => table.0.iter().any(|entry| names_node(&entry.value.value, node)),
        _ => false,
    }
}
