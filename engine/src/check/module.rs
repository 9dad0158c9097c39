use super::{
    context::Check,
    drafts::Draft,
    inputs::{self, Input},
    wires,
};
use crate::{
    fault::{Fault, Span},
    graph::{Graph, Interface},
    plan::Plan,
};
use osteoflow_node::PortPayload;
use serde::Serialize;

/// A module without faults, checked alone: what a graph that uses it may say.
#[derive(Debug)]
pub struct Module {
    /// What it declares.
    pub description: ModuleDescription,
    /// Its nodes; what its inputs feed is wired to nothing, so it cannot run.
    pub plan: Plan,
    /// What is hardly meant.
    pub warnings: Vec<Fault>,
}

/// What a module declares, in the words of its author, with what the nodes within add.
#[derive(Debug, Clone, Serialize)]
pub struct ModuleDescription {
    /// Its name: that of `[graph]`, or else the file's.
    pub name: String,
    /// What it is for.
    pub doc: String,
    /// What it takes.
    pub inputs: Vec<ModuleInput>,
    /// What it gives.
    pub outputs: Vec<ModuleOutput>,
    /// What a graph may set.
    pub params: Vec<ModuleParam>,
    /// The nodes within, by name, and their kinds.
    pub nodes: Vec<(String, String)>,
}

/// An input of a module.
#[derive(Debug, Clone, Serialize)]
pub struct ModuleInput {
    /// Its name.
    pub name: String,
    /// What the author says; else what the kind within says of the port.
    pub doc: String,
    /// What it takes.
    pub payload: &'static str,
    /// How the ports within join it, each once.
    pub joins: Vec<&'static str>,
    /// Whether it may be wired to nothing.
    pub optional: bool,
    /// The ports that it feeds, `node.port`.
    pub to: Vec<String>,
}

/// An output of a module.
#[derive(Debug, Clone, Serialize)]
pub struct ModuleOutput {
    /// Its name.
    pub name: String,
    /// What the author says; else what the kind within says of the port.
    pub doc: String,
    /// What it gives.
    pub payload: &'static str,
    /// The wire within, `node.port`.
    pub from: String,
}

/// A parameter of a module.
#[derive(Debug, Clone, Serialize)]
pub struct ModuleParam {
    /// Its name.
    pub name: String,
    /// What the author says; else what the kind within says of the parameter.
    pub doc: String,
    /// The value where a graph gives none; else it is what the nodes within say.
    pub default: Option<serde_json::Value>,
    /// Whether a graph must give it.
    pub required: bool,
    /// The keys that it sets, `node.parameter`.
    pub to: Vec<String>,
}

