//! The kind `icp.symmetric`.

use super::{In, Out, own_rules};
use osteoflow_algorithms::icp::{IcpParams, Method};
use osteoflow_node::{Context, Describe, Node, NodeError, ParamError};

/// Fine registration of a bone surface onto the CT surface by symmetric ICP.
///
/// Each point is drawn along the mean of its own normal and its partner's, which is exact where the bone is round. Its
/// normals are estimated where the cloud has none, which takes longer than the registration itself.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "icp.symmetric"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
max_pair_distance_mm = 5.0
"#,
    literature = ["Rusinkiewicz 2019"]
)]
pub struct Symmetric(IcpParams);

impl Node for Symmetric {
    const KIND: &'static str = "icp.symmetric";
    type Params = IcpParams;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: IcpParams) -> Result<Self, ParamError> {
        Ok(Self(own_rules(params)?))
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.register(Method::Symmetric, &self.0, ctx)
    }
}
