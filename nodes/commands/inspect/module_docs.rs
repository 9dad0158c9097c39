//! Markdown documentation of a module.

use super::node_docs::{cell, heading};
use osteoflow_engine::check::ModuleDescription;
use std::fmt::Write as _;

/// A module with its ports and parameters, and an example of its use.
pub(crate) fn markdown(of: &ModuleDescription, file: &str) -> String {
    let mut out = format!("## {} (a module)\n", of.name);
    if !of.doc.is_empty() {
        let _ = write!(out, "\n{}\n", of.doc.trim());
    }
    out += &heading("Inputs", of.inputs.is_empty(), "| Input | Takes | Join | Feeds | |");
    for input in &of.inputs {
        let doc = if input.optional { format!("Optional. {}", input.doc) } else { input.doc.clone() };
        let joins: Vec<_> = input.joins.iter().map(|join| format!("`{join}`")).collect();
        let (joins, to, doc) = (joins.join(", "), code(&input.to), cell(&doc));
        let _ = writeln!(out, "| `{}` | `{}` | {joins} | {to} | {doc} |", input.name, input.payload);
    }
    out += &heading("Outputs", of.outputs.is_empty(), "| Output | Gives | Wire within | |");
    for output in &of.outputs {
        let _ =
            writeln!(out, "| `{}` | `{}` | `{}` | {} |", output.name, output.payload, output.from, cell(&output.doc));
    }
    out += &heading("Parameters", of.params.is_empty(), "| Name | Default | Sets | |");
    for param in &of.params {
        let default = match (&param.default, param.required) {
            (_, true) => "required".into(),
            (Some(default), _) => format!("`{default}`"),
            (None, _) => String::new(),
        };
        let _ = writeln!(out, "| `{}` | {default} | {} | {} |", param.name, code(&param.to), cell(&param.doc));
    }
    out += "\n**Nodes**\n\n";
    for (name, kind) in &of.nodes {
        let _ = writeln!(out, "- `{name}`: {kind}");
    }
    let wired = of.inputs.iter().filter(|input| !input.optional).map(|input| format!("{} = \"node.port\"", input.name));
    let wired: Vec<_> = wired.collect();
    let set = of.params.iter().filter(|param| param.required).map(|param| format!("{} = ..\n", param.name));
    let set: String = set.collect();
    let inputs = if wired.is_empty() { String::new() } else { format!("in   = {{ {} }}\n", wired.join(", ")) };
    let _ = write!(
        out,
        "\n**Example**\n\n```toml\n[node.{}]\nkind = \"module\"\nfile = \"{file}\"\n{inputs}{set}```\n",
        of.name
    );
    out
}

fn code(names: &[String]) -> String {
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
}