impl Check<'_> {
    /// What modules declare as outputs are wires of theirs.
    pub(super) fn outlets(&mut self, graph: &Graph, drafts: &[Draft<'_>]) {
        let used = graph.modules.iter().flat_map(|module| {
            let outputs = module.outputs.iter().flatten();
            outputs.map(|(name, wire, at)| (format!("output \"{name}\" of module \"{}\"", module.node), wire, at))
        });
        let own = graph.interface.iter().flat_map(|interface| &interface.outputs);
        let own = own.map(|outlet| (format!("module output \"{}\"", outlet.name), &outlet.from, &outlet.from_at));
        for (owner, wire, at) in used.chain(own) {
            wires::find(wire, at, &owner, drafts, &self.names, &mut self.faults);
        }
    }

    /// The ports that an input of the module at hand feeds take one type.
    pub(super) fn inlets(&mut self, interface: &Interface, drafts: &[Draft<'_>], inputs: &[Vec<Input>]) {
        for inlet in &interface.inputs {
            let mut first: Option<(&'static str, String)> = None;
            for (draft, input) in fed_by(&inlet.name, drafts, inputs) {
                let PortPayload::Type(ty) = input.port.payload else { continue };
                let port = format!("{}.{}", draft.name, input.port.name);
                match &first {
                    None => first = Some((ty.name, port)),
                    Some((name, other)) if *name != ty.name => {
                        let message = format!("module input \"{}\" feeds ports of different types", inlet.name);
                        let fault = Fault::new(message).at(&inlet.name_at, "cannot be both");
                        self.faults.push(fault.note(format!("{other} takes {name}, {port} takes {}", ty.name)));
                        break;
                    }
                    Some(_) => {}
                }
            }
        }
    }

    /// A module is no graph to run.
    pub(super) fn refuse_module(&mut self, at: &Span) {
        let fault = Fault::new("this is a module: other graphs use it, it does not run by itself");
        let fault = fault.at(at, "declares a module");
        let help =
            "use it as a node: kind = \"module\", file = \"..\"; osteoflow check and inspect take the file itself";
        self.faults.push(fault.help(help));
    }
}

fn fed_by<'a, 'd>(
    inlet: &str,
    drafts: &'a [Draft<'d>],
    inputs: &'a [Vec<Input>],
) -> impl Iterator<Item = (&'a Draft<'d>, &'a Input)> {
    let all = drafts.iter().zip(inputs).flat_map(|(draft, inputs)| inputs.iter().map(move |input| (draft, input)));
    all.filter(move |(_, input)| input.outside.as_deref() == Some(inlet))
}

/// What the module at hand declares.
pub(super) fn describe(
    interface: &Interface,
    name: &str,
    drafts: &[Draft<'_>],
    inputs: &[Vec<Input>],
    names: &wires::Names,
) -> ModuleDescription {
    let or = |said: &str, other: Option<String>| if said.is_empty() { other.unwrap_or_default() } else { said.into() };
    let input = |inlet: &crate::graph::Inlet| {
        let ports: Vec<_> = fed_by(&inlet.name, drafts, inputs).map(|(_, input)| input).collect();
        let mut joins: Vec<_> = ports.iter().map(|input| input.port.join.name()).collect();
        joins.dedup();
        ModuleInput {
            name: inlet.name.clone(),
            doc: or(&inlet.doc, ports.first().map(|input| one_line(input.port.doc))),
            payload: ports.first().map_or("any", |input| input.port.payload.name()),
            joins,
            optional: inlet.optional,
            to: inlet.to.iter().map(|(to, _)| to.clone()).collect(),
        }
    };
    let output = |outlet: &crate::graph::Outlet| {
        let wire = names.flat(&outlet.from, &outlet.from_at, "", &mut Vec::new());
        let wire = wire.and_then(|wire| {
            let (node, port) = wire.rsplit_once('.')?;
            let index = drafts.iter().position(|draft| draft.name == node)?;
            let port = drafts[index].outputs.as_ref()?.iter().position(|output| output.name == port)?;
            Some((index, port))
        });
        let payload = wire.and_then(|wire| inputs::output(wire, drafts)?.payload);
        let doc = wire.and_then(|(node, port)| match &drafts[node].kind?.description.outputs {
            osteoflow_node::OutputPorts::Fixed(ports) => Some(one_line(ports.get(port)?.doc)),
            osteoflow_node::OutputPorts::Declared { .. } => None,
        });
        ModuleOutput {
            name: outlet.name.clone(),
            doc: or(&outlet.doc, doc),
            payload: payload.map_or("any", |payload| payload.name()),
            from: outlet.from.clone(),
        }
    };
    let param = |knob: &crate::graph::Knob| {
        let property = knob.to.first().and_then(|(to, _)| {
            let (node, key) = to.split_once('.')?;
            let draft = drafts.iter().find(|draft| draft.name == node)?;
            draft.kind?.description.params.get("properties")?.get(key)
        });
        let doc = property.and_then(|property| Some(one_line(property.get("description")?.as_str()?)));
        let said = knob.to.first().and_then(|(to, _)| {
            let (node, key) = to.split_once('.')?;
            let draft = drafts.iter().find(|draft| draft.name == node)?;
            if key == "kind" { Some(draft.kind_name().into()) } else { draft.params.get(key).cloned() }
        });
        let default = if knob.required { None } else { knob.default.as_ref().map(|d| d.to_json()).or(said) };
        ModuleParam {
            name: knob.name.clone(),
            doc: or(&knob.doc, doc),
            default,
            required: knob.required,
            to: knob.to.iter().map(|(to, _)| to.clone()).collect(),
        }
    };
    ModuleDescription {
        name: name.into(),
        doc: interface.doc.clone(),
        inputs: interface.inputs.iter().map(input).collect(),
        outputs: interface.outputs.iter().map(output).collect(),
        params: interface.params.iter().map(param).collect(),
        nodes: drafts.iter().map(|draft| (draft.name.to_owned(), draft.kind_name().to_owned())).collect(),
    }
}

fn one_line(text: &str) -> String {
    let paragraph = text.split("\n\n").next().unwrap_or(text);
    paragraph.split_whitespace().collect::<Vec<_>>().join(" ")
}
