//! The loop that runs a graph again whenever it changes: of `run --watch` and of `view GRAPH`.

use super::{exit::Exit, global::Global, progress::Progress};
use crate::app::{
    GraphArgs, Leave,
    out_dir::{self, OutDir},
};
use anyhow::Result;
use osteoflow_engine::{
    Checked, Faults, check,
    check::files,
    check_recorded,
    plan::Plan,
    run::{RunError, RunOptions, RunReport},
    watch::Stamps,
};
use std::{
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

/// A graph that is run again.
pub(crate) trait Rerun {
    /// The graph as it is now.
    fn graph(&self) -> GraphArgs;

    /// Increases with each change to it that is not one of its files.
    fn n_changes(&self) -> u64 {
        0
    }

    /// Shows the faults of the graph, which the next change may mend; an exit ends the loop.
    fn show_faults(&mut self, faults: &Faults) -> Result<Option<Exit>>;

    /// Runs what has changed since the last run. `seen`: when the change was.
    fn run(&mut self, checked: Checked, seen: Instant) -> Result<Turn>;
}

/// What follows a run.
pub(crate) enum Turn {
    /// The next, as soon as one of these files changes, or one of the graph.
    Wait(Stamps),
    /// Nothing.
    End(Exit),
}

/// Runs the graph until `cancelled`, or until nothing is left to wait for.
pub(crate) fn rerun(graph: &mut impl Rerun, cancelled: &AtomicBool) -> Result<Exit> {
    let is_cancelled = || cancelled.load(Ordering::Relaxed);
    let mut seen = Instant::now();
    loop {
        // Taken before the graph is read: what changes later counts as a change.
        let n_changes = graph.n_changes();
        let GraphArgs { graph: path, sets, plugins } = graph.graph();
        let kinds = plugins.kinds_apart()?;
        let of_graph = Stamps::of(files(&path, &sets, &kinds));
        let turn = match check(&path, &sets, &kinds) {
            Ok(checked) => graph.run(checked, seen)?,
            Err(faults) => match graph.show_faults(&faults)? {
                Some(exit) => Turn::End(exit),
                None => {
                    // A missing file may be created.
                    let text = osteoflow_engine::regular(&path).and_then(std::fs::read_to_string).unwrap_or_default();
                    let checked = check_recorded(&text, &path, &sets, &kinds);
                    Turn::Wait(checked.map(|checked| Stamps::of_plan(&checked.plan)).unwrap_or_default())
                }
            },
        };
        let stamps = match turn {
            Turn::Wait(files) => of_graph.and(&files),
            Turn::End(exit) => return Ok(exit),
        };
        let change = stamps.wait(&|| is_cancelled() || graph.n_changes() != n_changes);
        if is_cancelled() {
            return Ok(Exit::Done);
        }
        seen = change.unwrap_or_else(Instant::now);
    }
}

/// The runs of one loop.
pub(crate) struct Runs {
    pub(crate) options: RunOptions,
    pub(crate) global: Global,
    pub(crate) leave: Leave,
    /// Number of runs so far.
    pub(crate) n: usize,
}

impl Runs {
    /// The folder of the next run.
    pub(crate) fn folder(&self, plan: &Plan) -> Result<OutDir> {
        let dir = match &self.leave.out {
            Some(first) if self.n > 0 => out_dir::make_after(first)?,
            out => out_dir::make(out.as_deref(), &plan.name, self.leave.force)?,
        };
        let within = |file: &&PathBuf| match (dir.canonicalize(), file.canonicalize()) {
            (Ok(dir), Ok(file)) => dir.starts_with(file),
            _ => false,
        };
        if let Some(read) = plan.input_files.iter().find(within) {
            let (dir, read) = (dir.display(), read.display());
            usage!(
                "{dir} is inside {read}, which the graph reads, so each run would start the next; name another folder with --out"
            );
        }
        Ok(dir)
    }

    /// Makes a run whose files go into `dir`, which is removed if the run has no report.
    pub(crate) fn run(
        &mut self,
        dir: OutDir,
        options: RunOptions,
        progress: &Progress,
        run: impl FnOnce(&RunOptions) -> Result<RunReport, RunError>,
    ) -> Result<(RunReport, OutDir), RunError> {
        let report = run(&RunOptions { out_dir: Some(dir.to_path_buf()), ..options });
        progress.end();
        match report {
            Ok(report) => {
                self.n += 1;
                Ok((report, dir))
            }
            Err(error) => {
                dir.remove_if_empty();
                Err(error)
            }
        }
    }
}
