use super::{Exit, Format, Global, UsageError, node_docs, registry};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_node::Registry;
use serde_json::json;
use std::{fs, io::Write, path::PathBuf};

/// Show which nodes there are, and what one of them takes, gives and needs.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow inspect                        every kind, by stage
  osteoflow inspect icp                    the kinds of one stage
  osteoflow inspect icp.point_to_plane     one kind: ports, joins, parameters, example, literature
  osteoflow inspect icp.point_to_plane --format json
  osteoflow inspect --write-docs docs/nodes")]
pub(crate) struct Inspect {
    /// A kind such as `icp.point_to_plane`, or a stage such as `icp`; everything if not given.
    kind: Option<String>,

    /// Print Markdown, as in docs/nodes, for a list of kinds too.
    #[arg(long)]
    markdown: bool,

    /// Write a page for each stage into this folder, and remove the pages of stages that are gone.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["kind", "markdown"])]
    write_docs: Option<PathBuf>,
}

impl Inspect {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let registry = registry();
        if let Some(dir) = &self.write_docs {
            return write_docs(&registry, dir);
        }
        let chosen = self.chosen(&registry)?;
        let mut out = std::io::stdout().lock();
        let whole = self.kind.as_deref().is_some_and(|kind| registry.kind(kind).is_some());
        match global.format {
            Format::Json => {
                let kinds: Vec<_> = chosen.iter().flat_map(|(_, kinds)| kinds).collect();
                let value = if whole { json!(kinds[0]) } else { json!(kinds) };
                writeln!(out, "{}", serde_json::to_string_pretty(&value)?)?;
            }
            Format::Text if whole || self.markdown => {
                let texts = chosen.iter().flat_map(|(_, kinds)| kinds).map(|d| node_docs::markdown(d));
                write!(out, "{}", texts.collect::<Vec<_>>().join("\n"))?;
            }
            Format::Text => {
                let width = chosen.iter().flat_map(|(_, kinds)| kinds).map(|d| d.kind.len()).max().unwrap_or(0);
                for (stage, kinds) in &chosen {
                    writeln!(out, "{}", global.paint_out(stage, "1"))?;
                    for kind in kinds {
                        writeln!(out, "  {:<width$}  {}", kind.kind, kind.summary)?;
                    }
                }
            }
        }
        Ok(Exit::Done)
    }

    /// The kinds asked for, by stage.
    fn chosen<'r>(&self, registry: &'r Registry) -> Result<Vec<(&'r str, Vec<&'r osteoflow_node::Description>)>> {
        let all = node_docs::by_stage(registry);
        let Some(asked) = &self.kind else { return Ok(all) };
        let fits = |stage: &str, kind: &str| kind == asked || stage == asked;
        let chosen = all.into_iter().filter_map(|(stage, kinds)| {
            let kinds: Vec<_> = kinds.into_iter().filter(|d| fits(stage, d.kind)).collect();
            (!kinds.is_empty()).then_some((stage, kinds))
        });
        let chosen: Vec<_> = chosen.collect();
        if chosen.is_empty() {
            let said = format!("no node or stage is called \"{asked}\"; `osteoflow inspect` lists them");
            return Err(UsageError(said).into());
        }
        Ok(chosen)
    }
}

fn write_docs(registry: &Registry, dir: &PathBuf) -> Result<Exit> {
    fs::create_dir_all(dir).with_context(|| format!("{} cannot be made a folder", dir.display()))?;
    let pages = node_docs::pages(registry);
    for entry in fs::read_dir(dir)? {
        let path = entry?.path();
        let ours = path.file_name().and_then(|n| n.to_str()).is_some_and(|n| pages.iter().any(|(page, _)| page == n));
        if !ours && path.extension().is_some_and(|e| e == "md") {
            fs::remove_file(&path).with_context(|| format!("{} cannot be removed", path.display()))?;
        }
    }
    for (name, text) in pages {
        let path = dir.join(name);
        fs::write(&path, text).with_context(|| format!("{} cannot be written", path.display()))?;
    }
    Ok(Exit::Done)
}
