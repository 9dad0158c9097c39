//! Reads values of a graph file after a JSON Schema as schemars writes it, and fills in what the schema gives by default.

mod files;
mod range;
mod read;
mod table;
mod union;
mod value_type;

use crate::fault::{Fault, Span};
use serde_json::Value as Json;
use std::path::PathBuf;

/// Whether the files that parameters name have to be there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Files {
    /// They are going to be read.
    Needed,
    /// A recording stands for them.
    Recorded,
}

/// What is read, and what is wrong with it.
pub(crate) struct Walker<'a> {
    /// The schema, whose `$defs` references name.
    pub(crate) root: &'a Json,
    /// How faults name what is read: `node "icp"`.
    pub(crate) owner: String,
    /// Its table in the graph: `node.icp`.
    pub(crate) path: String,
    /// What has the parameters: the kind.
    pub(crate) kind: &'a str,
    /// Where the kind is chosen.
    pub(crate) kind_at: Option<&'a Span>,
    /// Whether missing files are faults.
    pub(crate) files: Files,
    /// What is wrong.
    pub(crate) faults: Vec<Fault>,
    /// The files named, absolute.
    pub(crate) input_files: Vec<PathBuf>,
}

/// What is being read: its name, and what its author says of it.
#[derive(Clone)]
struct Quantity {
    name: String,
    doc: Option<String>,
}
