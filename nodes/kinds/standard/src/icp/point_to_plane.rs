//! The kind `icp.point_to_plane`.

use super::{In, Out};
use osteoflow_algorithms::icp::{IcpParams, Method};
use osteoflow_node::{Context, Describe, Function, NodeError};

/// Fine registration of a bone surface onto the CT surface by point-to-plane ICP.
///
/// Minimises the distances along the target's normals. Points may slide along the surface, so a start millimetres off along
/// the bone takes a few more steps, not thousands.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "icp.point_to_plane"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
max_pair_distance_mm = 5.0
"#,
    literature = ["Chen & Medioni 1992", "Rusinkiewicz & Levoy 2001, section 3.5"]
)]
pub struct PointToPlane;

impl Function for PointToPlane {
    const KIND: &'static str = "icp.point_to_plane";
    type Params = IcpParams;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &IcpParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.register(Method::PointToPlane, params, ctx)
    }
}
