//! Sweeps of a graph.

use super::{
    error::{Error, UsageError},
    files::unless_data,
    folder_lock::FolderLock,
    options::Keep,
    out_dir::{self, OutDir},
    plugins::Plugins,
    program::{self, NOTICE},
    shipped,
};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    plan::Plan,
    run::RunOptions,
    sweep::{
        self, Ask, Done, Folder, FolderError, Run, Shard, Spec, Study, StudyError, Sweep, SweepCounts, SweepOptions,
        SweepRow, Watcher,
    },
};
use osteoflow_node::Registry;
use osteoflow_report::summary;
use serde_json::{Value, json};
use std::{
    num::NonZeroUsize,
    ops::RangeInclusive,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicBool},
};

/// Most runs of --only: each is recorded.
const MAX_ONLY: usize = 10_000;

/// Many runs of a graph, as its table `[sweep]` says.
#[derive(Debug, Clone, Args)]
pub struct SweepRequest {
    /// The graph file, with a table [sweep]; with --only also the folder of a sweep.
    #[arg(required_unless_present = "merge")]
    pub graph: Option<PathBuf>,

    /// Change any key of the graph in all runs, also of [sweep]: sweep.repeat=20; may be given again. Refused for a key that a
    /// factor or a draw sets; change the factor instead: sweep.factor.NAME.values=[..].
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,

    /// Plugins in addition to those of the graph.
    #[command(flatten)]
    pub plugins: Plugins,

    /// The folder to write the files into; refused if not empty. Default: a new one under runs/.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// Resume the sweep in --out: finished runs stay. Refused if graph, inputs, plugins or the program have changed; but
    /// --set sweep.repeat=N may ask for more repeats, of which the new ones are run.
    #[arg(long, requires = "out")]
    pub resume: bool,

    /// With --resume: run those again that failed, because a file could not be read or a package was missing.
    #[arg(long, requires = "resume")]
    pub retry_failed: bool,

    /// Run these runs alone, each as `run` would with its settings, and record it: its results are those of its row. N, or a list of
    /// numbers and ranges, 3,7-9, as --dry-run and runs.csv have them; each of several goes into a folder of its own, 000003. The
    /// graph may be the folder of a finished sweep, whose frozen graph is run.
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = numbers,
          conflicts_with_all = ["out", "resume", "retry_failed", "shard", "no_share"])]
    pub only: Vec<RangeInclusive<usize>>,

    /// With --only: the folder to write results.json, manifest.json and run.mcap into; refused if not empty. Default: a new one
    /// under runs/.
    #[arg(long, value_name = "DIR", requires = "only")]
    pub record: Option<PathBuf>,

    /// Run the K-th of N parts of the sweep, from 1; --merge combines them.
    #[arg(long, value_name = "K/N", value_parser = shard)]
    pub shard: Option<Shard>,

    /// Number of runs at a time; the tables do not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    pub workers: Option<NonZeroUsize>,

    /// Compute what several runs have in common in each of them, instead of once for all. The tables are the same.
    #[arg(long)]
    pub no_share: bool,

    /// Whether answers are cached.
    #[command(flatten)]
    pub keep: Keep,

    /// The specification in place of the graph's `[sweep]`.
    #[arg(skip)]
    pub spec: Option<Spec>,
}

fn shard(text: &str) -> Result<Shard, String> {
    let parts = text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((index, of)) if 1 <= index && index <= of => Ok(Shard { index, of }),
        _ => Err("a shard must be K/N with K from 1 to N, such as 2/8".into()),
    }
}

/// A number of a run, or the first and the last of a range.
fn numbers(text: &str) -> Result<RangeInclusive<usize>, String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (first.trim().parse(), last.trim().parse()) {
        (Ok(first), Ok(last)) if first <= last => Ok(first..=last),
        _ => Err("runs must be numbers or ranges, such as 3 or 7-9".into()),
    }
}

/// A run of a sweep that is run alone.
pub struct OneRun {
    /// Its row of the design.
    pub row: SweepRow,
    pub(crate) plan: Plan,
    pub(crate) registry: Arc<Registry>,
    /// What the sweep has stored of it.
    pub(crate) stored: Option<Done>,
}

/// A checked sweep with its folder.
pub struct SweepRun {
    pub(crate) sweep: Sweep,
    pub(crate) folder: Folder,
    pub(crate) options: SweepOptions,
}

impl SweepRequest {
    /// The checked sweep.
    ///
    /// # Errors
    /// All faults of the graph and its sweep.
    pub fn check(&self) -> Result<Sweep> {
        let graph = self.graph.as_deref().ok_or_else(|| UsageError("a sweep needs a graph file".into()))?;
        shipped::check_is_here(graph)?;
        let (kinds, workers) = (self.plugins.kinds_apart()?, program::n_workers(self.workers));
        Ok(unless_data(graph, sweep::check_as(graph, &self.sets, kinds, workers, self.spec.clone()))?)
    }

