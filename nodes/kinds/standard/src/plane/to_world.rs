//! The kind `plane.to_world`.

use osteoflow_geometry::{Planes, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// The planned cutting planes in the world, where the bone was at the scan.
///
/// `t_ct_world = t_ct_bone_marker * inverse(t_world_bone_marker)`, with the marker's pose at the scan.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "plane.to_world"
in   = { planes = "plan.planes", t_ct_bone_marker = "icp.t_target_source", t_world_bone_marker = "to_bone.t_world_bone_marker" }
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct ToWorld;

/// Inputs of [`ToWorld`].
#[derive(Inputs)]
pub struct In {
    /// The planned planes, in CT.
    #[port(join = "once", frame = "t_ct_bone_marker.to")]
    planes: Planes,
    /// The registration.
    #[port(join = "once", to = "planes", from = "t_world_bone_marker.from")]
    t_ct_bone_marker: Pose,
    /// The pose of the bone marker at the scan.
    #[port(from = "t_ct_bone_marker.from")]
    t_world_bone_marker: Pose,
}

/// Outputs of [`ToWorld`].
#[derive(Outputs)]
pub struct Out {
    /// The planes at the scan.
    #[port(frame = "t_world_bone_marker.to")]
    planes: Planes,
    /// The registration at the scan: world to CT.
    #[port(to = "planes", from = "t_world_bone_marker.to")]
    t_ct_world: Pose,
}

#[function("plane.to_world")]
impl ToWorld {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let stamp_ns = ctx.stamp_ns();
        let t_ct_world = i.t_ct_bone_marker.compose(&i.t_world_bone_marker.inverse())?.at(stamp_ns);
        i.planes.frame.expect(&t_ct_world.to, "the planned planes")?;
        let planes = i.planes.transformed(&t_ct_world.from, &t_ct_world.isometry.inverse()).at(stamp_ns);
        Ok(Out { planes, t_ct_world })
    }
}
