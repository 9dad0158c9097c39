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
pub(crate) use steps::cells;

use super::{
    error::{Error, UsageError},
    options::{Keep, SettingValue, space},
    plugins::Plugins,
    program, shipped,
};
use anyhow::{Context, Result, bail};
use clap::{
    Args, Command, FromArgMatches, ValueEnum,
    builder::{PathBufValueParser, PossibleValue, PossibleValuesParser, TypedValueParser},
};
use files::OutFiles;
use landmarks::Picked;
use method::{REPORT, has_output};
use osteoflow_algorithms::{
    parts::PartChoice,
    sensor::{SensorKind, SensorParams},
};
use osteoflow_engine::{
    Fault,
    check::{Checked, CommandLineParam, check_recorded, parameters},
};
use osteoflow_formats::{
    Space, input,
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
    pose_file,
    probe::is_ct,
};
use osteoflow_geometry::{
    NamedPoint,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::Kind;
use osteoflow_standard::parts;
use serde::Deserialize;
use serde_json::Value;
use std::{
    collections::BTreeSet,
    fmt::Display,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    time::Instant,
};

/// The word for a start at the identity.
const IDENTITY: &str = "identity";

/// The node of the points at which the error is predicted.
pub(crate) const TARGETS: &str = "targets";

/// Frames of target and source in the graph.
const FRAMES: [&str; 2] = ["ct", "camera"];

/// A registration of SOURCE, which moves, onto TARGET, which stays.
#[derive(Debug, Clone, Args, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegisterRequest {
    /// The surface that stays, or points of it.
    #[serde(skip)]
    #[arg(value_parser = PathBufValueParser::new().map(RegisterInput::from))]
    pub target: RegisterInput,

    /// The points that move, or a surface, whose vertices are taken.
    #[serde(skip)]
    #[arg(value_parser = PathBufValueParser::new().map(RegisterInput::from))]
    pub source: RegisterInput,

    /// The start, source to target: 16 numbers row by row as text or JSON, a file of --out, or the word identity. A .tfm (ITK transform)
    /// is read as 3D Slicer saves it: such a file holds the inverse, and the program inverts it. Default: by the shape of the bone alone.
    #[arg(long, value_name = "FILE")]
    pub init: Option<PathBuf>,

    /// A start in memory, source to target, mm.
    #[serde(skip)]
    #[arg(skip)]
    pub init_pose: Option<Isometry3<f64>>,

    /// Start from three or more points picked in TARGET and in SOURCE, matched by name: Slicer markups (.mrk.json, .fcsv), a
    /// picking list of CloudCompare, MeshLab .pp, CSV (label,x,y,z) or text.
    #[arg(long, num_args = 2, value_names = ["TARGET_POINTS", "SOURCE_POINTS"], conflicts_with = "init")]
    pub landmarks: Option<Vec<PathBuf>>,

    /// Start from points that lie off the surface, such as screws, rings or skin markers. The verdict compares them with the registration of
    /// the surface. Files as of --landmarks.
    #[arg(long, num_args = 2, value_names = ["TARGET_POINTS", "SOURCE_POINTS"], conflicts_with_all = ["init", "landmarks"])]
    pub fiducials: Option<Vec<PathBuf>>,

    /// Named points in TARGET's frame at which the error is predicted, such as a tumour. The verdict then compares their mean error with its
    /// limit. Formats as of --landmarks.
    #[arg(long, value_name = "FILE", conflicts_with = "no_verdict")]
    pub targets: Option<PathBuf>,

    /// The method: which residuals the registration makes small. docs/method/icp.md says which to use.
    #[arg(long, default_value = method::BUILT_IN[0].0, value_name = "METHOD", conflicts_with = "plugins",
          value_parser = PossibleValuesParser::new(method::BUILT_IN.map(|(name, about)| PossibleValue::new(name).help(about))))]
    pub method: String,

    /// Plugins, of which one registers instead of a built-in method.
    #[serde(skip)]
    #[command(flatten)]
    pub plugins: Plugins,

    /// The kind of node that does the registration, if --plugin has several.
    #[arg(long, value_name = "STAGE.KIND", requires = "plugins", conflicts_with = "method")]
    pub kind: Option<String>,

    /// How the nearest sample of TARGET is found for each point: tree (searched at every step), or cached (only for points whose nearest one
    /// may have changed, with the same result). Default: that of the method.
    #[arg(long, value_name = "PAIRING")]
    pub pairing: Option<String>,

    /// Largest distance of a pair, mm.
    #[arg(long, value_name = "MM", value_parser = number)]
    pub max_pair_distance_mm: Option<f64>,

    /// Largest number of steps.
    #[arg(long, value_name = "N")]
    pub max_iterations: Option<u32>,

    /// Converged if the remaining distance is below this, mm.
    #[arg(long, value_name = "MM", value_parser = number)]
    pub step_mm: Option<f64>,

    /// Converged only if the last step also turned by less than this, rad.
    #[arg(long, value_name = "RAD", value_parser = number)]
    pub step_rad: Option<f64>,

    /// Any parameter of the method, as osteoflow inspect lists them: KEY=VALUE; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,

    /// When to stop.
    #[arg(long, value_enum, default_value_t = Stop::Converge, value_name = "WHEN", conflicts_with = "plugins")]
    pub stop: Stop,

    /// If TARGET is a CT: bone is above this value, HU. Default: midway between soft tissue and bone; the verdict then assumes it.
    #[arg(long, value_name = "HU", value_parser = number, allow_hyphen_values = true)]
    pub threshold_hu: Option<f64>,

    /// Which DICOM series of the folder TARGET: its number, or the ending of its identifier.
    #[arg(long, value_name = "SERIES")]
    pub series: Option<String>,

    /// Which part of TARGET: largest, a number (2 is the second largest), or nearest:X,Y,Z, the part nearest to this point, mm. osteoflow
    /// info lists the parts. Default: the largest of a CT, all of other files. A note says if some are about equally large.
    #[arg(long, value_name = "PART", value_parser = part, allow_hyphen_values = true)]
    pub component: Option<String>,

    /// Which part of SOURCE, written as for --component. A part of a cloud is a cluster: gaps in it are at most five times the median
    /// distance to the nearest other point. Default: all parts.
    #[arg(long, value_name = "PART", value_parser = part, allow_hyphen_values = true)]
    pub source_component: Option<String>,

    /// Only the points of SOURCE in this box: two opposite corners in its frame, mm. With several regions, a point must be in all of them.
    #[serde(rename = "box")]
    #[arg(long = "box", value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = box_mm, allow_hyphen_values = true)]
    pub box_mm: Option<[f64; 6]>,

    /// Only the points of SOURCE in this ball, its centre in SOURCE's frame and its radius, mm.
    #[serde(rename = "sphere")]
    #[arg(long = "sphere", value_name = "X,Y,Z,R", value_parser = sphere_mm, allow_hyphen_values = true)]
    pub sphere_mm: Option<[f64; 4]>,

    /// Only the points of SOURCE in a region that was drawn on the page of `osteoflow view` (region.json).
    #[arg(long, value_name = "FILE")]
    pub region: Option<PathBuf>,

    /// Number of points sampled from a target that is a surface.
    #[arg(long, default_value_t = 150_000, value_name = "N", value_parser = clap::value_parser!(u64).range(100..=10_000_000))]
    pub target_points: u64,

    /// If SOURCE has more points, only every second, third or n-th is used; 0: all. More would move the pose by less than its standard error.
    #[arg(long, default_value_t = 100_000, value_name = "N", value_parser = clap::value_parser!(u64).range(..=100_000_000))]
    pub max_points: u64,

    /// Seed of the sampling.
    #[arg(long, default_value_t = 1, value_name = "SEED")]
    pub seed: u64,

    /// The unit of all files in mm: 1000 for metres.
    #[arg(long, default_value_t = 1.0, value_name = "MM", value_parser = unit)]
    pub unit_mm: f64,

    /// The unit of TARGET in mm, if it differs.
    #[arg(long, value_name = "MM", value_parser = unit)]
    pub target_unit_mm: Option<f64>,

    /// The unit of SOURCE in mm, if it differs.
    #[arg(long, value_name = "MM", value_parser = unit)]
    pub source_unit_mm: Option<f64>,

    /// The unit of the translation in --init in mm, if it differs; files of --out are always in mm.
    #[arg(long, value_name = "MM", value_parser = unit)]
    pub init_unit_mm: Option<f64>,

    /// Position of the camera in the source's frame, mm; points then pair only with the side of the target that faces it.
    #[arg(long, value_name = "X,Y,Z", value_parser = camera, allow_hyphen_values = true)]
    pub camera: Option<Point3<f64>>,

    /// The device that measured SOURCE; the verdict expects its errors: structured_light, laser, depth_camera, ultrasound or stylus, or a
    /// TOML file that osteoflow sensor writes for your own. Default: structured_light.
    #[arg(long, value_name = "NAME|FILE")]
    pub sensor: Option<PathBuf>,

    /// Radius of the ball at the stylus' tip, mm. The points of SOURCE are then middles of this ball, one radius outside of the surface.
    #[arg(long, value_name = "MM", value_parser = number, allow_hyphen_values = true)]
    pub tip_radius_mm: Option<f64>,

    /// Number of threads; the pose does not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    pub workers: Option<NonZeroUsize>,

    /// Whether answers are cached.
    #[command(flatten)]
    pub keep: Keep,

    /// Prepare and register this many times, to measure the times; the pose is the same.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub repeat: u32,

    /// Do not judge the pose, to save the time. Whether it can be trusted is then unknown.
    #[arg(long)]
    pub no_verdict: bool,

    /// The lowest verdict with which a pose is still given.
    #[arg(long, value_enum, default_value_t = Require::Doubtful, value_name = "ANSWER", conflicts_with = "no_verdict")]
    pub require: Require,

    /// Write the pose as .txt (the 4 x 4 matrix), .json (the whole answer), .tfm (for 3D Slicer), or .mrb (a scene of 3D Slicer); the last two
    /// need --space. Without an ending: a folder with .txt, .json, .tfm and the moved SOURCE. Nothing is overwritten.
    #[arg(long, value_name = "FILE|DIR")]
    pub out: Option<PathBuf>,

    /// Write SOURCE as registered (.ply, .pcd, .csv). The column residual_mm is the distance of each point from the surface, positive
    /// outside. The column on_bone is 1 for points of the bone (in the given regions, no farther off than the inliers), else 0.
    #[arg(long, value_name = "FILE")]
    pub write_source: Option<PathBuf>,

    /// The anatomical axes of the coordinates in TARGET and SOURCE, where the files do not state them. A .tfm or .mrb needs them, and is
    /// always written in LPS.
    #[serde(skip)]
    #[arg(long, value_parser = space(), ignore_case = true, value_name = "LPS|RAS")]
    pub space: Option<Space>,

    /// Write every step into a CSV. Nothing is overwritten.
    #[arg(long, value_name = "FILE", conflicts_with = "plugins")]
    pub trace: Option<PathBuf>,
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stop {
    /// At convergence.
    Converge,
    /// After --max-iterations steps on all points, to measure times; earlier only if no step makes the residuals smaller.
    Fixed,
}

