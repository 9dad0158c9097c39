mod module_docs;
mod node_docs;

use super::common::{Exit, Format, Global, graph_args, plugins, print_json, terminal};
use crate::app::{GraphArgs, Plugins, registry};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::{CheckedFile, plugin::Plugin};
use osteoflow_node::{Description, Registry};
use serde_json::json;
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
};

/// List the kinds of nodes and of data, or describe one: inputs, outputs, parameters and literature.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow inspect                        every kind, by stage
  osteoflow inspect icp                    the kinds of one stage
  osteoflow inspect icp.point_to_plane     one kind: ports, joins, parameters, example, literature
  osteoflow inspect icp.point_to_plane --format json
  osteoflow inspect graphs/modules/laser_point.toml        a module: inputs, outputs, parameters
  osteoflow inspect --plugin libmy_nodes.so my.kind        a kind of a plugin
  osteoflow inspect --payloads             the types of payloads
  osteoflow inspect --write-docs docs/nodes")]
pub(crate) struct Inspect {
    /// A kind such as `icp.point_to_plane`, a stage such as `icp`, or the file of a module; every kind if not given.
    kind: Option<String>,

    /// List the payload types: names for `type` in `out`, and the kinds that produce and take each.
    #[arg(long, conflicts_with_all = ["kind", "markdown", "write_docs"])]
    payloads: bool,

    /// List the plugins found by --plugin and OSTEOFLOW_PLUGIN_PATH: contents and build, or the reason for refusal.
    #[arg(long = "plugins", conflicts_with_all = ["kind", "payloads", "markdown", "write_docs"])]
    list_plugins: bool,

    #[command(flatten)]
    plugins: Plugins,

    /// Print Markdown, as in docs/nodes; also for a list of kinds.
    #[arg(long)]
    markdown: bool,

    /// Write a page for each stage into this folder, and remove the pages of stages that no longer exist.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["kind", "markdown"])]
    write_docs: Option<PathBuf>,
}

impl Inspect {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        if let Some(dir) = &self.write_docs {
            return write_docs(&registry(), dir);
        }
        let known = self.plugins.kinds()?.known();
        if self.list_plugins {
            return plugins::table(&known, global);
        }
        let exit = plugins::print_refused(&known, global)?;
        let registry = &known.registry;
        if self.payloads {
            return payloads(registry, global).map(|_| exit);
        }
        if let Some(file) = self.kind.as_deref().filter(|kind| is_file(kind, registry)) {
            return self.module(file, global);
        }
        let chosen = self.chosen(registry)?;
        let mut out = terminal::stdout().lock();
        let whole = self.kind.as_deref().is_some_and(|kind| registry.kind(kind).is_some());
        match global.format {
            Format::Json => {
                let kinds: Vec<_> = chosen.iter().flat_map(|(_, kinds)| kinds).collect();
                let of = |kind: &&Description| {
                    let mut value = json!(kind);
                    if let Some(plugin) = known.of_kind(kind.kind) {
                        let (description, file) = (&plugin.description, plugin.path.to_string_lossy());
                        value["plugin"] =
                            json!({ "name": description.name, "version": description.version, "file": file });
                    }
                    value
                };
                let value = if whole { of(kinds[0]) } else { kinds.into_iter().map(of).collect() };
                writeln!(out, "{}", serde_json::to_string_pretty(&value)?)?;
            }
            Format::Text if whole || self.markdown => {
                let texts = chosen.iter().flat_map(|(_, kinds)| kinds).map(|d| match known.of_kind(d.kind) {
                    Some(plugin) => format!("{}\n{}.\n", node_docs::markdown(d).trim_end(), from(plugin)),
                    None => node_docs::markdown(d),
                });
                write!(out, "{}", texts.collect::<Vec<_>>().join("\n"))?;
            }
            Format::Text => {
                let width = chosen.iter().flat_map(|(_, kinds)| kinds).map(|d| d.kind.len()).max().unwrap_or(0);
                for (stage, kinds) in &chosen {
                    writeln!(out, "{}", global.paint_out(stage, "1"))?;
                    for kind in kinds {
                        let from =
                            known.of_kind(kind.kind).map(|plugin| format!(" ({})", from(plugin))).unwrap_or_default();
                        writeln!(out, "  {:<width$}  {}{from}", kind.kind, kind.summary)?;
                    }
                }
            }
        }
        Ok(exit)
    }

    /// Describes a module.
    fn module(&self, file: &str, global: &Global) -> Result<Exit> {
        let graph = GraphArgs { graph: file.into(), sets: Vec::new(), plugins: self.plugins.clone() };
        let Some(checked) = graph_args::check_file(&graph, global)? else { return Ok(Exit::Usage) };
        let CheckedFile::Module(module) = checked else {
            usage!("{file} is a graph, not a module; `osteoflow check` and `osteoflow graph` show graphs");
        };
        match global.format {
            Format::Json => print_json(&json!(module.description))?,
            Format::Text => write!(terminal::stdout(), "{}", module_docs::markdown(&module.description, file))?,
        }
        Ok(Exit::Done)
    }

    /// The requested kinds, by stage.
    fn chosen<'r>(&self, registry: &'r Registry) -> Result<Vec<(&'r str, Vec<&'r osteoflow_node::Description>)>> {
        let all = node_docs::by_stage(registry);
        let Some(name) = &self.kind else { return Ok(all) };
        let fits = |stage: &str, kind: &str| kind == name || stage == name;
        let chosen = all.into_iter().filter_map(|(stage, kinds)| {
            let kinds: Vec<_> = kinds.into_iter().filter(|d| fits(stage, d.kind)).collect();
            (!kinds.is_empty()).then_some((stage, kinds))
        });
        let chosen: Vec<_> = chosen.collect();
        if chosen.is_empty() {
            let names = registry.kinds().map(|kind| kind.description.kind);
            let names = names.chain(node_docs::by_stage(registry).into_iter().map(|(stage, _)| stage));
            return Err(plugins::unknown("node or stage", name, names).into());
        }
        Ok(chosen)
    }
}

