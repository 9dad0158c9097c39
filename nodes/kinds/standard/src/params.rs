use osteoflow_node::{schemars::JsonSchema, serde::Deserialize};

/// The parameters of a kind without parameters.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NoParams {}
