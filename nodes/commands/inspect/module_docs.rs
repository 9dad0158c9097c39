//! Markdown documentation of a module.

use super::node_docs::{Entry, FirstKinds, list};
use osteoflow_engine::check::ModuleDescription;
use std::fmt::Write as _;

/// A module with its ports and parameters, and an example of its use.
pub(crate) fn markdown(of: &ModuleDescription, file: &str) -> String {
    let mut out = format!("## {} (a module)\n", of.name);
    if !of.doc.is_empty() {
        let _ = write!(out, "\n{}\n", of.doc.trim());
    }
    let inputs = of.inputs.iter().map(|input| {
        let joins: Vec<_> = input.joins.iter().map(|join| format!("`{join}`")).collect();
        let optional = if input.optional { "optional" } else { "" };
        let traits = vec![format!("`{}`", input.payload), joins.join(", "), optional.into()];
        Entry::new(&input.name, traits, code(&input.to), &input.doc)
    });
    let outputs = of.outputs.iter().map(|output| {
        let (payload, from) = (format!("`{}`", output.payload), format!("`{}`", output.from));
        Entry::new(&output.name, vec![payload], from, &output.doc)
    });
    let params = of.params.iter().map(|param| {
        let default = match (&param.default, param.required) {
            (_, true) => "required".into(),
            (Some(default), _) => format!("`{default}`"),
            (None, _) => String::new(),
        };
        Entry::new(&param.name, vec![default], code(&param.to), &param.doc)
    });
    let mut section = |title, entries: Vec<Entry>| list(&mut out, title, &entries, "", &mut FirstKinds::new());
    section("**Inputs** (type, join, what it feeds)", inputs.collect());
    section("**Outputs** (type, wire within)", outputs.collect());
    section("**Parameters** (default, what it sets)", params.collect());
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
