use super::{
    frames::Frames,
    inputs::Input,
    parsed_nodes::ParsedNode,
    record::Record,
    resolved,
    results::{Result, Results},
    wires::OutputIndex,
};
use crate::{
    graph::{Table, Value, header::Header},
    hash::Digest,
    plan::{Link, Location, OutputId, Plan, PlanInput, PlanNode, PlanOutput, PlanPlugin, ResultEntry},
    plugin::Known,
};
use osteoflow_node::Role;
use serde_json::json;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    sync::Arc,
};

/// A graph without faults, resolved and ready to be planned.
pub(super) struct Net<'a> {
    pub(super) header: Header,
    pub(super) plugins: Vec<PlanPlugin>,
    pub(super) parsed_nodes: Vec<ParsedNode<'a>>,
    pub(super) inputs: Vec<Vec<Input>>,
    /// In topological order.
    pub(super) order: Vec<usize>,
    pub(super) frames: Frames,
    pub(super) record: Record,
    pub(super) results: Results,
}

/// The plugins that the graph names, and other plugins whose kinds it uses.
pub(super) fn plugins(known: &Known, parsed_nodes: &[ParsedNode<'_>]) -> Vec<PlanPlugin> {
    let used = known.plugins.iter().filter_map(|plugin| {
        let of_plugin = parsed_nodes.iter().filter_map(|parsed_node| parsed_node.kind);
        let of_plugin = of_plugin.filter(|kind| kind.plugin.as_ref() == Some(&plugin.identity));
        let kinds: BTreeSet<_> = of_plugin.map(|kind| kind.description.kind.to_owned()).collect();
        (plugin.named || !kinds.is_empty()).then(|| {
            let mut plugin_in_plan = plugin.in_plan(kinds.into_iter().collect());
            let named = parsed_nodes
                .iter()
                .filter(|node| node.kind.is_some_and(|kind| kind.plugin.as_ref() == Some(&plugin.identity)));
            named.for_each(|node| {
                plugin_in_plan.loads.add_environment(node.env.iter().map(|(_, entry)| entry.as_str()))
            });
            plugin_in_plan
        })
    });
    used.collect()
}

/// What identifies the code of a node: its plugin, with the environment variables that the node names.
fn identity(plugin: &Arc<str>, node: &ParsedNode<'_>) -> Arc<str> {
    if node.env.is_empty() {
        return plugin.clone();
    }
    let environment: Vec<_> = node.env.iter().map(|(_, entry)| entry).collect();
    Digest::of_json(&json!([plugin.as_ref(), environment])).to_string().into()
}

/// Where each entry of the table, and of the tables in it, is set.
fn param_places(table: &Table) -> BTreeMap<String, Location> {
    let mut places = BTreeMap::new();
    let mut open = vec![(String::new(), table)];
    while let Some((prefix, table)) = open.pop() {
        for entry in &table.0 {
            let path = format!("{prefix}{}", entry.key);
            if let Value::Table(inner) = &entry.value.value {
                open.push((format!("{path}."), inner));
            }
            places.insert(path, entry.value.at.location());
        }
    }
    places
}

impl Net<'_> {
    pub(super) fn plan(&self, path: &Path) -> Plan {
        let mut place = vec![0; self.order.len()];
        for (index, &parsed_node) in self.order.iter().enumerate() {
            place[parsed_node] = index;
        }
        let id = |(node, port): OutputIndex| OutputId { node: place[node], port };
        let mut nodes: Vec<_> = self.order.iter().map(|&parsed_node| self.node(parsed_node)).collect();
        let mut links = Vec::new();
        for (to_node, &parsed_node) in self.order.iter().enumerate() {
            for (to_port, input) in self.inputs[parsed_node].iter().enumerate() {
                let Input { capacity, max_bytes, policy, .. } = *input;
                for from in input.known_wires().map(|(wire, _)| id(wire)) {
                    nodes[from.node].outputs[from.port].links.push(links.len());
                    nodes[to_node].inputs[to_port].links.push(links.len());
                    links.push(Link { from, to_node, to_port, capacity, max_bytes, policy });
                }
            }
        }
        let mut record: Vec<_> = self.record.wires.iter().map(|&wire| id(wire)).collect();
        record.sort_unstable();
        let result = |result: &Result| ResultEntry {
            key: result.key.clone(),
            from: id(result.from),
            all: result.all,
            optional: result.optional,
            location: result.key_at.location(),
        };
        let files = self.parsed_nodes.iter().flat_map(|node| node.input_files.iter().chain(&node.further_files));
        let mut input_files: Vec<_> = files.cloned().collect();
        input_files.sort();
        input_files.dedup();
        Plan {
            name: self.header.name.clone(),
            seed: self.header.seed,
            path: path.into(),
            nodes,
            links,
            record,
            recording: self.record.settings,
            results: self.results.entries.iter().map(result).collect(),
            require: self.results.require,
            input_files,
            plugins: self.plugins.clone(),
            frames: self.header.frames.iter().flat_map(|(names, _)| names.clone()).collect(),
            resolved: resolved::text(self),
        }
    }

    fn node(&self, index: usize) -> PlanNode {
        let parsed_node = &self.parsed_nodes[index];
        let outputs = parsed_node.outputs.iter().flatten().zip(&self.frames[index]);
        let output = |(output, frames): (&super::parsed_nodes::Output, &crate::plan::PortFrames)| {
            Some(PlanOutput {
                name: output.name.clone(),
                payload: output.payload?,
                frames: frames.clone(),
                links: Vec::new(),
            })
        };
        PlanNode {
            name: parsed_node.name.into(),
            kind: parsed_node.kind_name().into(),
            role: parsed_node.role().unwrap_or(Role::Node),
            location: parsed_node.reported_at().location(),
            plugin: parsed_node.kind.and_then(|kind| kind.plugin.as_ref()).map(|plugin| identity(plugin, parsed_node)),
            params: parsed_node.params.clone(),
            param_places: param_places(parsed_node.table),
            files: parsed_node.input_files.clone(),
            declared: parsed_node.declared.clone().into(),
            inputs: self.inputs[index]
                .iter()
                .map(|i| PlanInput { port: i.port.clone(), links: Vec::new(), contract: i.contract })
                .collect(),
            outputs: outputs.filter_map(output).collect(),
            on_error: parsed_node.on_error,
            place: parsed_node.place,
            deadline: parsed_node.deadline,
        }
    }
}

#[cfg(test)]
mod tests;
