//! Finds all faults of a graph in one pass, before any node fires, and plans it.

mod assemble;
mod build;
mod command_line_params;
mod context;
mod contracts;
mod declared;
mod faults;
mod feedback;
mod frames;
mod inherited;
mod inputs;
mod join;
mod missing_trigger;
mod module;
mod order;
mod parsed_nodes;
mod producers;
mod record;
mod resolved;
mod results;
mod schema;
mod starvation;
pub(crate) mod sweep;
mod wires;

pub use crate::graph::CommandLineParam;
pub use command_line_params::parameters;
pub use module::{Module, ModuleDescription, ModuleInput, ModuleOutput, ModuleParam};

use crate::{
    fault::{Fault, Faults, Severity},
    graph::{self, Graph, Sets, Variant, header},
    plan::Plan,
    plugin::{Kinds, Known},
};
use context::Check;
use osteoflow_node::{DeclaredPort, Place, Registry};
#[cfg(test)]
pub(crate) use resolved::pairs;
use schema::Files;
use std::path::{Path, PathBuf};

/// Default number of items that wait on a wire.
pub const DEFAULT_CAPACITY: usize = 4;

/// Default number of bytes that wait on a wire.
///
/// 256 MiB: eight seconds of a camera with clouds of 1 MB at 30 Hz, or an hour of poses at 250 Hz. A wire that needs
/// more most likely waits for something that never comes, and a dozen such wires still fit into a laptop's memory.
pub const DEFAULT_MAX_BYTES: u64 = 256 << 20;

/// A graph without faults.
#[derive(Debug)]
pub struct Checked {
    /// The plan of the run.
    pub plan: Plan,
    /// Warnings.
    pub warnings: Vec<Fault>,
    /// The kinds that the graph was checked with and is built from.
    pub registry: Registry,
    /// The contents of `[sweep]`, if the graph has it.
    pub sweep: Option<Box<sweep::Spec>>,
}

/// A file without faults: a graph, or a module that graphs use.
#[derive(Debug)]
pub enum CheckedFile {
    /// A graph that can be run.
    Graph(Checked),
    /// A module for use in other graphs.
    Module(Module),
}

/// Checks the graph file at `path` with the command line's settings, each `KEY=VALUE`.
///
/// # Errors
/// [`Faults`]: every fault of the file, of what it extends, of the modules it uses and of the settings.
pub fn check(path: &Path, sets: &[String], kinds: impl Into<Kinds>) -> Result<Checked, Faults> {
    let (graph, faults) = load(path, &[Sets::command_line(sets)])?;
    check_graph(&graph, path, &kinds.into(), Files::Needed, faults)
}

/// Checks the graph file of a sweep. The files that it names are those of no run if a factor replaces them, so they may be
/// missing here; those of the runs are checked with each.
pub(crate) fn check_sweep(path: &Path, sets: &[String], kinds: &Kinds) -> Result<Checked, Faults> {
    let (graph, faults) = load(path, &[Sets::command_line(sets)])?;
    check_graph(&graph, path, kinds, Files::Replaced, faults)
}

/// Checks a graph file for one run of its sweep, with the settings of the run's row, which are relative to the graph
/// file, and the variants that they name. Its `[sweep]` has been checked already.
pub(crate) fn check_row(
    path: &Path,
    sets: &[String],
    row: &[String],
    variants: &[Variant],
    kinds: &Kinds,
) -> Result<Checked, Faults> {
    let (mut graph, faults) = load(path, &[Sets::command_line(sets), Sets::row(row, path, variants)])?;
    graph.table.remove("sweep");
    check_graph(&graph, path, kinds, Files::Needed, faults)
}

/// Checks the text of a sweep's frozen graph, originally at `path`, with the run's settings and `sets`.
pub(crate) fn check_frozen(
    text: String,
    path: &Path,
    row: &[String],
    variants: &[Variant],
    sets: &[String],
    kinds: &Kinds,
) -> Result<Checked, Faults> {
    check_source(text, path, &[Sets::row(row, path, variants), Sets::command_line(sets)], kinds, Files::Needed)
}

/// Checks the file at `path`, which may be a graph or a module.
///
/// # Errors
/// [`Faults`]: every fault of the file, of what it extends, of the modules it uses and of the settings.
pub fn check_file(path: &Path, sets: &[String], kinds: impl Into<Kinds>) -> Result<CheckedFile, Faults> {
    let (graph, faults) = load(path, &[Sets::command_line(sets)])?;
    Check::new(&kinds.into().with(&graph.plugins), Files::Needed, faults).run(&graph, path)
}

/// A node by itself.
pub(crate) struct CheckedNode {
    pub(crate) kind: &'static str,
    pub(crate) params: serde_json::Value,
    pub(crate) declared: Vec<DeclaredPort>,
    pub(crate) place: Place,
}

/// Checks the text of a graph of one node whose wires lead nowhere, with settings; files that it names need not exist.
///
/// # Errors
/// [`Faults`]: every fault of the node and of the settings.
pub(crate) fn check_node(text: String, sets: &[String], known: &Known) -> Result<CheckedNode, Faults> {
    let mut faults = Vec::new();
    let graph = graph::load_text(text, Path::new("node"), &[Sets::command_line(sets)], &mut faults);
    Check::new(known, Files::Replaced, faults).lone_node(&graph)
}