/// The origin of a kind.
fn from(plugin: &Plugin) -> String {
    let description = &plugin.description;
    format!("from plugin {} {} ({})", description.name, description.version, plugin.path.display())
}

/// Whether the argument names a file rather than a kind.
fn is_file(word: &str, registry: &Registry) -> bool {
    registry.kind(word).is_none() && (word.ends_with(".toml") || Path::new(word).is_file())
}

/// Lists the payload types with the kinds that produce and take each.
fn payloads(registry: &Registry, global: &Global) -> Result<Exit> {
    let gives = |name: &str| kinds_with(registry, |d| d.outputs.fixed().iter().any(|port| port.payload.name() == name));
    let takes =
        |name: &str| kinds_with(registry, |d| d.inputs.iter().any(|port| port.payload.name() == name && !port.unused));
    let types: Vec<_> = registry.payload_types().collect();
    if global.format == Format::Json {
        let rows = types.iter().map(|ty| {
            json!({ "type": ty.name, "version": ty.version, "interpolates": ty.interpolates, "given_by": gives(ty.name), "taken_by": takes(ty.name) })
        });
        print_json(&rows.collect())?;
        return Ok(Exit::Done);
    }
    let mut out = terminal::stdout().lock();
    for ty in types {
        let between = if ty.interpolates { "; joins by interpolate" } else { "" };
        writeln!(out, "{} (version {}{between})", global.paint_out(ty.name, "1"), ty.version)?;
        for (word, kinds) in [("given by", gives(ty.name)), ("taken by", takes(ty.name))] {
            let list =
                if kinds.is_empty() { "no kind; a source may declare it by out".into() } else { kinds.join(", ") };
            if word == "given by" || !kinds.is_empty() {
                writeln!(out, "  {word} {list}")?;
            }
        }
    }
    Ok(Exit::Done)
}

fn kinds_with(registry: &Registry, is: impl Fn(&Description) -> bool) -> Vec<&'static str> {
    registry.kinds().filter(|kind| is(&kind.description)).map(|kind| kind.description.kind).collect()
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