/// The worst verdict with which a pose is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Require {
    /// A doubtful pose is given.
    Doubtful,
    /// A doubtful pose is refused.
    Trusted,
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

/// The unit of a file, mm.
pub(crate) fn unit(text: &str) -> Result<f64, String> {
    let unit: f64 =
        text.parse().map_err(|_| "a number is expected: 1 for millimetres, 10 for centimetres, 1000 for metres")?;
    let usable = (1e-6..=1e6).contains(&unit);
    usable.then_some(unit).ok_or_else(|| "it must be between 1e-6 and 1e6: 1 for millimetres, 1000 for metres".into())
}

fn camera(text: &str) -> Result<Point3<f64>, String> {
    numbers::<3>(text, "0,0,0").map(Point3::from)
}

/// The text of a part, as an option.
pub(crate) fn part(text: &str) -> Result<String, String> {
    text.parse::<PartChoice>().map(|_| text.trim().to_owned())
}

fn numbers<const N: usize>(text: &str, example: &str) -> Result<[f64; N], String> {
    let cells: Option<Vec<f64>> = text.split(',').map(|cell| cell.trim().parse().ok()).collect();
    let n_found = cells.as_ref().map_or(0, Vec::len);
    let cells = cells.and_then(|cells| <[f64; N]>::try_from(cells).ok());
    cells.filter(|cells| cells.iter().all(|c| c.is_finite())).ok_or_else(|| {
        let comma = match n_found > N {
            true => format!("; {n_found} were found: a decimal comma? write 0.5, not 0,5"),
            false => String::new(),
        };
        format!("{N} finite numbers in mm are expected, such as {example}{comma}")
    })
}

