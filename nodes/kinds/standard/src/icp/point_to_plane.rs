//! The kind `icp.point_to_plane`.

use super::{In, Out};
use osteoflow_algorithms::icp::{IcpParams, Method};
use osteoflow_node::{Context, Describe, NodeError, function};

/// Fine registration by point-to-plane ICP.
///
/// Minimises the distances along the target's normals. Points may slide along the surface, so a start millimetres off along the
/// bone takes a few more steps, not thousands.
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

#[function("icp.point_to_plane")]
impl PointToPlane {
    fn process(params: &IcpParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.register(Method::PointToPlane, params, ctx)
    }
}
