use super::common::{Exit, Global, plugins, terminal};
use crate::app::Plugins;
use anyhow::Result;
use clap::Args;
use osteoflow_engine::schema;
use std::io::Write;

/// Write a JSON Schema, by which a text editor completes keys and marks faults in graphs or plans.
///
/// That of the graph is generated from the descriptions of the nodes. A TOML language server (taplo, Even Better TOML) finds it by the
/// first line of a graph: #:schema PATH, relative to the graph.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow schema > graphs/osteoflow.schema.json
  osteoflow schema --kind icp.point_to_plane       the table of one node
  osteoflow schema --plan                          the surgical plan, plan.json")]
pub(crate) struct Schema {
    /// Only the table of a node of this kind.
    #[arg(long, value_name = "KIND")]
    kind: Option<String>,

    /// The schema of plan.json instead.
    #[arg(long, conflicts_with = "kind")]
    plan: bool,

    #[command(flatten)]
    plugins: Plugins,
}

/// The schema of a plan.
const PLAN: &str = include_str!("../../graphs/plan.schema.json");

impl Schema {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        if self.plan {
            write!(terminal::stdout(), "{PLAN}")?;
            return Ok(Exit::Done);
        }
        let known = self.plugins.kinds()?.known();
        let exit = plugins::print_refused(&known, global)?;
        let registry = known.registry;
        let schema = match &self.kind {
            None => schema::schema(&registry),
            Some(kind) => {
                let kinds = registry.kinds().map(|kind| kind.description.kind);
                schema::kind_schema(&registry, kind).ok_or_else(|| plugins::unknown("kind", kind, kinds))?
            }
        };
        writeln!(terminal::stdout(), "{}", serde_json::to_string_pretty(&schema)?)?;
        Ok(exit)
    }
}