/// A number of an option, with a decimal point.
pub(crate) fn number(text: &str) -> Result<f64, String> {
    let found = text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    found.ok_or_else(|| match text.trim().replacen(',', ".", 1) {
        point if text.contains(',') && point.parse::<f64>().is_ok() => format!("a decimal comma? write {point}"),
        _ => "a number is expected, such as 0.5".into(),
    })
}

/// A box by its lower and its upper corner.
fn box_mm(text: &str) -> Result<[f64; 6], String> {
    let example = "-60,-40,150,60,40,250";
    let corners: [f64; 6] = numbers(text, example)?;
    ordered(corners).ok_or_else(|| {
        format!("two opposite corners are expected, such as {example}, but these have a coordinate in common")
    })
}

fn ordered(corners: [f64; 6]) -> Option<[f64; 6]> {
    let ordered = std::array::from_fn(|k| {
        let (a, b) = (corners[k % 3], corners[k % 3 + 3]);
        if k < 3 { a.min(b) } else { a.max(b) }
    });
    (0..3).all(|k| ordered[k] < ordered[k + 3]).then_some(ordered)
}

fn sphere_mm(text: &str) -> Result<[f64; 4], String> {
    let example = "0,0,200,80";
    let sphere: [f64; 4] = numbers(text, example)?;
    let usable = RADII_MM.contains(&sphere[3]);
    usable
        .then_some(sphere)
        .ok_or_else(|| format!("the radius is {} mm, but must be between 0.001 and 1e6, as in {example}", sphere[3]))
}

