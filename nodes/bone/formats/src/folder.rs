//! A procedure as a folder of files, for setups without a recorder.
//!
//! A file `procedure.toml` names the files. Paths are relative to it. This is a complete one:
//!
//! ```toml
//! format  = 1
//! tracker = true               # false: nothing is tracked; the camera's frame is then called `world`
//! unit    = "mm"               # "mm", "cm", "m" or "um"; for every file below that does not say its own
//!
//! [scan]                       # the bone, seen once in full
//! file    = "scan.ply"
//! stamp_s = 11.0               # when it was taken, on the tracker's clock; or stamp_ns = 11_000_000_000
//!
//! [[laser]]                    # that view with the laser spot on a landmark, once for each
//! label   = "P1"               # the landmark's name in the plan
//! file    = "laser_p1.ply"
//! stamp_s = 15.0
//!
//! [[laser]]
//! label   = "P2"
//! file    = "laser_p2.ply"
//! stamp_s = 19.0
//!
//! [[laser]]
//! label   = "P3"
//! file    = "laser_p3.ply"
//! stamp_s = 23.0
//! unit    = "m"                # this file alone is in metres
//!
//! [phantom_scan]               # the calibration phantom, seen once; only with a tracker
//! file    = "phantom.ply"
//! stamp_s = 1.0
//!
//! [[poses]]                    # the tracker's poses: t_ns,parent,child,x,y,z,qx,qy,qz,qw
//! file = "tracker.csv"
//!
//! [[stylus]]                   # points touched with the stylus: name,x,y,z and t_ns if known
//! role  = "assessment"         # "init", "assessment" or "palpation"
//! file  = "assessment.csv"
//! frame = "world"
//!
//! [region]                     # the part of the camera's view that shows bone, in `unit`
//! min = [-60, -60, 150]
//! max = [60, 60, 260]
//!
//! [plan]
//! file = "plan.json"
//!
//! [bone]                       # the bone's surface from CT, STL or PLY
//! file = "fibula.stl"
//!
//! [phantom]                    # the phantom's CAD surface, in its own frame
//! file = "phantom.stl"
//! ```
//!
//! Only `format` is always needed; a graph names what else it needs. A simulated folder has `simulated = true`, which is passed
//! on to every result. Clouds are in the frame `camera`, or `world` without a tracker, seen from its origin. Poses go by the name of their child: the role of `world,bone_marker` is
//! `bone_marker`, that of `phantom,phantom_marker` is `phantom_marker_cad`, since the other is the tracker's. A point
//! that is NaN is left out and counted in [`FolderStreams::notes`].

mod mistakes;

use crate::{
    FileError, LostPose, Sign, StampOrder, input,
    mesh_or_cloud::{MeshRead, read_cloud, read_mesh},
    plan_file::{PlanRead, read_plan},
    poses_csv::read_poses,
    probe,
};
use mistakes::{PosesFile, RowRead};
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::{Cloud, Corrections, Frame, NamedPoint, Pose, Region, StampNs, SurfaceOrigin, TooFar};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The name of the file that names the others.
pub const FILE_NAME: &str = probe::PROCEDURE;

/// A folder whose `procedure.toml` has been read and whose files have been found.
#[derive(Debug, Clone)]
pub struct ProcedureFolder {
    /// The `procedure.toml`.
    pub path: PathBuf,
    /// Whether anything was tracked; otherwise the camera's frame is called `world`.
    pub tracked: bool,
    /// Whether all this was simulated, as the folder says.
    pub simulated: bool,
    /// The region of interest in the camera's frame, mm.
    pub region: Option<Region>,
    manifest: Manifest,
}

/// The streams of a folder.
#[derive(Debug, Clone, PartialEq)]
pub struct FolderStreams {
    /// The items in the order of `procedure.toml` and of the lines of its files.
    pub items: Vec<FolderItem>,
    /// Data that were left out or corrected, one sentence each.
    pub notes: Vec<String>,
    /// Signs that a file of poses is wrong.
    pub signs: Vec<Sign>,
}

/// One item of a folder's streams.
#[derive(Debug, Clone, PartialEq)]
pub struct FolderItem {
    /// Its role: `scan`, `laser`, `phantom_scan`, `camera_marker`, `bone_marker`, `phantom_marker`,
    /// `phantom_marker_cad`, `init`, `assessment`, `palpation`, or the child frame of any other pose.
    pub role: String,
    /// When it was measured; 0 for a constant.
    pub stamp_ns: StampNs,
    /// The item itself.
    pub body: FolderBody,
}

