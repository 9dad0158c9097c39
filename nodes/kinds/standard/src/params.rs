use osteoflow_node::{schemars::JsonSchema, serde::Deserialize};

/// The parameters of a kind without parameters.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NoParams {}

/// The default of `unit_mm` and of a speed.
pub(crate) fn one() -> f64 {
    1.0
}

/// The frame of a plan's coordinates.
pub(crate) fn ct() -> String {
    "ct".into()
}