/// Radii that `crop.sphere` takes, mm.
const RADII_MM: std::ops::RangeInclusive<f64> = 1e-3..=1e6;

impl Default for RegisterRequest {
    fn default() -> Self {
        Self::new("target", "source")
    }
}

impl RegisterRequest {
    /// The options by the names of their fields, all others at their default.
    ///
    /// # Errors
    /// [`Error::Usage`] for an option that there is not, or that takes another value.
    pub fn of(options: SettingValue) -> Result<Self, Error> {
        options.try_into().map_err(|error| Error::Usage(error.to_string().trim().replace('\n', " ")))
    }

    /// A registration with every option at its default.
    pub fn new(target: impl Into<PathBuf>, source: impl Into<PathBuf>) -> Self {
        let arguments = ["register".into(), "--".into(), target.into(), source.into()];
        let matches = Self::augment_args(Command::new("register")).get_matches_from(arguments);
        Self::from_arg_matches(&matches).expect("every other option has a default")
    }

    /// Checks the request and reads the start.
    ///
    /// # Errors
    /// The faults of the request, or a file of the start that cannot be read.
    pub fn check(mut self) -> Result<Register> {
        program::check_workers(self.workers)?;
        if self.repeat == 0 {
            usage!("repeat is 0, but must be at least 1");
        }
        let has_init = self.init.is_some() || self.init_pose.is_some();
        if [has_init, self.landmarks.is_some(), self.fiducials.is_some()].iter().filter(|is_given| **is_given).count()
            > 1
        {
            usage!("the start is given by more than one of init, landmarks and fiducials; leave one");
        }
        if let Some(corners) = self.box_mm.filter(|corners| ordered(*corners).is_none()) {
            usage!("the box {corners:?} has two corners with a coordinate in common");
        }
        let files = OutFiles::of(&self)?;
        for input in [&self.target, &self.source].into_iter().filter(|input| input.content.is_none()) {
            if input.path.extension().is_some_and(|ending| ending == "toml") {
                let file = input.path.display();
                usage!(
                    "{file} is a graph by its name, and no surface, points or CT; a graph is run by osteoflow run {file}"
                );
            }
            shipped::check_is_here(&input.path)?;
            if !input.path.is_dir() {
                input::check(&input.path)?;
            }
        }
        self.region.as_deref().map_or(Ok(()), input::check)?;
        let (kinds, kind_name) = self.kind()?;
        let known = kinds.known();
        let kind = known.registry.kind(&kind_name).context("the kind of the method was found")?;
        let (params, warnings) = self.params(kind)?;
        let mut notes: Vec<String> = warnings.into_iter().map(|warning| warning.message).collect();
        let began = Instant::now();
        let start = self.read_start(&mut notes)?;
        let targets = self.read_targets(&mut notes)?;
        let init_ms = began.elapsed().as_secs_f64() * 1e3;
        let removed = self.removed(has_output(kind, REPORT));
        let mut sets = self.graph_sets(&kind_name, &params);
        let sensor = toml::Table::try_from(self.stated_sensor()?).context("a sensor is a table")?;
        sets.extend(sensor.into_iter().map(|(key, value)| format!("ct_surface.sensor.{key}={value}")));
        sets.extend(self.region_sets());
        sets.extend((!removed.is_empty()).then(|| format!("remove={removed:?}")));
        self.choose_parts(&mut notes)?;
        let of_start = match start {
            ReadStart::Landmarks { .. } => two_files::from_pairs()?,
            ReadStart::Pose(_) => vec![r#"remove=["node.verdict.in.start", "results.start"]"#.into()],
            ReadStart::Shape => Vec::new(),
        };
        // The files of a registration are those that it names.
        let all = [&*of_start, &sets, &["remove=[\"node.export\"]".into()]].concat();
        let checked = check_recorded(two_files::BY_SHAPE, Path::new(two_files::NAME), &all, kinds)?;
        let params = params.all;
        Ok(Register { request: self, checked, all, sets, kind_name, params, files, start, targets, init_ms, notes })
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
        let fixed = if self.stop == Stop::Fixed { self.fixed() } else { &[] };
        let fixed = fixed.iter().map(|&(key, value)| CommandLineParam::Option { option: "stop fixed", key, value });
        let texts = self.sets.iter().map(|text| CommandLineParam::Set(text));
        let set: Vec<_> = options.chain(texts).chain(fixed).collect();
        let (all, warnings) = parameters(&kind.description, "register", &set)?;
        let key = |param: &CommandLineParam<'_>| match param {
            CommandLineParam::Option { key, .. } => (*key).to_owned(),
            CommandLineParam::Set(text) => text.split(['=', '.']).next().unwrap_or_default().trim().to_owned(),
        };
        Ok((Params { set: set.iter().map(key).collect(), all }, warnings))
    }

