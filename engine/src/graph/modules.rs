//! Replaces the nodes that use modules by the modules' own nodes, so that later stages need not know modules.

use super::{
    edit::Edit,
    extends::{self, Chain},
    extract, grammar, header,
    interface::{self, InputDecl, Interface, ParamDecl},
    limits::MAX_MODULE_DEPTH,
    merge::merge_nodes,
    plugins::NamedPlugin,
    remove::Removed,
    tree::{Entry, Spanned, Table, Value},
    unit,
};
use crate::{
    fault::{Fault, Span},
    names::nearest,
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// The kind of a node that uses a module.
pub(crate) const KIND: &str = "module";

/// Maximum number of module uses in a graph; a file that contains itself exponentially often exceeds it.
const MAX_MODULES: usize = 1000;

/// A node that used a module and has been replaced by the module's nodes.
#[derive(Debug, Clone)]
pub(crate) struct Module {
    /// The node's full name.
    pub(crate) node: String,
    /// The module's file, as shown.
    pub(crate) file: PathBuf,
    /// Its outputs: the name, the full name of the wire, and where it is declared; `None` if the module has a fault.
    pub(crate) outputs: Option<Vec<(String, String, Span)>>,
}

/// Replaces the nodes of a graph that use modules.
pub(super) struct Flattener<'f> {
    /// Canonical paths of the files that contain a node, outermost first, with the names shown; by the module's node.
    files: BTreeMap<String, Vec<(PathBuf, PathBuf)>>,
    n_texts: usize,
    /// The module files, whether or not they could be read.
    pub(super) texts: Vec<PathBuf>,
    pub(super) modules: Vec<Module>,
    /// The plugins named by these files.
    pub(super) plugins: Vec<NamedPlugin>,
    removed: &'f mut Removed,
    faults: &'f mut Vec<Fault>,
}

impl<'f> Flattener<'f> {
    /// A flattener for the graph file at `path`, which consists of `n_texts` texts including those it extends.
    pub(super) fn new(path: &Path, n_texts: usize, removed: &'f mut Removed, faults: &'f mut Vec<Fault>) -> Self {
        let files = BTreeMap::from([(String::new(), vec![(extends::canonical(path), extends::tidy(path))])]);
        Self { files, n_texts, texts: Vec::new(), modules: Vec::new(), plugins: Vec::new(), removed, faults }
    }

    /// Replaces modules by their nodes until none is left.
    pub(super) fn flatten(&mut self, table: &mut Table, mut edits: Vec<Edit>) {
        let mut at = 0;
        while let Some(nodes) = nodes_of(table) {
            let Some(entry) = nodes.0.get(at) else { break };
            if !is_module(entry) {
                at += 1;
                continue;
            }
            let user = nodes.0.remove(at);
            if self.modules.len() == MAX_MODULES {
                let fault = Fault::new(format!("the graph uses more than {MAX_MODULES} modules"));
                self.faults.push(fault.at(&user.key_at, "one too many").help("does a module hold itself many times?"));
                break;
            }
            let mut module = Module { node: user.key.clone(), file: PathBuf::new(), outputs: None };
            let within = self.read(&user, &mut module).unwrap_or_default();
            self.modules.push(module);
            self.insert(table, at, within, &mut edits);
        }
        self.removed.not_found(table, self.faults);
        self.faults.extend(edits.iter().map(Edit::not_found));
    }

    /// Inserts the nodes of a module and merges the graph's own settings of these nodes into them.
    fn insert(&mut self, table: &mut Table, at: usize, mut within: Table, edits: &mut Vec<Edit>) {
        let Some(nodes) = nodes_of(table) else { return };
        let (mut over, mut kept, mut place) = (Table::default(), Vec::new(), at);
        for (index, entry) in std::mem::take(&mut nodes.0).into_iter().enumerate() {
            if within.get(&entry.key).is_some() {
                place -= usize::from(index < at);
                over.0.push(entry);
            } else {
                kept.push(entry);
            }
        }
        merge_nodes(&mut within, over);
        // The remaining edits may concern a module inside this module.
        for edit in std::mem::take(edits) {
            match edit.is_within(&within) {
                true => self.faults.extend(edit.apply_to_nodes(&mut within).err().map(|fault| *fault)),
                false => edits.push(edit),
            }
        }
        kept.splice(place..place, within.0);
        nodes.0 = kept;
    }

