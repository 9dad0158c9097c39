//! What the subcommands do, with values in memory instead of files and text: the foundation of the Python package.
//!
//! The options of each function are those of its subcommand, as on the command line, so that defaults, checks and messages
//! are the same.

mod files;

pub use files::{Content, read, write_cloud, write_mesh, write_points, write_pose};
pub use osteoflow_engine::given::Given;
pub use osteoflow_formats::{Space, cloud_file::CloudFileRead, mesh_file::MeshRead, mesh_or_cloud::MeshOrCloud};

use crate::commands::{
    command_line::{Cli, Command},
    common::{
        exit::{UsageError, with_causes},
        global::{Colour, Format, Global},
        log, out_dir,
        plugins::HOST,
        progress::Progress,
        running, verdict_lines,
    },
    register::{self, align::Ended},
    sweep,
};
use anyhow::anyhow;
use clap::{Parser, error::ErrorKind};
use osteoflow_engine::{
    Faults,
    check::Checked,
    given::{output, run_given},
    plan::{OutputId, Plan},
    run::{Outcome, RunOptions},
    sweep::{Folder, FolderError, Shard, difference},
};
use osteoflow_formats::FileError;
use osteoflow_geometry::nalgebra::Isometry3;
use osteoflow_node::{Item, Registry};
use serde_json::Value;
use std::{
    collections::BTreeMap,
    io::IsTerminal,
    path::{Path, PathBuf},
    sync::{Arc, Once, atomic::AtomicBool},
};

/// Why there is no answer. Each text is that of the command.
#[derive(Debug)]
pub enum Error {
    /// The options or the graph have a fault; nothing was run.
    Usage(String),
    /// There is no result, for this reason; with what is known nevertheless, as the command prints it as JSON.
    Refused(String, Value),
    /// It was stopped.
    Interrupted,
    /// A file could not be read or written, or there was an internal error.
    Failed(String),
}

impl From<anyhow::Error> for Error {
    fn from(error: anyhow::Error) -> Self {
        let is_usage = error.chain().any(|cause| cause.is::<UsageError>() || cause.is::<Faults>());
        let sentence = with_causes(&error);
        if is_usage { Self::Usage(sentence) } else { Self::Failed(sentence) }
    }
}

impl From<FileError> for Error {
    fn from(error: FileError) -> Self {
        anyhow::Error::from(error).into()
    }
}

/// Names the program that runs this library, the arguments with which it runs [`crate::main`], and the file of the library:
/// another process of it looks at plugins, and the file identifies the program of a sweep.
pub fn hosted_by(program: PathBuf, before: Vec<std::ffi::OsString>, library: PathBuf) {
    osteoflow_engine::hash::program::set_file(library);
    let _ = HOST.set((program, before));
}

/// Reads the options of a subcommand.
fn parsed(subcommand: &str, options: &[String]) -> Result<Command, Error> {
    static LOG: Once = Once::new();
    LOG.call_once(|| log::start(&global(true)));
    let words = ["osteoflow", subcommand].into_iter().map(String::from).chain(options.iter().cloned());
    Cli::try_parse_from(words).map(|cli| cli.command).map_err(|error| {
        debug_assert!(error.kind() != ErrorKind::DisplayHelp, "no caller asks for help");
        let text = error.render().to_string();
        let text = text.strip_prefix("error: ").unwrap_or(&text);
        Error::Usage(text.split("\n\nUsage:").next().unwrap_or(text).trim_end().to_owned())
    })
}

/// The switches: progress only on a terminal.
fn global(shows_progress: bool) -> Global {
    let quiet = !(shows_progress && std::io::stderr().is_terminal());
    Global { format: Format::Text, quiet, verbose: 0, color: Colour::Auto }
}

fn not_parsed() -> Error {
    Error::Failed("the options were taken for those of another subcommand, which is a bug".into())
}

/// Inputs of a registration that are in memory, and replace its files.
#[derive(Debug, Default)]
pub struct RegisterInputs {
    /// What stays, in mm.
    pub target: Option<MeshOrCloud>,
    /// What moves, in mm.
    pub source: Option<MeshOrCloud>,
    /// The start, source to target.
    pub init: Option<Isometry3<f64>>,
}

