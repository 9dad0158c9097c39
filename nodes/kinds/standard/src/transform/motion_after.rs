//! The kind `transform.motion_after`.

use super::{TrackingParams, note_motion};
use osteoflow_algorithms::still_average::{Carries, StillReport, TakeMotion};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// How the markers moved around the time of a scan: before it, as `transform.to_bone_marker` gives it, and after it.
///
/// If a tracker's poses are late, the motion during a scan shows only after the scan's stamp. The window of
/// `transform.still_average` ends 500 ms after the stamp, or with the last sample before that: the node waits until the stamps
/// have reached that time. `after_ms` of an input sets another time. In a live run only the verdict waits for it.
#[derive(Describe)]
#[describe(example = r#"
kind = "transform.motion_after"
in   = { take_motion = "to_bone.take_motion", camera_motion = "camera_marker.motion", bone_motion = "bone_marker.motion" }
"#)]
pub struct MotionAfter;

/// Inputs of [`MotionAfter`].
#[derive(Inputs)]
pub struct In {
    /// How the markers moved in the time before the scan.
    take_motion: TakeMotion,
    /// How the camera's marker moved, from `transform.still_average`.
    #[port(join = "latest", after_ms = 500.0)]
    camera_motion: Option<StillReport>,
    /// How the bone's marker moved, from `transform.still_average`.
    #[port(join = "latest", after_ms = 500.0)]
    bone_motion: Option<StillReport>,
}

/// Outputs of [`MotionAfter`].
#[derive(Outputs)]
pub struct Out {
    /// How the markers moved in the time before the scan and after it: for the verdict.
    take_motion: TakeMotion,
}

#[function("transform.motion_after")]
impl MotionAfter {
    fn process(params: &TrackingParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let stamp_ns = ctx.stamp_ns();
        let In { mut take_motion, camera_motion, bone_motion } = i;
        let markers = [("camera", Carries::Data, camera_motion), ("bone", Carries::Frame, bone_motion)];
        for (marker, carries, motion) in markers {
            // A marker that is not wired, or that the bone does not have, carries nothing.
            if motion.is_none() && take_motion.markers.iter().all(|before| before.marker != marker) {
                continue;
            }
            let n_before = take_motion.after.len();
            take_motion = take_motion.followed_by(marker, carries, stamp_ns, motion.as_ref());
            if take_motion.after.len() > n_before {
                note_motion(marker, motion.as_ref(), params, &take_motion.what, "after", ctx);
            }
        }
        Ok(Out { take_motion })
    }
}
