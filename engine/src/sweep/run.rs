//! Runs the missing runs of a sweep on several workers.

use super::{
    Done, Folder, FolderError, Run, RunTimes, Shard, Sweep, SweepCounts, SweepOptions, Unsteady, Watcher, run_row,
    share::Shared, twice,
};
use crate::{
    options::RunOptions,
    partial::FinishedNode,
    plan::PlanPlugin,
    plugin::{late_difference, with_late_loads},
    run::Outcome,
    runtime::{Warning, on_workers},
    watch::Stamps,
};
use serde_json::Value as Json;
use std::{
    collections::{BTreeMap, VecDeque},
    path::PathBuf,
    sync::{Arc, Condvar, Mutex, PoisonError, atomic::Ordering},
};

impl Sweep {
    /// Runs what the folder lacks and stores each run as it ends. Does not write the tables.
    ///
    /// # Errors
    /// If the folder cannot be read or written, or an input file has changed since the check. A failed run is a row,
    /// not an error.
    pub fn run(
        &self,
        folder: &Folder,
        options: &SweepOptions,
        watcher: &dyn Watcher,
    ) -> Result<SweepCounts, FolderError> {
        let before = folder.runs_kept(options.retry_failed)?;
        let mut order = self.order(options.shard);
        let n_before = order.iter().filter(|run| before.binary_search(run).is_ok()).count();
        order.retain(|run| before.binary_search(run).is_err());
        let mut shared = match options.share {
            true => Shared::of(order.iter().map(|&run| &self.runs[run].keys[..])),
            false => Shared::default(),
        };
        let twice = twice::chosen(&self.runs, self.spec.repeat, self.spec.twice);
        let swept = self.run_in_order(order, &mut shared, &|run| twice.contains(&run), folder, options, watcher)?;
        Ok(SweepCounts { n_before, ..swept })
    }

    /// Runs these runs and stores each as it ends; `shared` has the nodes that they share.
    pub(super) fn run_in_order(
        &self,
        order: Vec<usize>,
        shared: &mut Shared,
        is_twice: &(dyn Fn(usize) -> bool + Sync),
        folder: &Folder,
        options: &SweepOptions,
        watcher: &dyn Watcher,
    ) -> Result<SweepCounts, FolderError> {
        let loaded_before = folder.plugins();
        let plugins = loaded_before.clone();
        let swept = SweepCounts::default();
        let state = Mutex::new(State { pending: order.into(), shared, swept, plugins, error: None });
        let (ended, cancelled) = (Condvar::new(), &options.run.cancelled);
        let lock = || state.lock().unwrap_or_else(PoisonError::into_inner);
        on_workers(
            options.workers.max(1),
            &|_| {
                alone(&|| {
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
                        let (mut done, times, left) = self.run_one(run, options, &found);
                        if let Some(first) = done.as_mut().filter(|done| is_twice(done.run) && !done.is_failed()) {
                            first.twice = self.run_again(run, options, first, &found, &left);
                        }
                        drop(found);
                        let kept =
                            done.as_ref().map(|done| match (self.changed(run), late_difference(&loaded_before)) {
                                (None, None) => folder.keep(done, times.as_ref()),
                                (Some(file), _) => Err(FolderError::Changed { path: file.display().to_string() }),
                                (None, Some(what)) => {
                                    Err(FolderError::Other { path: folder.dir().display().to_string(), what })
                                }
                            });
                        now = lock();
                        let plugins = with_late_loads(&now.plugins);
                        if plugins != now.plugins {
                            now.error = folder.note_plugins(&plugins).err().or(now.error.take());
                            now.plugins = plugins;
                        }
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
                })
            },
            &|_, error| tracing::warn!("one thread less: {error}"),
        );
        let State { pending, swept, error, .. } = state.into_inner().unwrap_or_else(PoisonError::into_inner);
        if let Some(error) = error {
            return Err(error);
        }
        let n_missing = pending.len();
        Ok(SweepCounts { n_missing, ..swept })
    }

