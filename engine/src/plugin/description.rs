//! A plugin's description in Rust types.

use crate::plan::Loads;
use osteoflow_node::abi::schema::PayloadDescription;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;
use std::path::PathBuf;

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
    /// What it loads beside its file.
    #[serde(default)]
    pub loads: Loads,
    /// Files beside those of `loads` whose change may change the description.
    #[serde(default)]
    pub watched: Vec<PathBuf>,
}

impl PluginDescription {
    /// Whether another process describes the same library. What it has loaded is compared by itself.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        let rest = |of: &Self| Self { loads: Loads::default(), watched: Vec::new(), ..of.clone() };
        rest(self) == rest(other)
    }
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
    /// Whether its answers may differ though everything that it is given is the same.
    #[serde(default)]
    pub unsteady: bool,
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
