//! Two files, one registration: what a graph's ICP node does, without a graph.

mod align;
mod answer;
mod inputs;
mod method;
mod trace;

use super::{
    Exit, Format, Global, UsageError,
    graph_args::tell,
    progress::Progress,
    registry,
    run::Keep,
    running::{self, Ran},
};
use align::{Ended, Work};
use anyhow::{Context, Result};
use clap::{Args, ValueEnum, builder::PossibleValuesParser};
use inputs::Inputs;
use method::Method;
use osteoflow_algorithms::icp::IcpParams;
use osteoflow_engine::{
    check::{Given, parameters},
    panics::mark_helper_thread,
};
use osteoflow_geometry::nalgebra::Point3;
use serde_json::Value;
use std::{
    fs,
    io::Write,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::Arc,
    thread,
};

/// Register one file onto another, without a graph: the SOURCE moves, the TARGET stays.
///
/// The same methods, parameters and defaults as the nodes `icp.*`. TARGET is a surface (STL, PLY with faces), from which
/// points are drawn as surface.prepare does, or points (PLY, XYZ, CSV), with normals where the file has them; else these
/// are estimated where the method needs them. SOURCE is points, or the vertices of a surface. Lengths are millimetres; each file lies in a frame of its own, and the answer
/// takes coordinates in the source's frame to the target's.
///
/// That it has not converged, or that the surfaces leave a motion free, is said on stderr and in the JSON, and is no
/// failure: look at it before you use the pose. Exit code 3 where there is no answer: too few pairs, no surface to take
/// normals from, points that are not there.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow register bone.stl scan.ply --init init.txt
  osteoflow register bone.stl scan.ply --init coarse.tfm --method point_to_point -v
  osteoflow register bone.stl scan.xyz --source-unit-mm 1000 --camera 0,0,0 --out pose.txt
  osteoflow register bone.stl scan.ply --init pose.json --set trim_fraction=0.2 --trace steps.csv
  osteoflow register bone.stl scan.ply --repeat 10 --workers 1 --format json | jq .align_ms

The parameters for --set: osteoflow inspect icp.point_to_plane

Timings:
  load         reading and parsing the files, drawing points from a surface, or the prepared target from the store
  prep_target  what is built once for a target: estimated normals, trees, cells, fields
  prep_source  what a method needs of the source alone
  align        the registration; cpu is its processor time

Exit codes:
    0  there is a pose; heed the warnings
    1  a file cannot be read or is not sound
    2  a fault of the command line
    3  no registration is possible; it is said why
  130  interrupted")]
pub(crate) struct Register {
    /// What stays: a surface in STL or PLY, or points in PLY, XYZ or CSV.
    target: PathBuf,

    /// What moves: points in PLY, XYZ or CSV, or a surface, whose vertices are taken.
    source: PathBuf,

    /// Where to start, source to target: 16 numbers row by row as text or JSON, an ITK transform (.tfm, of which the
    /// inverse is taken, as 3D Slicer shows it), or what --out wrote. Default: where the files put it.
    #[arg(long, value_name = "FILE")]
    init: Option<PathBuf>,

    /// What is made small.
    #[arg(long, default_value = method::DEFAULT, value_name = "METHOD",
          value_parser = PossibleValuesParser::new(method::METHODS.iter().map(Method::possible_value)))]
    method: String,

    /// How pairs are found: cached (the nearest samples, kept while none can be nearer), tree (searched anew at every
    /// step), or field (looked up in a grid). Default: as the method's node.
    #[arg(long, value_name = "PAIRING")]
    pairing: Option<String>,

    /// Pairs farther apart are not used, mm.
    #[arg(long, value_name = "MM")]
    max_pair_distance_mm: Option<f64>,

    /// Give up after so many steps.
    #[arg(long, value_name = "N")]
    max_iterations: Option<u32>,

    /// Converged where less than this is left to go, mm.
    #[arg(long, value_name = "MM")]
    step_mm: Option<f64>,

    /// Converged where less than this is left to turn, rad.
    #[arg(long, value_name = "RAD")]
    step_rad: Option<f64>,

    /// Any parameter of the method, as in a node's table: KEY=VALUE; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    /// When to stop.
    #[arg(long, value_enum, default_value_t = Stop::Converge, value_name = "WHEN")]
    stop: Stop,

    /// How many points are drawn from a target that is a surface.
    #[arg(long, default_value_t = 150_000, value_name = "N", value_parser = clap::value_parser!(u64).range(100..=10_000_000))]
    target_points: u64,

    /// The seed of that draw.
    #[arg(long, default_value_t = 0, value_name = "SEED")]
    seed: u64,

    /// The unit of all files in mm: 1000 for metres.
    #[arg(long, default_value_t = 1.0, value_name = "MM", value_parser = unit)]
    unit_mm: f64,

    /// The unit of TARGET in mm, where it differs.
    #[arg(long, value_name = "MM", value_parser = unit)]
    target_unit_mm: Option<f64>,

    /// The unit of SOURCE in mm, where it differs.
    #[arg(long, value_name = "MM", value_parser = unit)]
    source_unit_mm: Option<f64>,

    /// The unit of the translation in --init in mm, where it differs; what --out wrote is always in mm.
    #[arg(long, value_name = "MM", value_parser = unit)]
    init_unit_mm: Option<f64>,

    /// Where the camera stood, in the source's frame, mm; points then pair only with what faced it.
    #[arg(long, value_name = "X,Y,Z", value_parser = camera, allow_hyphen_values = true)]
    camera: Option<Point3<f64>>,

    /// How many threads; the pose does not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,

    #[command(flatten)]
    keep: Keep,

    /// Prepare and register so many times, for the timings.
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    repeat: u32,

    /// Write the pose: all of the answer into a .json, else the 4 x 4 matrix as text. Nothing is overwritten.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,

    /// Write every step into a CSV. Nothing is overwritten.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Stop {
    /// As soon as it has converged.
    Converge,
    /// After --max-iterations steps with all points, for timings; sooner only where no step is left to take.
    Fixed,
}