    /// The runs of a part, or of the whole sweep, ordered so that runs that share nodes are adjacent.
    pub(super) fn order(&self, shard: Option<Shard>) -> Vec<usize> {
        // Sorted by the first appearance of each key, node by node; keeps the order of the tables where nothing is
        // shared.
        let mut first = BTreeMap::new();
        for (index, run) in self.runs.iter().enumerate() {
            for key in &run.keys {
                first.entry(*key).or_insert(index);
            }
        }
        let mut order: Vec<usize> = (0..self.runs.len()).collect();
        order.sort_by_cached_key(|&run| self.runs[run].keys.iter().map(|key| first[key]).collect::<Vec<_>>());
        match shard {
            // Adjacent runs share nodes, so a shard is a contiguous range.
            Some(Shard { index, of }) => order[order.len() * (index - 1) / of..order.len() * index / of].to_vec(),
            None => order,
        }
    }

    /// First input file of the run that has changed since the check.
    fn changed<'r>(&self, run: &'r Run) -> Option<&'r PathBuf> {
        let now = Stamps::of_plan(&run.plan);
        run.plan.input_files.iter().find(|file| now.get(file) != self.files.get(file))
    }

    /// Computes a row a second time, without the store and other runs; the nodes that answer otherwise. `None` if the user
    /// stopped it.
    fn run_again(
        &self,
        run: &Run,
        options: &SweepOptions,
        first: &Done,
        found: &[Option<Arc<FinishedNode>>],
        left: &[Option<FinishedNode>],
    ) -> Option<Vec<Unsteady>> {
        let run_options = RunOptions { store: None, ..options.run.clone() };
        let options = SweepOptions { run: run_options, ..options.clone() };
        let (second, _, again) = self.run_one(run, &options, &vec![None; run.plan.nodes.len()]);
        let before: Vec<_> = found.iter().zip(left).map(|(found, left)| found.as_deref().or(left.as_ref())).collect();
        let nodes = twice::compare(&run.plan, &run.registry, &before, &again);
        Some(twice::unsteady(&self.spec, &run.plan, &nodes, first, &second?))
    }

    /// Runs one row; nothing if the user stopped it, and no times of one that could not begin.
    fn run_one(
        &self,
        run: &Run,
        options: &SweepOptions,
        found: &[Option<Arc<FinishedNode>>],
    ) -> (Option<Done>, Option<RunTimes>, Vec<Option<FinishedNode>>) {
        // Names the run in what is logged of it.
        let _span = tracing::error_span!("run", number = run.row.run).entered();
        let of_run = RunOptions {
            workers: 1,
            out_dir: None,
            record: false,
            latency: false,
            cpu_time: true,
            ..options.run.clone()
        };
        let (report, left) = run_row::run(&run.plan, &run.registry, &of_run, found);
        let mut times = None;
        let mut done = match report {
            Ok(report) => {
                let format = |warning: &Warning| {
                    format!("node \"{}\", item {}: {}", warning.node, warning.item, warning.message)
                };
                let warnings = report.warnings.iter().map(format).collect();
                let of_run = RunTimes::of(run.row.run, &run.plan, &report, found);
                let reason = match &report.outcome {
                    Outcome::Interrupted => return (None, None, left),
                    Outcome::Refused(refusal) => Some(refusal.to_string()),
                    Outcome::Complete => None,
                };
                let mut results = report.results;
                of_run.add_to(&mut results, &self.spec.columns);
                times = Some(of_run);
                Done::of(&run.row, report.outcome.status(), reason, warnings, results)
            }
            Err(error) => Done::of(&run.row, Done::FAILED, Some(error.to_string()), Vec::new(), Json::Null),
        };
        done.asked.clone_from(&run.asked);
        (Some(done), times, left)
    }
}

/// Does the work in a pool of one thread: as many rows run at a time as threads are wanted, and the time of an algorithm is
/// that of its node alone.
fn alone(work: &(dyn Fn() + Sync)) {
    match rayon::ThreadPoolBuilder::new().num_threads(1).stack_size(8 << 20).build() {
        Ok(pool) => pool.install(work),
        Err(error) => {
            tracing::warn!("no pool of its own: {error}");
            work();
        }
    }
}

/// A sweep in progress.
struct State<'s> {
    pending: VecDeque<usize>,
    shared: &'s mut Shared,
    swept: SweepCounts,
    plugins: Vec<PlanPlugin>,
    error: Option<FolderError>,
}