    /// The nodes of the module under their full names, with inputs and parameters set by the node that uses it.
    fn read(&mut self, user: &Entry, module: &mut Module) -> Option<Table> {
        let node = user.key.as_str();
        let table = user.value.as_table()?;
        let Some(file) = table.get("file") else {
            let at = table.get("kind").map_or(&user.key_at, |kind| &kind.value.at);
            let fault = Fault::new(format!("node \"{node}\" does not say which module it is")).at(at, "no file here");
            self.faults.push(fault.help("add file = \"..\", the graph file of the module, relative to this file"));
            return None;
        };
        let text = extract::text(&file.value, &format!("node \"{node}\": file"), self.faults)?;
        let path = relative(&file.value.at, text);
        module.file = extends::tidy(&path);
        self.refuse_cycle(node, &path, &file.value.at)?;
        self.texts.push(path.clone());
        let text = match extends::read(&path) {
            Ok(text) => text,
            Err(fault) => {
                let fault = fault.at(&file.value.at, "relative to where it is written");
                self.faults.push(fault);
                return None;
            }
        };
        let before = self.n_texts;
        let mut chain = Chain::new(self.removed, self.faults).used(node, &user.key_at, before);
        let (main, mut inner) = chain.load(&path, text);
        self.n_texts += chain.len();
        self.texts.append(&mut chain.texts);
        self.plugins.append(&mut chain.plugins);
        let Some(interface) = interface::read(&mut inner, self.faults) else {
            let message = format!("node \"{node}\": {} is a graph, but no module", module.file.display());
            let fault = Fault::new(message).at(&file.value.at, "has no [module]");
            self.faults
                .push(fault.help(
                    "let it declare what it takes and gives: [module.inputs], [module.outputs], [module.params]",
                ));
            return None;
        };
        header::read(&inner, &main, self.faults);
        no_results(&inner, &format!("{node}/NODE.PORT"), self.faults);
        let prefix = format!("{node}/");
        let mut nodes = nodes_of(&mut inner).map(std::mem::take).unwrap_or_default();
        if nodes.0.is_empty() {
            let start = Span::new(&main, 0..0);
            let fault = Fault::new("the module has no node").at(&start, "no [node.NAME] here");
            self.faults.push(fault.follows());
        }
        rename(&mut nodes, &prefix);
        self.removed.take_inside(node, &mut nodes);
        let uses = User { user, table, file: &module.file, prefix: &prefix };
        uses.parameters(&interface.params, &mut nodes, self.faults);
        uses.inputs(&interface.inputs, &mut nodes, self.faults);
        uses.unknown(&interface, self.faults);
        let output_decls = interface.outputs.into_iter();
        let output_decls = output_decls
            .map(|output_decl| (output_decl.name, format!("{prefix}{}", output_decl.from), output_decl.from_at));
        module.outputs = Some(output_decls.collect());
        Some(nodes)
    }

    /// Records the files that contain the module's nodes; `None`, with a fault, if the module contains itself.
    fn refuse_cycle(&mut self, node: &str, path: &Path, at: &Span) -> Option<()> {
        let parent = node.rfind('/').map_or("", |slash| &node[..slash]);
        let mut files = self.files.get(parent).or_else(|| self.files.get(""))?.clone();
        let (same, shown) = (extends::canonical(path), extends::tidy(path));
        if let Some(start) = files.iter().position(|(seen, _)| *seen == same) {
            let names: Vec<_> = files[start..].iter().map(|(_, name)| name.display().to_string()).collect();
            let message = format!("modules hold each other in a circle: {} -> {}", names.join(" -> "), shown.display());
            self.faults.push(Fault::new(message).at(at, "closes the circle"));
            return None;
        }
        if files.len() > MAX_MODULE_DEPTH {
            let fault = Fault::new(format!("modules are nested more than {MAX_MODULE_DEPTH} deep"));
            self.faults.push(fault.at(at, "one too many").help("does a program write these files?"));
            return None;
        }
        files.push((same, shown));
        self.files.insert(node.into(), files);
        Some(())
    }
}

