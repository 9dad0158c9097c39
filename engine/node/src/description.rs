use crate::{FilePath, InputPort, OutputPorts};
use serde::{Deserialize, Serialize};

/// Description of a kind, available without building a node: the one source of `inspect`, docs/nodes, the editor schema
/// and the faults of `check`.
#[derive(Debug, Clone, Serialize)]
pub struct Description {
    /// `stage.variant`.
    pub kind: &'static str,
    /// One line: what the node gives.
    pub summary: String,
    /// Further paragraphs of the doc comment; may be empty.
    pub details: String,
    /// Node or source.
    pub role: Role,
    /// Whether it is a source of constants: one item on each output, at stamp 0.
    pub constant: bool,
    /// Whether its answers may differ though everything that it is given is the same.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub unsteady: bool,
    /// Whether answers are cached across runs.
    #[serde(rename = "kept")]
    pub cache: CachePolicy,
    /// Input ports; none for a source.
    pub inputs: Vec<InputPort>,
    /// Output ports.
    pub outputs: OutputPorts,
    /// JSON Schema of the parameters: types, defaults, ranges, docs.
    pub params: serde_json::Value,
    /// Example table for a graph file.
    pub example: &'static str,
    /// Paper, section, equation.
    pub literature: &'static [&'static str],
}

impl Description {
    /// Whether a parameter names a file, so that the answers also depend on its content.
    pub fn names_files(&self) -> bool {
        self.params.to_string().contains(FilePath::SCHEMA_FORMAT)
    }
}

/// Whether a kind has inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Fires when its inputs join.
    Node,
    /// Produces items by itself, with its own stamps.
    Source,
    /// A source that follows the world's clock.
    LiveSource,
}

/// Whether the answers of a kind are cached across runs, and what they depend on beside the program and the parameters.
/// A run that finds an answer in the store emits it instead of firing the node.
///
/// Worth it where a firing takes tens of milliseconds and inputs repeat. The node must not depend on earlier firings or
/// read files, and may use no more of its [`crate::Context`] than the policy says: otherwise the answer is not cached and
/// the run warns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CachePolicy {
    /// Computed at every firing.
    #[default]
    #[serde(rename = "no")]
    Never,
    /// Cached under the hash of the inputs.
    ByInputs,
    /// Cached under the hash of the inputs, run seed, node name and item number, for nodes that use
    /// [`crate::Context::rng`].
    ByInputsAndSeed,
}
