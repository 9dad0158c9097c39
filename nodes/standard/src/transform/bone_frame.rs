use osteoflow_algorithms::still_average::StillReport;
use osteoflow_geometry::{Frame, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, NodeError, schemars, serde};
use osteoflow_payloads::Flag;
use schemars::JsonSchema;
use serde::Deserialize;

/// Parameters of the nodes that carry data by a tracked marker.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct TrackingParams {
    /// Marker motion around a scan above which it is reported. 0.1 mm: three times a tracker's noise of 0.03 mm.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub flag_motion_above_mm: f64,
}

impl Default for TrackingParams {
    fn default() -> Self {
        Self { flag_motion_above_mm: 0.1 }
    }
}

/// The frame in which the bone does not move: its marker's, or the world.
pub(crate) struct BoneFrame(TrackingParams);

impl BoneFrame {
    pub(crate) fn new(params: TrackingParams) -> Self {
        Self(params)
    }

    /// The marker's pose at the time of `what`, or the world itself where the bone carries no marker.
    pub(crate) fn pose_at(
        &self,
        world: &Frame,
        marker: Option<Pose>,
        tracked: Option<Flag>,
        what: &str,
        ctx: &Context,
    ) -> Result<Pose, NodeError> {
        if tracked == Some(Flag(false)) {
            return Ok(Pose::new(world, world, Isometry3::identity()));
        }
        let Some(pose) = marker else {
            let why = ctx.absent_reason("t_world_bone_marker").unwrap_or("nothing is wired to it");
            return Err(NodeError::new(format!(
                "the bone marker was not seen at the time of {what}: {why}; a pose from another time would be stale"
            )));
        };
        world.expect(&pose.to, "what is carried over")?;
        Ok(pose)
    }

    /// Reports a marker that moved while the scan was taken.
    pub(crate) fn note_motion(&self, motion: Option<&StillReport>, what: &str, ctx: &mut Context) {
        note_motion("bone", motion, self.0.flag_motion_above_mm, what, ctx);
    }
}

/// Reports a marker that moved by more than `limit_mm` while the scan was taken.
pub(crate) fn note_motion(marker: &str, motion: Option<&StillReport>, limit_mm: f64, what: &str, ctx: &mut Context) {
    // The means of the window's halves lie half of the window's motion apart.
    let Some((motion, moved_mm)) = motion.map(|m| (m, 2.0 * m.drift_mm)).filter(|(_, moved)| *moved > limit_mm) else {
        return;
    };
    ctx.warn(format!(
        "the {marker} marker moved by {moved_mm:.2} mm over the {} samples before {what} was taken (more than {limit_mm} \
         mm): the cloud may be smeared",
        motion.n
    ));
}