    fn read_start(&mut self, notes: &mut Vec<String>) -> Result<ReadStart> {
        if let Some(pose) = self.init_pose {
            return Ok(ReadStart::Pose(pose));
        }
        Ok(match (&self.init, self.landmarks.as_deref().or(self.fiducials.as_deref())) {
            (Some(word), _) if word.as_os_str() == IDENTITY => ReadStart::Pose(Isometry3::identity()),
            (Some(file), _) => {
                let read = pose_file::read_pose(file, self.init_unit_mm.unwrap_or(self.unit_mm))?;
                notes.extend(read.notes.iter().map(|note| format!("{}: {note}", file.display())));
                ReadStart::Pose(read.isometry)
            }
            (None, Some([in_target, in_source])) => {
                let units = self.units_mm();
                let target = Picked { file: in_target, stated: self.target.stated_space(units[0], FRAMES[0], notes)? };
                let source = Picked { file: in_source, stated: self.source.stated_space(units[1], FRAMES[1], notes)? };
                let [target, source] = landmarks::read([target, source], units, self.space, notes)?;
                ReadStart::Landmarks { target, source }
            }
            (None, Some(files)) => {
                usage!("{} files of picked points are given, but must be two: in TARGET, in SOURCE", files.len());
            }
            (None, None) => ReadStart::Shape,
        })
    }

