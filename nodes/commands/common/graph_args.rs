use super::{
    exit::Exit,
    global::{Format, Global},
    plugins::PluginArgs,
    terminal::{self, print_json},
};
use crate::app::{Graph, RunRequest};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{Checked, CheckedFile, Fault, Faults, Module};
use serde_json::{Value, json};
use std::{io::Write, path::PathBuf};

/// A graph file and the changes that the command line makes to it.
#[derive(Debug, Clone, Args)]
pub(crate) struct GraphArgs {
    /// The graph file.
    pub(crate) graph: PathBuf,

    /// Change any key of the graph: NODE.PARAMETER=VALUE, NODE.kind=KIND, graph.seed=7; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) sets: Vec<String>,

    #[command(flatten)]
    pub(crate) plugins: PluginArgs,
}

impl GraphArgs {
    /// A run of it.
    pub(crate) fn request(&self) -> RunRequest {
        let (settings, plugins) = (self.sets.clone().into(), self.plugins.plugins());
        RunRequest { settings, plugins, ..RunRequest::new(&self.graph) }
    }

    /// Checks the graph and prints its warnings; `None` if it has faults, which are printed.
    pub(crate) fn check(&self, global: &Global) -> Result<Option<Checked>> {
        Ok(check(self.request(), global)?.map(|graph| graph.checked))
    }

    /// As [`Self::check`], for a file that may be a module.
    pub(crate) fn check_file(&self, global: &Global) -> Result<Option<CheckedFile>> {
        let file = osteoflow_engine::check_file(&self.graph, &self.sets, self.plugins.kinds()?);
        let file = or_faults(file.map_err(Into::into), global)?;
        if let Some(CheckedFile::Graph(Checked { warnings, .. }) | CheckedFile::Module(Module { warnings, .. })) = &file
        {
            warn(warnings, global)?;
        }
        Ok(file)
    }
}

/// Checks a graph and prints its warnings; `None` if it has faults, which are printed.
pub(crate) fn check(request: RunRequest, global: &Global) -> Result<Option<Graph>> {
    let graph = or_faults(request.checked(), global)?;
    graph.iter().try_for_each(|graph| warn(&graph.checked.warnings, global))?;
    Ok(graph)
}

/// What was checked; `None` if the graph has faults, which are printed.
pub(crate) fn or_faults<T>(checked: Result<T>, global: &Global) -> Result<Option<T>> {
    match checked.map_err(|error| error.downcast::<Faults>()) {
        Ok(checked) => Ok(Some(checked)),
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