    /// The runs of --only, checked.
    ///
    /// # Errors
    /// All faults of the graph and of the runs, and numbers that the sweep does not have.
    pub fn only(&self) -> Result<Vec<OneRun>> {
        let graph = self.graph.as_deref().ok_or_else(|| UsageError("--only needs a graph file".into()))?;
        let mut numbers: Vec<usize> = Vec::new();
        for number in self.only.iter().cloned().flatten() {
            if numbers.len() > MAX_ONLY {
                usage!("--only takes at most {MAX_ONLY} runs; leave it out to run all");
            }
            if !numbers.contains(&number) {
                numbers.push(number);
            }
        }
        let kinds = self.plugins.kinds_apart()?;
        if !graph.is_dir() {
            let (workers, spec) = (program::n_workers(self.workers), self.spec.clone());
            let runs = sweep::check_only(graph, &self.sets, kinds, &numbers, workers, spec)?;
            let one = |Run { row, plan, registry, .. }: Run| OneRun { row, plan, registry, stored: None };
            return Ok(runs.into_iter().map(one).collect());
        }
        let folder = Folder::open(graph).map_err(folder_error)?;
        let kinds = kinds.held()?;
        let stored = folder.runs().map_err(folder_error)?;
        let one = |number: usize| -> Result<OneRun> {
            if stored.binary_search(&number).is_err() {
                let has = stored.last().map_or("none".into(), |last| format!("{} runs up to {last}", stored.len()));
                usage!("{} has no run {number}; it has {has}", graph.display());
            }
            let done = folder.read(number).map_err(folder_error)?;
            let (values, sets) = (done.values.clone().into_iter().collect(), done.sets.clone());
            let row = SweepRow { run: number, values, seed: done.seed, sets };
            let checked = sweep::again(&folder, number, &self.sets, &kinds).map_err(folder_error)??;
            let registry = Arc::new(checked.registry);
            Ok(OneRun { row, plan: checked.plan, registry, stored: Some(done) })
        };
        numbers.into_iter().map(one).collect()
    }

    /// The folder of one of the runs of --only.
    pub(crate) fn folder_of(&self, run: &OneRun, is_alone: bool) -> Result<OutDir> {
        match &self.record {
            Some(dir) if is_alone => out_dir::make(Some(dir), &run.plan.name, false),
            Some(dir) => out_dir::make(Some(&dir.join(format!("{:06}", run.row.run))), &run.plan.name, false),
            None => out_dir::make(None, &format!("{}-{:06}", run.plan.name, run.row.run), false),
        }
    }

    /// The options of the runs of --only, which record.
    pub(crate) fn options_of_only(&self, cancelled: &Arc<AtomicBool>) -> Result<RunOptions> {
        let options = program::options(self.workers, cancelled);
        Ok(RunOptions { record: true, latency: true, store: self.keep.store()?, ..options })
    }

    fn options(&self, cancelled: &Arc<AtomicBool>) -> Result<SweepOptions> {
        let run = RunOptions { store: self.keep.store()?, ..program::options(self.workers, cancelled) };
        let (shard, retry_failed) = (self.shard, self.retry_failed);
        Ok(SweepOptions { workers: run.workers, run, share: !self.no_share, shard, retry_failed })
    }

    /// A new folder for the sweep, or the one to resume.
    ///
    /// # Errors
    /// The folder is in use, or of another sweep.
    pub fn begin(&self, sweep: Sweep, cancelled: &Arc<AtomicBool>) -> Result<SweepRun> {
        let options = self.options(cancelled)?;
        let folder = match (&self.out, self.resume) {
            (Some(dir), true) => {
                let _lock = sweep.renumbers(dir).then(|| FolderLock::take(dir)).transpose()?;
                sweep.resume(dir, &options)
            }
            (dir, _) => sweep.begin(&new_dir(dir.as_deref(), &sweep.plan.name)?, &options),
        };
        Ok(SweepRun { folder: folder.map_err(folder_error)?, sweep, options })
    }

    /// Begins the empty folder of a sweep, whose shards are run elsewhere, and returns the numbers of the runs of each shard:
    /// of `n_shards`, or of one for each run.
    ///
    /// # Errors
    /// As [`Self::check`] and [`Self::begin`].
    pub fn shards(&self, n_shards: Option<usize>) -> Result<Vec<Vec<usize>>> {
        let SweepRun { sweep, .. } = self.begin(self.check()?, &Arc::default())?;
        let of = n_shards.unwrap_or(usize::MAX).min(sweep.n_runs()).max(1);
        let runs_of = |index| sweep.part(Some(Shard { index, of })).map(|row| row.run).collect();
        Ok((1..=of).map(runs_of).collect())
    }
}

impl SweepRun {
    /// Number of runs that are not in the folder yet.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn n_left(&self) -> Result<usize> {
        let done = self.folder.runs_kept(self.options.retry_failed).map_err(folder_error)?;
        Ok(self.sweep.part(self.options.shard).filter(|row| done.binary_search(&row.run).is_err()).count())
    }

    pub(crate) fn make(&self, watcher: &dyn Watcher) -> Result<SweepCounts> {
        self.sweep.run(&self.folder, &self.options, watcher).map_err(folder_error)
    }

    /// Makes the runs and their summary.
    ///
    /// # Errors
    /// [`Error`]; interrupted runs can be resumed in the folder.
    pub fn run(&self, watcher: &dyn Watcher) -> Result<(), Error> {
        match self.make(watcher)?.n_missing {
            0 => Ok(summary(&self.folder).map(drop)?),
            _ => Err(Error::Interrupted),
        }
    }
}

