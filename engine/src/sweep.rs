//! Runs a graph many times with different settings and tabulates the results.
//!
//! `[sweep]` of a graph file defines which values are crossed or paired, what is drawn at random, how often each
//! setting is repeated, and which numbers are taken from the results of each run. All runs are checked before the first
//! one starts, and the checked plans are run: editing the graph meanwhile has no effect, and a changed input file stops
//! the sweep. Nodes that several runs share are computed once. A failed run is a row with its reason. The tables are
//! the same for any number of workers.

mod check;
mod design;
mod folder;
mod run;
mod run_row;
mod share;
mod study;
mod table;
#[cfg(test)]
mod tests;
mod times;
mod twice;

pub use crate::check::sweep::{Column, Compare, Distribution, Draw, Factor, Level, PointColumn, Spec, Variant};
pub use check::{again, check, check_as, check_only};
pub use design::{SweepRow, rows};
pub use folder::{DESIGN, Done, Folder, FolderError, GRAPH, POINTS, RUNS, RUNS_DIR, StudyRow, TIMES, merge};

pub use study::{Ask, Study, StudyError};
pub use table::{PointValue, at_path, point_values, without_value, write_points, write_runs};
pub use times::{NodeTimes, RunTimes};
pub use twice::Unsteady;

use folder::difference;

use crate::{
    fault::Fault,
    hash::{Digest, files::hashes, program},
    options::RunOptions,
    plan::{Plan, PlanPlugin},
    plugin::with_late_loads,
    recording::provenance::Provenance,
    watch::Stamps,
};
use osteoflow_node::Registry;
use serde_json::{Value as Json, json};
use std::{
    fmt,
    path::{Path, PathBuf},
    sync::Arc,
};

/// A checked sweep: no run has faults.
#[derive(Debug)]
pub struct Sweep {
    /// The specification in `[sweep]`.
    pub spec: Spec,
    /// Warnings about the graph itself.
    pub warnings: Vec<Fault>,
    /// The graph itself.
    pub plan: Plan,
    runs: Vec<Run>,
    /// State of all input files when the sweep was checked.
    files: Stamps,
    hash: Digest,
}

/// A checked run of a sweep.
#[derive(Debug)]
pub struct Run {
    /// Its row of the design.
    pub row: SweepRow,
    /// Its plan.
    pub plan: Plan,
    /// The kinds that it is built from.
    pub registry: Arc<Registry>,
    /// Sharing key of each node.
    keys: Vec<Digest>,
    /// What was asked for, in a study.
    asked: Option<StudyRow>,
}

/// Part `index` of `of` of a sweep, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Number of the part, from 1.
    pub index: usize,
    /// Number of parts.
    pub of: usize,
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

/// Options of a sweep.
#[derive(Debug, Clone)]
pub struct SweepOptions {
    /// Number of runs at a time.
    pub workers: usize,
    /// Options of each run: stop request, fixed results, store, description of the command.
    pub run: RunOptions,
    /// Whether nodes that several runs share are computed once; the tables are the same with and without.
    pub share: bool,
    /// The part to run; `None` runs all.
    pub shard: Option<Shard>,
    /// Whether stored runs that failed are run again.
    pub retry_failed: bool,
}

/// Receives the progress of a sweep, on any thread.
pub trait Watcher: Sync {
    /// A run has ended.
    fn ended(&self, done: &Done);
}

impl Watcher for () {
    fn ended(&self, _: &Done) {}
}

/// Counts of a sweep after a call of [`Sweep::run`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SweepCounts {
    /// Runs that were in the folder already.
    pub n_before: usize,
    /// Runs that ended now.
    pub n_run: usize,
    /// Runs that are missing because the user stopped the sweep.
    pub n_missing: usize,
    /// Number of computed nodes.
    pub n_computed: usize,
    /// Number of nodes whose items were taken from another run.
    pub n_shared: usize,
}

impl Sweep {
    /// Number of runs.
    pub fn n_runs(&self) -> usize {
        self.runs.len()
    }

    /// Hash of everything that determines the tables.
    pub fn hash(&self) -> Digest {
        self.hash
    }

