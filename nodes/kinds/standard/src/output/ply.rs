//! The kind `output.ply`.

use super::{NoOutputs, file_of, is_refused};
use osteoflow_algorithms::trust::Verdict;
use osteoflow_formats::{
    Space,
    write::{Precision, write_cloud},
};
use osteoflow_geometry::Cloud;
use osteoflow_node::{Context, Describe, Inputs, NodeError, function};

/// Clouds as PLY files in the run's folder, named after the node; mm, those in `ct` say that they are LPS.
///
/// The numbers are 32-bit floats where these keep them to 1e-4 mm, else doubles, with a warning.
#[derive(Describe)]
#[describe(example = r#"
kind = "output.ply"
in   = { cloud = "to_bone.cloud" }
"#)]
pub struct Ply;

/// Inputs of [`Ply`].
#[derive(Inputs)]
pub struct In {
    /// A cloud; one file for each.
    cloud: Cloud,
    /// The verdict on what is written: a refused one is not. Unwired: it is written in any case.
    verdict: Option<Verdict>,
}

#[function("output.ply")]
impl Ply {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        if is_refused(i.verdict.as_ref(), ctx) {
            return Ok(NoOutputs {});
        }
        if let Some(path) = file_of(ctx, "ply")? {
            let notes = write_cloud(&path, &i.cloud, Space::of(&i.cloud.frame), Precision::Single)?;
            notes.into_iter().for_each(|note| ctx.warn(note));
        }
        Ok(NoOutputs {})
    }
}
