//! Finds everything wrong with a graph in one pass, before any node is built, and plans it.

mod assemble;
mod declared;
mod drafts;
mod feed;
mod frames;
mod glob;
mod header;
mod inputs;
mod join;
pub(crate) mod nearest;
mod order;
mod record;
mod resolved;
mod results;
mod schema;
mod take;
mod trigger;
mod unit;
mod wires;

use crate::{
    fault::{Fault, Faults, Severity},
    graph::{self, Graph},
    plan::Plan,
};
use osteoflow_node::Registry;
use schema::Files;
use std::path::Path;

/// How many items wait on a wire, where the graph does not say.
pub const DEFAULT_CAPACITY: usize = 4;

/// How many bytes wait at most on a wire, where the graph does not say.
///
/// 256 MiB: eight seconds of a camera that gives clouds of 1 MB at 30 Hz, or an hour of poses at 250 Hz. A wire that needs
/// more waits for something that will hardly come, and a dozen such wires still fit into a laptop's memory.
pub const DEFAULT_MAX_BYTES: u64 = 256 << 20;

/// A graph without faults.
#[derive(Debug)]
pub struct Checked {
    /// What runs.
    pub plan: Plan,
    /// What is hardly meant.
    pub warnings: Vec<Fault>,
}

/// Checks the graph file at `path` with the command line's settings, each `KEY=VALUE`.
///
/// # Errors
/// [`Faults`]: every fault of the file, of what it extends and of the settings.
pub fn check(path: &Path, sets: &[String], registry: &Registry) -> Result<Checked, Faults> {
    let mut faults = Vec::new();
    match graph::load(path, sets, &mut faults) {
        Some(graph) => Check { registry, files: Files::Needed, faults }.run(&graph, path),
        None => Err(Faults(faults)),
    }
}

/// Checks the text of a graph file as if it stood at `virtual_path`, which its relative paths are relative to.
///
/// # Errors
/// [`Faults`]: every fault of the text, of what it extends and of the settings.
pub fn check_text(text: &str, virtual_path: &Path, sets: &[String], registry: &Registry) -> Result<Checked, Faults> {
    check_given(text, virtual_path, sets, registry, Files::Needed)
}

/// Checks the text of a graph whose sources are going to be played from a recording: the files it names may be gone.
///
/// # Errors
/// [`Faults`]: every other fault.
pub fn check_recorded(
    text: &str,
    virtual_path: &Path,
    sets: &[String],
    registry: &Registry,
) -> Result<Checked, Faults> {
    check_given(text, virtual_path, sets, registry, Files::Recorded)
}

fn check_given(text: &str, path: &Path, sets: &[String], registry: &Registry, files: Files) -> Result<Checked, Faults> {
    let mut faults = Vec::new();
    let graph = graph::load_text(text.into(), path, sets, &mut faults);
    Check { registry, files, faults }.run(&graph, path)
}

/// One check: what graphs may name, and the faults found so far.
struct Check<'r> {
    registry: &'r Registry,
    files: Files,
    faults: Vec<Fault>,
}

impl Check<'_> {
    fn run(mut self, graph: &Graph, path: &Path) -> Result<Checked, Faults> {
        let header = self.header(graph);
        let drafts = self.drafts(graph, &header);
        let inputs = self.inputs(&drafts, &header);
        let order = self.order(&drafts, &inputs);
        let frames = order.as_ref().map(|order| self.frames(&drafts, &inputs, &header, order));
        let record = self.record(graph, &drafts);
        let results = self.results(graph, &drafts);
        let faults = sorted(self.faults);
        let (errors, warnings): (Vec<_>, Vec<_>) = faults.into_iter().partition(|f| f.severity == Severity::Error);
        match (order, frames) {
            (Some(order), Some(frames)) if errors.is_empty() => {
                let net = assemble::Net { header, drafts, inputs, order, frames, record, results };
                Ok(Checked { plan: net.plan(path), warnings })
            }
            _ => Err(Faults(errors.into_iter().chain(warnings).collect())),
        }
    }
}

/// In the order of the texts. After a syntax fault, what may be no more than its consequence is left out.
fn sorted(mut faults: Vec<Fault>) -> Vec<Fault> {
    let hidden: Vec<_> = faults.iter().filter_map(|fault| fault.hides.clone()).collect();
    let consequence = |fault: &Fault| match &fault.at {
        Some((span, _)) => fault.follows || hidden.iter().any(|hidden| hidden.covers(span)),
        None => false,
    };
    faults.retain(|fault| hidden.is_empty() || fault.hides.is_some() || !consequence(fault));
    faults.sort_by_key(|fault| fault.at.as_ref().map(|(span, _)| span.key()));
    faults
}
