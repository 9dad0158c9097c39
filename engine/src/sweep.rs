//! Runs a graph many times with other settings, and makes tables of what came out.
//!
//! `[sweep]` of a graph file says which values are crossed or paired, what is drawn at random, how often each setting is
//! run, and which numbers are taken out of the results of each run. All runs are checked before the first one begins, and
//! what they run is what was checked: a file that is edited meanwhile changes nothing. What several runs have in common is
//! computed once. A run that fails is a row with its reason. The tables are the same for any number of workers.

mod design;
mod folder;
mod run_row;
mod share;
mod spec;
mod table;
#[cfg(test)]
mod tests;

pub use design::{Row, rows};
pub use folder::{DESIGN, Done, Folder, FolderError, GRAPH, POINTS, RUNS, RUNS_DIR, merge};
pub(crate) use spec::read;
pub use spec::{Column, Compare, Distribution, Draw, Factor, Level, PointColumn, Spec};
pub use table::{PointValue, at_path, point_values, write_points, write_runs};

use crate::{
    check::{self, Checked},
    digest::Digest,
    fault::{Fault, Faults},
    manifest::{hashes, sha256},
    part::Left,
    plan::Plan,
    plugin::Kinds,
    run::{Outcome, RunOptions},
    store::Key,
    sync::on_workers,
    watch::Stamps,
};
use osteoflow_node::{Registry, Role};
use serde_json::{Value as Json, json};
use share::Shared;
use std::{
    path::Path,
    sync::{
        Arc, Condvar, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

/// A sweep whose every run is without faults.
#[derive(Debug)]
pub struct Sweep {
    /// What `[sweep]` says.
    pub spec: Spec,
    /// What is hardly meant, of the graph itself.
    pub warnings: Vec<Fault>,
    /// The graph itself.
    pub plan: Plan,
    registry: Registry,
    runs: Vec<Run>,
    hash: Digest,
}

#[derive(Debug)]
struct Run {
    row: Row,
    plan: Plan,
    /// Of each node, what decides its items.
    keys: Vec<Digest>,
}

/// A part of a sweep: the `index`-th of `of`, from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Which, from 1.
    pub index: usize,
    /// Of so many.
    pub of: usize,
}

/// How a sweep is run.
#[derive(Debug, Clone)]
pub struct SweepOptions {
    /// How many runs are under way at a time.
    pub workers: usize,
    /// What each run is given: cancelling, fixed results, the store, what the command says of itself.
    pub run: RunOptions,
    /// Whether what several runs have in common is computed once; the tables are the same with and without.
    pub share: bool,
    /// The part that is run; all if not given.
    pub shard: Option<Shard>,
}

/// Is told how far a sweep has come; from whatever thread it happens on.
pub trait Watcher: Sync {
    /// A run has come to its end.
    fn ended(&self, done: &Done);
}

impl Watcher for () {
    fn ended(&self, _: &Done) {}
}

/// What a sweep has come to.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Swept {
    /// Runs that were there already.
    pub n_before: usize,
    /// Runs that came to their end now.
    pub n_run: usize,
    /// Of all runs that are there, those without results.
    pub n_without: usize,
    /// Runs that are missing, because the user has stopped the sweep.
    pub n_missing: usize,
    /// Nodes that were computed.
    pub n_computed: usize,
    /// Nodes whose items another run had left.
    pub n_shared: usize,
}

/// Checks the graph file at `path` and every run of its sweep; on `workers` threads.
///
/// # Errors
/// [`Faults`]: of the graph; or of the first run that has any, with the settings of that run; and if the graph has no
/// `[sweep]`.
pub fn check(path: &Path, sets: &[String], kinds: impl Into<Kinds>, workers: usize) -> Result<Sweep, Faults> {
    let kinds = kinds.into();
    let Checked { plan, warnings, registry, sweep } = check::check(path, sets, kinds.clone())?;
    let Some(spec) = sweep else {
        let fault = Fault::new(format!("{} has no table [sweep]", path.display()));
        let help = "say what is varied, such as [sweep] repeat = 10, and which numbers are wanted in [sweep.columns]";
        return Err(Faults(vec![fault.help(help)]));
    };
    if let Some(live) = plan.nodes.iter().find(|node| node.role == Role::LiveSource) {
        let fault = Fault::new(format!("node \"{}\" is a live source, which gives what it gives once", live.name));
        return Err(Faults(vec![fault.help("record it, and sweep over the recording")]));
    }
    let rows = rows(&spec, plan.seed);
    let runs = check_rows(path, sets, &kinds, rows, workers)?;
    let hash = hash(&spec, &runs);
    Ok(Sweep { spec: *spec, warnings, plan, registry, runs, hash })
}

/// Checks a run of a sweep once more from what its folder holds: the frozen graph with what the run has set in it, and with
/// `sets` besides. Who runs it compares its results with those that are there: program and inputs may have changed.
///
/// # Errors
/// If the folder cannot be read; within, the faults that the graph has now.
pub fn again(
    folder: &Folder,
    run: usize,
    sets: &[String],
    kinds: &Kinds,
) -> Result<Result<Checked, Faults>, FolderError> {
    let path = Path::new(folder.about["graph"]["file"].as_str().unwrap_or(GRAPH));
    Ok(check::check_frozen(folder.graph()?, path, &folder.sets(run)?, sets, kinds))
}

