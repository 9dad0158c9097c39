//! The kind `transform.stylus_tip`.

use super::{TrackingParams, marker_motion, note_motion};
use osteoflow_algorithms::still_average::{Carries, StillReport, TakeMotion};
use osteoflow_geometry::{NamedPoint, Points, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// Touched points, recomputed from the stylus' tracked marker and its calibrated tip.
#[derive(Describe)]
#[describe(example = r#"
kind = "transform.stylus_tip"
in   = { touched = "recording.stylus_assessment", t_world_stylus_marker = "recording.stylus_marker", tip = "stylus.tip" }
"#)]
pub struct StylusTip;

/// Inputs of [`StylusTip`].
#[derive(Inputs)]
pub struct In {
    /// One touch, of which name and stamp are used.
    #[port(frame = "t_world_stylus_marker.to")]
    touched: Points,
    /// The marker on the stylus, at the touch.
    #[port(join = "interpolate", max_gap_ms = 1000.0, to = "touched")]
    t_world_stylus_marker: Pose,
    /// The tip in that marker's frame.
    #[port(join = "once", frame = "t_world_stylus_marker.from")]
    tip: Points,
    /// How the marker moved in the time before a touch, from `transform.still_average`.
    #[port(join = "latest")]
    motion: Option<StillReport>,
}

/// Outputs of [`StylusTip`].
#[derive(Outputs)]
pub struct Out {
    /// The touch at the position of the tip.
    #[port(frame = "touched")]
    points: Points,
    /// How the stylus' marker moved at the touch: for `transform.points_to_bone_marker` and the verdict.
    take_motion: TakeMotion,
}

#[function("transform.stylus_tip")]
impl StylusTip {
    fn process(params: &TrackingParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let [touch] = &i.touched.points[..] else {
            return Err(NodeError::new(format!("{} touches at once, where one is expected", i.touched.points.len())));
        };
        let tip = i.tip.points.first().ok_or_else(|| NodeError::new("the tip's list is empty"))?;
        let pose = i.t_world_stylus_marker.expect(&i.touched.frame, &i.tip.frame)?;
        let touch = NamedPoint { position: pose * tip.position, ..touch.clone() };
        note_motion("stylus", i.motion.as_ref(), params, &touch.name, "before", ctx);
        let stylus = marker_motion("stylus", Carries::Data, &i.t_world_stylus_marker, i.motion.as_ref());
        let take_motion = TakeMotion::new(&*touch.name).by(stylus);
        Ok(Out { take_motion, points: Points::new(&i.touched.frame, vec![touch]) })
    }
}
