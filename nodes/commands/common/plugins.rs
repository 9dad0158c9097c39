//! Plugins of a command: search, inspection and listing.

use super::{
    exit::Exit,
    global::{Format, Global},
    terminal::{self, print_json},
    text_table::TextTable,
};
use crate::app::{FOLDERS, Plugins, UsageError};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    Faults,
    fault::Severity,
    plugin::{Kinds, Known},
};
use serde_json::{Value, json};
use std::{io::Write, path::PathBuf};

/// Plugins in addition to those of the graph.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct PluginArgs {
    /// A library with kinds of nodes, in addition to those that the graph names, or instead of one with the same file name;
    /// may be given again. OSTEOFLOW_PLUGIN_PATH names folders whose libraries are all loaded.
    #[arg(long = "plugin", value_name = "FILE")]
    plugins: Vec<PathBuf>,

    /// Load no plugins, whatever the graph, the environment or a recording names; kinds of plugins are then unknown.
    #[arg(long, conflicts_with_all = ["plugins", "python"])]
    no_plugins: bool,

    /// The interpreter for plugins in Python. Otherwise OSTEOFLOW_PYTHON, that of the active environment (VIRTUAL_ENV), or python3.
    #[arg(long, value_name = "FILE")]
    python: Option<PathBuf>,
}

impl PluginArgs {
    /// The libraries that the command line names.
    pub(crate) fn files(&self) -> &[PathBuf] {
        &self.plugins
    }

    /// As a request names them.
    pub(crate) fn plugins(&self) -> Plugins {
        Plugins { files: self.plugins.clone(), none: self.no_plugins, python: self.python.clone() }
    }

    /// As [`Plugins::kinds`].
    pub(crate) fn kinds(&self) -> Result<Kinds> {
        self.plugins().kinds()
    }

    /// As [`Plugins::kinds_apart`].
    pub(crate) fn kinds_apart(&self) -> Result<Kinds> {
        self.plugins().kinds_apart()
    }
}

/// Prints refused plugins on stderr; a plugin that was named explicitly is a fault.
pub(crate) fn print_refused(known: &Known, global: &Global) -> Result<Exit> {
    let faults = known.faults();
    let exit = match faults.iter().any(|fault| fault.severity == Severity::Error) {
        true => Exit::Usage,
        false => Exit::Done,
    };
    let shown: Vec<_> = faults.into_iter().filter(|f| !global.quiet || f.severity == Severity::Error).collect();
    if !shown.is_empty() {
        writeln!(terminal::stderr(), "{}\n", Faults(shown).render(global.colour_err()))?;
    }
    Ok(exit)
}

/// Prints a table of the plugins.
pub(crate) fn table(known: &Known, global: &Global) -> Result<Exit> {
    if global.format == Format::Json {
        let rows = known.plugins.iter().map(|plugin| {
            let description = &plugin.description;
            json!({
                "name": description.name, "version": description.version, "abi": description.abi, "sdk": description.sdk,
                "compiler": description.compiler, "file": plugin.path.to_string_lossy(), "sha256": &*plugin.sha256,
                "kinds": description.kinds.iter().map(|kind| &kind.kind).collect::<Vec<_>>(),
                "payloads": description.payloads.iter().map(|p| format!("{}@{}", p.name, p.version)).collect::<Vec<_>>(),
            })
        });
        let refused = known.refused.iter().map(|r| json!({ "file": r.path.to_string_lossy(), "why": r.why }));
        print_json(&json!({ "plugins": rows.collect::<Value>(), "refused": refused.collect::<Value>() }))?;
        return print_refused(known, &Global { quiet: true, ..global.clone() });
    }
    let mut out = terminal::stdout().lock();
    if known.plugins.is_empty() {
        writeln!(out, "no plugins; name one by --plugin FILE, or folders of them by {FOLDERS}")?;
    } else {
        let mut table = TextTable::new("plugin", &["version", "abi", "sdk", "compiler"]);
        for plugin in &known.plugins {
            let description = &plugin.description;
            let abi = format!("{}.{}", description.abi.0, description.abi.1);
            let kinds: Vec<_> = description.kinds.iter().map(|kind| kind.kind.as_str()).collect();
            let file = plugin.path.display().to_string();
            let about_it = format!("{} in {file}", kinds.join(", "));
            let cells =
                [description.version.clone(), abi, description.sdk.clone(), description.compiler.clone(), about_it];
            table.row(&description.name, cells);
        }
        writeln!(out, "{}", table.lines())?;
    }
    drop(out);
    print_refused(known, global)
}

/// The error of a kind or stage that is none of the known names.
pub(crate) fn unknown<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str>) -> UsageError {
    let near = osteoflow_engine::names::nearest(name, known);
    let near = near.map(|near| format!("did you mean \"{near}\"? ")).unwrap_or_default();
    UsageError(format!("there is no {what} \"{name}\"; {near}`osteoflow inspect` lists them"))
}
