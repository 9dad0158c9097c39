//! What a plugin says of itself, in Rust's own words.

use osteoflow_node::abi::schema::PayloadDescription;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

/// A plugin's description.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PluginAbout {
    /// Its name.
    pub name: String,
    /// Its version.
    pub version: String,
    /// What it was built with.
    pub sdk: String,
    /// The compiler that built it.
    pub compiler: String,
    /// The interface that it speaks.
    pub abi: (u32, u32),
    /// Its kinds.
    pub kinds: Vec<KindAbout>,
    /// Payloads that its ports name, or that it defines.
    pub payloads: Vec<PayloadDescription>,
}

/// A kind as its plugin describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KindAbout {
    /// `stage.variant`.
    pub kind: String,
    /// What it gives.
    pub doc: String,
    /// JSON Schema of its parameters.
    pub params: Json,
    /// Its table in a graph file.
    pub example: String,
    /// Paper, section, equation.
    pub literature: Vec<String>,
    /// Node or source.
    pub role: osteoflow_node::Role,
    /// Whether it is a source of constants.
    pub constant: bool,
    /// Whether its answers are kept.
    pub kept: osteoflow_node::CachePolicy,
    /// Its inputs.
    pub inputs: Vec<InputAbout>,
    /// Its outputs.
    pub outputs: OutputsAbout,
}

/// An input as its plugin describes it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InputAbout {
    /// Name, payload and frames.
    pub port: PortAbout,
    /// How its items are chosen.
    pub join: osteoflow_node::Join,
    /// Whether it may stay unwired.
    pub optional: bool,
    /// Whether the kind does not need it.
    pub unused: bool,
}

/// What inputs and outputs have in common.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PortAbout {
    /// Its name.
    pub name: String,
    /// What it takes or gives.
    pub doc: String,
    /// Name and version of its payload; `None`: any.
    pub payload: Option<(String, u32)>,
    /// The frame of anything but a pose, and both of a pose.
    pub frames: [Option<String>; 3],
}

/// The outputs as a plugin describes them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum OutputsAbout {
    /// The kind's own.
    Fixed(Vec<PortAbout>),
    /// Declared in the graph, each with parameters of this JSON Schema.
    Declared(Json),
}
