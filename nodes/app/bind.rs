//! Binds a plan to the surface that it was drawn on.

use super::{
    error::UsageError,
    files::{check_new, write_new},
};
use anyhow::{Result, anyhow, bail};
use osteoflow_algorithms::{
    mesh_query::MeshQuery,
    trust::{Answer, fingerprint, plan_faults},
};
use osteoflow_formats::{
    Space, input,
    mesh_or_cloud::{MeshOrCloud, MeshRead, read_mesh_or_cloud},
    plan_file::{PlanRead, bound_to, parse_plan},
    probe::is_ct,
    write::ending,
};
use osteoflow_geometry::{NamedPoint, SurfaceKey};
use osteoflow_standard::surface::ct::{NoThreshold, read_bone};
use serde::Deserialize as _;
use serde_json::json;
use std::path::Path;

/// Distance from the surface beyond which a planned point is noted, mm: picks on a surface are on it, and its triangles are finer.
const OFF_MM: f64 = 1.0;

/// A bone that a plan was drawn on: a surface, points of one, or a CT.
#[derive(Debug)]
pub(crate) struct Bone<'a> {
    /// The file, or the folder of a DICOM series.
    pub(crate) path: &'a Path,
    /// Millimetres in the unit of a surface or of points.
    pub(crate) unit_mm: f64,
    /// The space of its numbers, where it does not state it.
    pub(crate) space: Option<Space>,
    /// Bone is above this in a CT; unset: what the volume suggests.
    pub(crate) threshold_hu: Option<f64>,
    /// Which DICOM series of a folder; unset: the only one that may be a CT.
    pub(crate) series: Option<&'a str>,
}

/// Writes a plan with what identifies the bone: `surface` with the file's hash, the frame of reference of a DICOM series, and points
/// of the surface. Returns the key and notes.
///
/// # Errors
/// A file cannot be read, OUT exists or is no `.json`, or the plan contradicts the bone.
pub(crate) fn bind(plan: &Path, bone: &Bone<'_>, out: &Path) -> Result<(SurfaceKey, Vec<String>)> {
    check_new(out)?;
    if ending(out) != "json" {
        usage!("{}: a plan is written as .json", out.display());
    }
    let text = input::read_text(plan)?;
    let PlanRead { plan: drawn, mut notes, .. } = parse_plan(plan, &text)?;
    let BoneRead { mesh, key } = bone.read(&mut notes)?;
    let points: Vec<NamedPoint> = drawn.landmarks.points.iter().chain(&*drawn.assessment.points).cloned().collect();
    match &mesh {
        Some(mesh) => {
            let planes = Some(&drawn.planes).filter(|planes| !planes.planes.is_empty());
            let faults = plan_faults(mesh, &points, planes);
            if let Some(fault) = faults.iter().find(|fault| fault.answer == Answer::Refused) {
                bail!("{} is not bound to {}: {fault}", plan.display(), bone.path.display());
            }
            notes.extend(faults.iter().map(ToString::to_string));
            let off_mm =
                |p: &NamedPoint| mesh.closest_point(&p.position).map_or(f64::INFINITY, |closest| closest.distance_mm);
            let far =
                points.iter().map(|p| (p, off_mm(p))).max_by(|a, b| a.1.total_cmp(&b.1)).filter(|far| far.1 > OFF_MM);
            if let Some((point, mm)) = far {
                let message = "a plan that was drawn on this surface has its points nearer; look at both together";
                notes.push(format!("{} lies {mm:.1} mm off the surface: {message}", point.name));
            }
        }
        None => notes.push("the bone is points, so it was not examined whether the plan lies on it".into()),
    }
    if drawn.surface.is_some_and(|before| before != key) {
        notes.push(format!("{} was bound to another surface before", plan.display()));
    }
    write_new(out, &bound_to(plan, &text, &key)?)?;
    Ok((key, notes))
}

/// A bone as read.
struct BoneRead {
    mesh: Option<MeshQuery>,
    key: SurfaceKey,
}

impl Bone<'_> {
    fn read(&self, notes: &mut Vec<String>) -> Result<BoneRead> {
        let Self { path, unit_mm, space, threshold_hu, series } = *self;
        let usage = |message: String| UsageError(format!("{}: {message}", path.display()));
        let (shape, report) = if is_ct(path) {
            if unit_mm != 1.0 || space.is_some() {
                return Err(usage("a CT states its unit and space; leave out --scale and --space".into()).into());
            }
            let params =
                serde_json::from_value(json!({ "path": path, "threshold_hu": threshold_hu, "series": series }))?;
            let bone =
                read_bone(&params, NoThreshold::Suggest).map_err(|error| anyhow!("{}: {error}", path.display()))?;
            let read = MeshRead { mesh: bone.mesh, n_degenerate: 0, space: Space::Lps, notes: bone.notes };
            (MeshOrCloud::Mesh(read), bone.report)
        } else {
            if threshold_hu.is_some() {
                return Err(usage("--iso-hu is for a CT".into()).into());
            }
            if series.is_some() {
                return Err(usage("--series is for a folder with DICOM series".into()).into());
            }
            let bytes = input::read(path)?;
            let mut shape = read_mesh_or_cloud(path, &bytes, unit_mm, "ct")?;
            if let Some(space) = space {
                shape = shape.in_space(space).map_err(|stated| usage(format!("{stated}; leave out --space")))?;
            }
            (shape, json!({ "sha256": input::sha256_of(&bytes) }))
        };
        let taken = shape.space().taken_for_lps(&"ct".into());
        let named = |note: &String| format!("{}: {note}", path.display());
        notes.extend(taken.iter().chain(shape.notes()).map(named));
        let mut key = SurfaceKey::deserialize(report)?;
        let (vertices, mesh) = match shape {
            MeshOrCloud::Mesh(read) => (read.mesh.vertices().to_vec(), Some(MeshQuery::new(&read.mesh))),
            MeshOrCloud::Cloud(read, _) => (read.cloud.points().to_vec(), None),
        };
        key.points = fingerprint(&vertices);
        Ok(BoneRead { mesh, key })
    }
}
