//! Files of clouds, surfaces, picked points, poses and CTs, each recognised by its content.

use super::error::{Error, UsageError};
use anyhow::{Context, Result, anyhow};
use osteoflow_engine::{Fault, Faults, durable, run, sweep};
use osteoflow_formats::{
    Space, input,
    mesh_or_cloud::{MeshOrCloud, MeshRead, read_mesh_or_cloud},
    picked_points::{PickedPoints, read_scene, write_fcsv, write_mrk_json, write_points_csv},
    pose_file::{itk_text, read_pose},
    probe::{Kind, Probe, probe},
    write::{self, Precision},
};
use osteoflow_geometry::{
    Cloud, Mesh, NamedPoint,
    nalgebra::{Isometry3, Matrix4},
    nearest_isometry,
};
use osteoflow_standard::surface::ct::{NoThreshold, read_bone};
use serde_json::json;
use std::{ffi::OsStr, fmt, io::Write as _, path::Path};

/// Faults of a graph file, or that it is no graph but a file of data, with the command that takes it.
pub(crate) fn unless_data<T>(path: &Path, checked: Result<T, Faults>) -> Result<T, Faults> {
    checked.map_err(|faults| match Data::of(path) {
        Some(data) => {
            let fault = Fault::new(format!("{} is no graph, but {data}", path.display()));
            Faults(vec![data.commands(path).into_iter().fold(fault, Fault::help)])
        }
        None => faults,
    })
}

/// A file or folder of data.
#[derive(Debug)]
pub(crate) enum Data {
    /// The folder of a run.
    Run,
    /// The folder of a sweep.
    Sweep,
    Other(Probe),
}

impl fmt::Display for Data {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Run => f.write_str("the folder of a run"),
            Self::Sweep => f.write_str("the folder of a sweep"),
            Self::Other(Probe { kind: kind @ Kind::Unread(_), .. }) => write!(f, "{kind}, which is not read"),
            Self::Other(probe) => probe.kind.fmt(f),
        }
    }
}

impl Data {
    /// What a file or folder holds; `None` if it cannot be read, is of no known format, or a graph by its name.
    pub(crate) fn of(path: &Path) -> Option<Self> {
        let holds = |name: &str| path.join(name).is_file();
        match path.extension().and_then(OsStr::to_str) {
            _ if holds(sweep::DESIGN) => Some(Self::Sweep),
            _ if holds(run::files::MANIFEST) => Some(Self::Run),
            Some("toml") => None,
            _ => probe(path)
                .ok()
                .filter(|found| found.kind != Kind::Unknown && !(found.kind == Kind::Ct && path.is_dir()))
                .map(Self::Other),
        }
    }

    /// What it is, unless that is a run or its folder.
    pub(crate) fn kind(&self) -> Option<Kind> {
        if let Self::Other(probe) = self { Some(probe.kind) } else { None }
    }

    /// The commands that take it, in words.
    pub(crate) fn commands(&self, path: &Path) -> Vec<String> {
        let file = path.display();
        let mut commands: Vec<String> = match self {
            Self::Run => vec![
                format!("see it: osteoflow view {file}"),
                format!("run it again from its recording: osteoflow replay {file}"),
                format!("or write a page about it: osteoflow report {file}"),
            ],
            Self::Sweep => vec![
                format!("write a page about it: osteoflow report {file}"),
                format!("or compare it with another: osteoflow compare {file} OTHER"),
            ],
            Self::Other(Probe { kind, advice, .. }) => match kind {
                Kind::Mesh | Kind::Ct => vec![
                    format!("register a scan onto it: osteoflow register {file} SCAN"),
                    format!("and see it in the browser: osteoflow view {file} SCAN"),
                ],
                Kind::Cloud => vec![
                    format!("register it onto its bone: osteoflow register BONE {file}"),
                    format!("and see it in the browser: osteoflow view BONE {file}"),
                ],
                Kind::Points => vec![format!("start from it: osteoflow register BONE SCAN --landmarks IN_BONE {file}")],
                Kind::Pose => vec![format!("start from it: osteoflow register BONE SCAN --init {file}")],
                Kind::Recording => vec![
                    format!("run it: osteoflow run graphs/fibula_recorded.toml --set recording.path={file}"),
                    format!("or see it: osteoflow view {file}"),
                ],
                Kind::Procedure => {
                    vec![format!("run it: osteoflow run graphs/fibula_folder.toml --set recording.path={file}")]
                }
                Kind::Unread(_) => return vec![advice.clone()],
                _ => Vec::new(),
            },
        };
        commands.push(format!("what it holds: osteoflow info {file}"));
        commands
    }
}

