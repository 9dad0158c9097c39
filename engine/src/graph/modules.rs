//! Puts the nodes of modules in the place of the nodes that use them, so that nothing behind knows of modules.

use super::{
    edit::Edit,
    extends::{self, Chain},
    grammar, header,
    interface::{self, Inlet, Interface, Knob},
    merge::merge_nodes,
    plugins::NamedPlugin,
    remove::Removed,
    take,
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

/// So many modules a graph may use: more than anybody writes, few enough to tell a file that holds itself many times.
const MOST: usize = 1000;

/// A node that uses a module, after its nodes have taken its place.
#[derive(Debug, Clone)]
pub(crate) struct Module {
    /// The node's full name.
    pub(crate) node: String,
    /// The module's file, as shown.
    pub(crate) file: PathBuf,
    /// Its outputs: the name, the wire in full, and where it is declared; not known if the module is at fault.
    pub(crate) outputs: Option<Vec<(String, String, Span)>>,
}

/// What a graph file holds beside the nodes that modules stand for.
pub(super) struct Flattener<'f> {
    /// Canonical paths of the files that hold a node, outermost first, with the names shown; by the module's node.
    files: BTreeMap<String, Vec<(PathBuf, PathBuf)>>,
    n_texts: usize,
    texts: Vec<PathBuf>,
    modules: Vec<Module>,
    plugins: Vec<NamedPlugin>,
    removed: &'f mut Removed,
    faults: &'f mut Vec<Fault>,
}

/// What modules bring along beside their nodes.
pub(super) struct Within {
    pub(super) modules: Vec<Module>,
    /// The files asked for.
    pub(super) texts: Vec<PathBuf>,
    /// The plugins that they name.
    pub(super) plugins: Vec<NamedPlugin>,
}

impl<'f> Flattener<'f> {
    /// For the graph file at `path`, which with what it extends has `n_texts` texts.
    pub(super) fn new(path: &Path, n_texts: usize, removed: &'f mut Removed, faults: &'f mut Vec<Fault>) -> Self {
        let files = BTreeMap::from([(String::new(), vec![(extends::canonical(path), extends::tidy(path))])]);
        Self { files, n_texts, texts: Vec::new(), modules: Vec::new(), plugins: Vec::new(), removed, faults }
    }

    /// Puts nodes in the place of modules until there is none.
    pub(super) fn flatten(mut self, table: &mut Table, mut edits: Vec<Edit>) -> Within {
        let mut at = 0;
        while let Some(nodes) = nodes_of(table) {
            let Some(entry) = nodes.0.get(at) else { break };
            if !is_module(entry) {
                at += 1;
                continue;
            }
            let user = nodes.0.remove(at);
            if self.modules.len() == MOST {
                let fault = Fault::new(format!("the graph uses more than {MOST} modules"));
                self.faults.push(fault.at(&user.key_at, "one too many").help("does a module hold itself many times?"));
                break;
            }
            let within = self.module(&user);
            self.insert(table, at, within, &mut edits);
        }
        self.removed.not_found(table, self.faults);
        self.faults.extend(edits.iter().map(Edit::not_found));
        Within { modules: self.modules, texts: self.texts, plugins: self.plugins }
    }

    /// Puts the nodes of a module at their place, under what the graph says of each of them.
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
        // The other edits may be of a module within the module.
        for edit in std::mem::take(edits) {
            match edit.is_within(&within) {
                true => self.faults.extend(edit.apply_to_nodes(&mut within).err().map(|fault| *fault)),
                false => edits.push(edit),
            }
        }
        kept.splice(place..place, within.0);
        nodes.0 = kept;
    }

    /// The nodes that the module stands for, under their full names, fed and set as the node that uses it says.
    fn module(&mut self, user: &Entry) -> Table {
        let node = user.key.as_str();
        let mut module = Module { node: node.into(), file: PathBuf::new(), outputs: None };
        let nodes = self.read(user, &mut module).unwrap_or_default();
        self.modules.push(module);
        nodes
    }

    fn read(&mut self, user: &Entry, module: &mut Module) -> Option<Table> {
        let node = user.key.as_str();
        let table = user.value.as_table()?;
        let Some(file) = table.get("file") else {
            let at = table.get("kind").map_or(&user.key_at, |kind| &kind.value.at);
            let fault = Fault::new(format!("node \"{node}\" does not say which module it is")).at(at, "no file here");
            self.faults.push(fault.help("add file = \"..\", the graph file of the module, relative to this file"));
            return None;
        };
        let text = take::text(&file.value, &format!("node \"{node}\": file"), self.faults)?;
        let path = relative(&file.value.at, text);
        module.file = extends::tidy(&path);
        self.see_no_circle(node, &path, &file.value.at)?;
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
        let mut chain = Chain::new(&path, self.removed, self.faults).used(node, &user.key_at, before);
        let (main, mut inner) = chain.load(text);
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
        let outlets = interface.outputs.into_iter();
        let outlets = outlets.map(|outlet| (outlet.name, format!("{prefix}{}", outlet.from), outlet.from_at));
        module.outputs = Some(outlets.collect());
        Some(nodes)
    }

    /// Notes the files that the module's nodes lie in; `None` with a fault if one of them is the module itself.
    fn see_no_circle(&mut self, node: &str, path: &Path, at: &Span) -> Option<()> {
        let parent = node.rfind('/').map_or("", |slash| &node[..slash]);
        let mut files = self.files.get(parent).or_else(|| self.files.get(""))?.clone();
        let (same, shown) = (extends::canonical(path), extends::tidy(path));
        if let Some(start) = files.iter().position(|(seen, _)| *seen == same) {
            let names: Vec<_> = files[start..].iter().map(|(_, name)| name.display().to_string()).collect();
            let message = format!("modules hold each other in a circle: {} -> {}", names.join(" -> "), shown.display());
            self.faults.push(Fault::new(message).at(at, "closes the circle"));
            return None;
        }
        files.push((same, shown));
        self.files.insert(node.into(), files);
        Some(())
    }
}

