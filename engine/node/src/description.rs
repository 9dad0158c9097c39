use crate::{FilePath, InputPort, OutputPorts};
use serde::{Deserialize, Serialize};

/// Everything known of a kind without building it: the one source of `inspect`, the docs, the schema and the faults.
#[derive(Debug, Clone, Serialize)]
pub struct Description {
    /// `stage.variant`.
    pub kind: &'static str,
    /// What it gives, in one line.
    pub summary: String,
    /// What else its author says, possibly nothing.
    pub details: String,
    /// Node or source.
    pub role: Role,
    /// Whether it is a source of constants: one item on each output, without a time (stamp 0).
    pub constant: bool,
    /// Whether its answers are kept from one run to the next.
    pub kept: Kept,
    /// Its input ports; none for a source.
    pub inputs: Vec<InputPort>,
    /// Its output ports.
    pub outputs: OutputPorts,
    /// JSON Schema of its parameters: types, defaults, ranges, docs.
    pub params: serde_json::Value,
    /// Its table in a graph file.
    pub example: &'static str,
    /// Paper, section, equation.
    pub literature: &'static [&'static str],
}

impl Description {
    /// Whether a parameter names a file, whose content then decides what the kind gives.
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
    /// Answers by itself, in stamps of its own.
    Source,
    /// A source that follows the world's clock.
    LiveSource,
}

/// Whether the answers of a kind are kept from one run to the next, and what decides them beside the program and the
/// parameters. A run that finds an answer in the store emits it instead of firing the node.
///
/// Worth it where computing takes tens of milliseconds and the same inputs come again. A node of such a kind remembers
/// nothing of earlier firings, reads no file, and takes from its [`crate::Context`] no more than it says here: an answer
/// for which it took more is not kept, and the run warns of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kept {
    /// It is computed at every firing.
    #[default]
    No,
    /// It is kept: what the input ports bring decides it.
    ByInputs,
    /// It is kept: so do the draws of [`crate::Context::rng`], which seed, node name and item decide.
    ByInputsAndSeed,
}
