//! The kind `output.planes`.

use super::{NoOutputs, file_of, lps};
use osteoflow_formats::picked_points::write_planes_mrk_json;
use osteoflow_geometry::Planes as PlaneList;
use osteoflow_node::{Context, Describe, Inputs, NodeError, function};

/// Planes in `ct` as markups of 3D Slicer (`.mrk.json`, LPS) in the run's folder, named after the node; unknown planes are left
/// out, with a warning.
#[derive(Describe)]
#[describe(example = r#"
kind = "output.planes"
in   = { planes = "plan.planes" }
"#)]
pub struct Planes;

/// Inputs of [`Planes`].
#[derive(Inputs)]
pub struct In {
    /// Planes; one file for each set.
    planes: PlaneList,
}

#[function("output.planes")]
impl Planes {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        lps(&i.planes.frame, "the planes are", "wire plan.planes")?;
        let known: Vec<_> = i.planes.planes.iter().filter_map(|p| Some((p.name.clone(), *p.isometry()?))).collect();
        let n_unknown = i.planes.planes.len() - known.len();
        if n_unknown > 0 {
            ctx.warn(format!("{n_unknown} planes are unknown and were left out"));
        }
        if let Some(path) = file_of(ctx, "mrk.json")? {
            write_planes_mrk_json(&path, &known)?;
        }
        Ok(NoOutputs {})
    }
}