/// What a file holds.
#[derive(Debug)]
pub enum Content {
    /// A surface or a cloud, or the surface of the bone in a CT; mm.
    Shape(MeshOrCloud),
    /// Points picked by hand, mm.
    Points(PickedPoints),
    /// A rigid motion, mm, and notes on it.
    Pose(Isometry3<f64>, Vec<String>),
    /// A recording of a run.
    Recording,
}

/// Reads a file of any format that the program reads.
///
/// `unit_mm` is the file's unit in mm. `threshold_hu` and `series` are for a CT. Coordinates are LPS where the file states a
/// space.
///
/// # Errors
/// [`Error`] if it cannot be read or is of no known format.
pub fn read(
    file: &Path,
    unit_mm: f64,
    frame: &str,
    threshold_hu: Option<f64>,
    series: Option<&str>,
) -> Result<Content, Error> {
    if !(1e-6..=1e6).contains(&unit_mm) {
        let message =
            format!("unit_mm is {unit_mm}, but must be between 1e-6 and 1e6: 1 for millimetres, 1000 for metres");
        return Err(Error::Usage(message));
    }
    let kind = probe(file)?.kind;
    if kind == Kind::Ct {
        return ct(file, unit_mm, frame, threshold_hu, series);
    }
    for (option, is_given) in [("threshold_hu", threshold_hu.is_some()), ("series", series.is_some())] {
        if is_given {
            return Err(Error::Usage(format!("{option} is for a CT, and {} is {kind}", file.display())));
        }
    }
    Ok(match kind {
        Kind::Recording => Content::Recording,
        Kind::Points => {
            let mut picked = read_scene(file)?;
            if picked.space == Space::Unknown {
                picked.points.iter_mut().for_each(|point| point.position *= unit_mm);
            }
            Content::Points(picked)
        }
        Kind::Pose => {
            let read = read_pose(file, unit_mm)?;
            Content::Pose(read.isometry, read.notes)
        }
        _ => Content::Shape(read_mesh_or_cloud(file, &input::read(file)?, unit_mm, frame)?),
    })
}

fn ct(
    file: &Path,
    unit_mm: f64,
    frame: &str,
    threshold_hu: Option<f64>,
    series: Option<&str>,
) -> Result<Content, Error> {
    let name = file.display();
    if unit_mm != 1.0 {
        return Err(Error::Usage(format!("{name}: a CT states its unit; leave out unit_mm")));
    }
    let params = json!({ "path": file, "threshold_hu": threshold_hu, "series": series, "frame": frame });
    let params = serde_json::from_value(params).map_err(|error| Error::Usage(error.to_string()))?;
    let bone = read_bone(&params, NoThreshold::Suggest).map_err(|error| {
        let error = error.to_string();
        if error.contains(&name.to_string()) { anyhow!("{error}") } else { anyhow!("{name}: {error}") }
    })?;
    let read = MeshRead { mesh: bone.mesh, n_degenerate: 0, space: Space::Lps, notes: bone.notes };
    Ok(Content::Shape(MeshOrCloud::Mesh(read)))
}

/// Refuses to overwrite a file.
pub(crate) fn check_new(file: &Path) -> Result<()> {
    if !file.exists() {
        return Ok(());
    }
    Err(UsageError(format!("{} exists already; name another file, nothing is overwritten", file.display())).into())
}

