//! The kind `hole.range_image`.

use super::{In, Out, answer};
use osteoflow_algorithms::hole::{self, HoleParams};
use osteoflow_node::{Context, Describe, NodeError, function};

/// The landmark under a laser spot, found in the camera's image grid.
///
/// Both scans are projected from the viewpoint of the scan with the laser; cells that only the full scan fills are the hole.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "hole.range_image"
in   = { reference = "to_bone.cloud", cloud = "to_bone_laser.cloud" }
spot_radius_mm = 2.0
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct RangeImage;

#[function("hole.range_image")]
impl RangeImage {
    fn process(params: &HoleParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        i.check()?;
        answer(&i.cloud, hole::range_image(&i.reference, &i.cloud, params), ctx)
    }
}
