use super::common::{Exit, Format, Global, graph_args, print_json, terminal};
use crate::app::GraphArgs;
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{Faults, plan::Plan};
use serde_json::json;
use std::{collections::BTreeMap, io::Write};

/// Print a graph with all defaults and included files filled in: one file with what extends, modules, --set and defaults bring in.
///
/// The output is a graph file itself, with every default, absolute paths and every recorded wire; it has the same plan and
/// gives the same results. A comment above each node names the place where it was written.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow expand graphs/variants/fibula_modules.toml
  osteoflow expand graphs/fibula.toml --set icp.kind=icp.point_to_point > flat.toml
  diff <(osteoflow expand a.toml) <(osteoflow expand b.toml)        the differences of two experiments")]
pub(crate) struct Expand {
    #[command(flatten)]
    graph: GraphArgs,
}

impl Expand {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let Some(checked) = graph_args::check(&self.graph, global)? else { return Ok(Exit::Usage) };
        let plan = &checked.plan;
        match global.format {
            Format::Json => print_json(&json!({
                "outcome": Exit::Done.to_json(),
                "graph": plan.name,
                "expanded": plan.resolved,
                "nodes": plan.nodes.iter().map(|node| json!({
                    "name": &*node.name,
                    "kind": node.kind,
                    "file": node.location.file.display().to_string(),
                    "line": node.location.line,
                })).collect::<Vec<_>>(),
                "warnings": Faults(checked.warnings.clone()).to_json(),
            }))?,
            Format::Text => write!(terminal::stdout(), "{}", commented(plan))?,
        }
        Ok(Exit::Done)
    }
}

/// The flat graph, with a comment above each node that names the place where it was written.
fn commented(plan: &Plan) -> String {
    let places: BTreeMap<String, String> = plan
        .nodes
        .iter()
        .map(|node| {
            let quoted = if node.name.contains('/') { format!("\"{}\"", node.name) } else { node.name.to_string() };
            (format!("[node.{quoted}]"), format!("# {}:{}\n", node.location.file.display(), node.location.line))
        })
        .collect();
    let mut out = String::new();
    for line in plan.resolved.lines() {
        out += places.get(line).map_or("", String::as_str);
        out += line;
        out.push('\n');
    }
    out
}
