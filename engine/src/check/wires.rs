//! Resolves wire names such as `crop.cloud`.

use super::parsed_nodes::ParsedNode;
use crate::{
    fault::{Fault, Span},
    graph::{Entry, Module, Removed, Value, extract},
    names::nearest,
};

/// Names that a wire may refer to besides the nodes of the plan.
#[derive(Default)]
pub(super) struct Names {
    pub(super) modules: Vec<Module>,
    pub(super) removed: Removed,
}

impl Names {
    pub(super) fn module(&self, node: &str) -> Option<&Module> {
        self.modules.iter().find(|module| module.node == node)
    }

    /// The full name of a wire: an output of a module resolves to the inner wire; other names are returned unchanged.
    /// `None` with a fault if the module has no such output, and without a fault if the module itself has one.
    pub(super) fn flat(&self, text: &str, at: &Span, owner: &str, faults: &mut Vec<Fault>) -> Option<String> {
        let mut text = text.to_owned();
        // The inner wire may be an output of a nested module.
        while let Some((module, port)) = text.rsplit_once('.').and_then(|(node, port)| Some((self.module(node)?, port)))
        {
            let outputs = module.outputs.as_ref()?;
            let Some((_, wire, _)) = outputs.iter().find(|(name, ..)| name == port) else {
                let file = module.file.display();
                let message = format!("{owner} is wired to \"{text}\", but module {file} has no output \"{port}\"");
                let names = || outputs.iter().map(|(name, ..)| name.as_str());
                let near = nearest::name(port, names()).map(|near| format!("did you mean \"{}.{near}\"?", module.node));
                let list = nearest::list("its outputs", names());
                let none = outputs.is_empty().then(|| "it declares no outputs".to_owned());
                let within = format!("a wire within is named \"{}/NODE.PORT\"", module.node);
                let fault = Fault::new(message).at(at, "no such output").help_if(near);
                faults.push(fault.note_if(list.or(none)).note(within).follows());
                return None;
            };
            text.clone_from(wire);
        }
        Some(text)
    }
}

/// The index of a node among the parsed nodes, and of the output among the node's outputs.
pub(super) type OutputIndex = (usize, usize);

/// Resolves a wire name to an output; `None` without a fault if its node has a fault already.
pub(super) fn find(
    text: &str,
    at: &Span,
    owner: &str,
    parsed_nodes: &[ParsedNode<'_>],
    names: &Names,
    faults: &mut Vec<Fault>,
) -> Option<OutputIndex> {
    let text = &names.flat(text, at, owner, faults)?;
    let Some((node, port)) = text.rsplit_once('.') else {
        faults.push(no_dot(text, at, owner, parsed_nodes, names));
        return None;
    };
    let Some(index) = parsed_nodes.iter().position(|parsed_node| parsed_node.name == node) else {
        let known = parsed_nodes
            .iter()
            .map(|parsed_node| parsed_node.name)
            .chain(names.modules.iter().map(|module| module.node.as_str()));
        let (_, list) = nearest::hint(node, "nodes", known);
        let fault = Fault::new(format!("{owner} is wired to \"{text}\", but there is no node \"{node}\""));
        let fault = fault.at(at, "no such node");
        faults.push(match names.removed.at(&format!("node.{node}")) {
            Some(removed) => {
                let help = format!("remove what takes \"{text}\" as well, or wire it to another node");
                fault.also(removed, format!("\"{node}\" is removed here")).help(help)
            }
            None => fault.help_if(near_node(node, port, parsed_nodes, names)).note_if(list),
        });
        let last = faults.len() - 1;
        faults[last].follows = true;
        return None;
    };
    let outputs = parsed_nodes[index].outputs.as_ref()?;
    let found = outputs.iter().position(|output| output.name == port);
    if found.is_none() {
        let names = || outputs.iter().map(|output| output.name.as_str());
        let kind = parsed_nodes[index].kind_name();
        let fault = Fault::new(format!("{owner} is wired to \"{text}\", but {kind} has no output \"{port}\""));
        let only = (outputs.len() == 1).then(|| format!("its one output is \"{node}.{}\"", outputs[0].name));
        let near = nearest::name(port, names()).map(|near| format!("did you mean \"{node}.{near}\"?"));
        let list = nearest::list(&format!("outputs of \"{node}\""), names());
        faults.push(fault.at(at, "no such output").help_if(near.or(only)).note_if(list).follows());
    }
    found.map(|port| (index, port))
}

/// The name of the wire that an input or a result is given, by itself or as `from` of a table; `lacks` says what is missing
/// without it.
pub(super) fn named<'a>(
    entry: &'a Entry,
    owner: &str,
    lacks: &str,
    faults: &mut Vec<Fault>,
) -> Option<(&'a str, &'a Span)> {
    let from = match &entry.value.value {
        Value::Text(_) => &entry.value,
        Value::Table(table) => {
            let from = table.get("from");
            if from.is_none() {
                let fault = Fault::new(format!("{owner} does not say its {lacks}"));
                let fault = fault.at(&entry.value.at, "no from here");
                faults.push(fault.help("add from = \"node.port\"").follows());
            }
            &from?.value
        }
        _ => {
            let takes = format!("{owner} takes a wire such as \"node.port\"");
            faults.push(extract::refused(&entry.value, takes, "a text is needed"));
            return None;
        }
    };
    Some((extract::text(from, &format!("{owner}: from"), faults)?, &from.at))
}

