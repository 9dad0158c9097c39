use super::{context::Check, schema::Walker};
use crate::{
    fault::{Fault, Severity, Span},
    graph::{
        Entry, Graph, MODULE, Spanned, Table, Value,
        extract::{self, Section},
        grammar,
        header::Header,
    },
    names::nearest,
    plan::{Deadline, OnError, PortFrames, variable},
    process::REFUSED_HERE,
};
use osteoflow_node::{DeclaredPort, FrameExpr, Kind, OutputPorts, Place, PortPayload, Role};
use serde_json::{Map, Value as Json};
use std::{path::PathBuf, time::Duration};

/// A node as read from its own table, before wires are resolved.
pub(super) struct ParsedNode<'a> {
    pub(super) name: &'a str,
    pub(super) name_at: &'a Span,
    /// `None` if it has a fault.
    pub(super) kind: Option<&'a Kind>,
    pub(super) table: &'a Table,
    pub(super) params: Json,
    /// The files that its parameters name.
    pub(super) input_files: Vec<PathBuf>,
    /// The files that a source will read beside these.
    pub(super) further_files: Vec<PathBuf>,
    pub(super) declared: Vec<DeclaredPort>,
    /// `None` if they have a fault.
    pub(super) outputs: Option<Vec<Output>>,
    pub(super) on_error: OnError,
    pub(super) place: Place,
    pub(super) deadline: Option<Deadline>,
    /// The environment variables that decide what it computes, by name and as `NAME=VALUE` or `NAME unset`.
    pub(super) env: Vec<(String, String)>,
}

/// An output of a parsed node.
pub(super) struct Output {
    pub(super) name: String,
    /// `None` if it has a fault.
    pub(super) payload: Option<PortPayload>,
    /// The frame expressions declared by the kind.
    pub(super) exprs: FrameExpr,
    /// The frames given in the graph.
    pub(super) given: PortFrames,
    /// Whether each of its items has a time, so that none is a constant.
    pub(super) is_timed: bool,
}

impl ParsedNode<'_> {
    pub(super) fn role(&self) -> Option<Role> {
        self.kind.map(|kind| kind.description.role)
    }

    pub(super) fn is_source(&self) -> bool {
        matches!(self.role(), Some(Role::Source | Role::LiveSource))
    }

    pub(super) fn kind_name(&self) -> &'static str {
        self.kind.map_or("", |kind| kind.description.kind)
    }

    /// The node, or its kind if a variant or the command line changed it. Missing parameters and inputs are reported
    /// there.
    pub(super) fn begins_at(&self) -> &Span {
        let kind_at = self.table.get("kind").map(|kind| &kind.value.at);
        kind_at.filter(|at| at.source.order != self.name_at.source.order).unwrap_or(self.name_at)
    }

    /// The location of the node in messages of a run: where a file chose its kind, otherwise where the node begins.
    pub(super) fn reported_at(&self) -> &Span {
        Some(self.begins_at()).filter(|at| !at.source.command_line).unwrap_or(self.name_at)
    }

    /// The place where a missing input is reported: `in`, or the node if it has none.
    pub(super) fn inputs_at(&self) -> &Span {
        let at = self.begins_at();
        if at.source.order != self.name_at.source.order {
            return at;
        }
        self.table.get("in").map_or(at, |entry| &entry.key_at)
    }
}