/// Faults where a module says what is to be kept of a run: that is for the graph that uses it.
pub(crate) fn no_results(module: &Table, wire: &str, faults: &mut Vec<Fault>) {
    for (key, table) in [("record", "[record]"), ("results", "[results]")] {
        if let Some(entry) = module.get(key) {
            let fault = Fault::new(format!("a module has no {table}")).at(&entry.key_at, "not in a module");
            faults.push(fault.help(format!("write it in the graph that uses the module, such as \"{wire}\"")));
        }
    }
}

/// What stands for the nodes of a module file that is checked alone: its inputs are fed from outside.
pub(super) fn stand_alone(table: &mut Table, interface: &Interface, faults: &mut Vec<Fault>) {
    let Some(table) = nodes_of(table) else { return };
    for knob in &interface.params {
        let default = knob.default.iter();
        for ((to, at), value) in knob.to.iter().flat_map(|to| default.clone().map(move |value| (to, value))) {
            set(table, "", to, at, value.clone(), "module parameter", &knob.name, faults);
        }
    }
    let mut fed = Vec::new();
    for inlet in &interface.inputs {
        for (to, at) in &inlet.to {
            let value = Spanned { value: Value::Outside(inlet.name.clone()), at: inlet.name_at.clone() };
            feed(table, "", inlet, (to, at), value, &mut fed, faults);
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
    fn parameters(&self, knobs: &[Knob], nodes: &mut Table, faults: &mut Vec<Fault>) {
        for knob in knobs {
            let given = self.table.get(&knob.name).map(|entry| &entry.value);
            if given.is_none() && knob.required {
                let (node, name) = (&self.user.key, &knob.name);
                let fault = Fault::new(format!("node \"{node}\": parameter \"{name}\" of the module is missing"));
                let fault = fault.at(&self.user.key_at, format!("needs {name}")).note_if(said(name, &knob.doc));
                faults.push(fault.help(format!("add {name} = ..")).follows());
            }
            let Some(value) = given.or(knob.default.as_ref()) else { continue };
            for (to, at) in &knob.to {
                set(nodes, self.prefix, to, at, value.clone(), "module parameter", &knob.name, faults);
            }
        }
    }

    fn inputs(&self, inlets: &[Inlet], nodes: &mut Table, faults: &mut Vec<Fault>) {
        let node = &self.user.key;
        let given = self.table.get("in");
        let given = given.and_then(|entry| take::table(&entry.value, &format!("node \"{node}\": in"), faults));
        let mut fed = Vec::new();
        for inlet in inlets {
            let value = match given.and_then(|given| given.get(&inlet.name)) {
                Some(entry) => entry.value.clone(),
                // What leads nowhere is at fault already.
                None if inlet.optional || inlet.to.is_empty() => continue,
                None => {
                    let misspelt = given.is_some_and(|given| {
                        let unknown = given.keys().filter(|key| inlets.iter().all(|inlet| inlet.name != *key));
                        unknown.into_iter().any(|key| nearest::name(key, [inlet.name.as_str()]).is_some())
                    });
                    if !misspelt {
                        faults.push(self.missing(inlet));
                    }
                    // What it would feed is not missing as well.
                    Spanned { value: Value::Outside(inlet.name.clone()), at: inlet.name_at.clone() }
                }
            };
            for (to, at) in &inlet.to {
                feed(nodes, self.prefix, inlet, (to, at), value.clone(), &mut fed, faults);
            }
        }
    }

    fn missing(&self, inlet: &Inlet) -> Fault {
        let (node, name) = (&self.user.key, &inlet.name);
        let at = self.table.get("in").map_or(&self.user.key_at, |entry| &entry.key_at);
        let fault = Fault::new(format!("node \"{node}\": input \"{name}\" of the module is wired to nothing"));
        let fault = fault.at(at, format!("needs {name}")).also(&inlet.name_at, "declared here");
        let feeds: Vec<_> = inlet.to.iter().map(|(to, _)| to.as_str()).collect();
        let note = format!("within the module it feeds {}", feeds.join(", "));
        fault.note_if(said(name, &inlet.doc)).note(note).help(format!("wire {name} = \"node.port\"")).follows()
    }

    /// Faults for keys and inputs that the module does not have.
    fn unknown(&self, interface: &Interface, faults: &mut Vec<Fault>) {
        let (node, file) = (&self.user.key, self.file.display());
        let inlets = || interface.inputs.iter().map(|inlet| inlet.name.as_str());
        let given = self.table.get("in").and_then(|entry| entry.value.as_table());
        for entry in given.into_iter().flat_map(|given| &given.0).filter(|entry| inlets().all(|name| name != entry.key))
        {
            let fault = Fault::new(format!("node \"{node}\": module {file} has no input \"{}\"", entry.key));
            let fault = interface::hint(&entry.key, "its inputs", inlets()).on(fault.at(&entry.key_at, "unknown"));
            let none = inlets().next().is_none().then(|| "it has no inputs".to_owned());
            faults.push(fault.note_if(none));
        }
        let knobs = || interface.params.iter().map(|knob| knob.name.as_str());
        let is_known = |key: &str| grammar::MODULE_NODE.contains(&key) || knobs().any(|name| name == key);
        for entry in self.table.0.iter().filter(|entry| !is_known(&entry.key)) {
            let key = entry.key.as_str();
            let fault = Fault::new(format!("node \"{node}\": module {file} has no parameter \"{key}\""));
            let fault = fault.at(&entry.key_at, "unknown");
            faults.push(match key {
                "on_error" => fault.help(format!("say it of a node within: [node.\"{node}/NAME\"] on_error = ..")),
                "out" => fault.help("its outputs are those that the module declares: take out away"),
                _ => match unit::other(key, None, knobs()) {
                    Some(other) => fault.help(format!("did you mean \"{}\"? the unit is part of the name", other.name)),
                    None => {
                        let none = knobs().next().is_none().then(|| "it has no parameters".to_owned());
                        let within = format!("a key of a node within is set by [node.\"{node}/NAME\"] {key} = ..");
                        interface::hint(key, "its parameters", knobs()).on(fault).note_if(none).note(within)
                    }
                },
            });
        }
    }
}

/// Leads a value to a port within the module, whatever else the module says of the port.
fn feed(
    nodes: &mut Table,
    prefix: &str,
    inlet: &Inlet,
    (to, at): (&str, &Span),
    value: Spanned,
    fed: &mut Vec<(String, String)>,
    faults: &mut Vec<Fault>,
) {
    let Some((node, port)) = to.split_once('.') else { return };
    if let Some((_, other)) = fed.iter().find(|(target, _)| target == to) {
        let message = format!("module inputs \"{other}\" and \"{}\" both feed {to}", inlet.name);
        let fault = Fault::new(message).at(at, "the second");
        faults.push(fault.help("an input has one producer; let one of them go elsewhere"));
        return;
    }
    fed.push((to.into(), inlet.name.clone()));
    let there = nodes.get(&format!("{prefix}{node}"));
    let there = there.and_then(|node| node.value.as_table()?.get("in")?.value.as_table()?.get(port));
    let wired = there.filter(|port| match &port.value.value {
        Value::Text(_) => true,
        Value::Table(table) => table.get("from").is_some(),
        _ => false,
    });
    if let Some(wired) = wired.filter(|_| !inlet.optional) {
        let message = format!("module input \"{}\" feeds {to}, which the module wires itself", inlet.name);
        let fault = Fault::new(message).at(at, "has a producer").also(&wired.key_at, "wired here");
        faults.push(fault.help("take one away, or add optional = true if that wire stands where nothing is given"));
    }
    set(nodes, prefix, &format!("{node}.in.{port}"), at, value, "module input", &inlet.name, faults);
}

/// Writes a value at `to`, a node within the module and the keys below it.
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
        faults.push(interface::hint(node, "its nodes", names.into_iter()).on(fault.at(at, "no such node")));
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

/// Gives the nodes of a module their full names, in their wires as well.
fn rename(nodes: &mut Table, prefix: &str) {
    for entry in &mut nodes.0 {
        entry.key.insert_str(0, prefix);
        let Value::Table(table) = &mut entry.value.value else { continue };
        let Some(Value::Table(inputs)) = table.get_mut("in").map(|entry| &mut entry.value.value) else { continue };
        for input in &mut inputs.0 {
            match &mut input.value.value {
                Value::Text(wire) => wire.insert_str(0, prefix),
                Value::Table(table) => {
                    if let Some(Value::Text(wire)) = table.get_mut("from").map(|from| &mut from.value.value) {
                        wire.insert_str(0, prefix);
                    }
                }
                _ => {}
            }
        }
    }
}

fn said(name: &str, doc: &str) -> Option<String> {
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
