use super::{
    Exit, Global, UsageError,
    content::{is_volume, picked_points},
};
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use osteoflow_formats::{
    FileError, Space,
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
    picked_points::{PickedPoints, parse_picked_points, write_fcsv, write_mrk_json, write_points_csv},
    write::{write_cloud, write_mesh},
};
use osteoflow_geometry::{
    Cloud, Mesh, NamedPoint,
    nalgebra::{Point3, Vector3},
};
use osteoflow_standard::surface::ct::{NoThreshold, read_bone};
use serde_json::json;
use std::{fs, io::Write, path::PathBuf};

/// Convert a file of points, a surface, picked points or a CT into another format.
///
/// The format of IN is recognised by its content, that of OUT by its ending: surfaces to .ply, .stl, .obj, their vertices to .pcd
/// or .csv; clouds to .ply, .pcd, .obj or .csv (x,y,z with a heading); picked points to .csv (label,x,y,z), .mrk.json or .fcsv;
/// a CT to the surface of its largest part.
/// Lengths are millimetres after --scale. Files that state RAS are turned to LPS; where a file states no space its numbers stay as
/// they are. Nothing is overwritten.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow convert scan.pcd scan.ply
  osteoflow convert bone_in_metres.obj bone.stl --scale 1000
  osteoflow convert ct_series bone.stl --iso-hu 600
  osteoflow convert plan.mrk.json plan.csv
  osteoflow convert picked.pp picked.mrk.json --space RAS    MeshLab states no space; here its numbers are RAS")]
pub(crate) struct Convert {
    /// The file to read.
    #[arg(value_name = "IN")]
    input: PathBuf,

    /// The file to write.
    #[arg(value_name = "OUT")]
    output: PathBuf,

    /// Factor for all lengths: 1000 for a file in metres.
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR", value_parser = factor)]
    scale: f64,

    /// The surface of IN, a CT, at this value, HU; its largest part above it.
    #[arg(long, value_name = "HU", allow_hyphen_values = true)]
    iso_hu: Option<f64>,

    /// The space of the numbers in IN, if IN does not state it; OUT is LPS then, as far as it can say so.
    #[arg(long, value_enum, ignore_case = true, value_name = "LPS|RAS")]
    space: Option<super::register::SpaceOption>,
}

