//! The kind `refine.slide`.

use crate::icp::In;
use osteoflow_algorithms::slide::{SlideParams, SlideReport, slide};
use osteoflow_geometry::Pose;
use osteoflow_node::{
    Context, Describe, NodeError, Outputs, function, params, schemars::JsonSchema, serde::Deserialize,
};

/// The best place of a registered scan along the bone and around it, and how well the residuals determine it.
///
/// A shaft is nearly a cylinder, so an ICP may end displaced along it and turned about it. This finds the minima of the
/// point-to-plane residual within `along_mm` and `around_deg` of `init`, registers the scan at the best with all points, and
/// reports the profiles along and around the bone, with the other five motions fitted at each place. A motion that the
/// residuals do not determine stays as in `init`, with a warning. About half a second of one core. docs/method/sliding.md has
/// the method.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "refine.slide"
in   = { source = "to_bone.cloud", target = "ct_surface.target", init = "icp.t_target_source" }
"#,
    literature = ["Gelfand et al. 2003", "Vuong 1989", "Liang and Zeger 1986"]
)]
pub struct Slide;

/// Parameters of [`Slide`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// How far along the bone, how far around it, and what is undetermined.
    pub profile: SlideParams,
    /// Warns if it moved the scan along the bone by more. 1.5: more than what point-to-point leaves of a sound start.
    #[param(1.5, 0.0..=200.0)]
    pub warn_mm: f64,
    /// Warns if it turned the scan about the bone by more. 2.
    #[param(2.0, 0.0..=180.0)]
    pub warn_deg: f64,
}

/// Outputs of [`Slide`].
#[derive(Outputs)]
pub struct Out {
    /// The registration.
    #[port(to = "target", from = "source")]
    t_target_source: Pose,
    /// The profiles, the other minima, and what is weak in words.
    report: SlideReport,
}

#[function("refine.slide")]
impl Slide {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let init = i.init.expect(&i.target.frame, &i.source.frame)?;
        let fit = slide(&i.target, &i.source, &init, &params.profile)?;
        for warning in fit.report.warnings(params.warn_mm, params.warn_deg.to_radians()) {
            ctx.warn(warning);
        }
        let pose = Pose::new(&i.target.frame, &i.source.frame, fit.t_target_source).at(ctx.stamp_ns());
        Ok(Out { t_target_source: pose, report: fit.report })
    }
}
