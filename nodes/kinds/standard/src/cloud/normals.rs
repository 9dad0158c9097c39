//! The kind `cloud.normals`.

use super::{In, Out};
use osteoflow_algorithms::normals::{NormalParams, estimate};
use osteoflow_node::{Context, Describe, NodeError, function};

/// A cloud with normals, oriented towards the camera.
///
/// Points whose neighbourhood gives no normal are left out, counted and reported.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "cloud.normals"
in   = { cloud = "to_bone.cloud" }
"#,
    literature = ["Hoppe et al. 1992, section 3.2"]
)]
pub struct Normals;

#[function("cloud.normals")]
impl Normals {
    fn process(params: &NormalParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let (cloud, n_dropped) = estimate(&i.cloud, params)?;
        if n_dropped > 0 {
            ctx.warn(format!(
                "{n_dropped} of {} points have too few neighbours for a normal and were left out",
                i.cloud.len()
            ));
        }
        Ok(Out { cloud })
    }
}
