//! `register`: one file registered onto another, without a graph.

pub(crate) mod align;
pub(crate) mod answer;
mod files;
pub(crate) mod inputs;
mod judge;
mod landmarks;
mod method;
mod plugin;
mod start;
mod trace;

use super::common::{
    Exit, Format, Global,
    graph_args::print_faults,
    progress::Progress,
    run_args::Keep,
    running::{self, Ran},
    space::SpaceOption,
    terminal,
};
use crate::app::{UsageError, registry};
use align::{Ended, Work};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum, builder::PossibleValuesParser};
use inputs::{Given, Inputs};
use method::{Method, MethodParams};
use osteoflow_engine::{
    Faults,
    check::{CommandLineParam, parameters},
    panics::mark_helper_thread,
    plugin::Kinds,
};
use osteoflow_geometry::nalgebra::Point3;
use osteoflow_node::Kind;
use plugin::{ByPlugin, PluginMethod};
use rayon::ThreadPool;
use serde_json::Value;
use std::{
    fs,
    io::Write,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicBool},
    thread,
};

/// Register one file onto another, without a graph: the SOURCE moves, the TARGET stays.
///
/// The same methods, parameters and defaults as the nodes `icp.*`. TARGET is a surface, from which points are sampled as by
/// surface.prepare, or points; PLY, STL, OBJ, OFF, VTK, PCD and text are read, and
/// as TARGET a CT: NIfTI, NRRD, or a folder with a DICOM series (docs/use/formats.md). Normals that the method needs and the file does not
/// have are estimated. SOURCE is points, or the vertices of a surface. Lengths are millimetres; each file has a frame of its
/// own, and the pose takes coordinates in the source's frame to the target's.
///
/// The first line is the verdict: trusted, doubtful or refused, by the rules of the node verdict.registration, with reasons. A
/// refused pose is not given. Missing convergence and undetermined motions are warnings, too, on stderr and in the JSON. Exit
/// code 3 if there is no pose: it is refused, or there are too few pairs, no points, or no surface to estimate normals from.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow register bone.stl scan.ply                        starts by the shape of the bone alone
  osteoflow register bone.stl scan.ply --out DIR              and writes pose and moved scan
  osteoflow register bone.stl scan.ply --landmarks plan.mrk.json picked.txt
  osteoflow register bone.stl scan.ply --init init.txt
  osteoflow register bone.stl scan.ply --init coarse.tfm --method point_to_point -v
  osteoflow register bone.stl scan.xyz --source-unit-mm 1000 --camera 0,0,0 --out pose.txt
  osteoflow register bone.stl scan.ply --init pose.json --set trim_fraction=0.2 --trace steps.csv
  osteoflow register bone.stl scan.ply --plugin my_icp/my_icp.py       with the registration of a plugin
  osteoflow register bone.stl scan.ply --repeat 10 --workers 1 --format json | jq .align_ms

The parameters for --set: osteoflow inspect icp.point_to_plane

Timings:
  load         reading and parsing the files, sampling a surface, or reading the prepared target from the store
  prep_target  preparing the target once: estimated normals, trees, cells, fields
  start        finding the start by shape or from picked points, once
  prep_source  preparing the source
  align        the registration; cpu is its processor time
  verdict      judging the pose; --no-verdict saves it

Exit codes:
    0  there is a pose; heed the verdict and the warnings
    1  a file cannot be read or is damaged
    2  a fault of the command line
    3  the pose is refused, or no registration is possible, with the reason
  130  interrupted")]
pub(crate) struct Register {
    /// The surface that stays, or points of it.
    target: PathBuf,

    /// The points that move, or a surface, whose vertices are taken.
    source: PathBuf,

    /// The start, source to target: 16 numbers row by row as text or JSON, an ITK transform (.tfm, whose inverse is taken, as
    /// 3D Slicer shows it), a file of --out, or the word identity. Default: by the shape of the bone alone.
    #[arg(long, value_name = "FILE")]
    init: Option<PathBuf>,

