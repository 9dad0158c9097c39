use super::{
    context::Check,
    inputs::{self, Input},
    parsed_nodes::ParsedNode,
    schema::first_paragraph,
    wires,
};
use crate::{
    fault::{Fault, Span},
    graph::{Graph, Interface},
    plan::Plan,
};
use osteoflow_node::PortPayload;
use serde::Serialize;

/// A module without faults, checked alone.
#[derive(Debug)]
pub struct Module {
    /// Its interface.
    pub description: ModuleDescription,
    /// The plan of its nodes; its inputs are not wired, so it cannot run.
    pub plan: Plan,
    /// Warnings.
    pub warnings: Vec<Fault>,
}

/// The interface of a module; missing docs are those of the inner nodes' kinds.
#[derive(Debug, Clone, Serialize)]
pub struct ModuleDescription {
    /// The name in `[graph]`, otherwise that of the file.
    pub name: String,
    /// Its doc.
    pub doc: String,
    /// Its inputs.
    pub inputs: Vec<ModuleInput>,
    /// Its outputs.
    pub outputs: Vec<ModuleOutput>,
    /// Its parameters.
    pub params: Vec<ModuleParam>,
    /// The inner nodes: names and kinds.
    pub nodes: Vec<(String, String)>,
}

/// An input of a module.
#[derive(Debug, Clone, Serialize)]
pub struct ModuleInput {
    /// Its name.
    pub name: String,
    /// Its doc; default: that of the inner port.
    pub doc: String,
    /// Its payload type.
    pub payload: &'static str,
    /// The distinct joins of the inner ports.
    pub joins: Vec<&'static str>,
    /// Whether it may be left unwired.
    pub optional: bool,
    /// The inner ports that it feeds, `node.port`.
    pub to: Vec<String>,
}

/// An output of a module.
#[derive(Debug, Clone, Serialize)]
pub struct ModuleOutput {
    /// Its name.
    pub name: String,
    /// Its doc; default: that of the inner port.
    pub doc: String,
    /// Its payload type.
    pub payload: &'static str,
    /// The inner wire, `node.port`.
    pub from: String,
}

/// A parameter of a module.
#[derive(Debug, Clone, Serialize)]
pub struct ModuleParam {
    /// Its name.
    pub name: String,
    /// Its doc; default: that of the inner parameter.
    pub doc: String,
    /// Its default; if `None`, the inner nodes keep their values.
    pub default: Option<serde_json::Value>,
    /// Whether a graph must set it.
    pub required: bool,
    /// The keys that it sets, `node.parameter`.
    pub to: Vec<String>,
}