/// The plans of all rows; they are looked at together, and the first with faults is told.
fn check_rows(path: &Path, sets: &[String], kinds: &Kinds, rows: Vec<Row>, workers: usize) -> Result<Vec<Run>, Faults> {
    let (next, places) = (AtomicUsize::new(0), rows.iter().map(|_| Mutex::new(None)).collect::<Vec<_>>());
    let stop = AtomicBool::new(false);
    let look = |_| {
        while !stop.load(Ordering::Relaxed)
            && let index = next.fetch_add(1, Ordering::Relaxed)
            && let Some(row) = rows.get(index)
        {
            let checked = check::check_row(path, sets, &row.sets, kinds.clone());
            stop.fetch_or(checked.is_err(), Ordering::Relaxed);
            *places[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(checked);
        }
    };
    on_workers(workers.min(rows.len()).max(1), &look, &|_, error| tracing::warn!("one thread less: {error}"));
    let mut runs = Vec::with_capacity(rows.len());
    let mut files = Stamps::default();
    for (row, place) in rows.iter().zip(places) {
        let checked = match place.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(Ok(checked)) => checked,
            Some(Err(mut faults)) => {
                let told = |(name, value): &(String, Json)| format!("{name} = {value}");
                let settings: Vec<_> = row.values.iter().map(told).collect();
                let note = format!("in run {} of the sweep: {}", row.run, settings.join(", "));
                faults.0.iter_mut().for_each(|fault| fault.notes.push(note.clone()));
                return Err(faults);
            }
            // Another row has faults, or comes first and is told.
            None => continue,
        };
        let mut plan = checked.plan;
        let new: Vec<_> = plan.input_files.iter().filter(|file| files.get(file).is_none()).cloned().collect();
        files = files.and(&Stamps::of(new));
        let keys = share::keys(&plan, &files);
        plan.path = path.into();
        runs.push(Run { row: row.clone(), plan, keys });
    }
    Ok(runs)
}

/// What decides the tables: the sweep, the graph of each run with its input files by their contents, and the program.
fn hash(spec: &Spec, runs: &[Run]) -> Digest {
    let mut files: Vec<_> = runs.iter().flat_map(|run| &run.plan.input_files).cloned().collect();
    files.sort();
    files.dedup();
    let mut key = Key::of("sweep").json("spec", &json!(spec));
    if let Ok((_, program)) = std::env::current_exe().and_then(|path| sha256(&path)) {
        key = key.digest("program", program);
    }
    // The same files in another place are the same sweep.
    let mut names = Vec::new();
    for (index, file) in files.iter().enumerate() {
        names.push((Json::from(file.to_string_lossy()).to_string(), format!("\"file {index}\"")));
        for entry in hashes(std::slice::from_ref(file)) {
            key = key.number("file", index as u64).text("sha256", &entry["sha256"].to_string());
        }
    }
    for run in runs {
        let text = names.iter().fold(run.plan.resolved.clone(), |text, (name, short)| text.replace(name, short));
        key = run.plan.plugins.iter().fold(key, |key, plugin| key.text("plugin", &plugin.sha256));
        key = key.text("graph", &text);
    }
    key.done().digest()
}

impl Sweep {
    /// How many runs there are.
    pub fn n_runs(&self) -> usize {
        self.runs.len()
    }

    /// The runs, in the order of the tables.
    pub fn rows(&self) -> impl Iterator<Item = &Row> {
        self.runs.iter().map(|run| &run.row)
    }

    /// The hash of all that decides the tables.
    pub fn hash(&self) -> Digest {
        self.hash
    }

