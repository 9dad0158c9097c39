//! The kind `hole.boundary`.

use super::{Out, answer};
use osteoflow_algorithms::hole::{self, HoleParams};
use osteoflow_geometry::Cloud;
use osteoflow_node::{Context, Describe, Inputs, NodeError, Unused, function};

/// The landmark under a laser spot, found in that scan alone as a gap with points all around it.
///
/// Needs no full scan, so the bone may have moved since then. The gap is searched in the camera's image and compared with the
/// surface around it. A spot at the silhouette is refused. Another gap of this size is mistaken for the spot, or is a second
/// candidate. Of 30 spots on two real bones, 23 were found within 0.9 mm (median 0.1 mm on a finely and 0.4 mm on a coarsely
/// meshed one) and 7 refused.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "hole.boundary"
in   = { cloud = "to_bone_laser.cloud" }
spot_radius_mm = 2.0
"#,
    literature = ["Bendels, Schnabel & Klein 2006, Detecting holes in point set surfaces"]
)]
pub struct Boundary;

/// Inputs of [`Boundary`].
#[derive(Inputs)]
pub struct In {
    /// The full scan that other detectors use; this one does not need it.
    #[port(join = "once", frame = "cloud")]
    reference: Unused<Cloud>,
    /// A scan with the laser spot, labelled with the landmark's name.
    cloud: Cloud,
}

#[function("hole.boundary")]
impl Boundary {
    fn process(params: &HoleParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let _ = i.reference;
        answer(&i.cloud, hole::boundary(&i.cloud, params), ctx)
    }
}
