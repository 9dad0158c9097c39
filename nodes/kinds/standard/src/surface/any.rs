//! The kinds `surface.any`, `surface.file` and `surface.ct`: one bone from one file, by the same parameters.

use super::ct::{CtBone, NoThreshold, read_bone};
use crate::{constant::Constant, parts};
use osteoflow_algorithms::{ct_surface::ComponentChoice, parts::PartChoice};
use osteoflow_formats::{
    Space,
    input::{self, sha256_of},
    mesh_or_cloud::{MeshOrCloud, read_mesh, read_mesh_or_cloud},
    probe::is_ct,
    volume::data_files,
};
use osteoflow_geometry::{Cloud, Mesh, SurfaceOrigin};
use osteoflow_node::{
    Context, Describe, Emit, FilePath, NodeError, Outputs, ParamError, params,
    schemars::{JsonSchema, Schema},
    serde::Deserialize,
};
use osteoflow_payloads::Json;
use serde_json::{Value, json};
use std::{path::PathBuf, sync::Arc};

/// A bone from a file that holds a surface, points of a surface, or a CT.
///
/// A surface is STL, PLY, OBJ, OFF or VTK; points are PLY, PCD, VTK or text; a CT is NIfTI, NRRD, MetaImage or DICOM, from
/// which the surface is taken as by `surface.ct`. The content decides. One of `mesh` and `points` has an item;
/// `surface.prepare_any` takes either.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "surface.any"
path = "bone.stl"
"#,
    literature = ["Gibson 1998"]
)]
pub struct Any;

/// A triangle mesh from a file: STL, PLY, OBJ, OFF or VTK, recognised by its content.
///
/// As `surface.any`, but points and a CT are refused.
#[derive(Describe)]
#[describe(example = r#"
kind  = "surface.file"
path  = "bone.stl"
frame = "ct"
"#)]
pub struct File;

/// The surface of a bone in a CT: NIfTI, NRRD, MetaImage, or a DICOM series in a folder.
///
/// As `surface.any`, but other files are refused, and so is a CT without `threshold_hu`.
///
/// The surface lies where linear interpolation between voxels meets the threshold. It is not smoothed, and spaces inside the
/// bone are not part of it. It stays open where the border of the volume cuts the bone. Coordinates are LPS, as in the file.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "surface.ct"
path = "ct_series"
threshold_hu = 600.0
"#,
    literature = ["Gibson 1998"]
)]
pub struct Ct;

/// Parameters of [`Any`].
#[params(path)]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// The file; of a CT .nii, .nii.gz, .nrrd, .nhdr, .mha, .mhd or an enhanced DICOM file, or the folder of a DICOM series.
    pub path: FilePath,
    /// The frame of its coordinates. `ct`: the plan's.
    #[param("ct")]
    pub frame: String,
    /// Millimetres in the unit of a surface or of points; a CT states its unit. 1: files of bones are in millimetres; 1000:
    /// metres.
    #[param(1.0, 1e-6..=1e6)]
    pub unit_mm: f64,
    /// The axes of a surface or of points whose file does not state them; RAS is turned to LPS. Unset: LPS in frame `ct`, as in
    /// 3D Slicer, with a warning.
    pub space: Option<SpaceName>,
    /// Bone is above this in a CT; in the file's own values if they are not HU. Unset: half-way between soft tissue and bone in
    /// the volume, which the verdict names among its assumptions. `surface.ct`, and values that are not HU, are refused without
    /// it, with a suggestion, as the threshold moves the surface.
    pub threshold_hu: Option<f64>,
    /// Which DICOM series of the folder: its number, or the ending of its identifier, with `#2` for the second stack of a
    /// series. Unset: the only one that may be a CT; localizers and coloured pages are left out by name.
    pub series: Option<String>,
    /// Which connected part is the bone: `"largest"`, its number by size, such as `"2"`, or `"nearest:X,Y,Z"`, the part nearest
    /// to a point, mm; `osteoflow info` lists them. In a cluster of points, gaps are at most five times the median distance to
    /// the nearest other point. Unset: of a CT the largest above the threshold, else all.
    pub component: Option<String>,
    /// A point in the bone's cortex, LPS, which chooses the part of a CT, instead of `component`.
    pub seed_mm: Option<[f64; 3]>,
    /// Whether spaces enclosed by the bone in a CT count as bone. Unset: yes, as a camera sees only the outside.
    pub fill_cavities: Option<bool>,
}

