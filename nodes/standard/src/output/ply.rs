//! The kind `output.ply`.

use super::file_of;
use osteoflow_formats::cloud_file::write_ply;
use osteoflow_geometry::Cloud;
use osteoflow_node::{Context, Describe, Inputs, Node, NodeError, Outputs, ParamError};

/// Clouds as PLY files in the run's folder, named after the node.
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
}

/// No outputs.
#[derive(Outputs)]
pub struct Out {}

impl Node for Ply {
    const KIND: &'static str = "output.ply";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn new(_: crate::NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        if let Some(path) = file_of(ctx, "ply")? {
            write_ply(&path, &i.cloud, 1.0)?;
        }
        Ok(Out {})
    }
}
