//! Plugins of a command: inspection and listing.

use super::{
    exit::Exit,
    global::{Format, Global},
    terminal::{self, print_json},
    text_table::TextTable,
};
use crate::app::{FOLDERS, UsageError};
use anyhow::Result;
use osteoflow_engine::{Faults, fault::Severity, plugin::Known};
use serde_json::{Value, json};
use std::io::Write;

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
    let near = osteoflow_engine::names::nearest::name(name, known);
    let near = near.map(|near| format!("did you mean \"{near}\"? ")).unwrap_or_default();
    UsageError(format!("there is no {what} \"{name}\"; {near}`osteoflow inspect` lists them"))
}
