//! The kind `plan.simulated`.

use super::Out;
use crate::{constant::Constant, own_bone::OwnBone};
use osteoflow_geometry::{SurfaceKey, SurgicalPlan};
use osteoflow_node::{Context, Describe, NodeError, ParamError, schemars::JsonSchema, serde::Deserialize};
use osteoflow_simulation::{BoneParams, DisplacedParams, displaced};

/// The plan for the simulated bone, bound to the surface that `surface.simulated` gives of the same bone.
#[derive(Describe)]
#[describe(example = r#"
kind = "plan.simulated"
"#)]
pub struct Simulated;

/// Parameters of [`Simulated`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(transform = osteoflow_simulation::without_table_defaults)]
pub struct Params {
    /// A bone of your own.
    #[serde(flatten)]
    pub own: OwnBone,
    /// The built-in bone, and what makes another of it. The same for every node that simulates it, but to simulate the
    /// plan of a wrong bone.
    pub bone: BoneParams,
    /// A plan that was drawn beside its place.
    pub displaced: DisplacedParams,
}

impl Constant for Simulated {
    const KIND: &'static str = "plan.simulated";
    type Params = Params;
    type Outputs = Out;

    fn check(params: &Params) -> Result<(), ParamError> {
        params.own.check(&params.bone)
    }

    fn read(params: &Params, ctx: &mut Context) -> Result<Out, NodeError> {
        let subject = params.own.subject(&params.bone)?;
        subject.notes.into_iter().for_each(|note| ctx.warn(note));
        // A displaced plan was drawn in another series, so nothing binds it to this surface.
        let surface = (params.displaced == DisplacedParams::default())
            .then(|| params.own.frame_of_reference_uid(&params.bone))
            .transpose()?
            .map(|uid| SurfaceKey { frame_of_reference_uid: Some(uid), ..SurfaceKey::default() });
        let plan = SurgicalPlan { surface, ..subject.plan };
        Ok(Out::new(displaced(plan, &params.displaced)?, false, None))
    }
}