/// Registers as `osteoflow register` does, and returns its JSON. `options` name files also for inputs in memory, which are not
/// opened.
///
/// # Errors
/// [`Error`]; refused if the pose is, or if there is none.
pub fn register(
    options: &[String],
    inputs: RegisterInputs,
    with_trace: bool,
    shows_progress: bool,
    cancelled: &Arc<AtomicBool>,
) -> Result<Value, Error> {
    let Command::Register(asked) = parsed("register", options)? else { return Err(not_parsed()) };
    let RegisterInputs { target, source, init } = inputs;
    let ready = asked.ready(register::inputs::Given { target, source, init })?;
    let work = ready.work(cancelled, &global(shows_progress));
    let ended = ready.pool.install(|| work.run());
    let answered = ready.answer().answered(&ended, with_trace)?;
    match (&ended, answered.json["refused"]["reason"].as_str()) {
        (Ended::Interrupted, _) => Err(Error::Interrupted),
        (_, Some(why)) => Err(Error::Refused(why.to_owned(), answered.json)),
        _ => Ok(answered.json),
    }
}

/// A checked graph.
pub struct Graph {
    checked: Checked,
    asked: crate::commands::run::Run,
}

/// A run of a graph.
#[derive(Debug)]
pub struct GraphRun {
    /// The content of `results.json`.
    pub results: Value,
    /// The items of the wires that were asked for.
    pub wires: BTreeMap<String, Vec<Item>>,
    /// Warnings of nodes.
    pub warnings: Vec<String>,
    /// The folder with the files of the run, if it wrote any.
    pub out_dir: Option<PathBuf>,
}

/// Checks a graph as `osteoflow run` does, with its options.
///
/// # Errors
/// [`Error::Usage`] with all faults of the graph.
pub fn graph(options: &[String]) -> Result<Graph, Error> {
    let Command::Run(asked) = parsed("run", options)? else { return Err(not_parsed()) };
    let kinds = asked.graph.plugins.kinds()?;
    let checked = osteoflow_engine::check(&asked.graph.graph, &asked.graph.sets, kinds)
        .map_err(|faults| Error::Usage(faults.to_string()))?;
    Ok(Graph { checked, asked })
}

impl Graph {
    /// Its plan.
    pub fn plan(&self) -> &Plan {
        &self.checked.plan
    }

    /// The kinds and payloads that it was checked with.
    pub fn registry(&self) -> &Registry {
        &self.checked.registry
    }

    /// Warnings about the graph.
    pub fn warnings(&self) -> Vec<String> {
        self.checked.warnings.iter().map(ToString::to_string).collect()
    }

    /// The output with this name.
    ///
    /// # Errors
    /// [`Error::Usage`] if there is none.
    pub fn output(&self, name: &str) -> Result<OutputId, Error> {
        output(self.plan(), name).map_err(Error::Usage)
    }

    /// Runs it with `given` in place of what its nodes would give; files are written if `--out` is among its options.
    ///
    /// # Errors
    /// [`Error`]; refused if it has no results.
    pub fn run(
        &self,
        given: Given,
        keeps: &(dyn Fn(&str) -> bool + Sync),
        shows_progress: bool,
        cancelled: &Arc<AtomicBool>,
    ) -> Result<GraphRun, Error> {
        let (plan, asked) = (self.plan(), &self.asked);
        let out_dir = match asked.leave.out.as_deref() {
            None => None,
            out => Some(out_dir::make(out, &plan.name, asked.leave.force)?),
        };
        let mut options = RunOptions {
            out_dir: out_dir.as_ref().map(|dir| dir.to_path_buf()),
            record: out_dir.is_some() && !asked.no_record,
            latency: out_dir.is_some() && !asked.no_record,
            shuffle: asked.shuffle,
            store: asked.keep.store()?,
            ..running::options_alone(asked.leave.workers, cancelled)
        };
        if !given.is_empty() {
            options.command["given_wires"] = given.wires(plan).into();
        }
        let progress = Progress::of_run(plan, options.workers, &global(shows_progress));
        let ran = run_given(plan, self.registry(), &options, &progress, given, keeps);
        progress.end();
        let (report, wires) = ran.map_err(running::run_error)?;
        let warnings = report.warnings.iter();
        let warnings = warnings.map(|w| format!("node \"{}\", item {}: {}", w.node, w.item, w.message)).collect();
        match &report.outcome {
            Outcome::Complete => Ok(GraphRun { results: report.results, wires, warnings, out_dir: options.out_dir }),
            Outcome::Interrupted => Err(Error::Interrupted),
            Outcome::Refused(refusal) => {
                let why = verdict_lines::refusal_in_short(refusal, &report.results);
                Err(Error::Refused(why, report.results))
            }
        }
    }
}

/// Simulates a procedure as `osteoflow simulate` does.
///
/// # Errors
/// [`Error`].
pub fn simulate(options: &[String]) -> Result<(), Error> {
    let Command::Simulate(asked) = parsed("simulate", options)? else { return Err(not_parsed()) };
    asked.execute(&global(false))?;
    Ok(())
}

