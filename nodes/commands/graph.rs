use super::common::{Exit, Global, graph_args, terminal};
use crate::app::{GraphArgs, Plugins, UsageError};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use osteoflow_draw::{Diagram, dot, mermaid, svg};
use osteoflow_engine::run::files;
use osteoflow_report::diagram;
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// Draw a graph, or a run: its times, and how many items went over each wire or were lost.
///
/// In the drawing of a run, nodes are coloured by their share of the time, wires are labelled with their numbers of items,
/// dropped items are red, and a failed node has a red frame, with the reason as its tooltip. Only the run's folder is needed.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow graph graphs/fibula.toml                          mermaid, for a page that renders it
  osteoflow graph graphs/fibula.toml --as svg > fibula.svg    for a browser; needs no other program
  osteoflow graph --run runs/fibula-20260314-092653 --as svg > run.svg
  osteoflow graph graphs/fibula.toml --as dot | dot -Tsvg > fibula.svg")]
pub(crate) struct Graph {
    /// The graph file.
    #[arg(required_unless_present = "run")]
    graph: Option<PathBuf>,

    /// Change any key of the graph: NODE.PARAMETER=VALUE, NODE.kind=KIND, graph.seed=7; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    #[command(flatten)]
    plugins: Plugins,

    /// Draw this run instead: its folder, or its manifest.json.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["graph", "sets", "plugins"])]
    run: Option<PathBuf>,

    /// The output format.
    #[arg(long = "as", value_enum, default_value_t = Language::Mermaid, value_name = "LANGUAGE")]
    language: Language,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Language {
    /// For Markdown pages.
    Mermaid,
    /// For Graphviz.
    Dot,
    /// For browsers and papers.
    Svg,
}

impl Graph {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let diagram = match (&self.run, &self.graph) {
            (Some(run), _) => of_run(run)?,
            (None, Some(graph)) => {
                let (graph, sets, plugins) = (graph.clone(), self.sets.clone(), self.plugins.clone());
                let Some(checked) = graph_args::check(&GraphArgs { graph, sets, plugins }, global)? else {
                    return Ok(Exit::Usage);
                };
                diagram::of_plan(&checked.plan)
            }
            (None, None) => return Err(UsageError("name a graph file, or a run by --run".into()).into()),
        };
        let drawn = match self.language {
            Language::Mermaid => mermaid(&diagram),
            Language::Dot => dot(&diagram),
            Language::Svg => svg(&diagram),
        };
        writeln!(terminal::stdout(), "{}", drawn.trim_end())?;
        Ok(Exit::Done)
    }
}

/// The diagram of a run, given its folder or its manifest.
fn of_run(run: &Path) -> Result<Diagram> {
    let path = if run.is_dir() { run.join(files::MANIFEST) } else { run.to_owned() };
    let shown = path.display();
    let text = osteoflow_engine::regular(&path)
        .and_then(std::fs::read_to_string)
        .with_context(|| format!("{shown} cannot be read; --run takes the folder of a run that has ended"))?;
    let manifest = serde_json::from_str(&text).with_context(|| format!("{shown} is not the manifest of a run"))?;
    diagram::of_manifest(&manifest).map_err(|why| anyhow::anyhow!("{shown} is not the manifest of a run: {why}"))
}
