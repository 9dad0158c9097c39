//! A run or a sweep as one file, which can be run again elsewhere: graph, plugins, inputs, results and provenance.
//!
//! An archive is a zip whose files `experiment.json` lists with size and SHA-256. It names no folder of the machine on which it was
//! made. `ro-crate-metadata.json` describes it as a Workflow Run RO-Crate.

mod index;
mod pack;
mod renamed;
mod ro_crate;
mod same;
mod search;
mod unpack;

pub use pack::{ExportRequest, Exported};
pub use same::{Sameness, same};
pub use unpack::ArchiveArgs;

pub(crate) use index::{Entry, Index, Role};
pub(crate) use unpack::{index_of, is_archive};

/// The list of the files of an archive.
pub(crate) const INDEX: &str = "experiment.json";
/// The graph that is run again.
const GRAPH: &str = "graph.toml";
/// What the run or the sweep has left.
const RESULTS: &str = "results";
const README: &str = "README.md";
/// Packages of the plugins' interpreters, as pip reads them.
const REQUIREMENTS: &str = "requirements.lock";