impl<'r> Check<'r> {
    /// The nodes in the order of the file.
    pub(super) fn parsed_nodes<'a>(&mut self, graph: &'a Graph, header: &Header) -> Vec<ParsedNode<'a>>
    where
        'r: 'a,
    {
        let Some(nodes) = graph.table.get("node") else {
            let fault = Fault::new("the graph has no node").at(&graph.start(), "no [node.NAME] here");
            self.faults.push(fault.help("begin with a source: [node.NAME] and its kind").follows());
            return Vec::new();
        };
        let Some(nodes) = extract::table(&nodes.value, "node", &mut self.faults) else { return Vec::new() };
        nodes.0.iter().filter_map(|entry| self.parsed_node(entry, nodes, header)).collect()
    }

    fn parsed_node<'a>(&mut self, entry: &'a Entry, nodes: &Table, header: &Header) -> Option<ParsedNode<'a>>
    where
        'r: 'a,
    {
        let name = entry.key.as_str();
        if !extract::is_node_name(name) {
            let fault = Fault::new(format!("a node cannot be called {name:?}")).at(&entry.key_at, "no name");
            self.faults.push(fault.help("a name has letters, digits, _ and - only"));
        } else if grammar::has(&grammar::TOP, name) {
            let fault = Fault::new(format!("a node cannot be called \"{name}\"")).at(&entry.key_at, "taken");
            self.faults.push(fault.help("the name is a part of the graph file itself; choose another"));
        }
        let Some(table) = entry.value.as_table() else {
            let message = format!("node \"{name}\" takes a table, found {}", entry.value.found());
            let fault = Fault::new(message).at(&entry.value.at, "a table is needed");
            self.faults.push(fault.help(table_help(name, entry, nodes)).hides(&entry.value.at));
            return None;
        };
        if let Some(fault) = nearly_there(name, entry, nodes) {
            self.faults.push(fault);
            return None;
        }
        let n_faults = self.faults.len();
        let kind = self.kind(name, entry, table, nodes);
        let mut parsed_node = ParsedNode {
            name,
            name_at: &entry.key_at,
            kind,
            table,
            params: Json::Object(Map::new()),
            input_files: Vec::new(),
            further_files: Vec::new(),
            declared: Vec::new(),
            outputs: None,
            on_error: OnError::default(),
            place: Place::default(),
            deadline: None,
            env: Vec::new(),
        };
        self.behaviour(&mut parsed_node);
        if let Some(kind) = kind {
            self.params(&mut parsed_node, kind);
            self.outputs(&mut parsed_node, kind, header);
            let has_errors = self.faults[n_faults..].iter().any(|fault| fault.severity == Severity::Error);
            if kind.plugin.is_none() && !has_errors {
                self.build(&mut parsed_node, kind, header.seed);
            }
        }
        Some(parsed_node)
    }

    fn kind(&mut self, name: &str, entry: &Entry, table: &Table, nodes: &Table) -> Option<&'r Kind> {
        let Some(kind) = table.get("kind") else {
            self.faults.push(no_kind(name, entry, nodes));
            return None;
        };
        let found = extract::text(&kind.value, &format!("node \"{name}\": kind"), &mut self.faults)?;
        let known = self.known.registry.kind(found);
        if known.is_none() {
            let kinds: Vec<_> = self.known.registry.kinds().map(|kind| kind.description.kind).collect();
            let stage = found.split('.').next().unwrap_or(found);
            let of_stage: Vec<_> = kinds.iter().copied().filter(|k| k.split('.').next() == Some(stage)).collect();
            let list = nearest::list(&format!("kinds of {stage}"), of_stage.iter().copied());
            let mut stages: Vec<_> = kinds.iter().filter_map(|kind| kind.split('.').next()).collect();
            stages.dedup();
            let list = list.or_else(|| nearest::list("kinds", kinds.iter().copied()));
            let list = list.or_else(|| Some(format!("stages: {}", stages.join(", "))));
            let known = kinds.into_iter().chain([MODULE]);
            let help = nearest::help(found, of_stage.iter().copied()).or_else(|| nearest::help(found, known));
            let fault = Fault::new(format!("node \"{name}\": there is no kind \"{found}\""));
            let fault = fault.at(&kind.value.at, "unknown").help_if(help);
            let refused: Vec<_> = self.known.refused.iter().map(|plugin| plugin.path.display().to_string()).collect();
            self.faults.push(match refused.is_empty() {
                true => fault.note_if(list),
                false => fault.note(format!("it may be of a plugin that is refused: {}", refused.join(", "))),
            });
        }
        known
    }

    /// Reads the keys that nodes of every kind have.
    fn behaviour(&mut self, parsed_node: &mut ParsedNode<'_>) {
        let table = Section::known(parsed_node.table, &grammar::NODE, format!("node \"{}\"", parsed_node.name));
        if table.word("on_error", &mut self.faults) == Some("skip") {
            parsed_node.on_error = OnError::Skip;
        }
        parsed_node.deadline = self.deadline(&table, parsed_node);
        let process = table.flag_if_set("process", &mut self.faults);
        parsed_node.place = Place { process, stop_after: None, pool: table.flag_if_set("pool", &mut self.faults) };
        if let Some(entry) = table.get("env") {
            parsed_node.env = self.environment(&entry.value, parsed_node.name, parsed_node.kind);
        }
        if let Some(entry) = table.get("stop_after_s") {
            let limit = table.seconds("stop_after_s", &mut self.faults).map(Duration::from_secs_f64);
            if process == Some(false) {
                let what = table.what("stop_after_s");
                let fault = Fault::new(format!("{what} ends a process of the node, but process is false"));
                self.faults.push(fault.at(&entry.value.at, "no process to end").help("take process = false out"));
            }
            // Only a process can be stopped from outside.
            parsed_node.place = Place { process: Some(true), stop_after: limit, ..parsed_node.place };
        }
        let asked = ["process", "stop_after_s"].into_iter().find_map(|key| Some((key, table.get(key)?)));
        if let (Some(why), Some(true), Some((key, entry))) = (REFUSED_HERE, parsed_node.place.process, asked) {
            let fault = Fault::new(format!("{}: {why}", table.what(key))).at(&entry.value.at, "no process here");
            self.faults.push(fault.help(format!("take {key} out, or run the graph there")));
        }
    }

    /// The environment variables that a node names, with their values.
    fn environment(&mut self, value: &Spanned, node: &str, kind: Option<&Kind>) -> Vec<(String, String)> {
        let Value::Array(items) = &value.value else {
            let takes = format!("node \"{node}\": env takes a list of names");
            let fault = extract::refused(value, takes, "a list is needed");
            self.faults.push(fault.help("write env = [\"MY_ICP_MODEL\"]"));
            return Vec::new();
        };
        if kind.is_some_and(|kind| kind.plugin.is_none()) {
            let message =
                format!("node \"{node}\": env is for kinds of plugins; a kind of the program reads no variable");
            self.faults.push(Fault::new(message).at(&value.at, "no plugin").help("take env out"));
        }
        let mut found = Vec::new();
        for item in items {
            let Some(name) = extract::text(item, &format!("node \"{node}\": env"), &mut self.faults) else { continue };
            if name.is_empty() || name.contains(['=', '\0', ' ']) {
                let fault = Fault::new(format!("node \"{node}\": no environment variable is called {name:?}"));
                self.faults.push(fault.at(&item.at, "no name"));
                continue;
            }
            match variable(name) {
                Some(entry) => found.push((name.to_owned(), entry)),
                None => {
                    let fault = Fault::new(format!("node \"{node}\": the environment variable {name} is no text"));
                    let help = "set it to UTF-8, or take it out of env: it cannot be recorded";
                    self.faults.push(fault.at(&item.at, "not UTF-8").help(help));
                }
            }
        }
        found
    }

    fn params(&mut self, parsed_node: &mut ParsedNode<'_>, kind: &Kind) {
        let schema = &kind.description.params;
        let properties = schema.get("properties").and_then(Json::as_object).into_iter().flatten();
        for (taken, _) in properties.filter(|(key, _)| grammar::has(&grammar::NODE, key)) {
            let message =
                format!("kind {} has a parameter \"{taken}\", which is a key of every node", parsed_node.kind_name());
            let at = parsed_node.table.get("kind").map_or(parsed_node.name_at, |kind| &kind.value.at);
            let fault = Fault::new(message).at(at, "cannot be used");
            self.faults.push(fault.help("its author has to give the parameter another name"));
        }
        let own: Vec<_> = grammar::names(&grammar::NODE).collect();
        let (owner, path) = (format!("node \"{}\"", parsed_node.name), format!("node.{}", parsed_node.name));
        let (table, at) = (parsed_node.table, parsed_node.begins_at().clone());
        if let Some(params) = self.read_params(parsed_node, schema, (owner, path), (table, &at), &own) {
            parsed_node.params = Json::Object(params);
        }
    }

    /// Reads the parameters of a node or of a declared output by their schema, except for the keys in `skip`; `named` are
    /// their owner in faults and the path of their table.
    pub(super) fn read_params(
        &mut self,
        parsed_node: &mut ParsedNode<'_>,
        schema: &Json,
        named: (String, String),
        (table, at): (&Table, &Span),
        skip: &[&str],
    ) -> Option<Map<String, Json>> {
        let mut walker = Walker {
            root: schema,
            owner: named.0,
            path: named.1,
            kind: parsed_node.kind_name(),
            kind_at: parsed_node.table.get("kind").map(|kind| &kind.value.at),
            files: self.files,
            faults: Vec::new(),
            input_files: Vec::new(),
        };
        let params = walker.table(schema, table, at, "", skip);
        self.faults.append(&mut walker.faults);
        parsed_node.input_files.append(&mut walker.input_files);
        params
    }

    fn outputs(&mut self, parsed_node: &mut ParsedNode<'_>, kind: &Kind, header: &Header) {
        match &kind.description.outputs {
            OutputPorts::Declared { schema } => self.declared(parsed_node, schema, header),
            OutputPorts::Fixed(ports) => {
                let output = |port: &osteoflow_node::OutputPort| Output {
                    name: port.name.into(),
                    payload: Some(port.payload),
                    exprs: port.frames,
                    given: PortFrames::default(),
                    is_timed: false,
                };
                parsed_node.outputs = Some(ports.iter().map(output).collect());
                if let Some(out) = parsed_node.table.get("out") {
                    let message =
                        format!("node \"{}\": {} has outputs of its own", parsed_node.name, parsed_node.kind_name());
                    let list = nearest::list("its outputs", ports.iter().map(|port| port.name));
                    let fault = Fault::new(message).at(&out.key_at, "declares outputs").note_if(list);
                    self.faults.push(fault.help("take out away"));
                }
            }
        }
    }
}

