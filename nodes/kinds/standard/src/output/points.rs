//! The kind `output.points`.

use super::{NoOutputs, file_of, lps};
use osteoflow_formats::picked_points::write_mrk_json;
use osteoflow_geometry::Points as PointList;
use osteoflow_node::{Context, Describe, Inputs, NodeError, function};

/// Named points in `ct` as markups of 3D Slicer (`.mrk.json`, LPS) in the run's folder, named after the node.
///
/// Points in another frame are refused, since the format claims a space; `output.csv` writes them.
#[derive(Describe)]
#[describe(example = r#"
kind = "output.points"
in   = { points = "plan.landmarks" }
"#)]
pub struct Points;

/// Inputs of [`Points`].
#[derive(Inputs)]
pub struct In {
    /// A list of points; one file for each.
    points: PointList,
}

#[function("output.points")]
impl Points {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        let space = lps(&i.points.frame, "the points are", "transform them (transform.points), or use output.csv")?;
        if let Some(path) = file_of(ctx, "mrk.json")? {
            write_mrk_json(&path, &i.points.points, space)?;
        }
        Ok(NoOutputs {})
    }
}
