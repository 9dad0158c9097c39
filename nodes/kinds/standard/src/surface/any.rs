//! The kind `surface.any`.

use super::{
    ct::{self, CtBone, NoThreshold, read_bone},
    file::SpaceName,
};
use crate::{constant::Constant, parts};
use osteoflow_formats::{
    Space,
    input::{self, sha256_of},
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
    volume::{data_files, is_volume},
};
use osteoflow_geometry::{Cloud, Mesh};
use osteoflow_node::{
    Context, Describe, Emit, FilePath, NodeError, Outputs, ParamError, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::Json;
use serde_json::json;
use std::{path::PathBuf, sync::Arc};

/// A bone from a file that holds a surface, points of a surface, or a CT.
///
/// A surface is STL, PLY, OBJ, OFF or VTK; points are PLY, PCD, VTK or text; a CT is NIfTI, NRRD, MetaImage or the folder of a DICOM series,
/// from which the surface is taken as by `surface.ct`. The format is recognised by the content. One of `mesh` and `points` has an
/// item; `surface.prepare_any` takes either.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "surface.any"
path = "bone.stl"
"#,
    literature = ["Gibson 1998"]
)]
pub struct Any;

/// Parameters of [`Any`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// The file, or the folder of a DICOM series.
    pub path: FilePath,
    /// The frame of its coordinates. `ct`: the plan's.
    #[serde(default = "crate::params::ct")]
    pub frame: String,
    /// Millimetres in the unit of a surface or of points. 1: files of bones are in millimetres; 1000 for a file in metres. A CT
    /// states its unit.
    #[serde(default = "crate::params::one")]
    #[schemars(range(min = 1e-6, max = 1e6))]
    pub unit_mm: f64,
    /// The axes of the numbers of a surface or of points, where the file does not state them; RAS is turned to LPS. Unset: in
    /// frame `ct` they are taken for LPS, as 3D Slicer takes them.
    pub space: Option<SpaceName>,
    /// Bone is above this in a CT, HU. Unset: half-way between soft tissue and bone in the volume, which the verdict names among
    /// its assumptions; refused with a suggestion where the values are not HU.
    pub threshold_hu: Option<f64>,
    /// Which DICOM series of the folder: its number, or the ending of its identifier. Unset: the only one that may be a CT.
    pub series: Option<String>,
    /// Which connected part is the bone: `"largest"`, its number by size, such as `"2"`, or `"nearest:X,Y,Z"`, the part nearest to a
    /// point, mm; `osteoflow info` lists them. Of points a part is a cluster: gaps in it are at most five times the median distance
    /// to the nearest other point. Unset: of a CT the largest above the threshold, else all of them.
    pub component: Option<String>,
    /// A point in the bone's cortex, LPS, which chooses the part of a CT instead of `component`.
    pub seed_mm: Option<[f64; 3]>,
    /// Whether spaces enclosed by the bone in a CT count as bone. Unset: they do, since a camera sees only the outside.
    pub fill_cavities: Option<bool>,
}

/// Outputs of [`Any`].
#[derive(Outputs)]
pub struct Out {
    /// The surface, once; empty if the file holds points.
    #[port(frame = "$frame")]
    mesh: Emit<Mesh>,
    /// The points, once; empty if the file holds a surface or a CT.
    #[port(frame = "$frame")]
    points: Emit<Cloud>,
    /// What the file holds: `holds` (`surface`, `points` or `ct`), the `space` of its coordinates, and the `assumptions` that a
    /// registration onto it makes, and the `sha256` of a file, by which a plan may be bound to it; of a CT also what `surface.ct` reports.
    report: Json,
}

impl From<MeshOrCloud> for Out {
    fn from(read: MeshOrCloud) -> Self {
        Self::of(read, None)
    }
}

impl Out {
    fn of(read: MeshOrCloud, sha256: Option<String>) -> Self {
        let space = read.space().to_string();
        let assumptions: &[&str] = if estimates_normals(&read) { &[ESTIMATED] } else { &[] };
        let report =
            |holds: &str| json!({ "holds": holds, "space": space, "sha256": sha256, "assumptions": assumptions });
        match read {
            MeshOrCloud::Mesh(read) => Self::surface(read.mesh, report("surface")),
            MeshOrCloud::Cloud(read, _) => Self {
                mesh: Emit::Empty("the file holds points".into()),
                points: read.cloud.into(),
                report: Json(Arc::new(report("points"))),
            },
        }
    }

