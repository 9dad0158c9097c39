//! The kind `calibrate.phantom_icp`.

use osteoflow_algorithms::calibrate::{
    PhantomParams, PhantomReport, equation_1, nominal_t_camera_phantom, phantom_icp,
};
use osteoflow_geometry::{Cloud, Mesh, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// The pose of the camera's marker in the camera, from one scan of a tracked phantom of known shape.
///
/// `t_camera_camera_marker = t_camera_phantom * t_phantom_phantom_marker * t_phantom_marker_world * t_world_camera_marker`,
/// with `t_camera_phantom` from an ICP of the phantom's CAD that starts at the marker's nominal pose. At least three faces must
/// be seen, one of them with few points. Refused are a scan that is mirrored, of the wrong size, farther from the CAD than its
/// own noise explains, or far from the nominal pose, and a phantom that lacks a block of the CAD or has one more. What the seen
/// faces leave open is a warning: the scale, the handedness, a turn in which the phantom fits as well. The report lists the
/// planes that the camera could see, and how much of each it saw.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "calibrate.phantom_icp"
in   = { cloud = "recording.phantom_scan", phantom = "phantom.mesh", nominal = "plan.t_camera_camera_marker_nominal", t_phantom_phantom_marker = "plan.t_phantom_phantom_marker", t_world_phantom_marker = "phantom_marker.pose", t_world_camera_marker = "camera_marker.pose" }
working_distance_mm = 200.0
"#,
    literature = ["section 2.2 of the paper, equation 1"]
)]
pub struct PhantomIcp;

/// Inputs of [`PhantomIcp`].
#[derive(Inputs)]
pub struct In {
    /// The phantom, seen by the camera.
    #[port(frame = "nominal.to")]
    cloud: Cloud,
    /// The phantom's CAD.
    #[port(join = "once", frame = "t_phantom_phantom_marker.to")]
    phantom: Mesh,
    /// `t_camera_camera_marker` as designed, good to a few mm and degrees.
    #[port(join = "once", to = "cloud", from = "t_world_camera_marker.from")]
    nominal: Pose,
    /// Known from the phantom's CAD.
    #[port(join = "once", to = "phantom", from = "t_world_phantom_marker.from")]
    t_phantom_phantom_marker: Pose,
    /// The tracked marker on the phantom.
    #[port(join = "interpolate", max_gap_ms = 500.0, to = "t_world_camera_marker.to")]
    t_world_phantom_marker: Pose,
    /// The tracked marker on the camera.
    #[port(join = "interpolate", max_gap_ms = 500.0, from = "nominal.from")]
    t_world_camera_marker: Pose,
}

/// Outputs of [`PhantomIcp`].
#[derive(Outputs)]
pub struct Out {
    /// The calibration.
    #[port(to = "nominal.to", from = "nominal.from")]
    t_camera_camera_marker: Pose,
    /// The phantom's marker as the camera saw it, for the propagation of its error.
    #[port(to = "nominal.to", from = "t_world_phantom_marker.from")]
    t_camera_phantom_marker: Pose,
    /// Residuals, and the error they cause at the working distance.
    report: PhantomReport,
}

#[function("calibrate.phantom_icp")]
impl PhantomIcp {
    fn process(params: &PhantomParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let (camera, camera_marker) = (&i.nominal.to, &i.nominal.from);
        i.cloud.frame.expect(camera, "the phantom's scan")?;
        i.phantom.frame.expect(&i.t_phantom_phantom_marker.to, "the phantom's CAD")?;
        let world = &i.t_world_camera_marker.to;
        let nominal = i.nominal.isometry;
        let t_p_mp = i.t_phantom_phantom_marker.isometry;
        let t_w_mp = i.t_world_phantom_marker.expect(world, &i.t_phantom_phantom_marker.from)?;
        let t_w_mc = i.t_world_camera_marker.expect(world, camera_marker)?;

        let start = nominal_t_camera_phantom(&nominal, &t_p_mp, &t_w_mp, &t_w_mc);
        let fit = phantom_icp(i.cloud.points(), &i.phantom, &start, params)?;
        fit.report.notes.iter().for_each(|note| ctx.warn(note.clone()));
        let t_c_mc = equation_1(&fit.t_camera_phantom, &t_p_mp, &t_w_mp, &t_w_mc);
        let pose = Pose::new(camera, camera_marker, t_c_mc).at(ctx.stamp_ns());
        let phantom_marker = &i.t_phantom_phantom_marker.from;
        let t_c_mp = Pose::new(camera, phantom_marker, fit.t_camera_phantom * t_p_mp).at(ctx.stamp_ns());
        Ok(Out { t_camera_camera_marker: pose, t_camera_phantom_marker: t_c_mp, report: fit.report })
    }
}