/// Sweeps a graph, or merges the shards of a sweep, as `osteoflow sweep` does, and returns the folder and its summary.
///
/// # Errors
/// [`Error`]; interrupted runs can be resumed in the folder.
pub fn sweep(options: &[String], shows_progress: bool, cancelled: &Arc<AtomicBool>) -> Result<(PathBuf, Value), Error> {
    let Command::Sweep(asked) = parsed("sweep", options)? else { return Err(not_parsed()) };
    let Some((graph, sets)) = asked.graph() else {
        let folder = asked.merged_folder()?;
        return Ok((folder.dir().to_owned(), sweep::summary(&folder)?));
    };
    let options = asked.options(cancelled)?;
    let checked = osteoflow_engine::sweep::check(graph, sets, asked.kinds()?, options.workers)
        .map_err(|faults| Error::Usage(faults.to_string()))?;
    let folder = asked.folder(&checked, &options)?;
    let bar = sweep::Bar::begin(&checked, &folder, &options, &global(shows_progress))?;
    let swept = checked.run(&folder, &options, &bar).map_err(sweep::folder_error);
    bar.end();
    match swept?.n_missing {
        0 => Ok((folder.dir().to_owned(), sweep::summary(&folder)?)),
        _ => Err(Error::Interrupted),
    }
}

/// Begins the empty folder of a sweep, whose shards are run elsewhere, and returns the numbers of the runs of each shard: of
/// `n_shards`, or of one for each run.
///
/// # Errors
/// [`Error::Usage`] with all faults of the graph and its sweep.
pub fn sweep_shards(options: &[String], n_shards: Option<usize>) -> Result<Vec<Vec<usize>>, Error> {
    let Command::Sweep(asked) = parsed("sweep", options)? else { return Err(not_parsed()) };
    let Some((graph, sets)) = asked.graph() else { return Err(not_parsed()) };
    let options = asked.options(&Arc::default())?;
    let checked = osteoflow_engine::sweep::check(graph, sets, asked.kinds()?, options.workers)
        .map_err(|faults| Error::Usage(faults.to_string()))?;
    asked.folder(&checked, &options)?;
    let of = n_shards.unwrap_or(usize::MAX).min(checked.n_runs()).max(1);
    let runs_of = |index| checked.part(Some(Shard { index, of })).map(|row| row.run).collect();
    Ok((1..=of).map(runs_of).collect())
}

/// Why the folder of a shard cannot be used.
#[derive(Debug)]
pub enum ShardFault {
    /// It is of another sweep, with what differs.
    Other(String),
    /// It is damaged, or has other runs.
    Damaged(String),
}

/// Checks that the folder of a shard is of the sweep in `sweep`, and has exactly these runs, each readable.
///
/// # Errors
/// [`ShardFault`].
pub fn check_shard(sweep: &Path, shard: &Path, runs: &[usize]) -> Result<(), ShardFault> {
    let damaged = |error: FolderError| ShardFault::Damaged(error.to_string());
    let (sweep, folder) = (Folder::open(sweep).map_err(damaged)?, Folder::open(shard).map_err(damaged)?);
    if let Some(what) = difference(&sweep, &folder) {
        return Err(ShardFault::Other(what));
    }
    let found = folder.runs().map_err(damaged)?;
    if found != runs {
        return Err(ShardFault::Damaged(format!("it has the runs {found:?}, but was asked for {runs:?}")));
    }
    folder.done().map_err(damaged)?.try_for_each(|done| done.map(drop).map_err(damaged))
}

/// A line on the terminal with the progress of a sweep whose runs end elsewhere; shows nothing if stderr is no terminal.
pub struct SweepProgress(sweep::Bar);

impl SweepProgress {
    /// Begins to show the progress of `n_runs` runs.
    ///
    /// # Errors
    /// If stderr cannot be written.
    pub fn begin(n_runs: usize, shown: bool) -> Result<Self, Error> {
        Ok(Self(sweep::Bar::of(n_runs, "", 0, &global(shown))?))
    }

    /// Counts runs that have ended.
    pub fn ended(&self, n_runs: usize) {
        self.0.ended_elsewhere(n_runs);
    }

    /// Shows a message.
    pub fn message(&self, what: &str) {
        self.0.message(what);
    }

    /// Removes the line.
    pub fn end(&self) {
        self.0.end();
    }
}

/// A recording of a run.
///
/// # Errors
/// [`Error::Failed`] if it cannot be read.
pub fn recording(file: &Path) -> Result<osteoflow_engine::Recording, Error> {
    osteoflow_engine::Recording::open(file).map_err(|error| anyhow!("{error}").into())
}