/// The files of the graph: the graph file, the files it extends, the modules it uses and the libraries of plugins,
/// whether or not they can be read.
pub fn files(path: &Path, sets: &[String], kinds: impl Into<Kinds>) -> Vec<PathBuf> {
    let loaded = load(path, &[Sets::command_line(sets)]).ok();
    let (mut files, plugins) = loaded.map_or_else(|| (vec![path.into()], Vec::new()), |(g, _)| (g.texts, g.plugins));
    files.extend(kinds.into().files(&plugins));
    files
}

/// Checks the text of a graph file as if it were the file `virtual_path`, which its relative paths are relative to.
///
/// # Errors
/// [`Faults`]: every fault of the text, of what it extends and of the settings.
pub fn check_text(
    text: &str,
    virtual_path: &Path,
    sets: &[String],
    kinds: impl Into<Kinds>,
) -> Result<Checked, Faults> {
    check_source(text.into(), virtual_path, &[Sets::command_line(sets)], &kinds.into(), Files::Needed)
}

/// Checks the text of a graph whose sources are replayed from a recording; the files it names need not exist.
///
/// # Errors
/// [`Faults`]: every other fault.
pub fn check_recorded(
    text: &str,
    virtual_path: &Path,
    sets: &[String],
    kinds: impl Into<Kinds>,
) -> Result<Checked, Faults> {
    check_source(text.into(), virtual_path, &[Sets::command_line(sets)], &kinds.into(), Files::Replaced)
}

fn check_source(text: String, path: &Path, sets: &[Sets<'_>], kinds: &Kinds, files: Files) -> Result<Checked, Faults> {
    let mut faults = Vec::new();
    let graph = graph::load_text(text, path, sets, &mut faults);
    check_graph(&graph, path, kinds, files, faults)
}

fn load(path: &Path, sets: &[Sets<'_>]) -> Result<(Graph, Vec<Fault>), Faults> {
    let mut faults = Vec::new();
    match graph::load(path, sets, &mut faults) {
        Some(graph) => Ok((graph, faults)),
        None => Err(Faults(faults)),
    }
}

fn check_graph(graph: &Graph, path: &Path, kinds: &Kinds, files: Files, faults: Vec<Fault>) -> Result<Checked, Faults> {
    Check::new(&kinds.with(&graph.plugins), files, faults).graph(graph, path)
}

impl Check<'_> {
    /// Checks a graph; a module is a fault.
    fn graph(mut self, graph: &Graph, path: &Path) -> Result<Checked, Faults> {
        if let Some(interface) = &graph.interface {
            self.refuse_module(&interface.at);
        }
        match self.run(graph, path)? {
            CheckedFile::Graph(checked) => Ok(checked),
            CheckedFile::Module(_) => Err(Faults::default()),
        }
    }

    /// Checks the one node of a graph, but not its wires.
    fn lone_node(mut self, graph: &Graph) -> Result<CheckedNode, Faults> {
        let header = header::read(&graph.table, &graph.main, &mut self.faults);
        let nodes = self.parsed_nodes(graph, &header);
        let checked = nodes.into_iter().next().map(|node| CheckedNode {
            kind: node.kind_name(),
            params: node.params,
            declared: node.declared,
            place: node.place,
        });
        let errors = faults::sorted(self.faults).into_iter().filter(|fault| fault.severity == Severity::Error);
        let errors: Vec<_> = errors.collect();
        checked.filter(|_| errors.is_empty()).ok_or(Faults(errors))
    }

    fn run(mut self, graph: &Graph, path: &Path) -> Result<CheckedFile, Faults> {
        self.names = wires::Names { modules: graph.modules.clone(), removed: graph.removed.clone() };
        let header = header::read(&graph.table, &graph.main, &mut self.faults);
        let parsed_nodes = self.parsed_nodes(graph, &header);
        let parsed_nodes = self.without_unfed(parsed_nodes, graph);
        let inputs = self.inputs(&parsed_nodes, &header);
        self.check_outputs(graph, &parsed_nodes);
        if let Some(interface) = &graph.interface {
            self.check_inputs(interface, &parsed_nodes, &inputs);
            graph::no_results(&graph.table, "NODE.PORT", &mut self.faults);
        }
        let order = self.order(&parsed_nodes, &inputs);
        let frames = order.as_ref().map(|order| self.frames(&parsed_nodes, &inputs, &header, &order.nodes));
        if let Some(order) = &order {
            self.feedback(&parsed_nodes, &inputs, order);
            self.silences(&parsed_nodes, &inputs, order);
            self.faults.extend(starvation::faults(&parsed_nodes, &inputs, &order.nodes));
        }
        let record = self.record(graph, &parsed_nodes);
        let results = self.results(graph, &parsed_nodes);
        let sweep = sweep::read(graph, &mut self.faults).map(Box::new);
        let found = faults::add_uses(faults::sorted(self.faults));
        let (errors, warnings): (Vec<_>, Vec<_>) = found.into_iter().partition(|f| f.severity == Severity::Error);
        match (order, frames) {
            (Some(order), Some(frames)) if errors.is_empty() => {
                let describe =
                    |interface| module::describe(interface, &header.name, &parsed_nodes, &inputs, &self.names);
                let description = graph.interface.as_ref().map(describe);
                let plugins = assemble::plugins(self.known, &parsed_nodes);
                let order = order.nodes;
                let net = assemble::Net { header, plugins, parsed_nodes, inputs, order, frames, record, results };
                let plan = net.plan(path);
                Ok(match description {
                    Some(description) => CheckedFile::Module(Module { description, plan, warnings }),
                    None => {
                        CheckedFile::Graph(Checked { plan, warnings, registry: self.known.registry.clone(), sweep })
                    }
                })
            }
            _ => Err(Faults(errors.into_iter().chain(warnings).collect())),
        }
    }
}