fn near_node(node: &str, port: &str, parsed_nodes: &[ParsedNode<'_>], names: &Names) -> Option<String> {
    let modules = names.modules.iter().map(|module| module.node.as_str());
    // The path of a module may be missing: `icp` for `registration/icp`.
    let near = nearest::name(node, parsed_nodes.iter().map(|parsed_node| parsed_node.name).chain(modules))?;
    if let Some(outputs) = names.module(near).and_then(|module| module.outputs.as_ref()) {
        let there = outputs.iter().any(|(name, ..)| name == port);
        return Some(match there {
            true => format!("did you mean \"{near}.{port}\"?"),
            false => format!("did you mean the module \"{near}\"?"),
        });
    }
    let outputs = parsed_nodes.iter().find(|parsed_node| parsed_node.name == near)?.outputs.as_ref();
    let there = outputs.is_some_and(|outputs| outputs.iter().any(|output| output.name == port));
    Some(if there { format!("did you mean \"{near}.{port}\"?") } else { format!("did you mean node \"{near}\"?") })
}

fn no_dot(text: &str, at: &Span, owner: &str, parsed_nodes: &[ParsedNode<'_>], names: &Names) -> Fault {
    let fault = Fault::new(format!("{owner} takes a wire, which is written node.port, found {text:?}"));
    let fault = fault.at(at, "no dot here");
    let outputs = parsed_nodes
        .iter()
        .find(|parsed_node| parsed_node.name == text)
        .and_then(|parsed_node| parsed_node.outputs.as_ref());
    let outputs = outputs.map(|outputs| outputs.iter().map(|output| output.name.as_str()).collect());
    let module = names.module(text).and_then(|module| module.outputs.as_ref());
    let outputs: Option<Vec<&str>> = outputs.or(module.map(|m| m.iter().map(|(name, ..)| name.as_str()).collect()));
    match outputs {
        Some(outputs) => {
            let wires: Vec<_> = outputs.iter().map(|output| format!("\"{text}.{output}\"")).collect();
            fault.help(format!("write {}", wires.join(" or ")))
        }
        None => fault.help_if(nearest::help(text, parsed_nodes.iter().map(|parsed_node| parsed_node.name))),
    }
}

/// The name of a wire.
pub(super) fn name((node, port): OutputIndex, parsed_nodes: &[ParsedNode<'_>]) -> String {
    let port = parsed_nodes[node].outputs.as_ref().map_or("", |outputs| &outputs[port].name);
    format!("{}.{port}", parsed_nodes[node].name)
}
