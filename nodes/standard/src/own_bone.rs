//! A bone of the user's own, for the kinds that simulate.

use osteoflow_formats::{mesh_file::read_mesh, plan_file::read_plan_of};
use osteoflow_geometry::SurfaceOrigin;
use osteoflow_node::{FilePath, NodeError, ParamError, schemars::JsonSchema, serde::Deserialize};
use osteoflow_simulation::{BoneParams, Subject};
use std::path::Path;

/// Which bone is simulated on, if not the built-in one. The same for every node that simulates.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct OwnBone {
    /// The closed surface of a bone to simulate on, STL or PLY, mm, in the CT's coordinates; with `plan_file`, and the same
    /// for every node that simulates. None: the built-in bone.
    pub bone_file: Option<FilePath>,
    /// Its plan as `plan.file` reads it, or its anatomy alone (`malleolus_tip`, `proximal`, `lateral`, `posterior`), also
    /// under a key named after the bone's file; landmarks, assessment points and cuts are then placed by it.
    pub plan_file: Option<FilePath>,
}

impl OwnBone {
    /// Both files or none.
    pub(crate) fn checked(self) -> Result<Self, ParamError> {
        let (given, lacks) = match (&self.bone_file, &self.plan_file) {
            (Some(_), None) => ("bone_file", "plan_file"),
            (None, Some(_)) => ("plan_file", "bone_file"),
            _ => return Ok(self),
        };
        let said = format!("{given} is given, but {lacks} is not; a bone of your own needs both");
        Err(ParamError::new(lacks, said))
    }

    /// The bone and its plan; `built_in` where no files are given.
    pub(crate) fn subject(&self, built_in: &BoneParams) -> Result<Subject, NodeError> {
        match (&self.bone_file, &self.plan_file) {
            (Some(bone), Some(plan)) => read(bone.as_ref(), plan.as_ref()),
            _ => Ok(Subject::built_in(built_in)?),
        }
    }
}

/// The bone and its plan from their files.
///
/// # Errors
/// If a file cannot be read, the surface is open, or the plan lacks an anatomy or does not fit the bone.
pub fn read(bone_file: &Path, plan_file: &Path) -> Result<Subject, NodeError> {
    let name = bone_file.file_stem().unwrap_or_default().to_string_lossy();
    let plan = read_plan_of(plan_file, &name)?;
    let read = read_mesh(bone_file, 1.0, "ct", SurfaceOrigin::Exact)?;
    let mut subject = Subject::of(read.mesh, plan)?;
    subject.notes.splice(0..0, read.notes);
    Ok(subject)
}
