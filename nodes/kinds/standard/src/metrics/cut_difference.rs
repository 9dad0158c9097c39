//! The kind `metrics.cut_difference`.

use crate::transform::points::in_one_list;
use osteoflow_algorithms::metrics::{CutDifferenceParams, CutDifferenceReport, cut_difference, error_at_points};
use osteoflow_geometry::{Mesh, Planes, Points, Pose, nalgebra::Isometry3};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// The difference between the bone fragment of the executed cuts and the planned one.
///
/// Two planes cut a closed fragment out of the bone: the planned ones, and the executed ones, which the registration's error
/// displaces. The fragments are compared in place (the error of the cuts), and after the executed one was moved back by the
/// inverse of the error (the error of its shape; no best fit). Each comparison is by vertices, by distances to the other's
/// surface, and by distances to the bone's own surface alone, in both directions. The error is the true one and, with measured
/// assessment points, the paper's: the motion that best carries the planned points to the measured ones, as registered.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.cut_difference"
in   = { planes = "plan.planes", bone = "bone.mesh", t_ct_world = "planes_at_scan.t_ct_world", t_ct_world_true = "recording.t_ct_world_true", planned = "plan.assessment", measured = "assessment.points", t_ct_bone_marker = "icp.t_target_source" }
"#,
    literature = [
        "sections 3.2.2 and 3.2.3 of the paper",
        "Cignoni, Rocchini & Scopigno 1998, Metro: measuring error on simplified surfaces",
        "Sutherland & Hodgman 1974, Reentrant polygon clipping",
    ]
)]
pub struct CutDifference;

/// Inputs of [`CutDifference`].
#[derive(Inputs)]
pub struct In {
    /// The two planned planes.
    #[port(join = "once")]
    planes: Planes,
    /// The bone's closed surface.
    #[port(join = "once", frame = "planes")]
    bone: Mesh,
    /// The registration.
    #[port(to = "planes", from = "t_ct_world_true.from")]
    t_ct_world: Pose,
    /// The true registration.
    #[port(join = "once", to = "planes", from = "t_ct_world.from")]
    t_ct_world_true: Pose,
    /// The assessment points as planned, for the paper's error.
    #[port(join = "once", frame = "planes")]
    planned: Option<Points>,
    /// The assessment points as touched, all until the end.
    #[port(join = "collect", frame = "t_ct_bone_marker.from")]
    measured: Vec<Option<Points>>,
    /// The registration of the frame of the touched points.
    #[port(join = "once", to = "planes", from = "measured")]
    t_ct_bone_marker: Option<Pose>,
}

/// Outputs of [`CutDifference`].
#[derive(Outputs)]
pub struct Out {
    /// Volumes, ends and distances, by the true error and by the paper's.
    report: CutDifferenceReport,
}

#[function("metrics.cut_difference")]
impl CutDifference {
    fn process(params: &CutDifferenceParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let error = i.t_ct_world.compose(&i.t_ct_world_true.inverse())?;
        let error = error.expect(&i.planes.frame, &i.planes.frame)?;
        let measured = i.measured_error(ctx)?;
        Ok(Out { report: cut_difference(&i.bone, &i.planes, &error, measured, params)? })
    }
}

impl In {
    /// The error as measured at points, or the reason why there is none. Frames that do not match are an error.
    fn measured_error(&self, ctx: &Context) -> Result<Result<Isometry3<f64>, String>, NodeError> {
        let touched: Vec<Points> = self.measured.iter().flatten().cloned().collect();
        let (Some(planned), Some(pose), false) = (&self.planned, &self.t_ct_bone_marker, touched.is_empty()) else {
            let why = ["planned", "measured", "t_ct_bone_marker"].into_iter().find_map(|port| ctx.absent_reason(port));
            return Ok(Err(format!("no assessment points were measured: {}", why.unwrap_or("nothing came"))));
        };
        planned.frame.expect(&self.planes.frame, "the assessment points")?;
        let touched = in_one_list(&touched)?;
        let t_ct_measured = pose.expect(&self.planes.frame, &touched.frame)?;
        Ok(error_at_points(&planned.points, &touched.points, &t_ct_measured).map_err(|why| why.to_string()))
    }
}
