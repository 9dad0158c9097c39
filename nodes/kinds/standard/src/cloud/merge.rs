//! The kind `cloud.merge`.

use osteoflow_algorithms::merge::merge;
use osteoflow_geometry::Cloud;
use osteoflow_node::{Context, Describe, Emit, Inputs, NodeError, Outputs, function};

/// Several views of the bone as one cloud, in the bone's frame.
///
/// The merged cloud has no viewpoint. A missing view, such as one whose pose was lost, is left out, and a warning says how many
/// are and why; without any there is no merged cloud.
#[derive(Describe)]
#[describe(example = r#"
kind = "cloud.merge"
in   = { clouds = { from = "to_bone.cloud", n = 3 } }
"#)]
pub struct Merge;

/// Inputs of [`Merge`].
#[derive(Inputs)]
pub struct In {
    /// Views in one frame; all until the end, or `n` at a time.
    clouds: Vec<Option<Cloud>>,
}

/// Outputs of [`Merge`].
#[derive(Outputs)]
pub struct Out {
    /// All points, view after view.
    #[port(frame = "clouds")]
    cloud: Emit<Cloud>,
}

#[function("cloud.merge")]
impl Merge {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let n = i.clouds.len();
        let missing: Vec<usize> = (0..n).filter(|k| i.clouds[*k].is_none()).collect();
        let clouds: Vec<Cloud> = i.clouds.into_iter().flatten().collect();
        let why = ctx.absent_reason("clouds").unwrap_or("it is missing").to_owned();
        if clouds.is_empty() {
            return Ok(Out { cloud: Emit::Empty(why) });
        }
        if let Some(first) = missing.first() {
            let n_missing = missing.len();
            ctx.warn(format!(
                "{n_missing} of {n} views are left out, since they are missing; the first is number {first}: {why}"
            ));
        }
        Ok(Out { cloud: merge(&clouds)?.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::Point3;
    use osteoflow_node::{Empty, Function};
    use std::sync::Arc;

    /// The merged points, or why there are none, and the warnings.
    fn merged(views: &[bool]) -> (Result<usize, String>, Vec<String>) {
        let mut ctx = Context::for_test("merge");
        if views.contains(&false) {
            ctx.note_absent("clouds", Arc::new(Empty { node: "to_bone".into(), reason: "the marker was lost".into() }));
        }
        let view = |is_there: &bool| is_there.then(|| Cloud::new("bone", vec![Point3::origin(); 5]).unwrap());
        let out =
            Merge::process(&crate::NoParams {}, In { clouds: views.iter().map(view).collect() }, &mut ctx).unwrap();
        let cloud = match out.cloud {
            Emit::Value(cloud) => Ok(cloud.len()),
            Emit::Empty(why) => Err(why),
            Emit::Silent => panic!("an answer is due"),
        };
        (cloud, ctx.take_warnings())
    }

    #[test]
    fn a_missing_view_is_left_out_and_named_and_without_any_there_is_no_cloud() {
        assert_eq!(merged(&[true; 86]), (Ok(430), vec![]));
        let mut views = [true; 86];
        (views[7], views[80]) = (false, false);
        let told = "2 of 86 views are left out, since they are missing; the first is number 7: the marker was lost";
        assert_eq!(merged(&views), (Ok(420), vec![told.to_owned()]));
        assert_eq!(merged(&[false; 3]), (Err("the marker was lost".into()), vec![]));
        // A collection that never became complete.
        assert_eq!(merged(&[]).0, Err("it is missing".into()));
    }
}
