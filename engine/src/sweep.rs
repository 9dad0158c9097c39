//! Runs a graph many times with other settings, and makes tables of what came out.
//!
//! `[sweep]` of a graph file says which values are crossed or paired, what is drawn at random, how often each setting
//! is run, and which numbers are taken out of the results of each run. All runs are checked before the first one begins,
//! and what they run is what was checked: a graph that is edited meanwhile changes nothing, an input file that changes
//! stops the sweep. What several runs have in common is computed once. A run that fails is a row with its reason. The
//! tables are the same for any number of workers.

mod check;
mod design;
mod folder;
mod run;
mod run_row;
mod share;
mod table;
#[cfg(test)]
mod tests;

pub use crate::check::sweep::{Column, Compare, Distribution, Draw, Factor, Level, PointColumn, Spec};
pub use check::{again, check};
pub use design::{Row, rows};
pub use folder::{DESIGN, Done, Folder, FolderError, GRAPH, POINTS, RUNS, RUNS_DIR, merge};
pub use table::{PointValue, at_path, point_values, without_value, write_points, write_runs};

use crate::{
    fault::Fault,
    hash::{Digest, files::hashes},
    plan::Plan,
    runtime::RunOptions,
    watch::Stamps,
};
use osteoflow_node::Registry;
use serde_json::json;
use std::{
    fmt,
    path::{Path, PathBuf},
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
    /// The input files of all runs, as they were when they were checked.
    files: Stamps,
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

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
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
    /// Runs that are missing, because the user has stopped the sweep.
    pub n_missing: usize,
    /// Nodes that were computed.
    pub n_computed: usize,
    /// Nodes whose items another run had left.
    pub n_shared: usize,
}

impl Sweep {
    /// How many runs there are.
    pub fn n_runs(&self) -> usize {
        self.runs.len()
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
        let files = input_files(&self.runs);
        let about = json!({
            "graph": { "name": self.plan.name, "file": self.plan.path.display().to_string(), "seed": self.plan.seed },
            "hash": self.hash.to_string(),
            "n_runs": self.runs.len(),
            "shard": options.shard.map(|shard| shard.to_string()),
            "sweep": self.spec,
            "engine_version": env!("CARGO_PKG_VERSION"),
            "command": options.run.command,
            "inputs": hashes(&files),
            "plugins": self.plan.plugins,
        });
        Folder::begin(dir, &self.plan.resolved, about)
    }

    /// The runs of a part, or all, in the order of the tables.
    pub fn part(&self, shard: Option<Shard>) -> impl Iterator<Item = &Row> {
        let mut part = self.order(shard);
        part.sort_unstable();
        part.into_iter().map(|run| &self.runs[run].row)
    }

    /// Goes on in the folder of this very sweep, with the part of it that it was begun with.
    ///
    /// # Errors
    /// If it holds another sweep, another part of it, or none.
    pub fn resume(&self, dir: &Path, shard: Option<Shard>) -> Result<Folder, FolderError> {
        let folder = Folder::open(dir)?;
        let hash = self.hash.to_string();
        if folder.hash() != hash {
            let what = format!(
                "graph, input files, plugins or program are not those it was begun with (hash {} then, {hash} now)",
                folder.hash()
            );
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

/// The input files of all runs, each once.
fn input_files(runs: &[Run]) -> Vec<PathBuf> {
    let mut files: Vec<_> = runs.iter().flat_map(|run| &run.plan.input_files).cloned().collect();
    files.sort();
    files.dedup();
    files
}
