//! The kind `metrics.cuts`.

use super::axes;
use osteoflow_algorithms::metrics::{CutsReport, achieved, cuts};
use osteoflow_geometry::{Axes, Mesh, Planes, Pose};
use osteoflow_node::{Context, Describe, Function, Inputs, NodeError, Outputs};

/// The error of the cuts against the planned ones, where the true registration is known.
///
/// A planned plane is carried to the world by the registration and back to CT by the true one, or, with `truth`, where CT and
/// plan may differ from the bone, by the motion from the plane that was meant to the planned one. Reported are offset, tilt
/// and roll where it meets the bone, and the length of the segment between two planes.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.cuts"
in   = { planes = "plan.planes", t_ct_world = "planes_at_scan.t_ct_world", t_ct_world_true = "recording.t_ct_world_true", truth = "recording.planes_true", axes = "plan.axes", bone = "bone.mesh" }
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
}

/// Outputs of [`Cuts`].
#[derive(Outputs)]
pub struct Out {
    /// Per plane and per segment.
    report: CutsReport,
}

impl Function for Cuts {
    const KIND: &'static str = "metrics.cuts";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let slip = i.t_ct_world_true.compose(&i.t_ct_world.inverse())?;
        let slip = slip.expect(&i.planes.frame, &i.planes.frame)?;
        let achieved = match &i.truth {
            Some(truth) => {
                truth.frame.expect(&i.t_ct_world.from, "the true planes")?;
                achieved(&i.planes, truth, &i.t_ct_world.isometry)?
            }
            None => i.planes.transformed(&i.planes.frame, &slip),
        };
        let axes = axes(i.axes, i.bone.as_ref())?;
        Ok(Out { report: cuts(&i.planes, &achieved, &axes, i.bone.as_ref())? })
    }
}