    fn read_targets(&mut self, notes: &mut Vec<String>) -> Result<Vec<NamedPoint>> {
        let Some(file) = self.targets.clone() else { return Ok(Vec::new()) };
        if self.no_verdict {
            usage!("targets are where the verdict predicts the error; leave out no_verdict");
        }
        let unit_mm = self.units_mm()[0];
        let stated = self.target.stated_space(unit_mm, FRAMES[0], notes)?;
        let (points, _) = landmarks::points(&Picked { file: &file, stated }, unit_mm, self.space, notes)?;
        if points.is_empty() {
            bail!("--targets: {} holds no points", file.display());
        }
        Ok(points)
    }

    /// The units of TARGET and SOURCE in mm.
    fn units_mm(&self) -> [f64; 2] {
        [self.target_unit_mm, self.source_unit_mm].map(|unit_mm| unit_mm.unwrap_or(self.unit_mm))
    }

    /// What the graph lacks under this request.
    fn removed(&self, has_report: bool) -> Vec<&'static str> {
        let mut removed = Vec::new();
        if !has_report {
            removed.extend(["node.verdict.in.icp", "node.export.in.icp", "results.icp"]);
        } else if self.stop == Stop::Fixed {
            // A fixed number of steps need not converge.
            removed.push("node.verdict.in.icp");
        }
        if self.no_verdict {
            removed.extend(["node.verdict", "node.export.in.verdict", "results.verdict"]);
        }
        removed
    }

    /// The settings of the graph.
    fn graph_sets(&self, kind: &str, params: &Params) -> Vec<String> {
        let path = |path: &Path| Some(path.display().to_string().into());
        let unit = |unit_mm: f64| (unit_mm != 1.0).then(|| unit_mm.into());
        let [target_mm, source_mm] = self.units_mm();
        let is_judged = !self.no_verdict && self.fiducials.is_some();
        let keys: [(&str, Option<toml::Value>); 15] = [
            ("bone.path", path(&self.target.path)),
            ("scan.path", path(&self.source.path)),
            ("icp.kind", Some(kind.into())),
            ("bone.unit_mm", unit(target_mm)),
            ("scan.unit_mm", unit(source_mm)),
            ("bone.threshold_hu", self.threshold_hu.map(Into::into)),
            ("bone.series", self.series.clone().map(Into::into)),
            ("bone.component", self.component.clone().map(Into::into)),
            ("scan.component", self.source_component.clone().map(Into::into)),
            ("scan.camera", self.camera.map(|camera| camera.coords.as_slice().to_vec().into())),
            ("ct_surface.n_points", Some((self.target_points as i64).into())),
            ("thin.max_points", Some((self.max_points as i64).into())),
            ("graph.seed", Some((self.seed as i64).into())),
            ("verdict.on_surface", is_judged.then(|| false.into())),
            ("results.require", (self.require == Require::Trusted).then(|| "trusted".into())),
        ];
        let keys = keys.into_iter().filter_map(|(key, value)| Some(format!("{key}={}", value?)));
        let of_method = params
            .set
            .iter()
            .filter_map(|key| Some(format!("icp.{key}={}", toml::Value::try_from(params.all.get(key)?).ok()?)));
        let mut sets: Vec<String> = keys.chain(of_method).collect();
        if let Some(file) = &self.targets {
            let path = toml::Value::from(file.display().to_string());
            sets.extend([
                format!("node.{TARGETS}.kind=\"acquire.points\""),
                format!("node.{TARGETS}.frame={:?}", FRAMES[0]),
                format!("node.{TARGETS}.path={path}"),
                format!("node.verdict.in.assessment=\"{TARGETS}.points\""),
                "verdict.assessment_on_surface=false".to_owned(),
            ]);
        }
        sets
    }

    /// What the scan was measured with, as stated by a name, a file, or both.
    fn stated_sensor(&self) -> Result<SensorParams> {
        let tip = SensorParams { tip_radius_mm: self.tip_radius_mm, ..SensorParams::default() };
        let Some(given) = &self.sensor else { return Ok(tip) };
        let name = SensorKind::ALL.into_iter().find(|kind| given.as_os_str() == kind.word());
        if name.is_some() {
            return Ok(SensorParams { like: name, ..tip });
        }
        if !given.exists() {
            let names = SensorKind::ALL.map(SensorKind::word).join(", ");
            usage!("the sensor is \"{}\", which is no file and none of {names}", given.display());
        }
        Ok(tip.or(&input::read_toml(given, "description of a sensor")?))
    }

    /// The nodes that crop the scan, in the order in which it passes them: their names, the options, and their settings.
    fn crops(&self) -> impl Iterator<Item = (&'static str, &'static str, Vec<String>)> {
        let region = self.region.as_ref().map(|file| {
            let path = toml::Value::from(file.display().to_string());
            ("crop_region", "region", vec!["kind=\"crop.file\"".to_owned(), format!("path={path}")])
        });
        let sphere = self.sphere_mm.map(|[x, y, z, radius]| {
            let centre = format!("centre_mm=[{x:?}, {y:?}, {z:?}]");
            ("crop_sphere", "sphere", vec!["kind=\"crop.sphere\"".to_owned(), centre, format!("radius_mm={radius:?}")])
        });
        // The graph's own node.
        let of_box = self.box_mm.and_then(ordered).map(|[x0, y0, z0, x1, y1, z1]| {
            let corners = [format!("min_mm=[{x0:?}, {y0:?}, {z0:?}]"), format!("max_mm=[{x1:?}, {y1:?}, {z1:?}]")];
            ("crop", "box", corners.to_vec())
        });
        [region, sphere, of_box].into_iter().flatten()
    }

    /// The settings that insert a node for each region.
    fn region_sets(&self) -> Vec<String> {
        let mut sets = Vec::new();
        let mut wire = "scan.cloud".to_owned();
        for (node, _, of_node) in self.crops() {
            sets.push(format!("node.{node}.in.cloud={wire:?}"));
            sets.extend(of_node.iter().map(|set| format!("node.{node}.{set}")));
            wire = format!("{node}.cloud");
        }
        if wire != "crop.cloud" {
            sets.push(format!("node.crop.in.cloud={wire:?}"));
        }
        sets
    }

    /// Chooses the parts of files that are in memory, as their nodes would.
    fn choose_parts(&mut self, notes: &mut Vec<String>) -> Result<()> {
        let usage = |error: &dyn Display| UsageError(error.to_string());
        let choice = |part: &Option<String>| -> Result<Option<PartChoice>> {
            part.as_deref().map(str::parse).transpose().map_err(|error: String| usage(&error).into())
        };
        let (target, source) = (choice(&self.component)?, choice(&self.source_component)?);
        let inputs = [
            (&mut self.target, target, TARGET_PART, parts::of_target as fn(_, _) -> _),
            (&mut self.source, source, SOURCE_PART, parts::of_scan),
        ];
        for (input, choice, option, take) in inputs {
            let Some(content) = input.content.take() else { continue };
            let (content, of_parts) =
                take(content, choice).map_err(|error| usage(&format!("{}: {error}", input.path.display())))?;
            input.content = Some(content);
            let note = |note: String| format!("{}: {}", input.path.display(), note.replace(PART_KEY, option));
            notes.extend(of_parts.into_iter().map(note));
        }
        Ok(())
    }
}

/// A part in the notes of nodes, and as options.
pub(crate) const PART_KEY: &str = "component = ";
pub(crate) const TARGET_PART: &str = "--component ";
const SOURCE_PART: &str = "--source-component ";

impl RegisterInput {
    /// The space that the file states. Reads it, since picked points are turned as the file that they were picked in.
    fn stated_space(&mut self, unit_mm: f64, frame: &str, notes: &mut Vec<String>) -> Result<Space> {
        if self.content.is_none() && is_ct(&self.path) {
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
    pub(crate) request: RegisterRequest,
    checked: Checked,
    /// What is set of the graph of two files.
    all: Vec<String>,
    /// That of it which does not concern the start and the files of the answer.
    pub(crate) sets: Vec<String>,
    /// The kind that registers.
    kind_name: String,
    /// Its parameters.
    params: Value,
    files: OutFiles,
    start: ReadStart,
    /// Where the error is predicted.
    pub(crate) targets: Vec<NamedPoint>,
    init_ms: f64,
    notes: Vec<String>,
}
