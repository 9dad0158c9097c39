use crate::{InputPort, OutputPorts};
use serde::Serialize;

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

/// Whether a kind has inputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Fires when its inputs join.
    Node,
    /// Answers by itself, in stamps of its own.
    Source,
    /// A source that follows the world's clock.
    LiveSource,
}
