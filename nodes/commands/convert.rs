mod poses;
mod recording;

use super::common::{Exit, Global, LogArgs, terminal};
use crate::app::{
    UsageError,
    bind::{Bone, bind},
    files::{check_new, write_list, write_motion},
    register::{PART_KEY, TARGET_PART, part},
    space,
};
use anyhow::{Result, anyhow, bail};
use clap::Args;
use osteoflow_formats::{
    Space, input,
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
    picked_points::{PickedPoints, read_picked_points, read_scene},
    plan_file::{PlanRole, plan_of_picked, write_plan},
    pose_file::read_pose,
    probe::Kind,
    write::{Precision, ending, write_cloud, write_mesh},
};
use osteoflow_geometry::{
    matrix_rows,
    nalgebra::{Isometry3, Translation3, UnitQuaternion},
};
use osteoflow_standard::{
    parts,
    surface::ct::{NoThreshold, read_bone},
};
use serde_json::json;
use std::{
    io::Write,
    path::{Path, PathBuf},
};

/// Convert a file into another format: points, a surface, picked points, a CT, a rigid motion, a log of poses or a recorded cloud; make a plan of
/// what was drawn in 3D Slicer, or write into a plan on which surface it was drawn (--bind).
///
/// The format of IN is recognised by its content, that of OUT by its ending: surfaces to .ply, .stl, .obj, their vertices to .pcd
/// or .csv; clouds to .ply, .pcd, .vtk, .obj or .csv (x,y,z with a heading); picked points to .csv (label,x,y,z), .mrk.json or .fcsv,
/// and with planes, such as a scene of 3D Slicer planned with BoneReconstructionPlanner, to .json, a plan;
/// a CT to the surface of its largest part; a rigid motion to .txt (the matrix), .json or .tfm; a log of poses (.igs.mha of PLUS, TUM, EuRoC, KITTI, a table) to .mcap, .csv or .tum; a cloud
/// of a recording to what clouds are written as; a plan, with --bind, to the same plan that says which surface it was drawn on.
/// Lengths are millimetres after --scale. Files that state RAS are turned to LPS; where a file states no space its numbers stay as
/// they are. Nothing is overwritten.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow convert scan.pcd scan.ply
  osteoflow convert bone_in_metres.obj bone.stl --scale 1000
  osteoflow convert ct_series bone.stl --iso-hu 600
  osteoflow convert study bone.stl --iso-hu 600 --series 201
  osteoflow convert legs.stl left.stl --component nearest:80,0,-400
  osteoflow convert plan.mrk.json plan.csv
  osteoflow convert plan.json bound.json --bind bone.stl
  osteoflow convert planned.mrb plan.json --map screws=landmarks
  osteoflow convert pivot.igs.mha pivot.mcap
  osteoflow convert polaris.csv polaris.mcap --columns polaris.toml
  osteoflow convert bag scan.ply --topic /camera/points
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

    /// The surface of IN, a CT, at this value, HU: of the part that --component takes.
    #[arg(long, value_name = "HU", allow_hyphen_values = true)]
    iso_hu: Option<f64>,

    /// Which DICOM series of the folder IN (with --bind: of BONE): its number, or the ending of its identifier; info lists them.
    #[arg(long, value_name = "SERIES")]
    series: Option<String>,

    /// Which part of IN: largest, its number by size, such as 2, or nearest:X,Y,Z, the part nearest to a point, mm; info lists them.
    /// Default: of a CT the largest, else all of them.
    #[arg(long, value_name = "PART", value_parser = part, allow_hyphen_values = true, conflicts_with = "bind")]
    component: Option<String>,

    /// The space of the numbers in IN, if IN does not state it; OUT is LPS then, as far as it can say so.
    #[arg(long, value_parser = space(), ignore_case = true, value_name = "LPS|RAS")]
    space: Option<Space>,

    /// Write the numbers of a .ply or .pcd as doubles, bit for bit. Without it they are 32-bit floats, which every program reads,
    /// where these keep them to 1e-4 mm, and else doubles, which is noted: PCL reads zeros from them, and so does Open3D from a PCD.
    #[arg(long)]
    double: bool,

    /// IN is a plan, and OUT, .json, is the same plan bound to this surface or CT, on which it was drawn: a run then tells landmarks
    /// that were all aimed wrong from a plan of another series. --scale, --space, --iso-hu and --series are BONE's.
    #[arg(long, value_name = "BONE")]
    bind: Option<PathBuf>,

    /// What a plane, a list of points or a point of IN is in the plan OUT (.json): landmarks, assessment, plane (two by two they bound a
    /// segment, both normals from the first to the second), plane_reversed (with its normal to the other side) or ignored. Default: by the names of BoneReconstructionPlanner, of the lists landmarks and
    /// assessment, and of points P1, P2 .. and M1, M2 ..
    #[arg(long = "map", value_name = "NAME=ROLE", value_parser = role, conflicts_with = "bind")]
    map: Vec<(String, PlanRole)>,

    /// A plan that has what 3D Slicer does not draw, for the plan OUT: axes, anatomy and poses of markers.
    #[arg(long, value_name = "PLAN", conflicts_with = "bind")]
    rest: Option<PathBuf>,

    /// The topic of the cloud, if IN is a recording with clouds on several.
    #[arg(long, value_name = "TOPIC")]
    topic: Option<String>,

    /// Which message of the topic, from 1 on. Default: the first.
    #[arg(long, value_name = "N")]
    message: Option<usize>,

    #[command(flatten)]
    log: LogArgs,
}

