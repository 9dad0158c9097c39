//! The kind `cloud.from_points`.

use crate::transform::points::in_one_list;
use osteoflow_geometry::{Cloud, Points};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// A cloud of points that were touched one by one, such as a surface palpated with a stylus.
#[derive(Describe)]
#[describe(example = r#"
kind = "cloud.from_points"
in   = { points = "palpation.points" }
"#)]
pub struct FromPoints;

/// Inputs of [`FromPoints`].
#[derive(Inputs)]
pub struct In {
    /// The points, all until the end.
    points: Vec<Points>,
}

/// Outputs of [`FromPoints`].
#[derive(Outputs)]
pub struct Out {
    /// The points as a cloud, taken when the last was touched.
    #[port(frame = "points")]
    cloud: Cloud,
}

#[function("cloud.from_points")]
impl FromPoints {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let points = in_one_list(&i.points)?;
        Ok(Out { cloud: Cloud::new(&points.frame, points.positions())?.at(ctx.stamp_ns()) })
    }
}
