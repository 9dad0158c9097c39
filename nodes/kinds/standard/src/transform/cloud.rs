//! The kind `transform.cloud`.

use osteoflow_geometry::{Cloud as CloudPayload, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// A cloud in another frame, by a pose: a scan on the CT, for export.
#[derive(Describe)]
#[describe(example = r#"
kind = "transform.cloud"
in   = { cloud = "to_bone.cloud", pose = "icp.t_target_source" }
"#)]
pub struct Cloud;

/// Inputs of [`Cloud`].
#[derive(Inputs)]
pub struct In {
    /// The cloud.
    #[port(frame = "pose.from")]
    cloud: CloudPayload,
    /// The pose that is applied: from the cloud's frame to the one wanted.
    #[port(from = "cloud")]
    pose: Pose,
}

/// Outputs of [`Cloud`].
#[derive(Outputs)]
pub struct Out {
    /// The cloud in the frame that the pose leads to.
    #[port(frame = "pose.to")]
    cloud: CloudPayload,
}

#[function("transform.cloud")]
impl Cloud {
    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        i.cloud.frame.expect(&i.pose.from, "the cloud")?;
        Ok(Out { cloud: i.cloud.transformed(&i.pose.to, &i.pose.isometry) })
    }
}