    /// Begins in an empty folder.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn begin(&self, dir: &Path, options: &SweepOptions) -> Result<Folder, FolderError> {
        let mut files: Vec<_> = self.runs.iter().flat_map(|run| &run.plan.input_files).cloned().collect();
        files.sort();
        files.dedup();
        let about = json!({
            "graph": { "name": self.plan.name, "file": self.plan.path.display().to_string(), "seed": self.plan.seed },
            "hash": self.hash.to_string(),
            "n_runs": self.runs.len(),
            "shard": options.shard.map(|shard| format!("{}/{}", shard.index, shard.of)),
            "sweep": self.spec,
            "engine_version": env!("CARGO_PKG_VERSION"),
            "command": options.run.command,
            "inputs": hashes(&files),
            "plugins": self.plan.plugins,
        });
        Folder::begin(dir, &self.plan.resolved, about)
    }

    /// Goes on in the folder of this very sweep.
    ///
    /// # Errors
    /// If it holds another sweep, or none.
    pub fn resume(&self, dir: &Path) -> Result<Folder, FolderError> {
        let folder = Folder::open(dir)?;
        let hash = self.hash.to_string();
        if folder.hash() != hash {
            let what = format!(
                "graph, input files, plugins or program are not those it was begun with (hash {} then, {hash} now)",
                folder.hash()
            );
            return Err(FolderError::Other { path: dir.display().to_string(), what });
        }
        Ok(folder)
    }

    /// Runs what the folder does not have yet, and keeps each run as it ends. The tables are left to the caller.
    ///
    /// # Errors
    /// If the folder cannot be read or written; a run that fails is a row.
    pub fn run(&self, folder: &Folder, options: &SweepOptions, watcher: &dyn Watcher) -> Result<Swept, FolderError> {
        let before = folder.runs()?;
        let mut order = self.order();
        if let Some(Shard { index, of }) = options.shard {
            // Neighbours have much in common, so a shard takes a stretch.
            let n = order.len();
            order = order[n * (index - 1) / of..n * index / of].to_vec();
        }
        let n_before = order.iter().filter(|run| before.binary_search(run).is_ok()).count();
        order.retain(|run| before.binary_search(run).is_err());
        let shared = match options.share {
            true => Shared::of(order.iter().map(|&run| &self.runs[run].keys[..])),
            false => Shared::default(),
        };
        let state = Mutex::new(State { pending: order.into(), shared, swept: Swept::default(), error: None });
        let (ended, cancelled) = (Condvar::new(), &options.run.cancelled);
        let lock = || state.lock().unwrap_or_else(PoisonError::into_inner);
        on_workers(
            options.workers.max(1),
            &|_| {
                let mut now = lock();
                loop {
                    if cancelled.load(Ordering::Relaxed) || now.error.is_some() {
                        ended.notify_all();
                        return;
                    }
                    let free = now.pending.iter().position(|&run| now.shared.is_free(&self.runs[run].keys));
                    let Some(at) = free else {
                        if now.pending.is_empty() {
                            return;
                        }
                        now = ended.wait(now).unwrap_or_else(PoisonError::into_inner);
                        continue;
                    };
                    let Some(run) = now.pending.remove(at).map(|run| &self.runs[run]) else { return };
                    let found = now.shared.begin(&run.keys);
                    drop(now);
                    let n_shared = found.iter().flatten().count();
                    let (done, left) = self.run_one(run, options, &found);
                    drop(found);
                    let kept = done.as_ref().map(|done| folder.keep(done, &run.row.sets));
                    now = lock();
                    now.shared.end(&run.keys, left);
                    now.swept.n_shared += n_shared;
                    now.swept.n_computed += run.keys.len() - n_shared;
                    match (kept, &done) {
                        (Some(Err(error)), _) => now.error = now.error.take().or(Some(error)),
                        (Some(Ok(())), Some(done)) => {
                            now.swept.n_run += 1;
                            watcher.ended(done);
                        }
                        _ => {}
                    }
                    ended.notify_all();
                }
            },
            &|_, error| tracing::warn!("one thread less: {error}"),
        );
        let State { pending, swept, error, .. } = state.into_inner().unwrap_or_else(PoisonError::into_inner);
        if let Some(error) = error {
            return Err(error);
        }
        let n_missing = pending.len();
        let mut swept = Swept { n_before, n_missing, ..swept };
        for done in folder.done()? {
            swept.n_without += usize::from(done?.status != "complete");
        }
        Ok(swept)
    }

    /// The runs in an order in which those that have much in common follow each other.
    fn order(&self) -> Vec<usize> {
        // By when the keys were first seen, node by node: sorting by that keeps the order of the tables where nothing is shared.
        let mut first = std::collections::BTreeMap::new();
        for (index, run) in self.runs.iter().enumerate() {
            for key in &run.keys {
                first.entry(*key).or_insert(index);
            }
        }
        let mut order: Vec<usize> = (0..self.runs.len()).collect();
        order.sort_by_cached_key(|&run| self.runs[run].keys.iter().map(|key| first[key]).collect::<Vec<_>>());
        order
    }

    /// One run; `None` where the user has stopped it.
    fn run_one(
        &self,
        run: &Run,
        options: &SweepOptions,
        found: &[Option<Arc<Left>>],
    ) -> (Option<Done>, Vec<Option<Left>>) {
        let of_run = RunOptions { workers: 1, out_dir: None, record: false, latency: false, ..options.run.clone() };
        let (report, left) = run_row::run(&run.plan, &self.registry, &of_run, found);
        let done = match report {
            Ok(report) => {
                let told = |warning: &crate::run::Warning| {
                    format!("node \"{}\", item {}: {}", warning.node, warning.item, warning.message)
                };
                let warnings = report.warnings.iter().map(told).collect();
                let reason = match &report.outcome {
                    Outcome::Interrupted => return (None, left),
                    Outcome::Refused(refusal) => Some(refusal.to_string()),
                    Outcome::Complete => None,
                };
                Done::of(&run.row, report.outcome.status(), reason, warnings, report.results)
            }
            Err(error) => Done::of(&run.row, "failed", Some(error.to_string()), Vec::new(), Json::Null),
        };
        (Some(done), left)
    }
}

/// A sweep under way.
struct State {
    pending: std::collections::VecDeque<usize>,
    shared: Shared,
    swept: Swept,
    error: Option<FolderError>,
}
