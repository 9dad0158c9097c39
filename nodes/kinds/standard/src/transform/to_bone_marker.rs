//! The kind `transform.to_bone_marker`.

use super::{Carried, TrackingParams, marker_motion, note_motion, pose_at};
use osteoflow_algorithms::point_times::{POINT_TIME, PointTimeUnit, point_times};
use osteoflow_algorithms::still_average::{Carries, MarkerPath, StillReport, TakeMotion};
use osteoflow_geometry::{Cloud, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};
use osteoflow_payloads::Flag;

/// A cloud in the frame of the marker on the bone, where clouds of different times coincide.
///
/// The marker's pose is that at the cloud's stamp. A marker that moved before the scan by more than the tracker's noise
/// explains is reported, since it smears the cloud. If `tracked` is false, the cloud stays in the world, and the bone must not
/// move between scans. Points whose times `transform.to_world` has read are each carried by the marker's pose at their own
/// time, if `path` is wired.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "transform.to_bone_marker"
in   = { cloud = "to_world.cloud", t_world_bone_marker = "bone_marker.pose", motion = "bone_marker.motion", path = "bone_marker.path" }
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct ToBoneMarker;

/// Inputs of [`ToBoneMarker`].
#[derive(Inputs)]
pub struct In {
    /// A cloud in the world.
    #[port(frame = "t_world_bone_marker.to")]
    pub(super) cloud: Cloud,
    /// The tracked marker on the bone.
    #[port(join = "interpolate", max_gap_ms = 500.0, to = "cloud")]
    pub(super) t_world_bone_marker: Option<Pose>,
    /// How the marker moved in the time before a sample, from `transform.still_average`.
    #[port(join = "latest")]
    pub(super) motion: Option<StillReport>,
    /// Whether the bone carries a marker at all. Unwired: it does.
    #[port(join = "once")]
    pub(super) tracked: Option<Flag>,
    /// How the camera's marker moved while the cloud was taken, from `transform.to_world`.
    pub(super) take_motion: Option<TakeMotion>,
    /// Where the marker was while the cloud was taken, from `transform.still_average`: up to 1 s after its stamp, or `after_ms`.
    #[port(join = "latest", after_ms = 1000.0)]
    pub(super) path: Option<MarkerPath>,
}

/// Outputs of [`ToBoneMarker`].
#[derive(Outputs)]
pub struct Out {
    /// The cloud in the bone marker's frame, or in the world where there is no such marker.
    #[port(frame = "t_world_bone_marker.from")]
    pub(super) cloud: Cloud,
    /// The pose of the bone marker; the world itself where there is no such marker.
    #[port(to = "t_world_bone_marker.to", from = "t_world_bone_marker.from")]
    t_world_bone_marker: Pose,
    /// How the markers of camera and bone moved while the cloud was taken: for the verdict.
    pub(super) take_motion: TakeMotion,
}

#[function("transform.to_bone_marker")]
impl ToBoneMarker {
    fn process(params: &TrackingParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let what = i.cloud.label.as_deref().unwrap_or("the scan");
        let mut pose = pose_at(&i.cloud.frame, i.t_world_bone_marker, i.tracked, what, ctx)?;
        // The world itself is no marker.
        let path = i.path.filter(|_| pose.to != pose.from);
        let has_times = i.cloud.extras().iter().any(|(name, _)| &**name == POINT_TIME);
        let times = if has_times { point_times(&i.cloud, PointTimeUnit::S).ok().flatten() } else { None };
        // An average lags behind a marker that moves, and points with poses of their own do not.
        if let Some(at_stamp) = path.as_ref().zip(times.as_ref()).and_then(|(p, _)| p.at(i.cloud.stamp_ns, 0).ok()) {
            pose.isometry = at_stamp;
        }
        let to_bone = pose.inverse();
        let on_bone = Some(&pose.isometry).filter(|_| pose.to != pose.from);
        let mut take_motion = i.take_motion.unwrap_or_else(|| TakeMotion::new(what));
        let by = Carried { marker: "bone", path: path.as_ref(), times: times.as_ref(), t_at_stamp: &to_bone };
        let (cloud, is_undone) = by.cloud(&i.cloud, |marker| marker.inverse())?;
        match take_motion.time.as_mut().filter(|_| is_undone) {
            Some(time) => time.undone.push("bone".to_owned()),
            None => note_motion("bone", i.motion.as_ref(), params, what, "before", ctx),
        }
        let bone = marker_motion("bone", Carries::Frame, &pose, i.motion.as_ref());
        let take_motion = take_motion.by(bone).during("bone", Carries::Frame, i.cloud.stamp_ns, path.as_ref());
        let take_motion = take_motion.on_bone(on_bone).carried(&to_bone.isometry);
        Ok(Out { cloud, take_motion, t_world_bone_marker: pose.at(i.cloud.stamp_ns) })
    }
}
