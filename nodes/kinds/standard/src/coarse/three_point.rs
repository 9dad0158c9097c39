//! The kind `coarse.three_point`.

use crate::transform::points::in_one_list;
use osteoflow_algorithms::coarse::{self, CoarseReport, DoubtParams};
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::{Cloud, Points, Pose};
use osteoflow_node::{
    Context, Describe, Inputs, NodeError, Outputs, Unused, function, params, schemars::JsonSchema, serde::Deserialize,
};

/// The rigid motion that best carries located landmarks onto the planned ones.
///
/// Points are paired by name. The report has residuals, side lengths and collinearity in mm. The residual at the points (FRE)
/// does not predict the accuracy: a shift that all points share does not change it. A point of low confidence, such as a laser
/// spot at the silhouette, is used only if its distances to the others are as planned.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "coarse.three_point"
in   = { target = "plan.landmarks", source = { from = "hole.point", n = 3 } }
"#,
    literature = ["Kabsch 1976", "section 2.3 of the paper"]
)]
pub struct ThreePoint;

/// Parameters of [`ThreePoint`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Maximum residual (RMS) of the planned landmarks. 10: landmarks that a ruler placed 10 mm off pass, a spot on the wrong
    /// side of the scan does not.
    #[param(10.0, 0.01..=1000.0)]
    pub max_fre_mm: f64,
    /// Points of less confidence are refused where a distance to another point disagrees with the plan. 0.4: the
    /// `min_confidence` of the hole detectors, which a lost patch rarely reaches.
    #[param(0.4, 0.0..=1.0)]
    pub min_confidence: f64,
    /// Maximum difference of such a point's distances to the others from the plan. 3: aiming errors of 0.6 and 0.7 mm across
    /// and along the bone change the worse of two distances by 1.0 mm (median), 2.7 mm (99 %) and 3.1 mm (largest of 2000).
    #[param(3.0, 0.0..=1000.0)]
    pub max_side_difference_mm: f64,
}

/// Inputs of [`ThreePoint`].
#[derive(Inputs)]
pub struct In {
    /// The planned landmarks.
    #[port(join = "once")]
    target: Points,
    /// The landmarks as located, three or more.
    #[port(join = "collect", n = 3)]
    source: Vec<Points>,
    /// The scan, which kinds that register by shape use.
    cloud: Unused<Cloud>,
    /// The CT surface, which kinds that register by shape use.
    #[port(join = "once")]
    surface: Unused<Target>,
}

/// Outputs of [`ThreePoint`].
#[derive(Outputs)]
pub struct Out {
    /// The coarse registration.
    #[port(to = "target", from = "source")]
    t_target_source: Pose,
    /// The residuals at the points.
    report: CoarseReport,
}

#[function("coarse.three_point")]
impl ThreePoint {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let _ = (i.cloud, i.surface);
        let source = in_one_list(&i.source)?;
        if i.target.points.is_empty() {
            let next = "plan.landmarks places P1..P3 on the bone's surface";
            return Err(NodeError::new(format!("the plan gives no landmarks to fit to; {next}")));
        }
        let fit = coarse::three_point(&i.target.points, &source.points)?;
        let (min_confidence, max_side_difference_mm) = (params.min_confidence, params.max_side_difference_mm);
        let doubt = DoubtParams { min_confidence, max_side_difference_mm };
        coarse::confirm(&source.points, &fit.report.sides, &doubt)?;
        if fit.report.fre_mm > params.max_fre_mm {
            return Err(NodeError::new(misfit(&fit.report, params.max_fre_mm)));
        }
        let pose = Pose::new(&i.target.frame, &source.frame, fit.t_target_source).at(ctx.stamp_ns());
        Ok(Out { t_target_source: pose, report: fit.report })
    }
}

/// The message for points that do not fit, with the side lengths, which need no registration.
fn misfit(report: &CoarseReport, limit_mm: f64) -> String {
    let sides = report.sides.iter().map(|s| {
        let (from, to, target, source) = (&s.from, &s.to, s.target_mm, s.source_mm);
        format!("{from}-{to} is {source:.1} mm in the scan and {target:.1} mm in the plan")
    });
    let sides: Vec<String> = sides.collect();
    format!(
        "the points miss the planned landmarks by {:.1} mm (RMS), {limit_mm} mm is allowed: {}; was a spot found at the \
         wrong place, or are two landmarks exchanged?",
        report.fre_mm,
        sides.join(", ")
    )
}
