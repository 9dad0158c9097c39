//! A plugin's description in Rust types.

use osteoflow_node::abi::schema::PayloadDescription;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

/// A plugin's description.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PluginDescription {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
    /// The SDK it was built with.
    pub sdk: String,
    /// The compiler that built it.
    pub compiler: String,
    /// The version of the plugin interface that it uses.
    pub abi: (u32, u32),
    /// Its kinds.
    pub kinds: Vec<KindDescription>,
    /// Payloads that its ports name, or that it defines.
    pub payloads: Vec<PayloadDescription>,
}

/// A kind as its plugin describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KindDescription {
    /// `stage.variant`.
    pub kind: String,
    /// Its doc.
    pub doc: String,
    /// JSON Schema of its parameters.
    pub params: Json,
    /// Its example table in a graph file.
    pub example: String,
    /// Paper, section, equation.
    pub literature: Vec<String>,
    /// Node or source.
    pub role: osteoflow_node::Role,
    /// Whether it is a source of constants.
    pub constant: bool,
    /// When its answers are cached.
    pub kept: osteoflow_node::CachePolicy,
    /// Its inputs.
    pub inputs: Vec<InputDescription>,
    /// Its outputs.
    pub outputs: OutputsDescription,
}

/// An input as its plugin describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InputDescription {
    /// Name, payload and frames.
    pub port: PortDescription,
    /// The default join.
    pub join: osteoflow_node::Join,
    /// Whether it may be left unwired.
    pub optional: bool,
    /// Whether the kind ignores it.
    pub unused: bool,
}

/// The common part of inputs and outputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PortDescription {
    /// Its name.
    pub name: String,
    /// Its doc.
    pub doc: String,
    /// Name and version of its payload; `None` accepts any.
    pub payload: Option<(String, u32)>,
    /// The frame of a payload other than a pose, then the `to` and `from` of a pose.
    pub frames: [Option<String>; 3],
}

/// The outputs as a plugin describes them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum OutputsDescription {
    /// Fixed by the kind.
    Fixed(Vec<PortDescription>),
    /// Declared in the graph, each with parameters of this JSON Schema.
    Declared(Json),
}
