use super::common::{Exit, Format, Global, graph_args, print_json, run_path, terminal, text_table::TextTable};
use crate::app::{GraphArgs, UsageError};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    CheckedFile, Faults,
    ages::{Part, Predicted, Times},
    plan::{Location, Plan},
};
use osteoflow_report::format::duration;
use serde_json::{Value as Json, json};
use std::{io::Write, path::PathBuf};

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
  osteoflow check graphs/fibula.toml --format json       faults with file, line and column, for editors
  osteoflow check graphs/fibula_tracking.toml --times runs/fibula_tracking    which contract of time cannot be kept")]
pub(crate) struct Check {
    #[command(flatten)]
    graph: GraphArgs,

    /// The folder of a run of the graph: how old values will be by its times, and which max_age_ms or deadline_ms cannot be kept.
    #[arg(long, value_name = "RUN")]
    times: Option<PathBuf>,
}

impl Check {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let Some(file) = graph_args::check_file(&self.graph, global)? else { return Ok(Exit::Usage) };
        let (plan, warnings, is_module) = match file {
            CheckedFile::Graph(checked) => (checked.plan, checked.warnings, false),
            CheckedFile::Module(module) => (module.plan, module.warnings, true),
        };
        let times =
            self.times.as_deref().map(|run| Times::of_run(&run_path::folder(run)).map_err(UsageError)).transpose()?;
        let predicted = times.map(|times| times.predict(&plan)).unwrap_or_default();
        let broken: Vec<_> = predicted.iter().filter(|predicted| !predicted.is_kept()).collect();
        let exit = if broken.is_empty() { Exit::Done } else { Exit::Usage };
        for predicted in broken.iter().filter(|_| global.format == Format::Text) {
            let Location { file, line, .. } = place(&plan, predicted);
            global.say("error", format_args!("{}:{line}: {}", file.display(), cannot_keep(predicted)))?;
        }
        match global.format {
            Format::Json => print_json(&json!({
                "outcome": exit.to_json(),
                "graph": plan.name,
                "module": is_module,
                "nodes": plan.nodes.len(),
                "wires": plan.links.len(),
                "warnings": Faults(warnings).to_json(),
                "times": predicted.iter().map(|predicted| to_json(&plan, predicted)).collect::<Vec<_>>(),
            }))?,
            Format::Text if !global.quiet => {
                let (graph, nodes, wires) = (self.graph.graph.display(), plan.nodes.len(), plan.links.len());
                let module = if is_module { "a module of " } else { "" };
                let warned = match warnings.len() {
                    0 => String::new(),
                    1 => ", 1 warning".into(),
                    n => format!(", {n} warnings"),
                };
                let broken = match broken.len() {
                    0 => String::new(),
                    1 => ", 1 contract cannot be kept".into(),
                    n => format!(", {n} contracts cannot be kept"),
                };
                writeln!(
                    terminal::stdout(),
                    "{graph}: {module}{nodes} nodes, {wires} wires, no faults{warned}{broken}"
                )?;
                if !predicted.is_empty() {
                    write!(terminal::stdout(), "\n{}", table(&predicted))?;
                }
            }
            Format::Text => {}
        }
        Ok(exit)
    }
}

/// The predicted times, and what they are made of.
fn table(predicted: &[Predicted]) -> String {
    let mut table = TextTable::new("by the times of the run", &["allowed", "99 % below", "of which"]);
    for predicted in predicted {
        let ms = |ns: Option<i64>, none: &str| ns.map_or_else(|| none.into(), |ns| duration(ns as f64 / 1e6));
        let cells = [ms(predicted.limit_ns, "-"), ms(predicted.ns, "no bound"), parts(predicted)];
        table.row(&predicted.on, cells);
    }
    table.lines()
}

/// The three longest parts.
fn parts(predicted: &Predicted) -> String {
    let part = |(what, ns): &(Part, i64)| match ns {
        0 => what.to_string(),
        ns => format!("{what} {}", duration(*ns as f64 / 1e6)),
    };
    predicted.parts.iter().take(3).map(part).collect::<Vec<_>>().join(", ")
}

fn cannot_keep(predicted: &Predicted) -> String {
    let Predicted { on, contract, limit_ns, ns, .. } = predicted;
    let key = contract.as_ref().map_or("max_age_ms", |(_, _, key)| key);
    let limit_ms = limit_ns.unwrap_or(0) as f64 / 1e6;
    let found = ns.map_or_else(|| "it has no bound".into(), |ns| format!("it needs {}", duration(ns as f64 / 1e6)));
    let help = match predicted.breaks() {
        Some(Part::Firing(node)) => format!("node \"{node}\" takes most of it; make it faster, or allow more"),
        Some(part) => format!("allow more, or change what takes most: {part}"),
        None => "allow more".into(),
    };
    format!("{on} cannot keep {key} = {limit_ms}: {found} ({}); {help}", parts(predicted))
}

/// Where the contract is set.
fn place<'p>(plan: &'p Plan, predicted: &Predicted) -> &'p Location {
    let (node, path) = predicted.contract.as_ref().map_or((0, ""), |(node, path, _)| (*node, path));
    let node = &plan.nodes[node];
    node.param_places.get(path).unwrap_or(&node.location)
}

fn to_json(plan: &Plan, predicted: &Predicted) -> Json {
    let ms = |ns: i64| ns as f64 / 1e6;
    let at = predicted.contract.as_ref().map(|_| place(plan, predicted));
    json!({
        "on": predicted.on, "kept": predicted.is_kept(), "limit_ms": predicted.limit_ns.map(ms), "predicted_ms": predicted.ns.map(ms),
        "breaks": predicted.breaks().filter(|_| !predicted.is_kept()).map(ToString::to_string),
        "parts": predicted.parts.iter().map(|(what, ns)| json!({ "what": what.to_string(), "ms": ms(*ns) })).collect::<Vec<_>>(),
        "file": at.map(|at| at.file.display().to_string()), "line": at.map(|at| at.line),
    })
}
