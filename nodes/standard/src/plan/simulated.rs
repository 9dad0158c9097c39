//! The kind `plan.simulated`.

use super::Out;
use osteoflow_node::{Context, Describe, NodeError, ParamError, Source, schemars::JsonSchema, serde::Deserialize};
use osteoflow_simulation::{
    bone::{self, BoneParams},
    plan,
};

/// The plan for the built-in bone.
#[derive(Describe)]
#[describe(example = r#"
kind = "plan.simulated"
"#)]
pub struct Simulated {
    params: Params,
    done: bool,
}

/// Parameters of [`Simulated`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// The bone; the same for every node that simulates it.
    pub bone: BoneParams,
}

impl Source for Simulated {
    const KIND: &'static str = "plan.simulated";
    const CONSTANT: bool = true;
    type Params = Params;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { params, done: false })
    }

    fn next(&mut self, _ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        if std::mem::replace(&mut self.done, true) {
            return Ok(None);
        }
        let bone = &self.params.bone;
        Ok(Some(plan(&bone::fibula(bone), &bone::anatomy(bone))?.into()))
    }
}
