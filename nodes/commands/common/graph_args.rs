//! Checks of graphs whose faults and warnings are printed.

use super::{
    exit::Exit,
    global::{Format, Global},
    terminal::{self, print_json},
};
use crate::app::{GraphArgs, files::unless_data};
use anyhow::Result;
use osteoflow_engine::{Checked, CheckedFile, Fault, Faults};
use serde_json::{Value, json};
use std::io::Write;

/// Checks a graph and prints its warnings; `None` if it has faults, which are printed.
pub(crate) fn check(graph: &GraphArgs, global: &Global) -> Result<Option<Checked>> {
    or_faults(graph.checked(), |checked| &checked.warnings, global)
}

/// As [`check`], for a file that may be a module.
pub(crate) fn check_file(graph: &GraphArgs, global: &Global) -> Result<Option<CheckedFile>> {
    let file = osteoflow_engine::check_file(&graph.graph, &graph.sets, graph.plugins.kinds()?);
    fn warnings(file: &CheckedFile) -> &[Fault] {
        match file {
            CheckedFile::Graph(checked) => &checked.warnings,
            CheckedFile::Module(module) => &module.warnings,
        }
    }
    or_faults(unless_data(&graph.graph, file).map_err(Into::into), warnings, global)
}

/// What was checked, whose warnings are printed; `None` if it has faults, which are printed.
pub(crate) fn or_faults<T>(
    checked: Result<T>,
    warnings: impl Fn(&T) -> &[Fault],
    global: &Global,
) -> Result<Option<T>> {
    match checked.map_err(|error| error.downcast::<Faults>()) {
        Ok(checked) => warn(warnings(&checked), global).map(|()| Some(checked)),
        Err(Ok(faults)) => print_faults(&faults, global).map(|()| None),
        Err(Err(error)) => Err(error),
    }
}

/// Prints warnings about the graph.
pub(crate) fn warn(warnings: &[Fault], global: &Global) -> Result<()> {
    if !warnings.is_empty() && !global.quiet && global.format == Format::Text {
        writeln!(terminal::stderr(), "{}\n", Faults(warnings.to_vec()).render(global.colour_err()))?;
    }
    Ok(())
}

/// Prints all faults: as text on stderr, or as JSON on stdout.
pub(crate) fn print_faults(faults: &Faults, global: &Global) -> Result<()> {
    match global.format {
        Format::Text => writeln!(terminal::stderr(), "{}", faults.render(global.colour_err()))?,
        Format::Json => print_json(&as_json(faults))?,
    }
    Ok(())
}

/// The faults as one JSON value.
pub(crate) fn as_json(faults: &Faults) -> Value {
    json!({ "outcome": Exit::Usage.to_json(), "faults": faults.to_json() })
}