/// Faults for `[record]` and `[results]` in a module; they belong in the graph that uses it.
pub(crate) fn no_results(module: &Table, wire: &str, faults: &mut Vec<Fault>) {
    for (key, table) in [("record", "[record]"), ("results", "[results]")] {
        if let Some(entry) = module.get(key) {
            let fault = Fault::new(format!("a module has no {table}")).at(&entry.key_at, "not in a module");
            faults.push(fault.help(format!("write it in the graph that uses the module, such as \"{wire}\"")));
        }
    }
}

/// Prepares the nodes of a module file that is checked alone: its inputs are fed by placeholders.
pub(super) fn prepare_alone(table: &mut Table, interface: &Interface, faults: &mut Vec<Fault>) {
    let Some(table) = nodes_of(table) else { return };
    for param_decl in &interface.params {
        let default = param_decl.default.iter();
        for ((to, at), value) in param_decl.to.iter().flat_map(|to| default.clone().map(move |value| (to, value))) {
            set(table, "", to, at, value.clone(), "module parameter", &param_decl.name, faults);
        }
    }
    let mut fed = Vec::new();
    for input_decl in &interface.inputs {
        for (to, at) in &input_decl.to {
            let value = Spanned { value: Value::Outside(input_decl.name.clone()), at: input_decl.name_at.clone() };
            feed(table, "", input_decl, (to, at), value, &mut fed, faults);
        }
    }
}

/// A node that uses a module.
struct User<'a> {
    user: &'a Entry,
    table: &'a Table,
    file: &'a Path,
    prefix: &'a str,
}