/// The fault of a node that exists only on the command line and has nearly the name of another.
fn nearly_there(name: &str, entry: &Entry, nodes: &Table) -> Option<Fault> {
    if !entry.key_at.source.command_line {
        return None;
    }
    let others = || nodes.0.iter().filter(|other| !other.key_at.source.command_line).map(|other| other.key.as_str());
    let has_kind = entry.value.as_table().is_some_and(|table| table.get("kind").is_some());
    let (help, list) = nearest::hint(name, "nodes", others());
    if has_kind && help.is_none() {
        return None;
    }
    let fault = Fault::new(format!("there is no node \"{name}\"")).at(&entry.key_at, "unknown");
    Some(fault.hint((help, list)).follows())
}

/// What is meant by a node that is given a value: its kind, or a key of another node.
fn table_help(name: &str, entry: &Entry, nodes: &Table) -> String {
    let text = entry.value.as_text().unwrap_or("VALUE");
    match entry.key_at.source.command_line {
        true if grammar::has(&grammar::NODE, name) => format!("name its node before it, such as icp.{name}={text}"),
        true if text.contains('.') => format!("write {name}.kind={text}"),
        true => match nodes.keys().find(|other| *other != name) {
            Some(other) => format!("KEY is a node and its key, such as {other}.kind or {other}.{name}"),
            None => "KEY is a node and its key".into(),
        },
        false if text.contains('.') => format!("write [node.{name}] and kind = {text:?}"),
        false => format!("write [node.{name}]"),
    }
}

/// The fault of a node without a kind: a misspelt node of the base graph, or a missing `kind`.
fn no_kind(name: &str, entry: &Entry, nodes: &Table) -> Fault {
    let others = nodes.0.iter().filter(|other| {
        other.key != name && matches!(&other.value.value, Value::Table(table) if table.get("kind").is_some())
    });
    let keys = match &entry.value.value {
        Value::Table(table) => table.0.iter().map(|own| own.key.as_str()).collect(),
        _ => Vec::new(),
    };
    let misspelt = keys.iter().find(|key| nearest::name(key, ["kind"]).is_some());
    let misspelt = misspelt.map(|key| format!("did you mean \"kind\" by \"{key}\"?"));
    let help = misspelt.or_else(|| nearest::help(name, others.map(|other| other.key.as_str())));
    let fault = Fault::new(format!("node \"{name}\" has no kind")).at(&entry.key_at, "no kind here");
    fault.help(help.unwrap_or_else(|| "add kind = \"stage.variant\"".into())).follows()
}
