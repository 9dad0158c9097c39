use super::{Exit, Global, GraphArgs};
use anyhow::Result;
use clap::{Args, ValueEnum};
use std::io::Write;

/// Draw a graph as text: nodes by stage, types and frames on the wires.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow graph graphs/fibula.toml                          mermaid, for a page that renders it
  osteoflow graph graphs/fibula.toml --as dot | dot -Tsvg > fibula.svg")]
pub(crate) struct Graph {
    #[command(flatten)]
    graph: GraphArgs,

    /// The language to draw in.
    #[arg(long = "as", value_enum, default_value_t = Language::Mermaid, value_name = "LANGUAGE")]
    language: Language,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Language {
    /// For Markdown pages.
    Mermaid,
    /// For Graphviz.
    Dot,
}

impl Graph {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let (_, Some(checked)) = self.graph.check(global)? else { return Ok(Exit::Usage) };
        let drawn = match self.language {
            Language::Mermaid => osteoflow_engine::draw::mermaid(&checked.plan),
            Language::Dot => osteoflow_engine::draw::dot(&checked.plan),
        };
        writeln!(std::io::stdout(), "{}", drawn.trim_end())?;
        Ok(Exit::Done)
    }
}
