use super::common::{Exit, Format, Global, graph_args, print_json, terminal};
use crate::app::GraphArgs;
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{CheckedFile, Faults};
use serde_json::json;
use std::io::Write;

/// Check a graph without running it: every fault with its line, all in one pass.
///
/// Checks kinds, ports, parameters with their ranges, types and frames along the wires, cycles and missing files. No node is
/// built and no data is read.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow check graphs/fibula.toml
  osteoflow check graphs/modules/laser_point.toml        a module is also checked alone
  osteoflow check graphs/fibula.toml --set icp.kind=icp.point_to_point
  osteoflow check graphs/fibula.toml --format json       faults with file, line and column, for editors")]
pub(crate) struct Check {
    #[command(flatten)]
    graph: GraphArgs,
}

impl Check {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let Some(file) = graph_args::check_file(&self.graph, global)? else { return Ok(Exit::Usage) };
        let (plan, warnings, is_module) = match file {
            CheckedFile::Graph(checked) => (checked.plan, checked.warnings, false),
            CheckedFile::Module(module) => (module.plan, module.warnings, true),
        };
        match global.format {
            Format::Json => print_json(&json!({
                "outcome": Exit::Done.to_json(),
                "graph": plan.name,
                "module": is_module,
                "nodes": plan.nodes.len(),
                "wires": plan.links.len(),
                "warnings": Faults(warnings).to_json(),
            }))?,
            Format::Text if !global.quiet => {
                let (graph, nodes, wires) = (self.graph.graph.display(), plan.nodes.len(), plan.links.len());
                let module = if is_module { "a module of " } else { "" };
                let warned = match warnings.len() {
                    0 => String::new(),
                    1 => ", 1 warning".into(),
                    n => format!(", {n} warnings"),
                };
                writeln!(terminal::stdout(), "{graph}: {module}{nodes} nodes, {wires} wires, no faults{warned}")?;
            }
            Format::Text => {}
        }
        Ok(Exit::Done)
    }
}
