use super::{
    context::Check,
    parsed_nodes::ParsedNode,
    wires::{self, OutputIndex},
};
use crate::{
    fault::Fault,
    graph::{
        Graph, Module, Value,
        extract::{self, Section},
        grammar,
    },
    names::{glob, nearest},
    plan::{RecordSettings, Sources},
};
use osteoflow_container::Compression;

/// The contents of `[record]`.
pub(super) struct Record {
    /// The wires, in the order of the parsed nodes and their ports.
    pub(super) wires: Vec<OutputIndex>,
    pub(super) settings: RecordSettings,
}

impl Check<'_> {
    /// The wires to record: those of the sources, unless `sources` disables them, and those that match a pattern of
    /// `wires`.
    pub(super) fn record(&mut self, graph: &Graph, parsed_nodes: &[ParsedNode<'_>]) -> Record {
        let mut sources = true;
        let mut settings = RecordSettings::default();
        let mut patterns = Vec::new();
        let table = graph.table.get("record").and_then(|e| extract::table(&e.value, "record", &mut self.faults));
        if let Some(table) = table {
            let table = Section::new(table, &grammar::RECORD, "[record]", "", &mut self.faults);
            if let Some(entry) = table.get("sources") {
                match &entry.value.value {
                    Value::Bool(recorded) => sources = *recorded,
                    Value::Text(text) if text == "hash" => {
                        (sources, settings.sources) = (false, Sources::Hashes);
                    }
                    _ => {
                        let fault =
                            extract::refused(&entry.value, "sources takes true, false or \"hash\"", "not known");
                        let help = "\"hash\" names the files that sources read by SHA-256 and does not copy them";
                        self.faults.push(fault.help(help));
                    }
                }
            }
            if let Some(way) = table.word("compression", &mut self.faults).and_then(Compression::from_name) {
                settings.compression = way;
            }
            settings.views = table.flag("views", &mut self.faults);
            settings.plugins = table.flag("plugins", &mut self.faults);
            if let Some(entry) = table.get("wires") {
                match &entry.value.value {
                    Value::Array(items) => patterns.extend(items),
                    Value::Text(_) => patterns.push(&entry.value),
                    _ => {
                        let takes = "wires takes a list such as [\"icp.*\"]";
                        self.faults.push(extract::refused(&entry.value, takes, "a list is needed"));
                    }
                }
            }
        }
        let mut all: Vec<OutputIndex> = Vec::new();
        for (node, parsed_node) in parsed_nodes.iter().enumerate() {
            all.extend((0..parsed_node.outputs.as_ref().map_or(0, Vec::len)).map(|port| (node, port)));
        }
        // The items of a live source are in no file and cannot be read again.
        let live = |node: usize| {
            settings.sources == Sources::Hashes && parsed_nodes[node].role() == Some(osteoflow_node::Role::LiveSource)
        };
        let mut chosen: Vec<bool> =
            all.iter().map(|(node, _)| live(*node) || (sources && parsed_nodes[*node].is_source())).collect();
        for pattern in patterns {
            let Some(text) = extract::text(pattern, "wires", &mut self.faults) else { continue };
            let mut any = false;
            for (wire, chosen) in all.iter().zip(&mut chosen) {
                if glob::fits(text, &wires::name(*wire, parsed_nodes)) {
                    (any, *chosen) = (true, true);
                }
            }
            // An output of a module is an alias of an inner wire.
            for module in &self.names.modules {
                for (name, _, at) in module.outputs.iter().flatten() {
                    let alias = format!("{}.{name}", module.node);
                    if !glob::fits(text, &alias) {
                        continue;
                    }
                    // Faults of the module's own outputs are reported at the module.
                    let wire = self.names.flat(&alias, at, "", &mut Vec::new());
                    let wire = wire.and_then(|wire| all.iter().position(|w| wires::name(*w, parsed_nodes) == wire));
                    any = true;
                    if let Some(index) = wire {
                        chosen[index] = true;
                    }
                }
            }
            // The node has a fault, so its outputs are unknown.
            let node = text.split('.').next().unwrap_or(text);
            let unknown = parsed_nodes
                .iter()
                .any(|parsed_node| parsed_node.outputs.is_none() && glob::fits(node, parsed_node.name));
            let unknown =
                unknown || self.names.modules.iter().any(|m| m.outputs.is_none() && glob::fits(node, &m.node));
            if !any && !unknown {
                let fault = Fault::new(format!("nothing to record: no wire is called \"{text}\"")).warning();
                let outputs = |m: &Module| -> Vec<String> {
                    m.outputs.iter().flatten().map(|(name, ..)| format!("{}.{name}", m.node)).collect()
                };
                let names = all.iter().map(|wire| wires::name(*wire, parsed_nodes));
                let names: Vec<_> = names.chain(self.names.modules.iter().flat_map(outputs)).collect();
                let of_node = parsed_nodes.iter().any(|parsed_node| parsed_node.name == text)
                    || self.names.module(text).is_some();
                let help = of_node.then(|| format!("write \"{text}.*\" for all outputs of the node"));
                let help = help.or_else(|| nearest::help(text, names.iter().map(String::as_str)));
                let help = help.or_else(|| {
                    let (node, rest) = text.split_once('.')?;
                    let modules = self.names.modules.iter().map(|module| module.node.as_str());
                    let near =
                        nearest::name(node, parsed_nodes.iter().map(|parsed_node| parsed_node.name).chain(modules))?;
                    (near != node).then(|| format!("did you mean \"{near}.{rest}\"?"))
                });
                self.faults.push(fault.at(&pattern.at, "fits no wire").help_if(help).follows());
            }
        }
        let wires = all.into_iter().zip(chosen).filter_map(|(wire, chosen)| chosen.then_some(wire)).collect();
        Record { wires, settings }
    }
}
