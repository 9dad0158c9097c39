//! The kind `transform.points_to_bone_marker`.

use super::{TrackingParams, marker_motion, note_motion, pose_at};
use osteoflow_algorithms::still_average::{Carries, StillReport, TakeMotion};
use osteoflow_geometry::{Points, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};
use osteoflow_payloads::Flag;

/// Points touched in the world, in the frame of the marker on the bone.
///
/// Each point is transformed by the marker's pose at its own stamp. For clouds see `transform.to_bone_marker`.
#[derive(Describe)]
#[describe(example = r#"
kind = "transform.points_to_bone_marker"
in   = { points = "recording.stylus_assessment", t_world_bone_marker = "bone_marker.pose" }
"#)]
pub struct PointsToBoneMarker;

/// Inputs of [`PointsToBoneMarker`].
#[derive(Inputs)]
pub struct In {
    /// Points in the world.
    #[port(frame = "t_world_bone_marker.to")]
    points: Points,
    /// The tracked marker on the bone.
    #[port(join = "interpolate", max_gap_ms = 500.0, to = "points")]
    t_world_bone_marker: Option<Pose>,
    /// Whether the bone carries a marker at all. Unwired: it does.
    #[port(join = "once")]
    tracked: Option<Flag>,
    /// How the marker moved in the time before a touch, from `transform.still_average`.
    #[port(join = "latest")]
    motion: Option<StillReport>,
    /// How the stylus' marker moved at the touch, from `transform.stylus_tip`.
    take_motion: Option<TakeMotion>,
}

/// Outputs of [`PointsToBoneMarker`].
#[derive(Outputs)]
pub struct Out {
    /// The points in the bone marker's frame, or in the world where there is no such marker.
    #[port(frame = "t_world_bone_marker.from")]
    points: Points,
    /// The pose of the bone marker; the world itself where there is no such marker.
    #[port(to = "t_world_bone_marker.to", from = "t_world_bone_marker.from")]
    t_world_bone_marker: Pose,
    /// How the bone's marker moved while the points were touched: for the verdict.
    take_motion: TakeMotion,
}

#[function("transform.points_to_bone_marker")]
impl PointsToBoneMarker {
    fn process(params: &TrackingParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let what = i.points.points.first().map_or("a point", |p| &*p.name);
        let pose = pose_at(&i.points.frame, i.t_world_bone_marker, i.tracked, what, ctx)?;
        note_motion("bone", i.motion.as_ref(), params, what, "before", ctx);
        let to_bone = pose.inverse();
        // The world itself is no marker.
        let on_bone = Some(&pose.isometry).filter(|_| pose.to != pose.from);
        let bone = marker_motion("bone", Carries::Frame, &pose, i.motion.as_ref());
        let take_motion =
            i.take_motion.unwrap_or_else(|| TakeMotion::new(what)).by(bone).on_bone(on_bone).carried(&to_bone.isometry);
        let points = i.points.transformed(&to_bone.to, &to_bone.isometry);
        Ok(Out { points, take_motion, t_world_bone_marker: pose.at(ctx.stamp_ns()) })
    }
}
