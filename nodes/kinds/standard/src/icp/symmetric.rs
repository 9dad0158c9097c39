//! The kind `icp.symmetric`.

use super::{In, Out};
use osteoflow_algorithms::icp::{IcpParams, Method};
use osteoflow_node::{Context, Describe, NodeError, function};

/// Fine registration by symmetric ICP.
///
/// Minimises the distances along the mean of both points' normals, which is exact if the bone is round. The scan's normals are
/// estimated if it has none, which takes longer than the registration itself.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "icp.symmetric"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
max_pair_distance_mm = 5.0
"#,
    literature = ["Rusinkiewicz 2019"]
)]
pub struct Symmetric;

#[function("icp.symmetric")]
impl Symmetric {
    fn process(params: &IcpParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.register(Method::Symmetric, params, ctx)
    }
}
