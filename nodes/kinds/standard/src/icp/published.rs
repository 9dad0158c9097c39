//! The kind `icp.published`.

use super::{In, Out};
use osteoflow_algorithms::icp::{PublishedParams, register_published};
use osteoflow_node::{Context, Describe, NodeError, function};

/// Fine registration by plain point-to-point ICP, under one of the stop rules that the paper may have used.
///
/// The paper does not say when it stops. Each `reading` takes plain steps on all points, without weights, and stops by its own
/// rule; the report's `left_mm` says how far from the minimum. `icp.point_to_point` minimises the same cost to the end.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "icp.published"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "coarse.t_target_source" }
reading        = "iterations"
max_iterations = 50
"#,
    literature = ["Besl & McKay 1992", "section 2.3 of the paper"]
)]
pub struct Published;

#[function("icp.published")]
impl Published {
    fn process(params: &PublishedParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.run(params.stop_after_ms, ctx, |target, source, init, observer| {
            register_published(target, source, init, params, observer)
        })
    }
}
