//! The kind `icp.point_to_point`.

use super::{In, Out};
use osteoflow_algorithms::icp::{IcpParams, Method};
use osteoflow_node::{Context, Describe, NodeError, function};

/// Fine registration by point-to-point ICP, as in the paper.
///
/// Minimises the distances to the nearest samples. These resist a motion along the bone: a plain step recovers about a
/// thousandth of a slide. The report estimates the remaining distance; see `acceleration` and `stop_step_mm`.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "icp.point_to_point"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
max_pair_distance_mm = 5.0
"#,
    literature = ["Besl & McKay 1992", "section 2.3 of the paper"]
)]
pub struct PointToPoint;

#[function("icp.point_to_point")]
impl PointToPoint {
    fn process(params: &IcpParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.register(Method::PointToPoint, params, ctx)
    }
}