impl Stop {
    fn word(self) -> &'static str {
        match self {
            Self::Converge => "converge",
            Self::Fixed => "fixed",
        }
    }
}

/// What makes a method take its steps to the last, on all points.
const FIXED: [(&str, &str); 4] =
    [("stop_step_mm", "0.0"), ("stop_step_rad", "0.0"), ("stop_residual_mm", "0.0"), ("levels", "[]")];

impl Register {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let method = method::named(&self.method);
        let Some(params) = self.params(method, global)? else { return Ok(Exit::Usage) };
        for file in self.out.iter().chain(&self.trace) {
            refuse_existing(file)?;
        }
        let workers = self.workers.or_else(|| thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(workers).start_handler(|_| mark_helper_thread());
        let pool = pool.build().context("no threads for the registration")?;
        let inputs = Arc::new(pool.install(|| Inputs::read(self, method, params.icp.pairing))?);
        if global.format == Format::Text && !global.quiet {
            for note in &inputs.notes {
                writeln!(std::io::stderr(), "{}: {note}", global.paint_err("note", "1"))?;
            }
        }

        let cancelled = Arc::default();
        let work = Work {
            method,
            params: params.clone(),
            inputs: inputs.clone(),
            repeat: self.repeat,
            cancelled: Arc::clone(&cancelled),
            shown: align::Shown::new(self.repeat, global),
        };
        let ran = running::watch(Progress::hidden(), cancelled, move |_| Ok(pool.install(|| work.run())))?;
        let ended = match ran {
            Ran::Ended(ended) => ended,
            Ran::Left => Ended::Interrupted,
        };
        let about = answer::About { register: self, params: &params, inputs: &inputs, workers };
        about.tell(&ended, global)
    }

    /// The method's parameters; `None` where they have faults, which were told.
    fn params(&self, method: &Method, global: &Global) -> Result<Option<Params>> {
        let registry = registry();
        let kind = registry.kind(method.kind).context("a method is a node, too")?;
        let number = |value: Option<f64>| value.map(|value| format!("{value:?}"));
        let options = [
            ("pairing", "pairing", self.pairing.clone()),
            ("max-pair-distance-mm", "max_pair_distance_mm", number(self.max_pair_distance_mm)),
            ("max-iterations", "max_iterations", self.max_iterations.map(|n| n.to_string())),
            ("step-mm", "stop_step_mm", number(self.step_mm)),
            ("step-rad", "stop_step_rad", number(self.step_rad)),
        ];
        let given = options
            .iter()
            .filter_map(|(option, key, value)| Some(Given::Option { option, key, value: value.as_deref()? }));
        let fixed = FIXED.iter().filter(|_| self.stop == Stop::Fixed);
        let fixed = fixed.map(|&(key, value)| Given::Option { option: "stop fixed", key, value });
        let given: Vec<_> = given.chain(self.sets.iter().map(|set| Given::Set(set))).chain(fixed).collect();
        let as_json = match parameters(&kind.description, "register", &given) {
            Ok(params) => params,
            Err(faults) => {
                tell(&faults, global)?;
                return Ok(None);
            }
        };
        kind.build(&as_json, &osteoflow_node::BuildContext::detached("register"))
            .map_err(|error| UsageError(error.to_string()))?;
        let icp = serde_json::from_value(as_json.clone()).context("the parameters of the node are not the method's")?;
        Ok(Some(Params { icp, as_json }))
    }
}

/// A method's parameters, and how they are told.
#[derive(Debug, Clone)]
struct Params {
    icp: IcpParams,
    as_json: Value,
}

fn refuse_existing(file: &Path) -> Result<()> {
    if !file.exists() {
        return Ok(());
    }
    Err(UsageError(format!("{} is there already; name another file, nothing is overwritten", file.display())).into())
}

/// Writes a file that must not be there.
fn write_new(file: &Path, text: &str) -> Result<()> {
    let opened = fs::OpenOptions::new().write(true).create_new(true).open(file);
    let written = opened.and_then(|mut file| file.write_all(text.as_bytes()));
    written.with_context(|| format!("{} cannot be written", file.display()))
}

fn unit(text: &str) -> Result<f64, String> {
    let unit: f64 = text.parse().map_err(|_| "it is a number: 1 for millimetres, 1000 for metres")?;
    let usable = (1e-6..=1e6).contains(&unit);
    usable.then_some(unit).ok_or_else(|| "it lies between 1e-6 and 1e6: 1 for millimetres, 1000 for metres".into())
}

fn camera(text: &str) -> Result<Point3<f64>, String> {
    let cells: Option<Vec<f64>> = text.split(',').map(|cell| cell.trim().parse().ok()).collect();
    match cells.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|c| c.is_finite()) => Ok(Point3::new(x, y, z)),
        _ => Err("three finite numbers are expected, such as 0,0,0".into()),
    }
}
