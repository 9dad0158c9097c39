//! The kind `plane.update`.

use osteoflow_geometry::{Planes, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// The planned cutting planes in the world, following the marker on the bone at the tracker's rate.
///
/// `t_world_plane = t_world_bone_marker * inverse(t_ct_bone_marker) * t_ct_plane`. While the marker is lost, the planes
/// are unknown, and the wire carries the reason; their last position is never used.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "plane.update"
in   = { planes = "plan.planes", t_ct_bone_marker = "icp.t_target_source", t_world_bone_marker = "recording.bone_marker" }
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct Update;

/// Inputs of [`Update`].
#[derive(Inputs)]
pub struct In {
    /// The planned planes, in CT.
    #[port(join = "once", frame = "t_ct_bone_marker.to")]
    planes: Planes,
    /// The registration.
    #[port(join = "once", to = "planes", from = "t_world_bone_marker.from")]
    t_ct_bone_marker: Pose,
    /// Samples of the marker on the bone.
    t_world_bone_marker: Option<Pose>,
}

/// Outputs of [`Update`].
#[derive(Outputs)]
pub struct Out {
    /// The planes at each sample.
    #[port(frame = "t_world_bone_marker.to")]
    planes: Planes,
}

#[function("plane.update")]
impl Update {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let Some(t_world_bone_marker) = i.t_world_bone_marker else {
            let why = ctx.absent_reason("t_world_bone_marker").unwrap_or("the bone marker is not tracked");
            return Ok(Out { planes: i.planes.unknown("world", ctx.stamp_ns(), why) });
        };
        let t_world_ct = t_world_bone_marker.compose(&i.t_ct_bone_marker.inverse())?;
        i.planes.frame.expect(&t_world_ct.from, "the planned planes")?;
        Ok(Out { planes: i.planes.transformed(&t_world_ct.to, &t_world_ct.isometry).at(ctx.stamp_ns()) })
    }
}
