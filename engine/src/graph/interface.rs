//! The interface of a module: its inputs, outputs and parameters.

use super::{
    extract::{self, Section},
    grammar::{self, Keys},
    tree::{Entry, Spanned, Table, Value},
};
use crate::fault::{Fault, Span};

/// The table `[module]` of a graph file.
#[derive(Debug, Clone)]
pub(crate) struct Interface {
    pub(crate) at: Span,
    pub(crate) doc: String,
    pub(crate) inputs: Vec<InputDecl>,
    pub(crate) outputs: Vec<OutputDecl>,
    pub(crate) params: Vec<ParamDecl>,
}

/// An input of a module, and the inner ports that it feeds.
#[derive(Debug, Clone)]
pub(crate) struct InputDecl {
    pub(crate) name: String,
    pub(crate) name_at: Span,
    pub(crate) doc: String,
    /// `node.port`, each with its place.
    pub(crate) to: Vec<(String, Span)>,
    pub(crate) optional: bool,
}

/// An output of a module, and the inner wire that it exposes.
#[derive(Debug, Clone)]
pub(crate) struct OutputDecl {
    pub(crate) name: String,
    pub(crate) doc: String,
    pub(crate) from: String,
    pub(crate) from_at: Span,
}

/// A parameter of a module, and the keys of inner nodes that it sets.
#[derive(Debug, Clone)]
pub(crate) struct ParamDecl {
    pub(crate) name: String,
    pub(crate) doc: String,
    /// `node.key`, each with its place.
    pub(crate) to: Vec<(String, Span)>,
    pub(crate) default: Option<Spanned>,
    pub(crate) required: bool,
}

/// Removes `[module]` from a graph file and reads it.
pub(super) fn read(table: &mut Table, faults: &mut Vec<Fault>) -> Option<Interface> {
    let entry = table.remove("module")?;
    let at = entry.key_at.clone();
    let mut interface =
        Interface { at, doc: String::new(), inputs: Vec::new(), outputs: Vec::new(), params: Vec::new() };
    let Some(module) = extract::table(&entry.value, "module", faults) else { return Some(interface) };
    let module = Section::new(module, &grammar::MODULE, "[module]", "module", faults);
    interface.doc = doc(&module, faults);
    for entry in entries(&module, "inputs", "an input", faults) {
        let owner = format!("module input \"{}\"", entry.key);
        let table = long(entry, "to");
        let Some(table) = section(&table, &grammar::MODULE_INPUT, &owner, faults) else { continue };
        interface.inputs.push(InputDecl {
            name: entry.key.clone(),
            name_at: entry.key_at.clone(),
            doc: doc(&table, faults),
            to: targets(&table, entry, &owner, "node.port", faults),
            optional: table.flag("optional", faults),
        });
    }
    for entry in entries(&module, "outputs", "an output", faults) {
        let owner = format!("module output \"{}\"", entry.key);
        let table = long(entry, "from");
        let Some(table) = section(&table, &grammar::MODULE_OUTPUT, &owner, faults) else { continue };
        let doc = doc(&table, faults);
        match table.get("from") {
            Some(from) => {
                let Some(wire) = table.text("from", faults) else { continue };
                let (name, from_at) = (entry.key.clone(), from.value.at.clone());
                interface.outputs.push(OutputDecl { name, doc, from: wire.into(), from_at });
            }
            None => {
                let fault = Fault::new(format!("{owner} does not say its wire")).at(&entry.value.at, "no from here");
                faults.push(fault.help("add from = \"node.port\", an output of a node of this file").follows());
            }
        }
    }
    for entry in entries(&module, "params", "a parameter", faults) {
        let owner = format!("module parameter \"{}\"", entry.key);
        if grammar::has(&grammar::NODE, &entry.key) || grammar::has(&grammar::MODULE_NODE, &entry.key) {
            let fault = Fault::new(format!("a module's parameter cannot be called \"{}\"", entry.key));
            let fault = fault.at(&entry.key_at, "taken");
            faults.push(fault.help("it is a key of the node that uses the module; choose another name"));
            continue;
        }
        let table = long(entry, "to");
        let Some(table) = section(&table, &grammar::MODULE_PARAM, &owner, faults) else { continue };
        let param_decl = ParamDecl {
            name: entry.key.clone(),
            doc: doc(&table, faults),
            to: targets(&table, entry, &owner, "node.parameter", faults),
            default: table.get("default").map(|default| default.value.clone()),
            required: table.flag("required", faults),
        };
        if let (Some(default), true) = (&param_decl.default, param_decl.required) {
            let fault = Fault::new(format!("{owner} is required, but has a default"));
            faults.push(fault.at(&default.at, "never used").help("keep one of them"));
        }
        interface.params.push(param_decl);
    }
    Some(interface)
}

fn entries<'t>(module: &Section<'t>, key: &str, what: &str, faults: &mut Vec<Fault>) -> &'t [Entry] {
    let Some(entry) = module.get(key) else { return &[] };
    let Some(table) = extract::table(&entry.value, &format!("[module] {key}"), faults) else { return &[] };
    for entry in table.0.iter().filter(|entry| !extract::is_name(&entry.key)) {
        let fault = Fault::new(format!("{what} of a module cannot be called {:?}", entry.key));
        faults.push(fault.at(&entry.key_at, "no name").help("a name has letters, digits, _ and - only"));
    }
    &table.0
}

/// The table of a declaration, of which a text or a list is short for `{ to = .. }`.
fn long(entry: &Entry, key: &str) -> Spanned {
    let mut value = entry.value.clone();
    if let Value::Text(_) | Value::Array(_) = value.value {
        value.lengthen(key);
    }
    value
}

fn section<'t>(value: &'t Spanned, keys: &'static Keys, owner: &str, faults: &mut Vec<Fault>) -> Option<Section<'t>> {
    let table = extract::table(value, owner, faults)?;
    Some(Section::new(table, keys, owner, owner, faults))
}

fn doc(table: &Section<'_>, faults: &mut Vec<Fault>) -> String {
    table.text("doc", faults).unwrap_or_default().into()
}

fn targets(
    table: &Section<'_>,
    entry: &Entry,
    owner: &str,
    form: &str,
    faults: &mut Vec<Fault>,
) -> Vec<(String, Span)> {
    let Some(to) = table.get("to") else {
        let fault = Fault::new(format!("{owner} leads nowhere")).at(&entry.key_at, "no to here");
        faults.push(fault.help(format!("add to = \"{form}\", or a list of such")).follows());
        return Vec::new();
    };
    let items = match &to.value.value {
        Value::Array(items) => items.as_slice(),
        _ => std::slice::from_ref(&to.value),
    };
    if items.is_empty() {
        let fault = Fault::new(format!("{owner} leads nowhere")).at(&to.value.at, "empty");
        faults.push(fault.help(format!("write to = \"{form}\", or take it away")));
    }
    let mut targets = Vec::new();
    for item in items {
        let Some(text) = extract::text(item, &format!("{owner}: to"), faults) else { continue };
        match text.split_once('.') {
            Some((node, key)) if !node.is_empty() && !key.is_empty() => targets.push((text.into(), item.at.clone())),
            _ => {
                let fault = Fault::new(format!("{owner}: to takes {form}, found {text:?}"));
                faults.push(fault.at(&item.at, "no dot here").help(format!("write to = \"{form}\"")));
            }
        }
    }
    targets
}
