//! The kind `metrics.tre_true`.

use super::{TreOut, axes};
use crate::moved::Moved;
use osteoflow_algorithms::metrics::tre;
use osteoflow_geometry::{Axes, Mesh, NamedPoint, Points, Pose};
use osteoflow_node::{Context, Describe, Emit, Inputs, NodeError, function};
use osteoflow_payloads::Json;

/// Target registration error against the true registration, where it is known, as in a simulation.
///
/// Per point `e = t_ct_world * inverse(t_ct_world_true) * p - p`, signed, along the bone's axes; with `truth`, if CT and plan
/// may differ from the bone, `e = t_ct_world * truth - p`. A point that was planned elsewhere when the truth was made has its
/// truth by the true registration.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.tre_true"
in   = { planned = "plan.assessment", t_ct_world = "planes_at_scan.t_ct_world", t_ct_world_true = "recording.t_ct_world_true", truth = "recording.assessment_true", axes = "plan.axes", bone = "bone.mesh", plan = "plan.report" }
"#,
    literature = ["section 3.2.1 of the paper"]
)]
pub struct TreTrue;

/// Inputs of [`TreTrue`].
#[derive(Inputs)]
pub struct In {
    /// Points on the bone at which the error is evaluated.
    #[port(join = "once")]
    planned: Points,
    /// The registration.
    #[port(to = "planned", from = "t_ct_world_true.from")]
    t_ct_world: Pose,
    /// The true registration.
    #[port(join = "once", to = "planned", from = "t_ct_world.from")]
    t_ct_world_true: Pose,
    /// Where the planned points truly are in the world, by name.
    #[port(join = "once", frame = "t_ct_world.from")]
    truth: Option<Points>,
    /// The axes along which errors are resolved.
    #[port(join = "once", frame = "planned")]
    axes: Option<Axes>,
    /// The bone's surface, whose principal axes are used where the plan has none.
    #[port(join = "once", frame = "planned")]
    bone: Option<Mesh>,
    /// The report of the plan: which points were planned elsewhere when `truth` was made.
    #[port(join = "once")]
    plan: Option<Json>,
}

#[function("metrics.tre_true")]
impl TreTrue {
    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<TreOut, NodeError> {
        let error = i.t_ct_world.compose(&i.t_ct_world_true.inverse())?;
        let error = error.expect(&i.planned.frame, &i.planned.frame)?;
        let axes = axes(i.axes, i.bone.as_ref())?;
        axes.frame.expect(&i.planned.frame, "the axes")?;
        let report = match &i.truth {
            Some(truth) => {
                truth.frame.expect(&i.t_ct_world.from, "the true points")?;
                let moved = Moved::of(i.plan.as_ref()).assessment;
                let t_world_ct = i.t_ct_world_true.isometry.inverse();
                let kept = truth.points.iter().filter(|p| moved.iter().all(|name| **name != *p.name)).cloned();
                let now = i.planned.points.iter().filter(|p| moved.iter().any(|name| **name == *p.name));
                let now = now.map(|p| NamedPoint::new(&*p.name, t_world_ct * p.position));
                let truth: Vec<_> = kept.chain(now).collect();
                tre(&i.planned.points, &truth, &i.t_ct_world.isometry, &axes)?
            }
            None => tre(&i.planned.points, &i.planned.points, &error, &axes)?,
        };
        Ok(TreOut { report: Emit::Value(report) })
    }
}
