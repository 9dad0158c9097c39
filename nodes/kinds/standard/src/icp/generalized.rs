//! The kind `icp.generalized`.

use super::{In, Out};
use osteoflow_algorithms::icp::{IcpParams, Method};
use osteoflow_node::{Context, Describe, NodeError, function};

/// Fine registration by generalized ICP (GICP), plane to plane.
///
/// Minimises the Mahalanobis distances between planar Gaussians at both points. The scan's normals are estimated if it has
/// none, which takes longer than the registration itself.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "icp.generalized"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
max_pair_distance_mm = 5.0
"#,
    literature = ["Segal, Haehnel & Thrun 2009"]
)]
pub struct Generalized;

#[function("icp.generalized")]
impl Generalized {
    fn process(params: &IcpParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.register(Method::Generalized, params, ctx)
    }
}