impl User<'_> {
    fn parameters(&self, param_decls: &[ParamDecl], nodes: &mut Table, faults: &mut Vec<Fault>) {
        for param_decl in param_decls {
            let given = self.table.get(&param_decl.name).map(|entry| &entry.value);
            if given.is_none() && param_decl.required {
                let (node, name) = (&self.user.key, &param_decl.name);
                let fault = Fault::new(format!("node \"{node}\": parameter \"{name}\" of the module is missing"));
                let fault =
                    fault.at(&self.user.key_at, format!("needs {name}")).note_if(describe(name, &param_decl.doc));
                faults.push(fault.help(format!("add {name} = ..")).follows());
            }
            let Some(value) = given.or(param_decl.default.as_ref()) else { continue };
            for (to, at) in &param_decl.to {
                set(nodes, self.prefix, to, at, value.clone(), "module parameter", &param_decl.name, faults);
            }
        }
    }

    fn inputs(&self, input_decls: &[InputDecl], nodes: &mut Table, faults: &mut Vec<Fault>) {
        let node = &self.user.key;
        let given = self.table.get("in");
        let given = given.and_then(|entry| extract::table(&entry.value, &format!("node \"{node}\": in"), faults));
        let mut fed = Vec::new();
        for input_decl in input_decls {
            let value = match given.and_then(|given| given.get(&input_decl.name)) {
                Some(entry) => entry.value.clone(),
                // An input without a target has a fault already.
                None if input_decl.optional || input_decl.to.is_empty() => continue,
                None => {
                    let misspelt = given.is_some_and(|given| {
                        let unknown =
                            given.keys().filter(|key| input_decls.iter().all(|input_decl| input_decl.name != *key));
                        unknown.into_iter().any(|key| nearest::name(key, [input_decl.name.as_str()]).is_some())
                    });
                    if !misspelt {
                        faults.push(self.missing(input_decl));
                    }
                    // The inner ports are fed by a placeholder, so that they are not reported as missing too.
                    Spanned { value: Value::Outside(input_decl.name.clone()), at: input_decl.name_at.clone() }
                }
            };
            for (to, at) in &input_decl.to {
                feed(nodes, self.prefix, input_decl, (to, at), value.clone(), &mut fed, faults);
            }
        }
    }

    fn missing(&self, input_decl: &InputDecl) -> Fault {
        let (node, name) = (&self.user.key, &input_decl.name);
        let at = self.table.get("in").map_or(&self.user.key_at, |entry| &entry.key_at);
        let fault = Fault::new(format!("node \"{node}\": input \"{name}\" of the module is wired to nothing"));
        let fault = fault.at(at, format!("needs {name}")).also(&input_decl.name_at, "declared here");
        let feeds: Vec<_> = input_decl.to.iter().map(|(to, _)| to.as_str()).collect();
        let note = format!("within the module it feeds {}", feeds.join(", "));
        fault.note_if(describe(name, &input_decl.doc)).note(note).help(format!("wire {name} = \"node.port\"")).follows()
    }

    /// Faults for keys and inputs that the module does not declare.
    fn unknown(&self, interface: &Interface, faults: &mut Vec<Fault>) {
        let (node, file) = (&self.user.key, self.file.display());
        let input_decls = || interface.inputs.iter().map(|input_decl| input_decl.name.as_str());
        let given = self.table.get("in").and_then(|entry| entry.value.as_table());
        for entry in
            given.into_iter().flat_map(|given| &given.0).filter(|entry| input_decls().all(|name| name != entry.key))
        {
            let fault = Fault::new(format!("node \"{node}\": module {file} has no input \"{}\"", entry.key));
            let fault = fault.at(&entry.key_at, "unknown").hint(nearest::hint(&entry.key, "its inputs", input_decls()));
            let none = input_decls().next().is_none().then(|| "it has no inputs".to_owned());
            faults.push(fault.note_if(none));
        }
        let param_decls = || interface.params.iter().map(|param_decl| param_decl.name.as_str());
        let is_known = |key: &str| grammar::has(&grammar::MODULE_NODE, key) || param_decls().any(|name| name == key);
        for entry in self.table.0.iter().filter(|entry| !is_known(&entry.key)) {
            let key = entry.key.as_str();
            let fault = Fault::new(format!("node \"{node}\": module {file} has no parameter \"{key}\""));
            let fault = fault.at(&entry.key_at, "unknown");
            faults.push(match key {
                "on_error" | "process" | "pool" | "stop_after_s" => {
                    fault.help(format!("say it of a node within: [node.\"{node}/NAME\"] {key} = .."))
                }
                "out" => fault.help("its outputs are those that the module declares: take out away"),
                _ => match unit::same_quantity(key, None, param_decls()) {
                    Some(other) => fault.help(format!("did you mean \"{}\"? the unit is part of the name", other.name)),
                    None => {
                        let none = param_decls().next().is_none().then(|| "it has no parameters".to_owned());
                        let within = format!("a key of a node within is set by [node.\"{node}/NAME\"] {key} = ..");
                        fault.hint(nearest::hint(key, "its parameters", param_decls())).note_if(none).note(within)
                    }
                },
            });
        }
    }
}

