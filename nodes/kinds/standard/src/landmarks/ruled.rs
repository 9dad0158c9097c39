//! The kind `landmarks.ruled`.

use crate::metrics::axes;
use osteoflow_algorithms::{
    landmarks::{RuledReport, RulerErrors, ruled},
    mesh_query::MeshQuery,
};
use osteoflow_geometry::{Axes, Mesh, Points, Pose, direction, nalgebra::Vector3};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// The true positions of P1, P2 and P3 as a surgeon marks them on the bone with a ruler, with the ruler's errors.
///
/// P1 is off along the bone. P2 and P3 are measured from P1, so they share its error and add their own; P2 is also off across
/// the bone. The marks are in the bone marker's frame, as those of the hole detectors: `coarse.three_point` takes them with
/// `in.source = { from = "ruled.points", n = 1 }`. Only a simulation knows the true registration that this needs.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "landmarks.ruled"
in   = { mesh = "bone.mesh", planned = "plan.landmarks", t_ct_world_true = "recording.t_ct_world_true", t_world_bone_marker = "to_bone.t_world_bone_marker", axes = "plan.axes" }
first_mm  = 6.5
second_mm = -1.0
third_mm  = 0.5
across_mm = 2.0
"#,
    literature = ["section 3.2.3 of the paper"]
)]
pub struct Ruled;

/// Inputs of [`Ruled`].
#[derive(Inputs)]
pub struct In {
    /// The real bone's surface.
    #[port(join = "once", frame = "planned")]
    mesh: Mesh,
    /// The planned landmarks P1, P2, P3 in this order.
    #[port(join = "once", frame = "mesh")]
    planned: Points,
    /// The true registration at the scan.
    #[port(join = "once", to = "planned", from = "t_world_bone_marker.to")]
    t_ct_world_true: Pose,
    /// The pose of the bone marker at the scan.
    #[port(join = "once", to = "t_ct_world_true.from")]
    t_world_bone_marker: Pose,
    /// The bone's axes, z along it. Unwired or empty: the principal axes of the surface.
    #[port(join = "once", frame = "planned")]
    axes: Option<Axes>,
}

/// Outputs of [`Ruled`].
#[derive(Outputs)]
pub struct Out {
    /// The marks.
    #[port(frame = "t_world_bone_marker.from")]
    points: Points,
    /// The errors of the marks: as set and as they are on the surface.
    report: RuledReport,
}

#[function("landmarks.ruled")]
impl Ruled {
    fn process(params: &RulerErrors, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let ct = &i.planned.frame;
        i.mesh.frame.expect(ct, "the bone's surface")?;
        let axes = axes(i.axes, Some(&i.mesh))?;
        axes.frame.expect(ct, "the axes")?;
        let t_bone_marker_ct = i.t_ct_world_true.compose(&i.t_world_bone_marker)?.inverse();
        let bone_marker = t_bone_marker_ct.to.clone();
        let motion = t_bone_marker_ct.expect(&bone_marker, ct)?;
        let along = direction(axes.columns * Vector3::z()).map_err(NodeError::new)?;
        let ruled = ruled(&MeshQuery::new(&i.mesh), &i.planned.points, &along, params)?;
        let points = Points::new(ct, ruled.points).transformed(bone_marker, &motion);
        Ok(Out { points: Points { stamp_ns: ctx.stamp_ns(), ..points }, report: ruled.report })
    }
}