impl Convert {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        if self.output.exists() {
            let message =
                format!("{} exists already; name another file, nothing is overwritten", self.output.display());
            return Err(UsageError(message).into());
        }
        if self.input.is_dir() || is_volume(&self.input) {
            let (done, notes) = self.ct()?;
            return self.done(&done, &notes, global);
        }
        if self.iso_hu.is_some() {
            return Err(UsageError(format!("{}: --iso-hu is for a CT", self.input.display())).into());
        }
        let bytes = fs::read(&self.input).with_context(|| format!("{} cannot be read", self.input.display()))?;
        let (done, notes) = match self.picked(&bytes) {
            Some(picked) => self.points(picked.map_err(without_cause)?)?,
            None => self.shape(&bytes)?,
        };
        self.done(&done, &notes, global)
    }

    /// Prints what was written.
    fn done(&self, done: &str, notes: &[String], global: &Global) -> Result<Exit> {
        if !global.quiet {
            for note in notes {
                writeln!(std::io::stderr(), "{}: {}: {note}", global.paint_err("note", "1"), self.input.display())?;
            }
            writeln!(std::io::stdout(), "{}: {done}", self.output.display())?;
        }
        Ok(Exit::Done)
    }

    /// The surface of a CT.
    fn ct(&self) -> Result<(String, Vec<String>)> {
        if self.scale != 1.0 || self.space.is_some() {
            let message = "a CT states its unit and space; leave out --scale and --space";
            return Err(UsageError(format!("{}: {message}", self.input.display())).into());
        }
        let Some(iso_hu) = self.iso_hu else {
            return Err(UsageError(format!("{}: give --iso-hu; bone is above it", self.input.display())).into());
        };
        let params = serde_json::from_value(json!({ "path": self.input, "threshold_hu": iso_hu }))?;
        let bone = read_bone(&params, NoThreshold::Refuse).map_err(|error| anyhow!("{error}"))?;
        write_mesh(&self.output, &bone.mesh, Space::Lps).map_err(without_cause)?;
        let (n_vertices, n_faces) = (bone.mesh.vertices().len(), bone.mesh.faces().len());
        Ok((format!("{n_vertices} vertices, {n_faces} faces{}", in_space(Space::Lps)), bone.notes))
    }

    /// The picked points in the bytes; `None` if it is a surface or a cloud. A text of numbers alone is a list of points if OUT is.
    fn picked(&self, bytes: &[u8]) -> Option<Result<PickedPoints, FileError>> {
        let name = self.output.to_string_lossy().to_lowercase();
        let writes_list = name.ends_with(".mrk.json") || name.ends_with(".fcsv");
        picked_points(&self.input, bytes).or_else(|| writes_list.then(|| parse_picked_points(&self.input, bytes)))
    }

    fn points(&self, read: PickedPoints) -> Result<(String, Vec<String>)> {
        let PickedPoints { mut points, planes, rois, space, n_skipped, mut notes, .. } = read;
        if n_skipped > 0 {
            notes.push(format!("{n_skipped} points are not placed or not active, and were passed over"));
        }
        if !planes.is_empty() || !rois.is_empty() {
            notes.push(format!("{} planes and {} boxes are not points, and were left out", planes.len(), rois.len()));
        }
        if points.is_empty() {
            bail!("{}: there are no points in it, only planes or boxes", self.input.display());
        }
        let space = self.space_of(space);
        for NamedPoint { position, .. } in &mut points {
            *position = placed(position, self.scale, self.turns(space));
        }
        let name = self.output.to_string_lossy().to_lowercase();
        let out = match space {
            Space::Unknown => Space::Unknown,
            Space::Lps | Space::Ras => Space::Lps,
        };
        let written = match () {
            () if name.ends_with(".mrk.json") => write_mrk_json(&self.output, &points, self.claimed(out)?),
            () if name.ends_with(".fcsv") => write_fcsv(&self.output, &points, self.claimed(out)?),
            // A comment before the heading would keep other programs from reading it.
            () if name.ends_with(".csv") => write_points_csv(&self.output, &points, Space::Unknown),
            () => {
                let message = "picked points are written as .csv, .mrk.json or .fcsv";
                return Err(UsageError(format!("{}: {message}", self.output.display())).into());
            }
        };
        written.map_err(without_cause)?;
        notes.extend((out == Space::Unknown).then(|| "it states no space; its numbers stay as they are".to_owned()));
        Ok((format!("{} points{}", points.len(), in_space(out)), notes))
    }

    fn shape(&self, bytes: &[u8]) -> Result<(String, Vec<String>)> {
        let read = read_mesh_or_cloud(&self.input, bytes, self.scale, "ct").map_err(without_cause)?;
        let ending = self.output.extension().map(|end| end.to_string_lossy().to_lowercase()).unwrap_or_default();
        let (done, space, notes) = match read {
            MeshOrCloud::Mesh(read) if ["ply", "stl", "obj"].contains(&ending.as_str()) => {
                let space = self.space_of(read.space);
                let mesh = self.turned_mesh(read.mesh, space)?;
                write_mesh(&self.output, &mesh, written(space)).map_err(without_cause)?;
                let done = format!("{} vertices, {} faces", mesh.vertices().len(), mesh.faces().len());
                (done, space, read.notes)
            }
            MeshOrCloud::Mesh(read) => {
                let space = self.space_of(read.space);
                let mut notes = read.notes;
                notes.push("a surface; its vertices are written".into());
                let cloud = Cloud::new("ct", read.mesh.vertex_column().clone())?;
                (self.write_cloud(&cloud, space)?, space, notes)
            }
            MeshOrCloud::Cloud(read, notes) => {
                let space = self.space_of(read.space);
                (self.write_cloud(&read.cloud, space)?, space, notes)
            }
        };
        Ok((format!("{done}{}", in_space(written(space))), notes))
    }

    fn write_cloud(&self, cloud: &Cloud, space: Space) -> Result<String> {
        let cloud = self.turned_cloud(cloud, space)?;
        // A comment before the heading would keep other programs from reading it.
        let is_csv = self.output.extension().is_some_and(|end| end.eq_ignore_ascii_case("csv"));
        let stated = if is_csv { Space::Unknown } else { written(space) };
        write_cloud(&self.output, &cloud, stated).map_err(without_cause)?;
        Ok(format!("{} points", cloud.len()))
    }

    /// The space that a file states, else that of --space.
    fn space_of(&self, stated: Space) -> Space {
        match stated {
            Space::Lps | Space::Ras => Space::Lps,
            Space::Unknown => self.space.map_or(Space::Unknown, Into::into),
        }
    }

    /// Whether the numbers are RAS and turned to LPS; what stated its space was turned by the reader.
    fn turns(&self, space: Space) -> bool {
        space == Space::Ras
    }

    /// The space for a format that claims one.
    fn claimed(&self, space: Space) -> Result<Space> {
        if space != Space::Unknown {
            return Ok(space);
        }
        let message = "states no space, and the format to write claims one; give --space LPS or --space RAS";
        Err(UsageError(format!("{} {message}", self.input.display())).into())
    }

    fn turned_mesh(&self, mesh: Mesh, space: Space) -> Result<Mesh> {
        if !self.turns(space) {
            return Ok(mesh);
        }
        let vertices: Vec<Point3<f64>> = mesh.vertices().iter().map(|p| placed(p, 1.0, true)).collect();
        Ok(Mesh::new(mesh.frame.clone(), mesh.origin, vertices, mesh.faces().to_vec())?)
    }

    fn turned_cloud(&self, cloud: &Cloud, space: Space) -> Result<Cloud> {
        if !self.turns(space) {
            return Ok(cloud.clone());
        }
        let points: Vec<Point3<f64>> = cloud.points().iter().map(|p| placed(p, 1.0, true)).collect();
        let mut turned = Cloud::new("ct", points)?;
        if let Some(normals) = cloud.normals() {
            let normals: Vec<Vector3<f64>> = normals.iter().map(|n| Vector3::new(-n.x, -n.y, n.z)).collect();
            turned = turned.with_normals(normals)?;
        }
        for (name, column) in cloud.extras() {
            turned = turned.with_extra(name.clone(), column.clone())?;
        }
        Ok(turned)
    }
}

/// The space in which a file is written: LPS, if it is known.
fn written(space: Space) -> Space {
    if space == Space::Unknown { Space::Unknown } else { Space::Lps }
}

fn in_space(space: Space) -> String {
    if space == Space::Unknown { ", in the space of the file that was read".into() } else { format!(", {space}") }
}

fn placed(p: &Point3<f64>, scale: f64, turns: bool) -> Point3<f64> {
    let sign = if turns { -1.0 } else { 1.0 };
    Point3::new(sign * p.x, sign * p.y, p.z) * scale
}

fn factor(text: &str) -> Result<f64, String> {
    let factor: f64 = text.parse().map_err(|_| "a number is expected, such as 1000")?;
    (1e-6..=1e6).contains(&factor).then_some(factor).ok_or_else(|| "it must be between 1e-6 and 1e6".into())
}

/// The error without its cause, which its message already names.
fn without_cause(error: FileError) -> anyhow::Error {
    anyhow!("{error}")
}
