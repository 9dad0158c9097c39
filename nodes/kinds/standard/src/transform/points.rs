//! The kind `transform.points`.

use osteoflow_geometry::{NamedPoint, Points as PointList, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// Named points of a stream as one list, in another frame.
#[derive(Describe)]
#[describe(example = r#"
kind = "transform.points"
in   = { points = { from = "hole.point", n = 3 }, pose = "to_bone.t_world_bone_marker" }
"#)]
pub struct Points;

/// Inputs of [`Points`].
#[derive(Inputs)]
pub struct In {
    /// Lists of points in one frame; all until the end, or `n` at a time.
    #[port(join = "collect", frame = "pose.from")]
    points: Vec<PointList>,
    /// The pose that is applied.
    #[port(join = "once", from = "points")]
    pose: Pose,
}

/// Outputs of [`Points`].
#[derive(Outputs)]
pub struct Out {
    /// All points in order.
    #[port(frame = "pose.to")]
    points: PointList,
}

#[function("transform.points")]
impl Points {
    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let points = in_one_list(&i.points)?;
        points.frame.expect(&i.pose.from, "a list of points")?;
        Ok(Out { points: points.transformed(&i.pose.to, &i.pose.isometry) })
    }
}

/// All points of lists in one frame.
pub(crate) fn in_one_list(lists: &[PointList]) -> Result<PointList, NodeError> {
    let first = lists.first().ok_or_else(|| NodeError::new("no points were received"))?;
    let mut points: Vec<NamedPoint> = Vec::new();
    for list in lists {
        list.frame.expect(&first.frame, "a list of points")?;
        points.extend(list.points.iter().cloned());
    }
    Ok(PointList::new(&first.frame, points))
}