    /// Start from three or more points picked in TARGET and in SOURCE, matched by name: Slicer markups (.mrk.json, .fcsv), a
    /// picking list of CloudCompare, MeshLab .pp, CSV (label,x,y,z) or text.
    #[arg(long, num_args = 2, value_names = ["TARGET_POINTS", "SOURCE_POINTS"], conflicts_with = "init")]
    landmarks: Option<Vec<PathBuf>>,

    /// The residual to minimise.
    #[arg(long, default_value = method::DEFAULT, value_name = "METHOD", conflicts_with = "plugins",
          value_parser = PossibleValuesParser::new(method::METHODS.iter().map(Method::possible_value)))]
    method: String,

    #[command(flatten)]
    by_plugin: ByPlugin,

    /// Correspondence search: cached (the nearest samples, kept while none can be nearer), tree (the nearest samples, searched
    /// at every step), or field (a grid of closest points). Default: as the method's node.
    #[arg(long, value_name = "PAIRING")]
    pairing: Option<String>,

    /// Largest distance of a pair, mm.
    #[arg(long, value_name = "MM")]
    max_pair_distance_mm: Option<f64>,

    /// Largest number of steps.
    #[arg(long, value_name = "N")]
    max_iterations: Option<u32>,

    /// Converged if the remaining distance is below this, mm.
    #[arg(long, value_name = "MM")]
    step_mm: Option<f64>,

    /// And if the last turn is below this, rad.
    #[arg(long, value_name = "RAD")]
    step_rad: Option<f64>,

    /// Any parameter of the method, as in a node's table: KEY=VALUE; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    /// When to stop.
    #[arg(long, value_enum, default_value_t = Stop::Converge, value_name = "WHEN", conflicts_with = "plugins")]
    stop: Stop,

    /// Bone is above this in a TARGET that is a CT, HU. Default: half-way between soft tissue and bone in the volume.
    #[arg(long, value_name = "HU", allow_hyphen_values = true)]
    threshold_hu: Option<f64>,

    /// Which DICOM series of the folder TARGET: its number, or the ending of its identifier.
    #[arg(long, value_name = "SERIES")]
    series: Option<String>,

    /// Number of points sampled from a target that is a surface.
    #[arg(long, default_value_t = 150_000, value_name = "N", value_parser = clap::value_parser!(u64).range(100..=10_000_000))]
    target_points: u64,

    /// Seed of the sampling.
    #[arg(long, default_value_t = 0, value_name = "SEED")]
    seed: u64,

    /// The unit of all files in mm: 1000 for metres.
    #[arg(long, default_value_t = 1.0, value_name = "MM", value_parser = unit)]
    unit_mm: f64,

    /// The unit of TARGET in mm, if it differs.
    #[arg(long, value_name = "MM", value_parser = unit)]
    target_unit_mm: Option<f64>,

    /// The unit of SOURCE in mm, if it differs.
    #[arg(long, value_name = "MM", value_parser = unit)]
    source_unit_mm: Option<f64>,

    /// The unit of the translation in --init in mm, if it differs; files of --out are always in mm.
    #[arg(long, value_name = "MM", value_parser = unit)]
    init_unit_mm: Option<f64>,

    /// Position of the camera in the source's frame, mm; points then pair only with the side of the target that faces it.
    #[arg(long, value_name = "X,Y,Z", value_parser = camera, allow_hyphen_values = true)]
    camera: Option<Point3<f64>>,

    /// Number of threads; the pose does not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,

    #[command(flatten)]
    keep: Keep,

    /// Prepare and register this many times, for the timings.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    repeat: u32,

    /// Do not judge the pose, to save the time. Whether it can be trusted is then unknown.
    #[arg(long)]
    no_verdict: bool,

    /// The worst verdict with which a pose is given.
    #[arg(long, value_enum, default_value_t = Require::Doubtful, value_name = "ANSWER", conflicts_with = "no_verdict")]
    require: Require,

    /// Write the pose: .txt (the 4 x 4 matrix), .json (the whole answer), .tfm (for 3D Slicer, with --space), or, without an
    /// ending, a folder with all of them and the moved SOURCE. Nothing is overwritten.
    #[arg(long, value_name = "FILE|DIR")]
    out: Option<PathBuf>,

    /// Write SOURCE as registered, with the distance of each point from the surface in the column residual_mm (.ply, .pcd, .csv).
    #[arg(long, value_name = "FILE")]
    write_source: Option<PathBuf>,

    /// The space of the numbers in TARGET and SOURCE where they do not state it, for a .tfm, which is always LPS.
    #[arg(long, value_enum, ignore_case = true, value_name = "LPS|RAS")]
    space: Option<SpaceOption>,

    /// Write every step into a CSV. Nothing is overwritten.
    #[arg(long, value_name = "FILE", conflicts_with = "plugins")]
    trace: Option<PathBuf>,
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Stop {
    /// At convergence.
    Converge,
    /// After --max-iterations steps on all points, for timings; earlier only if no step lowers the cost.
    Fixed,
}

