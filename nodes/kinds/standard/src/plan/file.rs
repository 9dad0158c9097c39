//! The kind `plan.file`.

use super::Out;
use osteoflow_formats::plan_file::read_plan;
use osteoflow_node::{
    Context, Describe, FilePath, NodeError, ParamError, Source, schemars::JsonSchema, serde::Deserialize,
};

/// A surgical plan from a JSON file, in millimetres and the CT frame.
#[derive(Describe)]
#[describe(example = r#"
kind = "plan.file"
path = "plan.json"
"#)]
pub struct File {
    path: FilePath,
    done: bool,
}

/// Parameters of [`File`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// The plan.
    pub path: FilePath,
}

impl Source for File {
    const KIND: &'static str = "plan.file";
    const CONSTANT: bool = true;
    type Params = Params;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { path: params.path, done: false })
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        if std::mem::replace(&mut self.done, true) {
            return Ok(None);
        }
        let read = read_plan(self.path.as_ref())?;
        read.notes.into_iter().for_each(|note| ctx.warn(note));
        if read.plan.planes.planes.is_empty() {
            ctx.warn(format!("{}: the plan has no planes, so no cut can be shown", self.path.0.display()));
        }
        Ok(Some(read.plan.into()))
    }
}