impl Check<'_> {
    /// Checks that the outputs that modules declare are wires of theirs.
    pub(super) fn check_outputs(&mut self, graph: &Graph, parsed_nodes: &[ParsedNode<'_>]) {
        let used = graph.modules.iter().flat_map(|module| {
            let outputs = module.outputs.iter().flatten();
            outputs.map(|(name, wire, at)| (format!("output \"{name}\" of module \"{}\"", module.node), wire, at))
        });
        let own = graph.interface.iter().flat_map(|interface| &interface.outputs);
        let own = own.map(|output_decl| {
            (format!("module output \"{}\"", output_decl.name), &output_decl.from, &output_decl.from_at)
        });
        for (owner, wire, at) in used.chain(own) {
            wires::find(wire, at, &owner, parsed_nodes, &self.names, &mut self.faults);
        }
    }

    /// Checks that all ports fed by an input of the module take the same type.
    pub(super) fn check_inputs(
        &mut self,
        interface: &Interface,
        parsed_nodes: &[ParsedNode<'_>],
        inputs: &[Vec<Input>],
    ) {
        for input_decl in &interface.inputs {
            let mut first: Option<(&'static str, String)> = None;
            for (parsed_node, input) in fed_by(&input_decl.name, parsed_nodes, inputs) {
                let PortPayload::Type(ty) = input.port.payload else { continue };
                let port = format!("{}.{}", parsed_node.name, input.port.name);
                match &first {
                    None => first = Some((ty.name, port)),
                    Some((name, other)) if *name != ty.name => {
                        let message = format!("module input \"{}\" feeds ports of different types", input_decl.name);
                        let fault = Fault::new(message).at(&input_decl.name_at, "cannot be both");
                        self.faults.push(fault.note(format!("{other} takes {name}, {port} takes {}", ty.name)));
                        break;
                    }
                    Some(_) => {}
                }
            }
        }
    }

    /// The fault of a module that is run as a graph.
    pub(super) fn refuse_module(&mut self, at: &Span) {
        let fault = Fault::new("this is a module: other graphs use it, it does not run by itself");
        let fault = fault.at(at, "declares a module");
        let help =
            "use it as a node: kind = \"module\", file = \"..\"; osteoflow check and inspect take the file itself";
        self.faults.push(fault.help(help));
    }
}

fn fed_by<'a, 'd>(
    input_decl: &str,
    parsed_nodes: &'a [ParsedNode<'d>],
    inputs: &'a [Vec<Input>],
) -> impl Iterator<Item = (&'a ParsedNode<'d>, &'a Input)> {
    let all = parsed_nodes
        .iter()
        .zip(inputs)
        .flat_map(|(parsed_node, inputs)| inputs.iter().map(move |input| (parsed_node, input)));
    all.filter(move |(_, input)| input.wires.iter().any(|wire| wire.outside.as_deref() == Some(input_decl)))
}

/// The interface of the module being checked.
pub(super) fn describe(
    interface: &Interface,
    name: &str,
    parsed_nodes: &[ParsedNode<'_>],
    inputs: &[Vec<Input>],
    names: &wires::Names,
) -> ModuleDescription {
    let or = |own: &str, other: Option<String>| if own.is_empty() { other.unwrap_or_default() } else { own.into() };
    let input = |input_decl: &crate::graph::InputDecl| {
        let ports: Vec<_> = fed_by(&input_decl.name, parsed_nodes, inputs).map(|(_, input)| input).collect();
        let mut joins: Vec<_> = ports.iter().map(|input| input.port.join.name()).collect();
        joins.dedup();
        ModuleInput {
            name: input_decl.name.clone(),
            doc: or(&input_decl.doc, ports.first().map(|input| first_paragraph(input.port.doc))),
            payload: ports.first().map_or("any", |input| input.port.payload.name()),
            joins,
            optional: input_decl.optional,
            to: input_decl.to.iter().map(|(to, _)| to.clone()).collect(),
        }
    };
    let output = |output_decl: &crate::graph::OutputDecl| {
        let wire = names.flat(&output_decl.from, &output_decl.from_at, "", &mut Vec::new());
        let wire = wire.and_then(|wire| {
            let (node, port) = wire.rsplit_once('.')?;
            let index = parsed_nodes.iter().position(|parsed_node| parsed_node.name == node)?;
            let port = parsed_nodes[index].outputs.as_ref()?.iter().position(|output| output.name == port)?;
            Some((index, port))
        });
        let payload = wire.and_then(|wire| inputs::output(wire, parsed_nodes)?.payload);
        let doc = wire.and_then(|(node, port)| {
            Some(first_paragraph(parsed_nodes[node].kind?.description.outputs.fixed().get(port)?.doc))
        });
        ModuleOutput {
            name: output_decl.name.clone(),
            doc: or(&output_decl.doc, doc),
            payload: payload.map_or("any", |payload| payload.name()),
            from: output_decl.from.clone(),
        }
    };
    let param = |param_decl: &crate::graph::ParamDecl| {
        let inner = param_decl.to.first().and_then(|(to, _)| {
            let (node, key) = to.split_once('.')?;
            Some((parsed_nodes.iter().find(|parsed_node| parsed_node.name == node)?, key))
        });
        let property = inner.and_then(|(node, key)| node.kind?.description.params.get("properties")?.get(key));
        let doc = property.and_then(|property| Some(first_paragraph(property.get("description")?.as_str()?)));
        let inner_default = inner.and_then(|(node, key)| match key {
            "kind" => Some(node.kind_name().into()),
            _ => node.params.get(key).cloned(),
        });
        let default =
            if param_decl.required { None } else { param_decl.default.as_ref().map(|d| d.to_json()).or(inner_default) };
        ModuleParam {
            name: param_decl.name.clone(),
            doc: or(&param_decl.doc, doc),
            default,
            required: param_decl.required,
            to: param_decl.to.iter().map(|(to, _)| to.clone()).collect(),
        }
    };
    ModuleDescription {
        name: name.into(),
        doc: interface.doc.clone(),
        inputs: interface.inputs.iter().map(input).collect(),
        outputs: interface.outputs.iter().map(output).collect(),
        params: interface.params.iter().map(param).collect(),
        nodes: parsed_nodes
            .iter()
            .map(|parsed_node| (parsed_node.name.to_owned(), parsed_node.kind_name().to_owned()))
            .collect(),
    }
}
