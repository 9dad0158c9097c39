//! The kind `icp.point_to_mesh`.

use super::{In, Out};
use osteoflow_algorithms::icp::{IcpParams, Method};
use osteoflow_node::{Context, Describe, NodeError, function};

/// Fine registration by the closest points of the surface's triangles.
///
/// Without the error of sampling the surface. The target must have been prepared from a mesh. The search takes several times as
/// long as that of samples.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "icp.point_to_mesh"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
max_pair_distance_mm = 5.0
"#,
    literature = ["Besl & McKay 1992", "Pottmann, Huang, Yang & Hu 2006, section 3"]
)]
pub struct PointToMesh;

#[function("icp.point_to_mesh")]
impl PointToMesh {
    fn process(params: &IcpParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.register(Method::PointToMesh, params, ctx)
    }
}
