//! The kind `output.transform`.

use super::{NOTICE, NoOutputs, file_of, is_refused, lps};
use osteoflow_algorithms::trust::Verdict;
use osteoflow_formats::pose_file::itk_text;
use osteoflow_geometry::Pose;
use osteoflow_node::{Context, Describe, Inputs, NodeError, function};

/// Poses as ITK transforms (`.tfm`) in the run's folder, named after the node, for 3D Slicer.
///
/// Slicer shows the motion from the pose's `from` to its `to`; the file holds the inverse, as Slicer's files do, and names both
/// frames. A pose that does not lead to `ct` is refused, since such files are LPS.
#[derive(Describe)]
#[describe(example = r#"
kind = "output.transform"
in   = { pose = "icp.t_target_source", verdict = "verdict.verdict" }
"#)]
pub struct Transform;

/// Inputs of [`Transform`].
#[derive(Inputs)]
pub struct In {
    /// A pose; one file for each.
    pose: Pose,
    /// The verdict on what is written: a refused one is not. Unwired: it is written in any case.
    verdict: Option<Verdict>,
}

#[function("output.transform")]
impl Transform {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        lps(&i.pose.to, "the pose leads to coordinates", "wire one that leads to ct, such as icp.t_target_source")?;
        if is_refused(i.verdict.as_ref(), ctx) {
            return Ok(NoOutputs {});
        }
        if let Some(path) = file_of(ctx, "tfm")? {
            let (to, from) = (&i.pose.to, &i.pose.from);
            let frames = format!("moves frame {from} to frame {to}, mm, LPS; the parameters are those of the inverse");
            osteoflow_formats::durable::write(path, itk_text(&i.pose.isometry, &[frames, NOTICE.into()]))?;
        }
        Ok(NoOutputs {})
    }
}