/// Writes a file that is whole or not there; nothing is overwritten.
pub(crate) fn write_new(out: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let cannot = || format!("{} cannot be written", out.display());
    let mut part = durable::Part::new(out).with_context(cannot)?;
    part.file().write_all(content.as_ref()).with_context(cannot)?;
    part.keep_new().with_context(cannot)
}

/// Writes a surface as PLY, STL or OBJ, by the ending of the file, and returns what its reader should know; nothing is overwritten.
///
/// # Errors
/// [`Error`] if the file exists, has another ending, or cannot be written.
pub fn write_mesh(file: &Path, mesh: &Mesh, space: Space, precision: Precision) -> Result<Vec<String>, Error> {
    check_new(file)?;
    Ok(write::write_mesh(file, mesh, space, precision)?)
}

/// Writes a cloud as PLY, PCD, VTK, OBJ or CSV, by the ending of the file, and returns what its reader should know; nothing is
/// overwritten.
///
/// # Errors
/// As [`write_mesh`].
pub fn write_cloud(file: &Path, cloud: &Cloud, space: Space, precision: Precision) -> Result<Vec<String>, Error> {
    check_new(file)?;
    Ok(write::write_cloud(file, cloud, space, precision)?)
}

/// Writes named points as `.mrk.json`, `.fcsv` or `.csv`; nothing is overwritten.
///
/// # Errors
/// As [`write_mesh`]; also if the format states a space and `space` is unknown.
pub fn write_points(file: &Path, points: &[NamedPoint], space: Space) -> Result<(), Error> {
    check_new(file)?;
    let no_space = format!("{}: the format to write claims a space; give space = \"LPS\" or \"RAS\"", file.display());
    Ok(write_list(file, points, space, &no_space)?)
}

/// Writes a list of points; `no_space` is the message if the format states a space and theirs is unknown.
pub(crate) fn write_list(file: &Path, points: &[NamedPoint], space: Space, no_space: &str) -> Result<()> {
    let name = file.to_string_lossy().to_lowercase();
    if !name.ends_with(".csv") && space == Space::Unknown {
        return Err(UsageError(no_space.into()).into());
    }
    let written = match () {
        () if name.ends_with(".mrk.json") => write_mrk_json(file, points, space),
        () if name.ends_with(".fcsv") => write_fcsv(file, points, space),
        // A comment before the heading would keep other programs from reading it.
        () if name.ends_with(".csv") => write_points_csv(file, points, Space::Unknown),
        () => {
            usage!("{}: picked points are written as .csv, .mrk.json or .fcsv", file.display());
        }
    };
    Ok(written?)
}

/// Writes a rigid motion, the rows of its matrix, as `.txt` (these numbers), `.json` (these numbers under `T`) or `.tfm` (an ITK
/// transform, LPS); nothing is overwritten.
///
/// # Errors
/// As [`write_mesh`]; also if it is no rigid motion.
pub fn write_pose(file: &Path, rows: &[[f64; 4]; 4]) -> Result<(), Error> {
    check_new(file)?;
    let matrix = Matrix4::from_fn(|row, column| rows[row][column]);
    let nearest = nearest_isometry(&matrix).map_err(|error| Error::Usage(format!("the pose: {error}")))?;
    Ok(write_motion(file, &nearest.value, rows)?)
}

/// Writes a rigid motion, whose numbers may be rounded.
pub(crate) fn write_motion(file: &Path, t_to_from: &Isometry3<f64>, rows: &[[f64; 4]; 4]) -> Result<()> {
    let text = match write::ending(file).as_str() {
        "txt" => rows.map(|row| row.map(|c| format!("{c:?}")).join(" ") + "\n").concat(),
        "json" => format!("{}\n", json!({ "T": rows.concat() })),
        "tfm" => itk_text(t_to_from, &[]),
        _ => {
            let message = "no pose is written so; end it with .txt (the matrix), .json or .tfm (3D Slicer)";
            usage!("{}: {message}", file.display());
        }
    };
    write_new(file, &text)
}
