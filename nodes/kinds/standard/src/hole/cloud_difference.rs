//! The kind `hole.cloud_difference`.

use super::{In, Out, answer};
use osteoflow_algorithms::hole::{self, HoleParams};
use osteoflow_node::{Context, Describe, NodeError, function};

/// The landmark under a laser spot: the points of the full scan that the scan with the laser lacks.
///
/// The centre of the main cluster of missing points is the landmark. If the scan with the laser has a viewpoint, points are
/// compared as its camera sees them, so the hole is also found on a slanted surface. The hole must be large enough for ten
/// points, or for six if the distances to the other landmarks confirm it.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "hole.cloud_difference"
in   = { reference = "to_bone.cloud", cloud = "to_bone_laser.cloud" }
spot_radius_mm = 2.0
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct CloudDifference;

#[function("hole.cloud_difference")]
impl CloudDifference {
    fn process(params: &HoleParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.check()?;
        answer(&i.cloud, hole::cloud_difference(&i.reference, &i.cloud, params), ctx)
    }
}
