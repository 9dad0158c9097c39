//! The kind `output.mesh`.

use super::{NoOutputs, file_of};
use osteoflow_formats::{
    Space,
    write::{Precision, write_mesh},
};
use osteoflow_geometry::Mesh as MeshPayload;
use osteoflow_node::{Context, Describe, Inputs, NodeError, function};

/// Surfaces as binary STL files in the run's folder, named after the node; mm, those in `ct` say that they are LPS.
#[derive(Describe)]
#[describe(example = r#"
kind = "output.mesh"
in   = { mesh = "bone.mesh" }
"#)]
pub struct Mesh;

/// Inputs of [`Mesh`].
#[derive(Inputs)]
pub struct In {
    /// A surface; one file for each.
    mesh: MeshPayload,
}

#[function("output.mesh")]
impl Mesh {
    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        if let Some(path) = file_of(ctx, "stl")? {
            let notes = write_mesh(&path, &i.mesh, Space::of(&i.mesh.frame), Precision::Single)?;
            notes.into_iter().for_each(|note| ctx.warn(note));
        }
        Ok(NoOutputs {})
    }
}
