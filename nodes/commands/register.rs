//! `register`: two files to a pose and a verdict.

mod text;

use super::common::{
    Exit, Format, Global,
    graph_args::print_faults,
    plugins::PluginArgs,
    progress::Progress,
    run_args::Keep,
    running::{self, Completion},
    space::SpaceOption,
    terminal,
};
use crate::app::{Method, Register as Checked, RegisterFiles, RegisterRequest, Registration, Start, Units};
use anyhow::Result;
use clap::{
    Args, ValueEnum,
    builder::{PossibleValue, PossibleValuesParser},
};
use osteoflow_engine::Faults;
use osteoflow_geometry::nalgebra::Point3;
use std::{io::Write, num::NonZeroUsize, path::PathBuf, sync::Arc};

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
  load         reading and parsing the files
  prep_target  sampling a surface and preparing it: estimated normals, trees, cells; or reading it from the store
  start        finding the start by shape or from picked points, once
  prep_source  preparing the source
  align        the registration; cpu is its processor time
  verdict      judging the pose; --no-verdict saves it

Exit codes:
    0  there is a pose; heed the verdict and the warnings
    1  a file is missing or cannot be written, or a file of the start is damaged
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
    #[arg(long, default_value = Method::BUILT_IN[0].0, value_name = "METHOD", conflicts_with = "plugins",
          value_parser = PossibleValuesParser::new(Method::BUILT_IN.map(|(name, about)| PossibleValue::new(name).help(about))))]
    method: String,

    #[command(flatten)]
    plugins: PluginArgs,

    /// Which kind of --plugin registers, if it has several.
    #[arg(long, value_name = "STAGE.KIND", requires = "plugins", conflicts_with = "method")]
    kind: Option<String>,

    /// Correspondence search: cached (the nearest samples, kept while none can be nearer), or tree (the nearest samples,
    /// searched at every step). Default: as the method's node.
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

    /// Bone is above this in a TARGET that is a CT, HU. Default: half-way between soft tissue and bone in the volume, which the
    /// verdict names among its assumptions.
    #[arg(long, value_name = "HU", allow_hyphen_values = true)]
    threshold_hu: Option<f64>,

    /// Which DICOM series of the folder TARGET: its number, or the ending of its identifier.
    #[arg(long, value_name = "SERIES")]
    series: Option<String>,

    /// Number of points sampled from a target that is a surface.
    #[arg(long, default_value_t = 150_000, value_name = "N", value_parser = clap::value_parser!(u64).range(100..=10_000_000))]
    target_points: u64,

    /// Seed of the sampling.
    #[arg(long, default_value_t = 1, value_name = "SEED")]
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

impl Register {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let checked = match self.request().checked() {
            Err(error) => match error.downcast::<Faults>() {
                Ok(faults) => {
                    print_faults(&faults, global)?;
                    return Ok(Exit::Usage);
                }
                Err(error) => return Err(error),
            },
            Ok(checked) => Arc::new(checked),
        };
        running::make_pool(self.workers)?;
        // Elsewhere than on a terminal nothing needs to say that a fraction of a second goes on.
        let progress = Progress::on_terminal(checked.plan(), !global.quiet && global.format == Format::Text);
        let cancelled = Arc::default();
        let (work, until) = (checked.clone(), Arc::clone(&cancelled));
        match running::watch(progress, cancelled, move |progress| work.run(progress, &until))? {
            Completion::Ended(registration) => self.print(&registration, &checked, global),
            Completion::Left => Ok(Exit::Interrupted),
        }
    }

    fn request(&self) -> RegisterRequest {
        let start = match (&self.init, self.landmarks.as_deref()) {
            (None, Some([of_target, of_source])) => Start::Landmarks([of_target.clone(), of_source.clone()]),
            (Some(file), _) => Start::file_or_identity(file.clone()),
            (None, _) => Start::Shape,
        };
        let method = match self.plugins.files().is_empty() {
            true => Method::BuiltIn(self.method.clone()),
            false => Method::Plugin(self.plugins.plugins(), self.kind.clone()),
        };
        let unit = |of_file: Option<f64>| of_file.unwrap_or(self.unit_mm);
        RegisterRequest {
            start,
            method,
            pairing: self.pairing.clone(),
            max_pair_distance_mm: self.max_pair_distance_mm,
            max_iterations: self.max_iterations,
            step_mm: self.step_mm,
            step_rad: self.step_rad,
            settings: self.sets.clone().into(),
            is_fixed: self.stop == Stop::Fixed,
            threshold_hu: self.threshold_hu,
            series: self.series.clone(),
            target_points: Some(self.target_points),
            seed: Some(self.seed),
            units: Units {
                target_mm: unit(self.target_unit_mm),
                source_mm: unit(self.source_unit_mm),
                init_mm: unit(self.init_unit_mm),
            },
            camera: self.camera,
            workers: self.workers,
            cache: !self.keep.no_cache,
            repeat: self.repeat,
            is_judged: !self.no_verdict,
            requires_trusted: self.require == Require::Trusted,
            files: RegisterFiles {
                out: self.out.clone(),
                source: self.write_source.clone(),
                trace: self.trace.clone(),
            },
            space: self.space.map(Into::into),
            ..RegisterRequest::new(&self.target, &self.source)
        }
    }

    /// Prints the answer, and returns the exit code.
    fn print(&self, registration: &Registration, checked: &Checked, global: &Global) -> Result<Exit> {
        let exit = match registration.refusal() {
            None => Exit::Done,
            Some(_) if registration.is_interrupted() => Exit::Interrupted,
            Some(_) => Exit::Refused,
        };
        let mut err = terminal::stderr().lock();
        if !global.quiet {
            if global.format == Format::Text {
                for note in registration.notes(checked) {
                    writeln!(err, "{}: {note}", global.paint_err("note", "1"))?;
                }
            }
            for warning in registration.warnings(checked) {
                writeln!(err, "{}: {warning}", global.paint_err("warning", "1;33"))?;
            }
        }
        match (exit, registration.refusal_text(checked)) {
            (Exit::Interrupted, _) => writeln!(err, "{}: there is no pose", global.paint_err("interrupted", "1;33"))?,
            (_, Some(why)) => writeln!(err, "{}: {why}", global.paint_err("refused", "1;31"))?,
            (_, None) => {}
        }
        drop(err);
        let mut out = terminal::stdout().lock();
        match global.format {
            // One line, so that the last line is the answer wherever others print before it.
            Format::Json => {
                writeln!(out, "{}", registration.to_json(checked, exit.to_json(), global.verbose > 0))?;
            }
            Format::Text if registration.has_ended() => {
                write!(out, "{}", text::text(registration, checked, global))?;
            }
            Format::Text => {}
        }
        Ok(exit)
    }
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
