//! The kind `surface.file`.

use crate::{constant::Constant, parts};
use osteoflow_formats::{Space, input::sha256, mesh_or_cloud::read_mesh};
use osteoflow_geometry::{Mesh, SurfaceOrigin};
use osteoflow_node::{
    Context, Describe, FilePath, NodeError, Outputs, ParamError, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::Json;
use serde_json::json;
use std::sync::Arc;

/// A triangle mesh from a file: STL, PLY, OBJ, OFF or VTK, recognised by its content.
#[derive(Describe)]
#[describe(example = r#"
kind  = "surface.file"
path  = "bone.stl"
frame = "ct"
"#)]
pub struct File;

/// Parameters of [`File`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// The file.
    pub path: FilePath,
    /// The frame of its coordinates. `ct`: a bone's surface is segmented from CT.
    #[serde(default = "crate::params::ct")]
    pub frame: String,
    /// Millimetres in the file's unit. 1: mesh files of bones are in millimetres; 1000 for a file in metres.
    #[serde(default = "crate::params::one")]
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub unit_mm: f64,
    /// The axes of the file's numbers, where it does not state them; RAS is turned to LPS. Unset: in frame `ct` they are taken
    /// for LPS, as 3D Slicer takes them, with a warning.
    pub space: Option<SpaceName>,
    /// Which connected part of the surface is the bone: `"largest"`, its number by area, such as `"2"`, or `"nearest:X,Y,Z"`, the
    /// part nearest to a point, mm; `osteoflow info` lists them. Unset: all of them.
    pub component: Option<String>,
}

/// The axes of a patient's coordinates.
#[derive(Debug, Clone, Copy, Deserialize, JsonSchema)]
pub enum SpaceName {
    /// x to the patient's left, y to posterior, z to superior.
    #[serde(rename = "LPS")]
    Lps,
    /// x to the patient's right, y to anterior, z to superior.
    #[serde(rename = "RAS")]
    Ras,
}

impl SpaceName {
    /// The space of this name.
    pub(super) fn space(self) -> Space {
        match self {
            Self::Lps => Space::Lps,
            Self::Ras => Space::Ras,
        }
    }
}

/// Outputs of [`File`].
#[derive(Outputs)]
pub struct Out {
    /// The mesh, once.
    #[port(frame = "$frame")]
    mesh: Mesh,
    /// The file's `sha256`, by which a plan may be bound to it.
    report: Json,
}

impl Constant for File {
    const KIND: &'static str = "surface.file";
    type Params = Params;
    type Outputs = Out;

    fn check(params: &Params) -> Result<(), ParamError> {
        parts::choice(params.component.as_deref()).map(drop)
    }

    fn read(params: &Params, ctx: &mut Context) -> Result<Out, NodeError> {
        let Params { path, frame, unit_mm, space, component } = params;
        let mut read = read_mesh(path.as_ref(), *unit_mm, frame.as_str(), SurfaceOrigin::User)?;
        if let Some(name) = space {
            let space = name.space();
            let contradicts = |message| NodeError::new(format!("{message}, but space = \"{space}\"; leave space out"));
            read = read.in_space(space).map_err(contradicts)?;
        }
        if let Some(note) = read.space.taken_for_lps(&read.mesh.frame) {
            ctx.warn(format!("{note}; set space = \"LPS\", or \"RAS\" if they are that"));
        }
        read.notes.into_iter().for_each(|note| ctx.warn(note));
        let (mesh, notes) = parts::of_bone(read.mesh, parts::choice(component.as_deref())?)
            .map_err(|error| parts::in_file(path.as_ref(), &error))?;
        notes.into_iter().for_each(|note| ctx.warn(note));
        let report = json!({ "sha256": sha256(path.as_ref())? });
        Ok(Out { mesh, report: Json(Arc::new(report)) })
    }
}