/// A study: a sweep whose rows are asked for one by one.
pub struct OpenStudy {
    study: Study,
    options: SweepOptions,
    _lock: FolderLock,
}

impl SweepRequest {
    /// A new study in --out, or the one there to go on with.
    ///
    /// # Errors
    /// All faults of the graph; the folder is in use, or of another study.
    pub fn study(&self) -> Result<OpenStudy> {
        let (Some(graph), Some(dir)) = (&self.graph, &self.out) else {
            usage!("a study needs a graph file and a folder");
        };
        match self.resume {
            true => drop(Folder::open(dir).map_err(folder_error)?),
            false => drop(new_dir(Some(dir), "")?),
        }
        let lock = FolderLock::take(dir)?;
        let options = self.options(&Arc::default())?;
        let kinds = self.plugins.kinds_apart()?;
        let study = Study::open(graph, &self.sets, kinds, dir, self.resume, options.clone())?;
        Ok(OpenStudy { study: study.map_err(folder_error)?, options, _lock: lock })
    }
}

impl OpenStudy {
    /// A row with the values of its columns.
    pub fn row(&self, done: &Done) -> Value {
        let columns = self.study.spec().columns.iter();
        let value = |path: &str| sweep::at_path(&done.results, path).cloned().unwrap_or_default();
        let columns: serde_json::Map<_, _> = columns.map(|column| (column.name.clone(), value(&column.path))).collect();
        json!({
            "run": done.run, "seed": done.seed, "values": done.values, "status": done.status, "reason": done.reason,
            "verdict": done.verdict().map(|answer| answer.name()), "warnings": done.warnings, "columns": columns,
            "results": done.results,
        })
    }

    /// The rows of these asks; those that the folder lacks are run.
    ///
    /// # Errors
    /// [`Error`]: settings that cannot be asked for, a file that has changed, or the user stopped it.
    pub fn run(
        &mut self,
        asks: &[Ask],
        watcher: &dyn Watcher,
        cancelled: &Arc<AtomicBool>,
    ) -> Result<Vec<Done>, Error> {
        let run = RunOptions { cancelled: cancelled.clone(), ..self.options.run.clone() };
        let options = SweepOptions { run, ..self.options.clone() };
        self.study.run(asks, &options, watcher).map_err(|error| match error {
            StudyError::Ask(what) => Error::Usage(what),
            StudyError::Folder(error) => folder_error(error).into(),
            StudyError::Interrupted => Error::Interrupted,
        })
    }

    /// Writes the tables and the summary of all rows so far.
    ///
    /// # Errors
    /// A file of the folder cannot be read or written.
    pub fn close(&mut self) -> Result<(), Error> {
        self.study.close().map_err(folder_error)?;
        summary(self.study.folder())?;
        Ok(())
    }
}

/// Combines the runs of shards in a new folder.
///
/// # Errors
/// The shards are not those of one sweep.
pub fn merge(shards: &[PathBuf], out: &Path) -> Result<Folder> {
    let shards = shards.iter().map(|dir| Folder::open(dir)).collect::<Result<Vec<_>, _>>().map_err(folder_error)?;
    sweep::merge(&shards, &new_dir(Some(out), "")?).map_err(folder_error)
}

/// Writes the summary of the runs into their folder.
///
/// # Errors
/// A file of the folder cannot be read or written.
pub fn summary(folder: &Folder) -> Result<Value> {
    Ok(summary::write(folder, NOTICE)?)
}

/// Converts an error: a wrong folder is a fault of the command line.
pub(crate) fn folder_error(error: FolderError) -> anyhow::Error {
    match error {
        FolderError::NoSweep { .. } | FolderError::Other { .. } | FolderError::Missing { .. } => {
            UsageError(error.to_string()).into()
        }
        other => other.into(),
    }
}

/// Creates the folder, or takes an empty one; for a folder with a sweep the error suggests --resume.
pub(crate) fn new_dir(out: Option<&Path>, graph: &str) -> Result<OutDir> {
    out.map_or(Ok(()), check_new)?;
    out_dir::make(out, graph, false)
}

/// Whether a sweep may begin in a folder.
///
/// # Errors
/// It holds a sweep, or other files.
pub(crate) fn check_new(dir: &Path) -> Result<()> {
    if dir.join(sweep::DESIGN).is_file() {
        usage!("{} holds a sweep already; continue it with --resume, or name another folder", dir.display());
    }
    out_dir::check_empty(dir, "name another folder")
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
    if let Some(what) = sweep.difference(&folder).map_err(damaged)? {
        return Err(ShardFault::Other(what));
    }
    let present = folder.runs().map_err(damaged)?;
    if present != runs {
        return Err(ShardFault::Damaged(format!("it has the runs {present:?}, but was asked for {runs:?}")));
    }
    folder.done().map_err(damaged)?.try_for_each(|done| done.map(drop).map_err(damaged))
}
