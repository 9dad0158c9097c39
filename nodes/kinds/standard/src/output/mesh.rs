//! The kind `output.mesh`.

use super::{NoOutputs, file_of};
use osteoflow_formats::{
    Space,
    write::{Precision, write_mesh},
};
use osteoflow_geometry::Mesh as MeshPayload;
use osteoflow_node::{Context, Describe, Function, Inputs, NodeError};

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

impl Function for Mesh {
    const KIND: &'static str = "output.mesh";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = NoOutputs;

    fn process(_: &crate::NoParams, i: In, ctx: &mut Context) -> Result<NoOutputs, NodeError> {
        if let Some(path) = file_of(ctx, "stl")? {
            let notes = write_mesh(&path, &i.mesh, Space::of(&i.mesh.frame), Precision::Single)?;
            notes.into_iter().for_each(|note| ctx.warn(note));
        }
        Ok(NoOutputs {})
    }
}
