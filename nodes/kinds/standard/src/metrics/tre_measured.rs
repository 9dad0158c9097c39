//! The kind `metrics.tre_measured`.

use super::{TreOut, axes};
use crate::transform::points::in_one_list;
use osteoflow_algorithms::metrics::tre;
use osteoflow_geometry::{Axes, Mesh, Points, Pose};
use osteoflow_node::{Context, Describe, Function, Inputs, NodeError};

/// Target registration error at points touched with a stylus, which includes the stylus' own error.
///
/// Per point `e = t_ct_bone_marker * p_measured - p_planned`, signed, along the bone's axes.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.tre_measured"
in   = { planned = "plan.assessment", measured = "assessment.points", t_ct_bone_marker = "icp.t_target_source", axes = "plan.axes", bone = "bone.mesh" }
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
}

impl Function for TreMeasured {
    const KIND: &'static str = "metrics.tre_measured";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = TreOut;

    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<TreOut, NodeError> {
        let measured = in_one_list(&i.measured)?;
        let t_ct_bone_marker = i.t_ct_bone_marker.expect(&i.planned.frame, &measured.frame)?;
        let axes = axes(i.axes, i.bone.as_ref())?;
        axes.frame.expect(&i.planned.frame, "the axes")?;
        Ok(TreOut { report: tre(&i.planned.points, &measured.points, &t_ct_bone_marker, &axes)? })
    }
}
