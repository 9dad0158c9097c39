//! The kind `plan.file`.

use super::Out;
use crate::constant::Constant;
use crate::moved::Moved;
use osteoflow_formats::plan_file::read_plan;
use osteoflow_node::{Context, Describe, FilePath, NodeError, params, schemars::JsonSchema, serde::Deserialize};

/// A surgical plan from a file, in mm and the CT frame: JSON, or planes and points of 3D Slicer (`.mrb`, `.mrk.json`), as
/// `osteoflow convert` reads them.
#[derive(Describe)]
#[describe(example = r#"
kind = "plan.file"
path = "plan.json"
"#)]
pub struct File;

/// Parameters of [`File`].
#[params(path)]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// The plan.
    pub path: FilePath,
    /// Whether you have looked at plan and surface together and found that they belong to each other. The verdict then takes a
    /// shift of all landmarks for aiming, as with a plan that is bound to its surface, and says so.
    pub confirm: bool,
    /// A plan with the axes, anatomy and poses of markers that `path` lacks, as 3D Slicer does not draw them. Default: `path`
    /// has all.
    pub rest: Option<FilePath>,
    /// The plan that the procedure was made for, if it was another one. Measurements of assessment points that have moved since
    /// are left out, and their simulated truths are taken from the true registration. The registration starts from the
    /// landmarks of that plan. Default: `path`.
    pub made_for: Option<FilePath>,
}

impl Constant for File {
    const KIND: &'static str = "plan.file";
    type Params = Params;
    type Outputs = Out;

    fn read(params: &Params, ctx: &mut Context) -> Result<Out, NodeError> {
        let rest = params.rest.as_ref().map(AsRef::as_ref);
        let mut read = read_plan(params.path.as_ref())?.completed_by(rest)?;
        read.notes.into_iter().for_each(|note| ctx.warn(note));
        if read.plan.planes.planes.is_empty() {
            ctx.warn(format!("{}: the plan has no planes, so no cut can be shown", params.path.0.display()));
        }
        let made_for = params.made_for.as_ref().map(|path| read_plan(path.as_ref())).transpose()?;
        let moved = made_for.map(|before| {
            let moved = Moved::since(&before.plan, &read.plan);
            let is_located_elsewhere = !moved.landmarks.is_empty();
            let now = is_located_elsewhere.then(|| std::mem::replace(&mut read.plan.landmarks, before.plan.landmarks));
            (moved, now)
        });
        if let Some((Moved { landmarks, .. }, Some(_))) = &moved {
            let (names, is, it) = match &landmarks[..] {
                [one] => (one.clone(), "is", "it was"),
                all => (all.join(", "), "are", "they were"),
            };
            ctx.warn(format!(
                "{names} {is} planned elsewhere than when the procedure was made; located {it} where the plan had it then, so the \
                 registration starts from there, and the new place counts for the next procedure"
            ));
        }
        Ok(Out::new(read.plan, params.confirm, moved.as_ref().map(|(moved, now)| (moved, now.as_ref()))))
    }
}
