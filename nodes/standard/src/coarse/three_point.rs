//! The kind `coarse.three_point`.

use crate::transform::points::in_one_list;
use osteoflow_algorithms::coarse::{self, CoarseReport};
use osteoflow_geometry::{Points, Pose};
use osteoflow_node::{Context, Describe, Inputs, Node, NodeError, Outputs, ParamError};

/// The rigid motion that best carries located landmarks onto the planned ones.
///
/// Points are paired by name. The report tells residuals, side lengths and collinearity in mm; what is left at the
/// points (FRE) does not tell the accuracy: a shift that all points share leaves no trace in it.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "coarse.three_point"
in   = { target = "plan.landmarks", source = { from = "hole.point", n = 3 } }
"#,
    literature = ["Kabsch 1976", "section 2.3 of the paper"]
)]
pub struct ThreePoint;

/// Inputs of [`ThreePoint`].
#[derive(Inputs)]
pub struct In {
    /// The planned landmarks.
    #[port(join = "once")]
    target: Points,
    /// The landmarks as located, three or more.
    #[port(join = "collect", n = 3)]
    source: Vec<Points>,
}

/// Outputs of [`ThreePoint`].
#[derive(Outputs)]
pub struct Out {
    /// The coarse registration.
    #[port(to = "target", from = "source")]
    t_target_source: Pose,
    /// What the fit leaves at the points.
    report: CoarseReport,
}

impl Node for ThreePoint {
    const KIND: &'static str = "coarse.three_point";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn new(_: crate::NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let source = in_one_list(&i.source)?;
        let fit = coarse::three_point(&i.target.points, &source.points)?;
        let pose = Pose::new(&i.target.frame, &source.frame, fit.t_target_source).at(ctx.stamp_ns());
        Ok(Out { t_target_source: pose, report: fit.report })
    }
}