/// The content of an item.
#[derive(Debug, Clone, PartialEq)]
pub enum FolderBody {
    /// A scan; laser scans carry their landmark as label.
    Cloud(Cloud),
    /// A pose, or the reason why there is none.
    Pose(Result<Pose, LostPose>),
    /// A point touched with the stylus, and its frame.
    Tip(Frame, NamedPoint),
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    format: u32,
    #[serde(default = "yes")]
    tracker: bool,
    #[serde(default)]
    simulated: bool,
    #[serde(default)]
    unit: Unit,
    scan: Option<ScanFile>,
    #[serde(default)]
    laser: Vec<LaserFile>,
    phantom_scan: Option<ScanFile>,
    #[serde(default)]
    poses: Vec<PlainFile>,
    #[serde(default)]
    stylus: Vec<StylusFile>,
    region: Option<RegionEntry>,
    plan: Option<PlainFile>,
    bone: Option<PlainFile>,
    phantom: Option<PlainFile>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ScanFile {
    file: PathBuf,
    unit: Option<Unit>,
    stamp_s: Option<f64>,
    stamp_ns: Option<StampNs>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct LaserFile {
    label: String,
    file: PathBuf,
    unit: Option<Unit>,
    stamp_s: Option<f64>,
    stamp_ns: Option<StampNs>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlainFile {
    file: PathBuf,
    unit: Option<Unit>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct StylusFile {
    role: StylusRole,
    file: PathBuf,
    #[serde(default = "world")]
    frame: String,
    unit: Option<Unit>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum StylusRole {
    Init,
    Assessment,
    Palpation,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct RegionEntry {
    min: [f64; 3],
    max: [f64; 3],
    unit: Option<Unit>,
}

#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Unit {
    #[default]
    Mm,
    Cm,
    M,
    Um,
}

impl Unit {
    fn mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::Cm => 10.0,
            Self::M => 1000.0,
            Self::Um => 0.001,
        }
    }
}

fn yes() -> bool {
    true
}

fn world() -> String {
    "world".into()
}

impl ProcedureFolder {
    /// Reads a `procedure.toml`, or the one in a folder, and looks whether the files it names are there.
    ///
    /// # Errors
    /// [`FileError`], naming line and column of an unknown key, a wrong value or a missing file.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let path = if path.is_dir() { path.join(FILE_NAME) } else { path.to_owned() };
        let text = input::read_text(&path)?;
        if path.extension().is_none_or(|ending| ending != "toml") && toml::from_str::<toml::Table>(&text).is_err() {
            let message = format!("a procedure in files is named by its folder, or by its {FILE_NAME}");
            let beside = path.with_file_name(FILE_NAME).is_file();
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let help = if beside { format!("; name {}", folder.display()) } else { String::new() };
            return Err(FileError::content(&path, "line 1", message + &help));
        }
        let manifest: Manifest = toml::from_str(&text).map_err(|error| {
            let place = error.span().map_or_else(|| "line 1".into(), |span| place_of(&text, span.start));
            FileError::content(&path, place, error.message().trim())
        })?;
        let folder = Self { tracked: manifest.tracker, simulated: manifest.simulated, region: None, path, manifest };
        folder.checked(&text)
    }

    fn checked(mut self, text: &str) -> Result<Self, FileError> {
        if self.manifest.format != 1 {
            let message = format!("format {} is not known, this reader knows 1", self.manifest.format);
            return Err(FileError::content(&self.path, "key \"format\"", message));
        }
        for file in self.files() {
            if !self.resolve(file).is_file() {
                let name = file.display().to_string();
                let place = text.find(&name).map_or_else(|| "files".into(), |at| place_of(text, at));
                let message = format!("there is no file \"{name}\"; paths are relative to {}", self.path.display());
                return Err(FileError::content(&self.path, place, message));
            }
        }
        if !self.tracked && (!self.manifest.poses.is_empty() || self.manifest.phantom_scan.is_some()) {
            let message =
                "it is false, but [[poses]] or [phantom_scan] are given; set tracker = true or leave them out";
            return Err(FileError::content(&self.path, "key \"tracker\"", message));
        }
        for (k, laser) in self.manifest.laser.iter().enumerate() {
            if self.manifest.laser[..k].iter().any(|other| other.label == laser.label) {
                let message = format!("label \"{}\" is given twice; each laser scan has its own landmark", laser.label);
                return Err(FileError::content(&self.path, format!("laser {}", k + 1), message));
            }
        }
        if let Some(region) = &self.manifest.region {
            let unit_mm = region.unit.unwrap_or(self.manifest.unit).mm();
            let (min, max) = (Point3::from(region.min) * unit_mm, Point3::from(region.max) * unit_mm);
            // A NaN compares as false, so it is refused here too.
            if !(0..3).all(|k| min[k] <= max[k]) {
                let message = format!("min {:?} does not lie below max {:?}", region.min, region.max);
                return Err(FileError::content(&self.path, "key \"region\"", message));
            }
            self.region = Some(Region { frame: self.camera_frame(), min, max });
        }
        Ok(self)
    }

    /// The frame of the clouds.
    pub fn camera_frame(&self) -> Frame {
        if self.tracked { "camera".into() } else { "world".into() }
    }

    /// The plan, if the folder has one.
    ///
    /// # Errors
    /// As [`read_plan`].
    pub fn plan(&self) -> Result<Option<PlanRead>, FileError> {
        self.manifest.plan.as_ref().map(|plan| read_plan(&self.resolve(&plan.file))).transpose()
    }

    /// The bone's surface from CT, in frame `ct`, if the folder has one.
    ///
    /// # Errors
    /// As [`read_mesh`].
    pub fn bone(&self) -> Result<Option<MeshRead>, FileError> {
        self.mesh(&self.manifest.bone, "ct")
    }

    /// The phantom's surface in its own frame `phantom`, if the folder has one.
    ///
    /// # Errors
    /// As [`read_mesh`].
    pub fn phantom(&self) -> Result<Option<MeshRead>, FileError> {
        self.mesh(&self.manifest.phantom, "phantom")
    }

    fn mesh(&self, file: &Option<PlainFile>, frame: &str) -> Result<Option<MeshRead>, FileError> {
        let Some(file) = file else { return Ok(None) };
        read_mesh(&self.resolve(&file.file), self.unit_mm(file.unit), frame, SurfaceOrigin::User).map(Some)
    }

    /// The files that `procedure.toml` names, in or out of its folder.
    pub fn named_files(&self) -> Vec<PathBuf> {
        self.files().map(|file| self.resolve(file)).collect()
    }

    /// Reads everything that has a time, and gives it in order of sensor time.
    ///
    /// # Errors
    /// [`FileError`] of the file that cannot be read.
    pub fn streams(&self) -> Result<FolderStreams, FileError> {
        let (mut items, mut notes, mut signs) = (Vec::new(), Vec::new(), Vec::new());
        let manifest = &self.manifest;
        if let Some(scan) = &manifest.phantom_scan {
            items.push(self.scan("phantom_scan", scan, None, &mut notes)?);
        }
        if let Some(scan) = &manifest.scan {
            items.push(self.scan("scan", scan, None, &mut notes)?);
        }
        for laser in &manifest.laser {
            let LaserFile { label, file, unit, stamp_s, stamp_ns } = laser.clone();
            let scan = ScanFile { file, unit, stamp_s, stamp_ns };
            items.push(self.scan("laser", &scan, Some(&label), &mut notes)?);
        }
        let mut poses_files = Vec::new();
        // A plan that cannot be read is a fault of the node that needs it.
        let planned = self
            .plan()
            .ok()
            .flatten()
            .and_then(|read| Some(read.plan.t_phantom_phantom_marker.as_ref()?.isometry.rotation));
        for file in &manifest.poses {
            let mut corrections = Corrections::default();
            let path = self.resolve(&file.file);
            let read = read_poses(&path, self.unit_mm(file.unit))?;
            let seen = read.log.poses.iter().zip(&read.lines).filter_map(|(pose, &line)| {
                let Pose { to, from, stamp_ns, isometry, .. } = &pose.as_ref().ok()?.value;
                let (translation, rotation) = (isometry.translation.vector, isometry.rotation);
                let (parent, child) = (to.to_string(), from.to_string());
                Some(RowRead { line, parent, child, stamp_ns: *stamp_ns, translation, rotation })
            });
            let seen = PosesFile { path: file.file.clone(), rows: seen.collect() };
            if let Some(planned) = &planned {
                mistakes::against_plan(&seen, planned)?;
            }
            let name = file.file.display();
            let scalar_first = mistakes::scalar_first(&seen).map(|sign| ("scalar_first", sign));
            let found = read.log.signs.into_iter().chain(scalar_first);
            signs.extend(found.map(|(rule, sign)| (rule, format!("{name}: {sign}"))));
            poses_files.push(seen);
            notes.extend(read.log.notes.iter().map(|note| format!("{name}: {note}")));
            for pose in read.log.poses {
                let pose = pose.map(|pose| corrections.take(pose));
                let (to, from, stamp_ns) = match &pose {
                    Ok(pose) => (&pose.to, &pose.from, pose.stamp_ns),
                    Err(lost) => (&lost.to, &lost.from, lost.stamp_ns),
                };
                let is_cad = to.as_str() == "phantom" && from.as_str() == "phantom_marker";
                let role = if is_cad { "phantom_marker_cad".into() } else { from.to_string() };
                items.push(FolderItem { role, stamp_ns, body: FolderBody::Pose(pose) });
            }
            notes.extend(corrections.note().map(|note| format!("{name}: {note}")));
        }
        let scans: Vec<StampNs> =
            items.iter().filter(|item| matches!(item.body, FolderBody::Cloud(_))).map(|item| item.stamp_ns).collect();
        mistakes::check(&poses_files, &scans)?;
        for file in &manifest.stylus {
            let role = match file.role {
                StylusRole::Init => "init",
                StylusRole::Assessment => "assessment",
                StylusRole::Palpation => "palpation",
            };
            let (tips, note) = read_tips(&self.resolve(&file.file), self.unit_mm(file.unit))?;
            notes.extend(note.map(|note| format!("{}: {note}", file.file.display())));
            for tip in tips {
                let body = FolderBody::Tip(file.frame.as_str().into(), tip.clone());
                items.push(FolderItem { role: role.into(), stamp_ns: tip.stamp_ns, body });
            }
        }
        Ok(FolderStreams { items, notes, signs })
    }

    fn scan(
        &self,
        role: &str,
        scan: &ScanFile,
        label: Option<&str>,
        notes: &mut Vec<String>,
    ) -> Result<FolderItem, FileError> {
        let path = self.resolve(&scan.file);
        let stamp_ns = self.stamp(scan)?;
        let read = read_cloud(&path, self.unit_mm(scan.unit), self.camera_frame())?;
        if read.n_dropped > 0 {
            let (file, n) = (scan.file.display(), read.n_points_in_file);
            notes.push(format!("{file}: {} of {n} points are not finite and were left out", read.n_dropped));
        }
        notes.extend(read.notes.iter().map(|note| format!("{}: {note}", scan.file.display())));
        let mut cloud = read.cloud.at(stamp_ns).seen_from(Isometry3::identity());
        if let Some(label) = label {
            cloud = cloud.labelled(label);
        }
        Ok(FolderItem { role: role.into(), stamp_ns, body: FolderBody::Cloud(cloud) })
    }

    fn stamp(&self, scan: &ScanFile) -> Result<StampNs, FileError> {
        let fault =
            |message: &str| FileError::content(&self.path, format!("stamp of \"{}\"", scan.file.display()), message);
        match (scan.stamp_ns, scan.stamp_s) {
            (Some(_), Some(_)) => Err(fault("give stamp_s or stamp_ns, not both")),
            (Some(ns), None) => Ok(ns),
            (None, Some(s)) if s.is_finite() && s.abs() < 9e9 => Ok((s * 1e9).round() as StampNs),
            (None, Some(_)) => Err(fault("stamp_s is no time in seconds")),
            (None, None) if self.tracked => {
                Err(fault("with a tracker a scan needs stamp_s or stamp_ns, to be paired with its poses"))
            }
            (None, None) => Ok(0),
        }
    }

    fn files(&self) -> impl Iterator<Item = &Path> {
        let w = &self.manifest;
        let scans = w.scan.iter().chain(&w.phantom_scan).map(|f| &f.file);
        let plain = w.poses.iter().chain(&w.plan).chain(&w.bone).chain(&w.phantom).map(|f| &f.file);
        let lasers = w.laser.iter().map(|f| &f.file);
        scans.chain(lasers).chain(plain).chain(w.stylus.iter().map(|f| &f.file)).map(PathBuf::as_path)
    }

    fn resolve(&self, file: &Path) -> PathBuf {
        self.path.parent().map_or_else(|| file.to_owned(), |folder| folder.join(file))
    }

    fn unit_mm(&self, unit: Option<Unit>) -> f64 {
        unit.unwrap_or(self.manifest.unit).mm()
    }
}

/// Named points from CSV with the header `name,x,y,z` and, if known, `t_ns`; positions in `unit_mm`. With a note, if their
/// stamps run backwards.
///
/// # Errors
/// [`FileError`], naming the line: a missing column, a word instead of a number, a point that is not finite or too far.
pub fn read_tips(path: &Path, unit_mm: f64) -> Result<(Vec<NamedPoint>, Option<String>), FileError> {
    let bytes = input::read(path)?;
    crate::space::check_comments(path, &bytes, unit_mm)?;
    let table = crate::table::Table::parse(path, &bytes)?;
    let [name, x, y, z] = [table.column("name")?, table.column("x")?, table.column("y")?, table.column("z")?];
    let t_ns = table.column("t_ns").ok();
    let tip = |row: &crate::table::Row| {
        let position = Point3::new(row.finite(x)?, row.finite(y)?, row.finite(z)?) * unit_mm;
        TooFar::check(position.coords.as_slice()).map_err(|far| row.fault(far.to_string()))?;
        let stamp_ns = t_ns.filter(|&k| !row.text(k).is_empty()).map_or(Ok(0), |k| row.whole(k))?;
        Ok(NamedPoint { stamp_ns, ..NamedPoint::new(row.named(name)?, position) })
    };
    let mut order = StampOrder::default();
    let mut tips = Vec::new();
    for row in table.rows() {
        let tip = tip(&row)?;
        order.take(tip.stamp_ns, || format!("line {}", row.line()));
        tips.push(tip);
    }
    Ok((tips, order.note("points")))
}

/// Line and column of a byte in a text.
fn place_of(text: &str, at: usize) -> String {
    let before = &text[..at.min(text.len())];
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
    format!("line {line}, column {column}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        plan_file::write_plan,
        poses_csv::write_poses,
        write::{write_ply, write_stl},
    };
    use osteoflow_geometry::{Mesh, Planes, Points, SurgicalPlan};

    /// The example in the module's documentation.
    fn example() -> String {
        let page = include_str!("folder.rs");
        let lines =
            page.lines().map_while(|line| line.strip_prefix("//!")).map(|line| line.strip_prefix(' ').unwrap_or(line));
        let inside =
            lines.skip_while(|line| !line.starts_with("```toml")).skip(1).take_while(|line| !line.starts_with("```"));
        inside.collect::<Vec<_>>().join("\n")
    }

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let point = Point3::new(1.0, 2.0, 200.0);
        let cloud = Cloud::new("camera", vec![point]).unwrap();
        for name in ["scan.ply", "laser_p1.ply", "laser_p2.ply", "phantom.ply"] {
            write_ply(&at(name), &cloud, 1.0).unwrap();
        }
        write_ply(&at("laser_p3.ply"), &cloud, 1000.0).unwrap();
        let pose = |to: &str, from: &str, ns| Pose::new(to, from, Isometry3::translation(1.0, 2.0, 3.0)).at(ns);
        let poses = [
            pose("world", "bone_marker", 12_000_000_000),
            pose("world", "camera_marker", 11_500_000_000),
            pose("phantom", "phantom_marker", 0),
            pose("world", "phantom_marker", 900_000_000),
        ];
        write_poses(&at("tracker.csv"), &poses).unwrap();
        std::fs::write(at("assessment.csv"), "name,x,y,z,t_ns\nM1,1,2,3,30000000000\nM2,4,5,6,31000000000\n").unwrap();
        let triangle = vec![Point3::origin(), Point3::new(30.0, 0.0, 0.0), Point3::new(0.0, 30.0, 0.0)];
        let mesh = Mesh::new("ct", SurfaceOrigin::User, triangle, vec![[0, 1, 2]]).unwrap();
        write_stl(&at("fibula.stl"), &mesh).unwrap();
        write_stl(&at("phantom.stl"), &mesh).unwrap();
        let none = || Points::new("ct", Vec::new());
        let plan = SurgicalPlan {
            surface: None,
            landmarks: none(),
            assessment: none(),
            planes: Planes::new("ct", Vec::new()),
            axes: None,
            anatomy: None,
            t_phantom_phantom_marker: None,
            t_camera_camera_marker_nominal: None,
        };
        write_plan(&at("plan.json"), &plan).unwrap();
        std::fs::write(at(FILE_NAME), example()).unwrap();
        folder
    }

    #[test]
    fn the_documented_example_has_its_streams() {
        let folder = folder();
        let procedure = ProcedureFolder::open(folder.path()).unwrap();
        let mut streams = procedure.streams().unwrap();
        streams.items.sort_by_key(|item| item.stamp_ns);
        assert_eq!(streams.notes, [""; 0]);
        let roles: Vec<(&str, StampNs)> =
            streams.items.iter().map(|i| (i.role.as_str(), i.stamp_ns / 100_000_000)).collect();
        let expected = [
            ("phantom_marker_cad", 0),
            ("phantom_marker", 9),
            ("phantom_scan", 10),
            ("scan", 110),
            ("camera_marker", 115),
            ("bone_marker", 120),
            ("laser", 150),
            ("laser", 190),
            ("laser", 230),
            ("assessment", 300),
            ("assessment", 310),
        ];
        assert_eq!(roles, expected);
        let clouds: Vec<&Cloud> = streams
            .items
            .iter()
            .filter_map(|i| match &i.body {
                FolderBody::Cloud(cloud) => Some(cloud),
                _ => None,
            })
            .collect();
        assert!(
            clouds.iter().all(|c| (c.points()[0] - Point3::new(1.0, 2.0, 200.0)).norm() < 1e-9),
            "in mm, whatever the unit"
        );
        assert!(clouds.iter().all(|c| c.frame.as_str() == "camera" && c.viewpoint == Some(Isometry3::identity())));
        assert_eq!(clouds.iter().filter_map(|c| c.label.as_deref()).collect::<Vec<_>>(), ["P1", "P2", "P3"]);
        assert_eq!(procedure.region.as_ref().unwrap().max, Point3::new(60.0, 60.0, 260.0));
        assert!(procedure.plan().unwrap().is_some());
        assert_eq!(procedure.bone().unwrap().unwrap().mesh.frame.as_str(), "ct");
        assert_eq!(procedure.phantom().unwrap().unwrap().mesh.frame.as_str(), "phantom");
    }

    #[test]
    fn without_a_tracker_the_camera_is_the_world_and_needs_no_stamps() {
        let folder = folder();
        let text = "format = 1\ntracker = false\n[scan]\nfile = \"scan.ply\"\n[[laser]]\nlabel = \"P1\"\nfile = \"laser_p1.ply\"\n";
        std::fs::write(folder.path().join(FILE_NAME), text).unwrap();
        let procedure = ProcedureFolder::open(&folder.path().join(FILE_NAME)).unwrap();
        let items = procedure.streams().unwrap().items;
        assert_eq!(items.len(), 2);
        for item in items {
            let FolderBody::Cloud(cloud) = item.body else { panic!("only scans were given") };
            assert_eq!((cloud.frame.as_str(), item.stamp_ns), ("world", 0));
        }
    }

    #[test]
    fn a_fault_names_its_line_or_key() {
        let folder = folder();
        let refusal = |from: &str, to: &str| {
            let text = example().replace(from, to);
            assert!(from.is_empty() || text != example(), "{from} is not in the example");
            std::fs::write(folder.path().join(FILE_NAME), text).unwrap();
            let result = ProcedureFolder::open(folder.path()).and_then(|p| p.streams());
            result.unwrap_err().to_string()
        };
        for (from, to, expected) in [
            ("format  = 1", "format = 2", "key \"format\": format 2 is not known, this reader knows 1"),
            ("[scan]", "[scans]", "line 5, column 2: unknown field `scans`, expected one of"),
            ("unit    = \"mm\"", "unit = \"inch\"", "line 3, column 8: unknown variant `inch`"),
            ("\"scan.ply\"", "\"scna.ply\"", "line 6, column 12: there is no file \"scna.ply\"; paths are relative to"),
            ("stamp_s = 15.0", "", "stamp of \"laser_p1.ply\": with a tracker a scan needs stamp_s or stamp_ns"),
            ("stamp_s = 15.0", "stamp_s = 15.0\nstamp_ns = 3", "give stamp_s or stamp_ns, not both"),
            (
                "tracker = true",
                "tracker = false",
                "key \"tracker\": it is false, but [[poses]] or [phantom_scan] are given",
            ),
            ("\"P2\"", "\"P1\"", "laser 2: label \"P1\" is given twice"),
            ("min = [-60", "min = [nan", "key \"region\": min [NaN"),
            ("label   = \"P1\"", "label = 1", "line 10, column 9: invalid type: integer `1`, expected a string"),
        ] {
            let refusal = refusal(from, to);
            assert!(refusal.contains(expected), "{expected}\n{refusal}");
        }
        std::fs::write(folder.path().join("assessment.csv"), "name,x,y,z\nM1,1,2,\n").unwrap();
        let refusal = refusal("", "");
        assert!(refusal.ends_with("assessment.csv: line 2: z is \"\", a number is expected"), "{refusal}");
    }
}