/// The worst verdict with which a pose is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Require {
    /// A doubtful pose is given.
    Doubtful,
    /// A doubtful pose is refused.
    Trusted,
}

impl Stop {
    fn name(self) -> &'static str {
        match self {
            Self::Converge => "converge",
            Self::Fixed => "fixed",
        }
    }
}

impl Register {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let ready = match self.ready(Given::default()) {
            Err(error) => match error.downcast::<Faults>() {
                Ok(faults) => {
                    print_faults(&faults, global)?;
                    return Ok(Exit::Usage);
                }
                Err(error) => return Err(error),
            },
            Ok(ready) => ready,
        };
        if global.format == Format::Text && !global.quiet {
            for note in &ready.inputs.notes {
                writeln!(terminal::stderr(), "{}: {note}", global.paint_err("note", "1"))?;
            }
        }
        let cancelled = Arc::default();
        let (work, pool) = (ready.work(&cancelled, global), ready.pool.clone());
        let ran = running::watch(Progress::hidden(), cancelled, move |_| Ok(pool.install(|| work.run())))?;
        let ended = match ran {
            Ran::Ended(ended) => ended,
            Ran::Left => Ended::Interrupted,
        };
        ready.answer().write(&ended, global)
    }

    /// Checks the parameters and reads the files, except those that `given` replaces.
    ///
    /// # Errors
    /// [`Faults`] of the parameters, a [`UsageError`], or a file that cannot be read.
    pub(crate) fn ready(&self, given: Given) -> Result<Ready<'_>> {
        let (method, params) = match self.by_plugin.find()? {
            Some((kinds, known, kind)) => {
                let kind = known.registry.kind(&kind).context("the kind was found")?;
                (&method::OF_PLUGIN, self.params_of_plugin(&kinds, kind)?)
            }
            None => {
                let method = method::named(&self.method);
                (method, self.params(method)?)
            }
        };
        let mut files = files::OutFiles::of(self)?;
        self.trace.iter().try_for_each(|file| refuse_existing(file))?;
        running::check_workers(self.workers)?;
        let workers = self.workers.or_else(|| thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(workers).start_handler(|_| mark_helper_thread());
        let pool = Arc::new(pool.build().context("no threads for the registration")?);
        let inputs = pool.install(|| Inputs::read(self, method, params.method.pairing(), given))?;
        files.check_space(self, &inputs)?;
        Ok(Ready { register: self, method, params, files, workers, pool, inputs: Arc::new(inputs) })
    }

    /// The options that set a parameter: option, key and value.
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

    /// The parameters of a kind that were given, and the defaults of the others.
    ///
    /// # Errors
    /// Their [`Faults`].
    fn checked_params(&self, kind: &Kind, fixed: &[(&str, &str)]) -> Result<Value> {
        let options = self.options();
        let given = options.iter().map(|(option, key, value)| CommandLineParam::Option { option, key, value });
        let fixed = fixed.iter().map(|&(key, value)| CommandLineParam::Option { option: "stop fixed", key, value });
        let given: Vec<_> = given.chain(self.sets.iter().map(|set| CommandLineParam::Set(set))).chain(fixed).collect();
        Ok(parameters(&kind.description, plugin::NODE, &given)?)
    }

    /// The method's parameters.
    ///
    /// # Errors
    /// Their [`Faults`].
    fn params(&self, method: &Method) -> Result<Params> {
        let registry = registry();
        let kind = registry.kind(method.kind).context("a method is a node, too")?;
        let as_json = self.checked_params(kind, if self.stop == Stop::Fixed { method.fixed } else { &[] })?;
        kind.build(&as_json, &osteoflow_node::BuildContext::detached(plugin::NODE))
            .map_err(|error| UsageError(error.to_string()))?;
        let params = method.params(as_json.clone()).context("the parameters of the node are not the method's")?;
        Ok(Params { method: params, as_json })
    }

    /// The parameters of a plugin's kind.
    ///
    /// # Errors
    /// Their [`Faults`], and those of its ports.
    fn params_of_plugin(&self, kinds: &Kinds, kind: &Kind) -> Result<Params> {
        let as_json = self.checked_params(kind, &[])?;
        let options = self.options().into_iter().map(|(_, key, value)| format!("{key}={value}"));
        let sets: Vec<String> = options.chain(self.sets.iter().cloned()).collect();
        let method = PluginMethod::new(kinds, kind, &sets, self.seed, self.workers)?;
        Ok(Params { method: MethodParams::Plugin(method), as_json })
    }
}