/// Sets the producer of a port of the module and keeps the port's other settings.
fn feed(
    nodes: &mut Table,
    prefix: &str,
    input_decl: &InputDecl,
    (to, at): (&str, &Span),
    value: Spanned,
    fed: &mut Vec<(String, String)>,
    faults: &mut Vec<Fault>,
) {
    let Some((node, port)) = to.split_once('.') else { return };
    if let Some((_, other)) = fed.iter().find(|(target, _)| target == to) {
        let message = format!("module inputs \"{other}\" and \"{}\" both feed {to}", input_decl.name);
        let fault = Fault::new(message).at(at, "the second");
        faults.push(fault.help("an input has one producer; let one of them go elsewhere"));
        return;
    }
    fed.push((to.into(), input_decl.name.clone()));
    let there = nodes.get(&format!("{prefix}{node}"));
    let there = there.and_then(|node| node.value.as_table()?.get("in")?.value.as_table()?.get(port));
    let wired = there.filter(|port| match &port.value.value {
        Value::Text(_) | Value::Array(_) => true,
        Value::Table(table) => table.get("from").is_some(),
        _ => false,
    });
    if let Some(wired) = wired.filter(|_| !input_decl.optional) {
        let message = format!("module input \"{}\" feeds {to}, which the module wires itself", input_decl.name);
        let fault = Fault::new(message).at(at, "has a producer").also(&wired.key_at, "wired here");
        faults.push(fault.help("take one away, or add optional = true if that wire stands where nothing is given"));
    }
    set(nodes, prefix, &format!("{node}.in.{port}"), at, value, "module input", &input_decl.name, faults);
}

/// Writes a value at `to`, the path of an inner node and its keys.
#[allow(clippy::too_many_arguments, reason = "a place, a value, and who asks for it")]
fn set(
    nodes: &mut Table,
    prefix: &str,
    to: &str,
    at: &Span,
    value: Spanned,
    what: &str,
    name: &str,
    faults: &mut Vec<Fault>,
) {
    let Some((node, keys)) = to.split_once('.') else { return };
    let full = format!("{prefix}{node}");
    if nodes.get(&full).is_none() {
        let fault = Fault::new(format!(
            "{what} \"{name}\" leads to \"{}\", but the module has no node \"{node}\"",
            at.text().trim_matches('"')
        ));
        let names: Vec<_> = nodes.keys().map(|name| name.strip_prefix(prefix).unwrap_or(name)).collect();
        faults.push(fault.at(at, "no such node").hint(nearest::hint(node, "its nodes", names)));
        return;
    }
    let mut value = value;
    for key in keys.split('.').rev() {
        let here = value.at.clone();
        let entry = Entry { key: key.into(), key_at: at.clone(), value };
        value = Spanned { value: Value::Table(Table(vec![entry])), at: here };
    }
    let over = Table(vec![Entry { key: full, key_at: at.clone(), value }]);
    merge_nodes(nodes, over);
}

/// Prefixes the names of a module's nodes, also in their wires.
fn rename(nodes: &mut Table, prefix: &str) {
    for entry in &mut nodes.0 {
        entry.key.insert_str(0, prefix);
        let Value::Table(table) = &mut entry.value.value else { continue };
        let Some(Value::Table(inputs)) = table.get_mut("in").map(|entry| &mut entry.value.value) else { continue };
        for input in &mut inputs.0 {
            let from = match &mut input.value.value {
                Value::Table(table) => table.get_mut("from").map(|from| &mut from.value.value),
                value => Some(value),
            };
            let wires = match from {
                Some(Value::Array(wires)) => wires.iter_mut().map(|wire| &mut wire.value).collect(),
                from => from.into_iter().collect::<Vec<_>>(),
            };
            for wire in wires {
                if let Value::Text(wire) = wire {
                    wire.insert_str(0, prefix);
                }
            }
        }
    }
}

fn describe(name: &str, doc: &str) -> Option<String> {
    (!doc.is_empty()).then(|| format!("{name}: {doc}"))
}

fn is_module(entry: &Entry) -> bool {
    let kind = entry.value.as_table().and_then(|table| table.get("kind"));
    kind.is_some_and(|kind| kind.value.as_text() == Some(KIND))
}

fn nodes_of(table: &mut Table) -> Option<&mut Table> {
    match table.get_mut("node").map(|entry| &mut entry.value.value) {
        Some(Value::Table(nodes)) => Some(nodes),
        _ => None,
    }
}

fn relative(at: &Span, text: &str) -> PathBuf {
    let written = Path::new(text);
    if written.is_absolute() || at.source.command_line {
        return written.into();
    }
    at.source.name.parent().unwrap_or(Path::new("")).join(written)
}
