//! Registration of two files: a run of `graphs/two_files.toml` in memory, with its options as settings of the graph.

mod answer;
mod files;
mod landmarks;
mod method;
mod run;
mod steps;
pub(crate) mod two_files;
pub(crate) mod words;

pub use answer::Registration;
pub use method::Method;
pub(crate) use steps::{cells, plain};

use super::{
    error::{Error, UsageError},
    program,
    settings::Settings,
};
use anyhow::{Context, Result};
use files::OutFiles;
use landmarks::Picked;
use method::{REPORT, has_output};
use osteoflow_engine::{
    Fault,
    check::{Checked, CommandLineParam, check_recorded, parameters},
};
use osteoflow_formats::{
    Space, input,
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
    pose_file,
    volume::is_volume,
};
use osteoflow_geometry::{
    NamedPoint,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::Kind;
use serde_json::Value;
use std::{
    collections::BTreeSet,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    time::Instant,
};

/// Frames of target and source in the graph.
const FRAMES: [&str; 2] = ["ct", "camera"];

/// A registration of SOURCE, which moves, onto TARGET, which stays.
#[derive(Debug, Clone)]
pub struct RegisterRequest {
    /// The surface that stays, points of it, or a CT.
    pub target: RegisterInput,
    /// The points that move, or a surface, whose vertices are taken.
    pub source: RegisterInput,
    /// Where to start.
    pub start: Start,
    /// What registers.
    pub method: Method,
    /// Correspondence search, such as `cached`.
    pub pairing: Option<String>,
    /// Largest distance of a pair, mm.
    pub max_pair_distance_mm: Option<f64>,
    /// Largest number of steps.
    pub max_iterations: Option<u32>,
    /// Converged if the remaining distance is below this, mm.
    pub step_mm: Option<f64>,
    /// And if the last turn is below this, rad.
    pub step_rad: Option<f64>,
    /// Further parameters of the method.
    pub settings: Settings,
    /// Whether `max_iterations` steps are taken on all points, instead of stopping at convergence.
    pub is_fixed: bool,
    /// Bone is above this in a CT, HU.
    pub threshold_hu: Option<f64>,
    /// Which DICOM series of a folder.
    pub series: Option<String>,
    /// Number of points sampled from a surface; by default that of the graph.
    pub target_points: Option<u64>,
    /// Seed of the run; by default that of the graph.
    pub seed: Option<u64>,
    /// The unit of a file in mm, of the translation of a start as well.
    pub units: Units,
    /// Position of the camera in the source's frame, mm.
    pub camera: Option<Point3<f64>>,
    /// Number of threads; by default the number of cores.
    pub workers: Option<NonZeroUsize>,
    /// Whether answers are loaded from the store and saved there.
    pub cache: bool,
    /// Number of registrations, for the timings.
    pub repeat: u32,
    /// Whether the pose is judged.
    pub is_judged: bool,
    /// Whether a doubtful pose is refused.
    pub requires_trusted: bool,
    /// Files to write.
    pub files: RegisterFiles,
    /// The space of the numbers in TARGET and SOURCE where they do not state it.
    pub space: Option<Space>,
}

/// A file, or its content in memory, in mm and named by `path`.
#[derive(Debug, Clone)]
pub struct RegisterInput {
    /// The file.
    pub path: PathBuf,
    /// What replaces it.
    pub content: Option<MeshOrCloud>,
}

impl From<PathBuf> for RegisterInput {
    fn from(path: PathBuf) -> Self {
        Self { path, content: None }
    }
}

/// Where a registration starts.
#[derive(Debug, Clone)]
pub enum Start {
    /// By the shape of the bone alone.
    Shape,
    /// At a pose, source to target.
    Pose(Isometry3<f64>),
    /// At the pose in a file.
    File(PathBuf),
    /// From points picked in target and source, matched by name.
    Landmarks([PathBuf; 2]),
}

impl Start {
    /// The pose in a file, or the identity for the word `identity`.
    pub fn file_or_identity(file: PathBuf) -> Self {
        if file.as_os_str() == "identity" { Self::Pose(Isometry3::identity()) } else { Self::File(file) }
    }
}

/// The units of the files in mm: 1000 for metres.
#[derive(Debug, Clone, Copy)]
pub struct Units {
    /// Of TARGET.
    pub target_mm: f64,
    /// Of SOURCE.
    pub source_mm: f64,
    /// Of the translation of a start from a file.
    pub init_mm: f64,
}

/// Files that a registration writes; nothing is overwritten.
#[derive(Debug, Clone, Default)]
pub struct RegisterFiles {
    /// The pose: .txt, .json or .tfm, or a folder with all of them and the moved source.
    pub out: Option<PathBuf>,
    /// The moved source.
    pub source: Option<PathBuf>,
    /// Every step as CSV.
    pub trace: Option<PathBuf>,
}

impl RegisterRequest {
    /// A registration with every option at its default.
    pub fn new(target: impl Into<PathBuf>, source: impl Into<PathBuf>) -> Self {
        Self {
            target: target.into().into(),
            source: source.into().into(),
            start: Start::Shape,
            method: Method::BuiltIn(Method::BUILT_IN[0].0.into()),
            pairing: None,
            max_pair_distance_mm: None,
            max_iterations: None,
            step_mm: None,
            step_rad: None,
            settings: Settings::default(),
            is_fixed: false,
            threshold_hu: None,
            series: None,
            target_points: None,
            seed: None,
            units: Units { target_mm: 1.0, source_mm: 1.0, init_mm: 1.0 },
            camera: None,
            workers: None,
            cache: true,
            repeat: 1,
            is_judged: true,
            requires_trusted: false,
            files: RegisterFiles::default(),
            space: None,
        }
    }

    /// Checks the request and reads the start.
    ///
    /// # Errors
    /// [`Error::Usage`] with the faults of the request; [`Error::Failed`] if a file of the start cannot be read.
    pub fn check(self) -> Result<Register, Error> {
        Ok(self.checked()?)
    }

    /// As [`Self::check`]; the error holds the faults.
    pub(crate) fn checked(mut self) -> Result<Register> {
        program::check_workers(self.workers)?;
        if self.repeat == 0 {
            return Err(UsageError("repeat is 0, but must be at least 1".into()).into());
        }
        let files = OutFiles::of(&self.files)?;
        for input in [&self.target, &self.source].into_iter().filter(|input| input.content.is_none()) {
            if !input.path.is_dir() {
                input::check(&input.path)?;
            }
        }
        let (kinds, kind_name) = self.method.kind()?;
        let known = kinds.known();
        let kind = known.registry.kind(&kind_name).context("the kind of the method was found")?;
        let (params, warnings) = self.params(kind)?;
        let mut notes: Vec<String> = warnings.into_iter().map(|warning| warning.message).collect();
        let began = Instant::now();
        let start = self.read_start(&mut notes)?;
        let init_ms = ms_since(began);
        let removed = self.removed(&start, has_output(kind, REPORT));
        let text = two_files::text(matches!(start, ReadStart::Landmarks { .. }), &removed)?;
        let sets = self.graph_settings(&kind_name, &params);
        let checked = check_recorded(&text, Path::new(two_files::NAME), sets.texts(), kinds)?;
        Ok(Register { request: self, checked, kind_name, params: params.all, files, start, init_ms, notes })
    }

    /// The options that set a parameter of the method: option, key and value.
    fn options(&self) -> Vec<(&'static str, &'static str, String)> {
        let number = |value: Option<f64>| value.map(|value| format!("{value:?}"));
        let options = [
            ("pairing", "pairing", self.pairing.clone()),
            ("max-pair-distance-mm", "max_pair_distance_mm", number(self.max_pair_distance_mm)),
            ("max-iterations", "max_iterations", self.max_iterations.map(|n| n.to_string())),
            ("step-mm", "stop_step_mm", number(self.step_mm)),
            ("step-rad", "stop_step_rad", number(self.step_rad)),
        ];
        options.into_iter().filter_map(|(option, key, value)| Some((option, key, value?))).collect()
    }

    /// Reads the parameters of the method's kind, with warnings. Settings outrank options.
    fn params(&self, kind: &Kind) -> Result<(Params, Vec<Fault>)> {
        let options = self.options();
        let options = options.iter().map(|(option, key, value)| CommandLineParam::Option { option, key, value });
        let fixed = if self.is_fixed { self.method.fixed() } else { &[] };
        let fixed = fixed.iter().map(|&(key, value)| CommandLineParam::Option { option: "stop fixed", key, value });
        let texts = self.settings.texts().iter().map(|text| CommandLineParam::Set(text));
        let set: Vec<_> = options.chain(texts).chain(fixed).collect();
        let (all, warnings) = parameters(&kind.description, "register", &set)?;
        let key = |param: &CommandLineParam<'_>| match param {
            CommandLineParam::Option { key, .. } => (*key).to_owned(),
            CommandLineParam::Set(text) => text.split(['=', '.']).next().unwrap_or_default().trim().to_owned(),
        };
        Ok((Params { set: set.iter().map(key).collect(), all }, warnings))
    }

    fn read_start(&mut self, notes: &mut Vec<String>) -> Result<ReadStart> {
        Ok(match self.start.clone() {
            Start::Shape => ReadStart::Shape,
            Start::Pose(pose) => ReadStart::Pose(pose),
            Start::File(file) => {
                let read = pose_file::read_pose(&file, self.units.init_mm)?;
                notes.extend(read.notes.iter().map(|note| format!("{}: {note}", file.display())));
                ReadStart::Pose(read.isometry)
            }
            Start::Landmarks([in_target, in_source]) => {
                let units = [self.units.target_mm, self.units.source_mm];
                let target = Picked { file: &in_target, stated: self.target.stated_space(units[0], FRAMES[0], notes)? };
                let source = Picked { file: &in_source, stated: self.source.stated_space(units[1], FRAMES[1], notes)? };
                let [target, source] = landmarks::read([target, source], units, self.space, notes)?;
                ReadStart::Landmarks { target, source }
            }
        })
    }

    /// What the graph lacks under this request.
    fn removed(&self, start: &ReadStart, has_report: bool) -> Vec<&'static str> {
        // The files of a registration are those that it names.
        let mut removed = vec!["node.export"];
        if let ReadStart::Pose(_) = start {
            removed.extend(["node.verdict.in.start", "results.start"]);
        }
        if !has_report {
            removed.extend(["node.verdict.in.icp", "results.icp"]);
        } else if self.is_fixed {
            // A fixed number of steps need not converge.
            removed.push("node.verdict.in.icp");
        }
        if !self.is_judged {
            removed.extend(["node.verdict", "results.verdict"]);
        }
        removed
    }

    /// The settings of the graph.
    fn graph_settings(&self, kind: &str, params: &Params) -> Settings {
        let mut settings = Settings::default();
        let path = |path: &Path| path.display().to_string().into();
        settings.set("bone.path", &path(&self.target.path));
        settings.set("scan.path", &path(&self.source.path));
        settings.set("icp.kind", &kind.into());
        let optional = [
            ("bone.unit_mm", Some(self.units.target_mm).filter(|mm| *mm != 1.0).map(Into::into)),
            ("scan.unit_mm", Some(self.units.source_mm).filter(|mm| *mm != 1.0).map(Into::into)),
            ("bone.threshold_hu", self.threshold_hu.map(Into::into)),
            ("bone.series", self.series.clone().map(Into::into)),
            ("scan.camera", self.camera.map(|camera| camera.coords.as_slice().to_vec().into())),
            ("ct_surface.n_points", self.target_points.map(|n| (n as i64).into())),
            ("graph.seed", self.seed.map(|seed| (seed as i64).into())),
            ("results.require", self.requires_trusted.then(|| "trusted".into())),
        ];
        for (key, value) in optional {
            value.into_iter().for_each(|value| settings.set(key, &value));
        }
        let all = params.all.as_object();
        for key in &params.set {
            let value = all.and_then(|all| all.get(key)).and_then(|value| toml::Value::try_from(value).ok());
            value.into_iter().for_each(|value| settings.set(format_args!("icp.{key}"), &value));
        }
        settings
    }
}