    fn surface(mesh: Mesh, report: serde_json::Value) -> Self {
        let points = Emit::Empty("the file holds a surface".into());
        Self { mesh: mesh.into(), points, report: Json(Arc::new(report)) }
    }
}

fn estimates_normals(read: &MeshOrCloud) -> bool {
    matches!(read, MeshOrCloud::Cloud(read, _) if read.cloud.normals().is_none())
}

const ESTIMATED: &str =
    "the normals of the surface were estimated from its points; on an open surface their side is a guess";

impl Params {
    /// The parameters that only a CT has, by name, as far as they are given.
    fn of_ct(&self) -> impl Iterator<Item = &'static str> {
        let given = [
            ("threshold_hu", self.threshold_hu.is_some()),
            ("series", self.series.is_some()),
            ("seed_mm", self.seed_mm.is_some()),
            ("fill_cavities", self.fill_cavities.is_some()),
        ];
        given.into_iter().filter_map(|(name, is_given)| is_given.then_some(name))
    }

    fn ct(&self) -> ct::Params {
        ct::Params {
            path: self.path.clone(),
            threshold_hu: self.threshold_hu,
            component: self.component.clone().unwrap_or_else(ct::largest),
            seed_mm: self.seed_mm,
            series: self.series.clone(),
            fill_cavities: self.fill_cavities.unwrap_or(true),
            frame: self.frame.clone(),
        }
    }
}

impl Constant for Any {
    const KIND: &'static str = "surface.any";
    type Params = Params;
    type Outputs = Out;

    fn check(params: &Params) -> Result<(), ParamError> {
        let path = params.path.as_ref();
        if is_volume(path) {
            params.ct().check()?;
            if params.unit_mm != 1.0 || params.space.is_some() {
                let name = if params.space.is_some() { "space" } else { "unit_mm" };
                return Err(ParamError::new(name, "a CT states its unit and its axes; leave it out"));
            }
        } else if let Some(name) = params.of_ct().next().filter(|_| path.exists()) {
            let file = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
            return Err(ParamError::new(name, format!("{name} is for a CT, and {file} is none; leave it out")));
        }
        parts::choice(params.component.as_deref())?;
        Ok(())
    }

    fn files(params: &Params) -> Vec<PathBuf> {
        data_files(params.path.as_ref())
    }

    fn read(params: &Params, ctx: &mut Context) -> Result<Out, NodeError> {
        if is_volume(params.path.as_ref()) { params.read_ct(ctx) } else { params.read_shape(ctx) }
    }
}

impl Params {
    fn read_ct(&self, ctx: &mut Context) -> Result<Out, NodeError> {
        let CtBone { mesh, notes, mut report } = read_bone(&self.ct(), NoThreshold::Suggest)?;
        notes.into_iter().for_each(|note| ctx.warn(note));
        let suggested_hu = report["threshold"].as_f64().filter(|_| self.threshold_hu.is_none());
        let assumptions: Vec<String> = suggested_hu
            .map(|hu| {
                format!(
                    "bone begins at {hu:.0} HU, which the volume suggests and nobody gave; the surface moves with it"
                )
            })
            .into_iter()
            .collect();
        report["holds"] = "ct".into();
        report["space"] = Space::Lps.to_string().into();
        report["assumptions"] = assumptions.into();
        Ok(Out::surface(mesh, report))
    }

    fn read_shape(&self, ctx: &mut Context) -> Result<Out, NodeError> {
        let bytes = input::read(self.path.as_ref())?;
        let mut read = read_mesh_or_cloud(self.path.as_ref(), &bytes, self.unit_mm, self.frame.as_str())?;
        if let Some(name) = self.space {
            let contradicts =
                |stated| NodeError::new(format!("{stated}, but space = \"{}\"; leave space out", name.space()));
            read = read.in_space(name.space()).map_err(contradicts)?;
        }
        let (read, notes) = parts::of_target(read, parts::choice(self.component.as_deref())?)
            .map_err(|error| parts::in_file(self.path.as_ref(), &error))?;
        if let Some(note) = read.space().taken_for_lps(&self.frame.as_str().into()) {
            ctx.warn(format!("{note}; set space = \"LPS\", or \"RAS\" if they are that"));
        }
        read.notes().iter().chain(&notes).for_each(|note| ctx.warn(note));
        if estimates_normals(&read) {
            ctx.warn(
                "no normals; they are estimated from the points, outwards if the surface is closed; on an open one their side is a \
                 guess, which matters only where the scan says where the camera was",
            );
        }
        Ok(Out::of(read, Some(sha256_of(&bytes))))
    }
}
