//! The kind `plan.simulated`.

use super::Out;
use crate::own_bone::OwnBone;
use osteoflow_node::{Context, Describe, NodeError, ParamError, Source, schemars::JsonSchema, serde::Deserialize};
use osteoflow_simulation::BoneParams;

/// The plan for the simulated bone.
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
#[serde(default, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars", transform = osteoflow_simulation::without_table_defaults)]
pub struct Params {
    /// A bone of your own.
    #[serde(flatten)]
    pub own: OwnBone,
    /// The built-in bone, and what makes another of it. The same for every node that simulates it, but to simulate the
    /// plan of a wrong bone.
    pub bone: BoneParams,
}

impl Source for Simulated {
    const KIND: &'static str = "plan.simulated";
    const CONSTANT: bool = true;
    type Params = Params;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        let params = Params { own: params.own.checked(&params.bone)?, ..params };
        Ok(Self { params, done: false })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        if std::mem::replace(&mut self.done, true) {
            return Ok(None);
        }
        let subject = self.params.own.subject(&self.params.bone)?;
        subject.notes.into_iter().for_each(|note| ctx.warn(note));
        Ok(Some(subject.plan.into()))
    }
}
