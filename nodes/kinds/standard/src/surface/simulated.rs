//! The kind `surface.simulated`.

use crate::{
    constant::Constant,
    own_bone::{OwnBone, refused},
};
use osteoflow_geometry::Mesh;
use osteoflow_node::{Context, Describe, NodeError, Outputs, ParamError, schemars::JsonSchema, serde::Deserialize};
use osteoflow_payloads::Json;
use osteoflow_simulation::{BoneParams, CtParams};
use serde_json::json;
use std::sync::Arc;

/// The simulated bone's surface: from a simulated CT, or exact.
///
/// A CT surface differs from the bone by voxels, blur, noise and the threshold.
#[derive(Describe)]
#[describe(example = r#"
kind = "surface.simulated"
exact = false
"#)]
pub struct Simulated;

/// Parameters of [`Simulated`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
#[schemars(transform = osteoflow_simulation::without_table_defaults)]
pub struct Params {
    /// Whether the surface that the camera scans is given. false: the CT's, as in an operating room.
    pub exact: bool,
    /// A bone of your own.
    #[serde(flatten)]
    pub own: OwnBone,
    /// The built-in bone, and what makes another of it. The same for every node that simulates it, but to simulate the
    /// CT of a wrong bone.
    pub bone: BoneParams,
    /// The CT.
    pub ct: CtParams,
}

/// Outputs of [`Simulated`].
#[derive(Outputs)]
pub struct Out {
    /// The surface, once.
    #[port(frame = "@ct")]
    mesh: Mesh,
    /// The simulated CT's `frame_of_reference_uid`, by which the simulated plan is bound to it.
    report: Json,
}

impl Constant for Simulated {
    const KIND: &'static str = "surface.simulated";
    type Params = Params;
    type Outputs = Out;

    fn check(params: &Params) -> Result<(), ParamError> {
        params.own.check(&params.bone)?;
        if params.exact { Ok(()) } else { params.ct.check().map_err(refused) }
    }

    fn read(params: &Params, ctx: &mut Context) -> Result<Out, NodeError> {
        let Params { exact, own, bone, ct } = params;
        let mesh = if *exact { own.subject(bone)?.bone().clone() } else { own.ct_surface(bone, ct, ctx.seed())? };
        let report = json!({ "frame_of_reference_uid": own.frame_of_reference_uid(bone)? });
        Ok(Out { mesh, report: Json(Arc::new(report)) })
    }
}