/// A registration with its inputs.
pub(crate) struct Ready<'a> {
    register: &'a Register,
    method: &'static Method,
    params: Params,
    files: files::OutFiles,
    workers: usize,
    pub(crate) pool: Arc<ThreadPool>,
    pub(crate) inputs: Arc<Inputs>,
}

impl Ready<'_> {
    /// What is to be computed.
    pub(crate) fn work(&self, cancelled: &Arc<AtomicBool>, global: &Global) -> Work {
        let asked = self.register;
        let trusted_only = asked.require == Require::Trusted;
        Work {
            method: self.method,
            params: self.params.clone(),
            inputs: self.inputs.clone(),
            repeat: asked.repeat,
            judge: (!asked.no_verdict).then_some(judge::Judge { trusted_only, stop: asked.stop }),
            moves_source: self.files.source.is_some(),
            cancelled: cancelled.clone(),
            progress: align::ProgressLine::new(asked.repeat, global),
        }
    }

    /// What the answer is made of.
    pub(crate) fn answer(&self) -> answer::Answer<'_> {
        let Self { register, params, files, workers, inputs, .. } = self;
        answer::Answer { register, params, inputs, files, workers: *workers }
    }
}

/// A method's parameters, and as JSON.
#[derive(Debug, Clone)]
struct Params {
    method: MethodParams,
    as_json: Value,
}

fn refuse_existing(file: &Path) -> Result<()> {
    if !file.exists() {
        return Ok(());
    }
    Err(UsageError(format!("{} exists already; name another file, nothing is overwritten", file.display())).into())
}

/// Writes a new file.
fn write_new(file: &Path, text: &str) -> Result<()> {
    let opened = fs::OpenOptions::new().write(true).create_new(true).open(file);
    let written = opened.and_then(|mut file| file.write_all(text.as_bytes()));
    written.with_context(|| format!("{} cannot be written", file.display()))
}

fn unit(text: &str) -> Result<f64, String> {
    let unit: f64 = text.parse().map_err(|_| "a number is expected: 1 for millimetres, 1000 for metres")?;
    let usable = (1e-6..=1e6).contains(&unit);
    usable.then_some(unit).ok_or_else(|| "it must be between 1e-6 and 1e6: 1 for millimetres, 1000 for metres".into())
}

fn camera(text: &str) -> Result<Point3<f64>, String> {
    let cells: Option<Vec<f64>> = text.split(',').map(|cell| cell.trim().parse().ok()).collect();
    match cells.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|c| c.is_finite()) => Ok(Point3::new(x, y, z)),
        _ => Err("three finite numbers are expected, such as 0,0,0".into()),
    }
}