impl RegisterInput {
    /// The space that the file states. Reads it, since picked points are turned as the file that they were picked in.
    fn stated_space(&mut self, unit_mm: f64, frame: &str, notes: &mut Vec<String>) -> Result<Space> {
        if self.content.is_none() && is_volume(&self.path) {
            return Ok(Space::Lps);
        }
        let read = match self.content.take() {
            Some(content) => content,
            None => {
                let bytes = input::read(&self.path)?;
                let read = read_mesh_or_cloud(&self.path, &bytes, unit_mm, frame)?;
                notes.extend(read.notes().iter().map(|note| format!("{}: {note}", self.path.display())));
                read
            }
        };
        Ok(self.content.insert(read).space())
    }
}

/// The parameters of the method's kind.
struct Params {
    /// Names of those that are set.
    set: BTreeSet<String>,
    /// All of them.
    all: Value,
}

/// A start whose files are read.
#[derive(Debug, Clone)]
enum ReadStart {
    Shape,
    Pose(Isometry3<f64>),
    Landmarks { target: Vec<NamedPoint>, source: Vec<NamedPoint> },
}

/// A checked registration.
pub struct Register {
    request: RegisterRequest,
    checked: Checked,
    /// The kind that registers.
    kind_name: String,
    /// Its parameters.
    params: Value,
    files: OutFiles,
    start: ReadStart,
    init_ms: f64,
    notes: Vec<String>,
}

fn ms_since(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() * 1e3
}