impl Convert {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        check_new(&self.output)?;
        if let Some(bone) = &self.bind {
            if self.log.kind(&self.input)? == Kind::Points {
                let file = self.input.display();
                usage!("{file}: a plan (.json) is bound; make one by osteoflow convert {file} plan.json first");
            }
            return self.bound(bone, global);
        }
        let (done, notes) = self.converted()?;
        self.done(&done, &notes, global)
    }

    /// Writes OUT by what IN holds; what was written, and notes.
    fn converted(&self) -> Result<(String, Vec<String>)> {
        let found = self.log.kind(&self.input)?;
        let name = self.output.to_string_lossy().to_lowercase();
        let writes_list = name.ends_with(".mrk.json") || name.ends_with(".fcsv");
        let is_plan = name.ends_with(".json") && !writes_list;
        match found {
            _ if (!self.map.is_empty() || self.rest.is_some()) && !(is_plan && found == Kind::Points) => {
                let option = if self.map.is_empty() { "--rest" } else { "--map" };
                self.leave_out(option, "points and planes that become a plan (.json)", found)
            }
            Kind::Recording => self.recorded(),
            Kind::Poses(format) => self.poses(format),
            Kind::Ct => self.ct(),
            _ if self.series.is_some() => self.leave_out("--series", "a folder with DICOM series", found),
            _ if self.iso_hu.is_some() => self.leave_out("--iso-hu", "a CT", found),
            Kind::Points | Kind::Pose if self.component.is_some() => {
                self.leave_out("--component", "a surface, a cloud or a CT", found)
            }
            Kind::Pose if self.space.is_some() => self.leave_out("--space", "points and surfaces", found),
            Kind::Pose => self.pose(),
            Kind::Points if is_plan => self.plan(read_scene(&self.input)?),
            Kind::Points => self.points(read_scene(&self.input)?),
            Kind::Cloud | Kind::Unknown if writes_list => self.points(read_picked_points(&self.input)?),
            _ => self.shape(&input::read(&self.input)?),
        }
    }

    /// Refuses an option that is for something else.
    fn leave_out<T>(&self, option: &str, is_for: &str, found: Kind) -> Result<T> {
        let file = self.input.display();
        Err(UsageError(format!("{file}: {option} is for {is_for}, and this file holds {found}; leave it out")).into())
    }

    /// A plan bound to its bone.
    fn bound(&self, path: &Path, global: &Global) -> Result<Exit> {
        let bone = Bone {
            path,
            unit_mm: self.scale,
            space: self.space,
            threshold_hu: self.iso_hu,
            series: self.series.as_deref(),
        };
        let (key, notes) = bind(&self.input, &bone, &self.output)?;
        let by = [
            key.sha256.is_some().then(|| "its hash".to_owned()),
            key.frame_of_reference_uid.is_some().then(|| "its frame of reference".to_owned()),
            Some(format!("{} points on it", key.points.len())),
        ];
        let by = by.into_iter().flatten().collect::<Vec<_>>().join(", ");
        if !global.quiet {
            for note in notes {
                global.say("note", note)?;
            }
        }
        self.done(&format!("the plan, bound to {} by {by}", path.display()), &[], global)
    }

    /// Prints what was written.
    fn done(&self, done: &str, notes: &[String], global: &Global) -> Result<Exit> {
        if !global.quiet {
            for note in notes {
                global.say("note", format!("{}: {note}", self.input.display()))?;
            }
            writeln!(terminal::stdout(), "{}: {done}", self.output.display())?;
        }
        Ok(Exit::Done)
    }

    /// The surface of a CT.
    fn ct(&self) -> Result<(String, Vec<String>)> {
        if self.scale != 1.0 || self.space.is_some() {
            usage!("{}: a CT states its unit and space; leave out --scale and --space", self.input.display());
        }
        let Some(iso_hu) = self.iso_hu else {
            usage!("{}: give --iso-hu; bone is above it", self.input.display());
        };
        let params = serde_json::from_value(json!({
            "path": self.input,
            "threshold_hu": iso_hu,
            "component": self.component.as_deref().unwrap_or("largest"),
            "series": self.series,
        }))?;
        let bone = read_bone(&params, NoThreshold::Refuse).map_err(|error| anyhow!("{error}"))?;
        let mut notes = bone.notes;
        notes.extend(self.told(write_mesh(&self.output, &bone.mesh, Space::Lps, self.precision())?));
        let (n_vertices, n_faces) = (bone.mesh.vertices().len(), bone.mesh.faces().len());
        Ok((format!("{n_vertices} vertices, {n_faces} faces{}", in_space(Space::Lps)), notes))
    }

    /// A rigid motion.
    fn pose(&self) -> Result<(String, Vec<String>)> {
        let read = read_pose(&self.input, self.scale)?;
        write_motion(&self.output, &read.isometry, &matrix_rows(&read.isometry))?;
        Ok((Kind::Pose.to_string(), read.notes))
    }

    /// What was picked, in LPS and mm, and the space that it is in then.
    fn picked(&self, read: PickedPoints) -> Result<(PickedPoints, Space)> {
        let (turn, space) = self.to_lps(read.space)?;
        Ok((read.transformed(&Isometry3::from_parts(Translation3::identity(), turn), self.scale), space))
    }

    /// A plan of what was drawn in another program.
    fn plan(&self, read: PickedPoints) -> Result<(String, Vec<String>)> {
        let (picked, space) = self.picked(read)?;
        let read = plan_of_picked(&self.input, &PickedPoints { space, ..picked }, &self.map)?;
        let read = read.completed_by(self.rest.as_deref())?;
        write_plan(&self.output, &read.plan)?;
        let plan = read.plan;
        let n = [plan.planes.planes.len(), plan.landmarks.points.len(), plan.assessment.points.len()];
        let done = format!("a surgical plan: {} planes, {} landmarks, {} assessment points", n[0], n[1], n[2]);
        let begin = format!("{}: ", self.input.display());
        Ok((done, read.notes.iter().map(|note| note.strip_prefix(&begin).unwrap_or(note).to_owned()).collect()))
    }

    fn points(&self, read: PickedPoints) -> Result<(String, Vec<String>)> {
        let (PickedPoints { points, planes, rois, mut notes, .. }, space) = self.picked(read)?;
        if !planes.is_empty() || !rois.is_empty() {
            notes.push(format!("{} planes and {} boxes are not points, and were left out", planes.len(), rois.len()));
        }
        if points.is_empty() {
            bail!("{}: there are no points in it, only planes or boxes", self.input.display());
        }
        let message = "states no space, and the format to write claims one; give --space LPS or --space RAS";
        write_list(&self.output, &points, space, &format!("{} {message}", self.input.display()))?;
        Ok((format!("{} points{}", points.len(), in_space(space)), notes))
    }

    fn shape(&self, bytes: &[u8]) -> Result<(String, Vec<String>)> {
        let read = read_mesh_or_cloud(&self.input, bytes, self.scale, "ct")?;
        let ending = ending(&self.output);
        let choice = self.component.as_deref().map(str::parse).transpose().map_err(UsageError)?;
        let chosen = parts::of_target(read, choice);
        let (read, of_parts) = chosen.map_err(|error| UsageError(format!("{}: {error}", self.input.display())))?;
        let with_parts = |notes| with(notes, of_parts.iter().map(|note| note.replace(PART_KEY, TARGET_PART)).collect());
        match read {
            MeshOrCloud::Mesh(read) if ["ply", "stl", "obj"].contains(&ending.as_str()) => {
                let (turn, space) = self.to_lps(read.space)?;
                let mesh = read.mesh.transformed("ct", &Isometry3::from_parts(Translation3::identity(), turn));
                let told = write_mesh(&self.output, &mesh, space, self.precision())?;
                let (n_vertices, n_faces) = (mesh.vertices().len(), mesh.faces().len());
                Ok((
                    format!("{n_vertices} vertices, {n_faces} faces{}", in_space(space)),
                    with(with_parts(read.notes), self.told(told)),
                ))
            }
            other => {
                let (read, notes) = other.into_cloud();
                let (turn, space) = self.to_lps(read.space)?;
                let cloud = read.cloud.transformed("ct", &Isometry3::from_parts(Translation3::identity(), turn));
                // A comment before the heading would keep other programs from reading it.
                let stated = if ending == "csv" { Space::Unknown } else { space };
                let told = write_cloud(&self.output, &cloud, stated, self.precision())?;
                Ok((format!("{} points{}", cloud.len(), in_space(space)), with(with_parts(notes), self.told(told))))
            }
        }
    }

    fn precision(&self) -> Precision {
        if self.double { Precision::Double } else { Precision::Single }
    }

    /// Notes about the file that was written.
    fn told(&self, notes: Vec<String>) -> Vec<String> {
        notes.into_iter().map(|note| format!("in {} {note}", self.output.display())).collect()
    }

    /// The rotation that takes what was read to LPS, and the space that it is in then.
    ///
    /// # Errors
    /// --space is given for a file that states its space.
    fn to_lps(&self, stated: Space) -> Result<(UnitQuaternion<f64>, Space)> {
        match (stated, self.space) {
            (Space::Unknown, None) => Ok((UnitQuaternion::identity(), Space::Unknown)),
            (Space::Unknown, Some(space)) => Ok((space.turn(), Space::Lps)),
            // The reader has turned it.
            (_, None) => Ok((UnitQuaternion::identity(), Space::Lps)),
            (stated, Some(_)) => {
                usage!("{} states {stated}; leave out --space", self.input.display());
            }
        }
    }
}

fn with(mut notes: Vec<String>, more: Vec<String>) -> Vec<String> {
    notes.extend(more);
    notes
}

fn in_space(space: Space) -> &'static str {
    if space == Space::Unknown { ", in the space of the file that was read, which it does not state" } else { ", LPS" }
}

fn role(text: &str) -> Result<(String, PlanRole), String> {
    let (name, role) = text.rsplit_once('=').ok_or("NAME=ROLE is expected, such as screws=landmarks")?;
    Ok((name.into(), role.parse()?))
}

fn factor(text: &str) -> Result<f64, String> {
    let factor: f64 = text.parse().map_err(|_| "a number is expected, such as 1000")?;
    (1e-6..=1e6).contains(&factor).then_some(factor).ok_or_else(|| "it must be between 1e-6 and 1e6".into())
}
