//! The kind `cloud.merge`.

use osteoflow_algorithms::merge::merge;
use osteoflow_geometry::Cloud;
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// Several views of the bone as one cloud, in the bone's frame.
///
/// The merged cloud has no viewpoint, since several cameras saw it.
#[derive(Describe)]
#[describe(example = r#"
kind = "cloud.merge"
in   = { clouds = { from = "to_bone.cloud", n = 3 } }
"#)]
pub struct Merge;

/// Inputs of [`Merge`].
#[derive(Inputs)]
pub struct In {
    /// Views in one frame; all until the end, or `n` at a time.
    clouds: Vec<Cloud>,
}

/// Outputs of [`Merge`].
#[derive(Outputs)]
pub struct Out {
    /// All points, view after view.
    #[port(frame = "clouds")]
    cloud: Cloud,
}

#[function("cloud.merge")]
impl Merge {
    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        Ok(Out { cloud: merge(&i.clouds)? })
    }
}
