//! The kind `metrics.tre_measured`.

use super::{TreOut, axes};
use crate::{moved::Moved, transform::points::in_one_list};
use osteoflow_algorithms::metrics::tre;
use osteoflow_geometry::{Axes, Mesh, Points, Pose};
use osteoflow_node::{Context, Describe, Emit, Inputs, NodeError, function};
use osteoflow_payloads::Json;

/// Target registration error at points touched with a stylus, which includes the stylus' own error.
///
/// Per point `e = t_ct_bone_marker * p_measured - p_planned`, signed, along the bone's axes. A point that was planned elsewhere
/// when it was touched is left out, with a warning.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.tre_measured"
in   = { planned = "plan.assessment", measured = "assessment.points", t_ct_bone_marker = "icp.t_target_source", axes = "plan.axes", bone = "bone.mesh", plan = "plan.report" }
"#,
    literature = ["section 3.2.1 of the paper"]
)]
pub struct TreMeasured;

/// Inputs of [`TreMeasured`].
#[derive(Inputs)]
pub struct In {
    /// The assessment points as planned.
    #[port(join = "once")]
    planned: Points,
    /// The assessment points as touched, all until the end.
    #[port(join = "collect", frame = "t_ct_bone_marker.from")]
    measured: Vec<Points>,
    /// The registration.
    #[port(join = "once", to = "planned", from = "measured")]
    t_ct_bone_marker: Pose,
    /// The axes along which errors are resolved.
    #[port(join = "once", frame = "planned")]
    axes: Option<Axes>,
    /// The bone's surface, whose principal axes are used where the plan has none.
    #[port(join = "once", frame = "planned")]
    bone: Option<Mesh>,
    /// The report of the plan: which points were planned elsewhere when they were measured.
    #[port(join = "once")]
    plan: Option<Json>,
}

#[function("metrics.tre_measured")]
impl TreMeasured {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<TreOut, NodeError> {
        let measured = in_one_list(&i.measured)?;
        let t_ct_bone_marker = i.t_ct_bone_marker.expect(&i.planned.frame, &measured.frame)?;
        let axes = axes(i.axes, i.bone.as_ref())?;
        axes.frame.expect(&i.planned.frame, "the axes")?;
        let moved = Moved::of(i.plan.as_ref()).assessment;
        let (old, planned): (Vec<_>, Vec<_>) =
            i.planned.points.iter().cloned().partition(|p| moved.iter().any(|name| **name == *p.name));
        if !old.is_empty() {
            let names = old.iter().map(|p| &*p.name).collect::<Vec<_>>().join(", ");
            let message = format!("{names}: measured for a plan that had it elsewhere, or not at all");
            ctx.warn(format!("{message}; the old measurement is left out, touch it again"));
            if planned.is_empty() {
                return Ok(TreOut { report: Emit::Empty(format!("{message}; no measurement is left")) });
            }
        }
        Ok(TreOut { report: Emit::Value(tre(&planned, &measured.points, &t_ct_bone_marker, &axes)?) })
    }
}
