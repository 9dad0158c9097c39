//! The kind `metrics.cuts`.

use super::axes;
use crate::moved::Moved;
use osteoflow_algorithms::metrics::{CutsReport, achieved, cuts};
use osteoflow_geometry::{Axes, Mesh, Plane, Planes, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};
use osteoflow_payloads::Json;

/// The error of the cuts against the planned ones, where the true registration is known.
///
/// A planned plane is carried to the world by the registration and back to CT by the true one; or, with `truth`, if CT and plan
/// may differ from the bone, by the motion from the plane that was meant to the planned one. A plane that was planned elsewhere
/// when the truth was made is carried back by the true registration. Reported are offset, tilt and roll where it meets the
/// bone, and the length of the segment between two planes.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.cuts"
in   = { planes = "plan.planes", t_ct_world = "planes_at_scan.t_ct_world", t_ct_world_true = "recording.t_ct_world_true", truth = "recording.planes_true", axes = "plan.axes", bone = "bone.mesh", plan = "plan.report" }
"#,
    literature = ["section 3.2.2 of the paper"]
)]
pub struct Cuts;

/// Inputs of [`Cuts`].
#[derive(Inputs)]
pub struct In {
    /// The planned planes.
    #[port(join = "once")]
    planes: Planes,
    /// The registration.
    #[port(to = "planes", from = "t_ct_world_true.from")]
    t_ct_world: Pose,
    /// The true registration.
    #[port(join = "once", to = "planes", from = "t_ct_world.from")]
    t_ct_world_true: Pose,
    /// Where the planned planes truly are in the world, by name.
    #[port(join = "once", frame = "t_ct_world.from")]
    truth: Option<Planes>,
    /// The bone's axes; roll is about z.
    #[port(join = "once", frame = "planes")]
    axes: Option<Axes>,
    /// The bone's surface: where the planes meet it.
    #[port(join = "once", frame = "planes")]
    bone: Option<Mesh>,
    /// The report of the plan: which planes were planned elsewhere when `truth` was made.
    #[port(join = "once")]
    plan: Option<Json>,
}

/// Outputs of [`Cuts`].
#[derive(Outputs)]
pub struct Out {
    /// Per plane and per segment.
    report: CutsReport,
}

#[function("metrics.cuts")]
impl Cuts {
    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let slip = i.t_ct_world_true.compose(&i.t_ct_world.inverse())?;
        let slip = slip.expect(&i.planes.frame, &i.planes.frame)?;
        let achieved = match &i.truth {
            Some(truth) => {
                truth.frame.expect(&i.t_ct_world.from, "the true planes")?;
                let moved = Moved::of(i.plan.as_ref()).planes;
                // The truth of a plane that moved is where the true registration has it.
                let is_moved = |p: &&Plane| moved.iter().any(|name| **name == *p.name);
                let now = i.planes.transformed(&i.t_ct_world.from, &i.t_ct_world_true.isometry.inverse());
                let kept = truth.planes.iter().filter(|p| !is_moved(p)).cloned();
                let truth: Vec<_> = kept.chain(now.planes.iter().filter(is_moved).cloned()).collect();
                achieved(&i.planes, &Planes::new(&i.t_ct_world.from, truth), &i.t_ct_world.isometry)?
            }
            None => i.planes.transformed(&i.planes.frame, &slip),
        };
        let axes = axes(i.axes, i.bone.as_ref())?;
        Ok(Out { report: cuts(&i.planes, &achieved, &axes, i.bone.as_ref())? })
    }
}