    /// Starts the sweep in an empty folder.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn begin(&self, dir: &Path, options: &SweepOptions) -> Result<Folder, FolderError> {
        Folder::begin(dir, &self.plan.resolved, self.about(options.shard, &options.run.command))
    }

    /// What the sweep is of.
    fn about(&self, shard: Option<Shard>, command: &Json) -> Json {
        self.about_part(&self.spec, &self.runs.iter().collect::<Vec<_>>(), self.hash, shard, command)
    }

    /// What the sweep is of, or of these runs with this specification.
    fn about_part(&self, spec: &Spec, runs: &[&Run], hash: Digest, shard: Option<Shard>, command: &Json) -> Json {
        let written = self.plan.nodes.iter().map(|node| (node.name.to_string(), json!(node.written())));
        json!({
            "graph": { "name": self.plan.name, "file": self.plan.path.display().to_string(), "seed": self.plan.seed },
            "hash": hash.to_string(),
            "n_runs": runs.len(),
            "shard": shard.map(|shard| shard.to_string()),
            "sweep": spec,
            "engine_version": env!("CARGO_PKG_VERSION"),
            "program_sha256": program::digest().map(|digest| digest.to_string()),
            "command": command,
            "inputs": hashes(&input_files(runs)),
            "plugins": with_late_loads(&self.plugins()),
            "written": written.collect::<serde_json::Map<_, _>>(),
        })
    }

    /// The plugins of all runs, each once.
    fn plugins(&self) -> Vec<PlanPlugin> {
        let mut plugins: Vec<PlanPlugin> = Vec::new();
        for plugin in self.runs.iter().flat_map(|run| &run.plan.plugins).chain(&self.plan.plugins) {
            match plugins.iter_mut().find(|known| known.path == plugin.path) {
                Some(known) => known.kinds.extend(
                    plugin.kinds.iter().filter(|kind| !known.kinds.contains(kind)).cloned().collect::<Vec<_>>(),
                ),
                None => plugins.push(plugin.clone()),
            }
        }
        plugins
    }

    /// The runs of a part, or of the whole sweep, in the order of the tables.
    pub fn part(&self, shard: Option<Shard>) -> impl Iterator<Item = &SweepRow> {
        let mut part = self.order(shard);
        part.sort_unstable();
        part.into_iter().map(|run| &self.runs[run].row)
    }

    /// Resumes the sweep in its folder, of whichever part. A folder of the same sweep with fewer repeats gets the numbers of this one.
    ///
    /// # Errors
    /// If the folder holds another sweep, or no sweep.
    pub fn resume(&self, dir: &Path, options: &SweepOptions) -> Result<Folder, FolderError> {
        let mut folder = Folder::open(dir)?;
        let path = dir.display().to_string();
        if folder.is_study() {
            let what = "its runs were asked for one by one from Python, which also goes on with it".into();
            return Err(FolderError::Other { path, what });
        }
        folder.finish_growth()?;
        let n_repeats = folder.spec()?.repeat;
        let is_smaller = n_repeats < self.spec.repeat && folder.hash() != self.hash.to_string();
        let about = if is_smaller { self.about_repeats(n_repeats) } else { self.about(None, &Json::Null) };
        if let Some(what) = difference(&about, &self.plan.resolved, &folder)? {
            return Err(FolderError::Other { path, what });
        }
        let then = Provenance::of(&folder.about);
        let now = Provenance::of(&self.about(None, &options.run.command));
        let program = then.program_differences(&now, ["its runs", "this program"]);
        for what in program.into_iter().chain(then.changed_files()) {
            tracing::warn!("{path} is made otherwise from here on: {what}");
        }
        if is_smaller {
            self.grow(&mut folder, n_repeats, &options.run.command)?;
            folder.finish_growth()?;
        }
        Ok(folder)
    }

    /// Whether [`Self::resume`] would give the runs of the folder other numbers.
    pub fn renumbers(&self, dir: &Path) -> bool {
        let of =
            |folder: Folder| Some(!folder.about["runs_in"].is_null() || folder.spec().ok()?.repeat < self.spec.repeat);
        Folder::open(dir).ok().and_then(of).unwrap_or_default()
    }

    /// What the sweep would be of with fewer repeats.
    fn about_repeats(&self, n_repeats: usize) -> Json {
        let spec = Spec { repeat: n_repeats, ..self.spec.clone() };
        let runs: Vec<&Run> = self.runs.iter().filter(|run| run.row.run % self.spec.repeat < n_repeats).collect();
        let hash = check::hash(&spec, &runs, &mut |file| hashes(&[file.into()]));
        self.about_part(&spec, &runs, hash, None, &Json::Null)
    }

    /// Gives the runs of a folder of fewer repeats the numbers of this sweep.
    fn grow(&self, folder: &mut Folder, n_repeats: usize, command: &Json) -> Result<(), FolderError> {
        let mut about = self.about(None, command);
        for key in ["plugins", "merged", "grown", "shard"] {
            if !folder.about[key].is_null() {
                about[key] = folder.about[key].clone();
            }
        }
        let before = json!({ "repeat": n_repeats, "hash": folder.hash(), "command": folder.about["command"] });
        let mut grown = about["grown"].as_array().cloned().unwrap_or_default();
        grown.push(before);
        about["grown"] = grown.into();
        folder.grow(about, |run| run / n_repeats * self.spec.repeat + run % n_repeats)
    }
}

/// Input files of all runs, without duplicates.
fn input_files(runs: &[&Run]) -> Vec<PathBuf> {
    let mut files: Vec<_> = runs.iter().flat_map(|run| &run.plan.input_files).cloned().collect();
    files.sort();
    files.dedup();
    files
}
