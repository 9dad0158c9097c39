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
mod table;
#[cfg(test)]
mod tests;
mod times;
mod twice;

pub use crate::check::sweep::{Column, Compare, Distribution, Draw, Factor, Level, PointColumn, Spec};
pub use check::{again, check, check_as};
pub use design::{SweepRow, rows};
pub use folder::{
    DESIGN, Done, Folder, FolderError, GRAPH, POINTS, RUNS, RUNS_DIR, TIMES, difference_of_plugins, merge,
};

use folder::difference;
pub use table::{PointValue, at_path, point_values, without_value, write_points, write_runs};
pub use times::{NodeTimes, RunTimes};
pub use twice::Unsteady;

use crate::{
    fault::Fault,
    hash::{Digest, files::hashes, program},
    options::RunOptions,
    plan::{Plan, PlanPlugin},
    plugin::with_late_loads,
    watch::Stamps,
};
use osteoflow_node::Registry;
use serde_json::{Value as Json, json};
use std::{
    fmt,
    path::{Path, PathBuf},
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
    registry: Registry,
    runs: Vec<Run>,
    /// State of all input files when the sweep was checked.
    files: Stamps,
    hash: Digest,
}

#[derive(Debug)]
struct Run {
    row: SweepRow,
    plan: Plan,
    /// Sharing key of each node.
    keys: Vec<Digest>,
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
        json!({
            "graph": { "name": self.plan.name, "file": self.plan.path.display().to_string(), "seed": self.plan.seed },
            "hash": self.hash.to_string(),
            "n_runs": self.runs.len(),
            "shard": shard.map(|shard| shard.to_string()),
            "sweep": self.spec,
            "engine_version": env!("CARGO_PKG_VERSION"),
            "program_sha256": program::digest().map(|digest| digest.to_string()),
            "command": command,
            "inputs": hashes(&input_files(&self.runs)),
            "plugins": with_late_loads(&self.plugins()),
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

    /// Resumes the sweep in its folder, with the part it was started with.
    ///
    /// # Errors
    /// If the folder holds another sweep, another part, or no sweep.
    pub fn resume(&self, dir: &Path, shard: Option<Shard>) -> Result<Folder, FolderError> {
        let folder = Folder::open(dir)?;
        if let Some(what) = difference(&self.about(shard, &Json::Null), &self.plan.resolved, &folder)? {
            return Err(FolderError::Other { path: dir.display().to_string(), what });
        }
        let (there, asked) = (folder.about["shard"].as_str(), shard.map(|shard| shard.to_string()));
        if there != asked.as_deref() {
            let there = there.map(str::to_owned);
            return Err(FolderError::Part { path: dir.display().to_string(), there, asked });
        }
        Ok(folder)
    }
}

/// Input files of all runs, without duplicates.
fn input_files(runs: &[Run]) -> Vec<PathBuf> {
    let mut files: Vec<_> = runs.iter().flat_map(|run| &run.plan.input_files).cloned().collect();
    files.sort();
    files.dedup();
    files
}
