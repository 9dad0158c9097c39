//! The kind `metrics.surface`.

use osteoflow_algorithms::{
    metrics::{SurfaceReport, surface_residual},
    target::Target,
};
use osteoflow_geometry::{Cloud, Pose};
use osteoflow_node::{
    Context, Describe, Inputs, NodeError, Outputs, function, params, schemars::JsonSchema, serde::Deserialize,
};

/// Distances of the registered scan from the CT surface, over its inliers and over all points.
///
/// A surface residual, which is neither FRE nor TRE: a scan that is displaced along the bone still lies on the surface.
#[derive(Describe)]
#[describe(example = r#"
kind = "metrics.surface"
in   = { source = "to_bone.cloud", target = "ct_surface.target", t_target_source = "icp.t_target_source" }
"#)]
pub struct Surface;

/// Parameters of [`Surface`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Points no farther from the surface than this are inliers. 1: twenty times the camera's noise.
    #[param(1.0, 1e-3..=1000.0)]
    pub max_pair_distance_mm: f64,
}

/// Inputs of [`Surface`].
#[derive(Inputs)]
pub struct In {
    /// The scan.
    source: Cloud,
    /// The CT surface.
    #[port(join = "once", frame = "t_target_source.to")]
    target: Target,
    /// The registration.
    #[port(join = "once", to = "target", from = "source")]
    t_target_source: Pose,
}

/// Outputs of [`Surface`].
#[derive(Outputs)]
pub struct Out {
    /// Residuals and the share of inliers.
    report: SurfaceReport,
}

#[function("metrics.surface")]
impl Surface {
    fn process(params: &Params, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let t_target_source = i.t_target_source.expect(&i.target.frame, &i.source.frame)?;
        let limit_mm = params.max_pair_distance_mm;
        Ok(Out { report: surface_residual(&i.target, i.source.points(), &t_target_source, limit_mm)? })
    }
}