/// Parameters of [`File`]: those of [`Any`] without the ones of a CT.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[schemars(transform = without_those_of_ct)]
pub struct FileParams {
    #[serde(flatten)]
    bone: Params,
}

/// Parameters of [`Ct`]: those of [`Any`] without what a CT states itself.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[schemars(transform = without_stated)]
pub struct CtParams {
    #[serde(flatten)]
    pub(super) bone: Params,
}

fn without_those_of_ct(schema: &mut Schema) {
    without(schema, &["threshold_hu", "series", "seed_mm", "fill_cavities"]);
    let path = schema.pointer_mut("/properties/path/description");
    path.into_iter().for_each(|path| *path = "The file.".into());
}

fn without_stated(schema: &mut Schema) {
    without(schema, &["unit_mm", "space"]);
}

fn without(schema: &mut Schema, names: &[&str]) {
    let properties = schema.get_mut("properties").and_then(Value::as_object_mut);
    properties.into_iter().for_each(|all| all.retain(|name, _| !names.contains(&name.as_str())));
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

/// Outputs of [`Any`].
#[derive(Outputs)]
pub struct Out {
    /// The surface, once; empty if the file holds points.
    #[port(frame = "$frame")]
    mesh: Emit<Mesh>,
    /// The points, once; empty if the file holds a surface or a CT.
    #[port(frame = "$frame")]
    points: Emit<Cloud>,
    /// What the file holds: `holds` (`surface`, `points` or `ct`), the `space` of its coordinates, the `assumptions` of a
    /// registration onto it, and its `sha256`, by which a plan may be bound to it; of a CT also what `surface.ct` reports.
    report: Json,
}

/// Outputs of [`File`] and [`Ct`].
#[derive(Outputs)]
pub struct MeshOut {
    /// The surface, once.
    #[port(frame = "$frame")]
    pub(super) mesh: Mesh,
    /// What a plan may be bound by: `sha256` of a single file, `frame_of_reference_uid` of a DICOM series; of a CT also the
    /// volume, the components, and how far the surface moves with the threshold.
    pub(super) report: Json,
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

    fn surface(mesh: Mesh, report: Value) -> Self {
        let points = Emit::Empty("the file holds a surface".into());
        Self { mesh: mesh.into(), points, report: Json(Arc::new(report)) }
    }
}

fn estimates_normals(read: &MeshOrCloud) -> bool {
    matches!(read, MeshOrCloud::Cloud(read, _) if read.cloud.normals().is_none())
}

const ESTIMATED: &str =
    "the normals of the surface were estimated from its points; on an open surface their side is a guess";

impl Constant for Any {
    const KIND: &'static str = "surface.any";
    type Params = Params;
    type Outputs = Out;

    fn check(params: &Params) -> Result<(), ParamError> {
        let path = params.path.as_ref();
        if is_ct(path) {
            let stated = [("space", params.space.is_some()), ("unit_mm", params.unit_mm != 1.0)];
            return match stated.iter().find(|(_, is_given)| *is_given) {
                Some((name, _)) => Err(ParamError::new(*name, "a CT states its unit and its axes; leave it out")),
                None => params.check_ct(),
            };
        }
        let of_ct = [
            ("threshold_hu", params.threshold_hu.is_some()),
            ("series", params.series.is_some()),
            ("seed_mm", params.seed_mm.is_some()),
            ("fill_cavities", params.fill_cavities.is_some()),
        ];
        if let Some((name, _)) = of_ct.iter().find(|(_, is_given)| *is_given && path.exists()) {
            let file = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy();
            return Err(ParamError::new(*name, format!("{name} is for a CT, and {file} is none; leave it out")));
        }
        parts::choice(params.component.as_deref()).map(drop)
    }

    fn files(params: &Params) -> Vec<PathBuf> {
        data_files(params.path.as_ref())
    }

    fn read(params: &Params, ctx: &mut Context) -> Result<Out, NodeError> {
        if !is_ct(params.path.as_ref()) {
            let bytes = input::read(params.path.as_ref())?;
            let read = read_mesh_or_cloud(params.path.as_ref(), &bytes, params.unit_mm, params.frame.as_str())?;
            return Ok(Out::of(params.taken(read, ctx)?, Some(sha256_of(&bytes))));
        }
        let CtBone { mesh, notes, mut report } = read_bone(params, NoThreshold::Suggest)?;
        notes.into_iter().for_each(|note| ctx.warn(note));
        let suggested_hu = report["threshold"].as_f64().filter(|_| params.threshold_hu.is_none());
        let assumed = |hu| {
            format!("bone begins at {hu:.0} HU, which the volume suggests and nobody gave; the surface moves with it")
        };
        report["holds"] = "ct".into();
        report["space"] = Space::Lps.to_string().into();
        report["assumptions"] = suggested_hu.map(assumed).into_iter().collect::<Vec<String>>().into();
        Ok(Out::surface(mesh, report))
    }
}

impl Constant for File {
    const KIND: &'static str = "surface.file";
    type Params = FileParams;
    type Outputs = MeshOut;

    fn check(params: &FileParams) -> Result<(), ParamError> {
        parts::choice(params.bone.component.as_deref()).map(drop)
    }

    fn read(FileParams { bone: params }: &FileParams, ctx: &mut Context) -> Result<MeshOut, NodeError> {
        let path = params.path.as_ref();
        let read = read_mesh(path, params.unit_mm, params.frame.as_str(), SurfaceOrigin::User)?;
        let MeshOrCloud::Mesh(read) = params.taken(MeshOrCloud::Mesh(read), ctx)? else {
            unreachable!("a part of a surface is one");
        };
        Ok(MeshOut { mesh: read.mesh, report: Json(Arc::new(json!({ "sha256": input::sha256(path)? }))) })
    }
}

impl Constant for Ct {
    const KIND: &'static str = "surface.ct";
    type Params = CtParams;
    type Outputs = MeshOut;

    fn check(params: &CtParams) -> Result<(), ParamError> {
        params.bone.check_ct()
    }

    fn files(params: &CtParams) -> Vec<PathBuf> {
        data_files(params.bone.path.as_ref())
    }

    fn read(params: &CtParams, ctx: &mut Context) -> Result<MeshOut, NodeError> {
        let bone = read_bone(&params.bone, NoThreshold::Refuse)?;
        bone.notes.into_iter().for_each(|note| ctx.warn(note));
        Ok(MeshOut { mesh: bone.mesh, report: Json(Arc::new(bone.report)) })
    }
}

impl Params {
    /// Refuses a choice of parts or a threshold that no CT serves.
    fn check_ct(&self) -> Result<(), ParamError> {
        match self.threshold_hu.is_some_and(|t| !t.is_finite()) {
            true => Err(ParamError::new("threshold_hu", "it is not finite")),
            false => self.part_of_ct().map(drop),
        }
    }

    /// The part of a CT that is the bone.
    pub(super) fn part_of_ct(&self) -> Result<ComponentChoice, ParamError> {
        match (&self.seed_mm, self.component.as_deref().unwrap_or("largest")) {
            (Some(_), component) if component != "largest" => {
                Err(ParamError::new("seed_mm", "the seed and component both choose a part; give one of them"))
            }
            (Some(seed), _) => Ok(ComponentChoice::Seed((*seed).into())),
            (None, component) => match parts::choice(Some(component))? {
                Some(PartChoice::Nearest(place)) => Ok(ComponentChoice::Nearest(place)),
                Some(PartChoice::Rank(rank)) => Ok(ComponentChoice::Rank(rank)),
                None => Ok(ComponentChoice::Rank(1)),
            },
        }
    }

    /// The chosen part of what was read, in the space that the parameters state; warns of what is in doubt.
    fn taken(&self, mut read: MeshOrCloud, ctx: &mut Context) -> Result<MeshOrCloud, NodeError> {
        if let Some(name) = self.space {
            let space = match name {
                SpaceName::Lps => Space::Lps,
                SpaceName::Ras => Space::Ras,
            };
            let contradicts = |stated| NodeError::new(format!("{stated}, but space = \"{space}\"; leave space out"));
            read = read.in_space(space).map_err(contradicts)?;
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
        Ok(read)
    }
}
