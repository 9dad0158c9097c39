//! The kind `metrics.laser_spot`.

use super::axes;
use crate::transform::points::in_one_list;
use osteoflow_algorithms::metrics::{LaserSpotReport, laser_spot};
use osteoflow_geometry::{Axes, Mesh, Points, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// The error of located laser spots against the true spots, and against the marks aimed at, in a simulation.
///
/// Per spot, located minus true, signed, along the bone's axes. Located points are in the world, at the full scan:
/// `transform.points` carries them there.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.laser_spot"
in   = { located = "laser_points.points", spots = "recording.laser_spots_true", marks = "recording.laser_marks_true", t_ct_world_true = "recording.t_ct_world_true", axes = "plan.axes", bone = "bone.mesh" }
"#,
    literature = ["section 4 of the paper"]
)]
pub struct LaserSpot;

/// Inputs of [`LaserSpot`].
#[derive(Inputs)]
pub struct In {
    /// The spots as located, all until the end.
    #[port(join = "collect", frame = "t_ct_world_true.from")]
    located: Vec<Points>,
    /// The true positions of the spots.
    #[port(join = "once", frame = "t_ct_world_true.from")]
    spots: Points,
    /// The marks that the laser was aimed at.
    #[port(join = "once", frame = "t_ct_world_true.from")]
    marks: Points,
    /// The true registration, which takes them to the frame of the axes.
    #[port(join = "once", from = "located")]
    t_ct_world_true: Pose,
    /// The axes along which errors are resolved.
    #[port(join = "once", frame = "t_ct_world_true.to")]
    axes: Option<Axes>,
    /// The bone's surface, whose principal axes are used where the plan has none.
    #[port(join = "once", frame = "t_ct_world_true.to")]
    bone: Option<Mesh>,
}

/// Outputs of [`LaserSpot`].
#[derive(Outputs)]
pub struct Out {
    /// Per spot and in summary, against the true spots and against the marks.
    report: LaserSpotReport,
}

#[function("metrics.laser_spot")]
impl LaserSpot {
    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let located = in_one_list(&i.located)?;
        let axes = axes(i.axes, i.bone.as_ref())?;
        let t_ct_world = i.t_ct_world_true.expect(&axes.frame, &located.frame)?;
        let truth = |points: &Points, what: &'static str| -> Result<Points, NodeError> {
            points.frame.expect(&located.frame, what)?;
            Ok(points.transformed(&axes.frame, &t_ct_world))
        };
        let (spots, marks) = (truth(&i.spots, "the true spots")?, truth(&i.marks, "the marks")?);
        Ok(Out { report: laser_spot(&located.points, &spots.points, &marks.points, &t_ct_world, &axes)? })
    }
}
