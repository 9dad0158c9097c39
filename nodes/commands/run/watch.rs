//! `run --watch`: runs the graph again whenever one of its files has changed.

use crate::app::{UsageError, run_error};
use crate::commands::common::{
    Exit, Format, Global, graph_args,
    progress::Progress,
    result_table, run_end,
    running::{self, Ran},
    terminal,
};
use crate::commands::run::Run;
use anyhow::{Result, anyhow};
use osteoflow_engine::{
    Checked, check,
    check::files,
    check_recorded,
    run::{Outcome, RunError, RunOptions, RunReport},
    watch::{Next, Session, Stamps},
};
use serde_json::{Value, json};
use std::{
    fs,
    io::Write,
    path::Path,
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

/// The state of a watch.
struct Watch {
    run: Run,
    global: Global,
    options: RunOptions,
    session: Session,
    /// Number of runs.
    n_runs: usize,
    /// The results of the last run that had any.
    results: Option<Value>,
}

/// How a check of the graph ended.
enum Looked {
    /// The files that parameters name, with their state when they were read.
    Files(Stamps),
    /// The user ended a run.
    Interrupted,
}

/// Runs until the user ends it.
pub(super) fn execute(run: &Run, global: &Global) -> Result<Exit> {
    let cancelled = Arc::default();
    let options = RunOptions {
        shuffle: run.shuffle,
        store: run.keep.store()?,
        ..running::options(run.leave.workers, &cancelled)?
    };
    let (run, global) = (run.clone(), global.clone());
    let mut watch = Watch { run, global, options, session: Session::default(), n_runs: 0, results: None };
    // The output shows each run.
    match running::watch(Progress::hidden(), cancelled, move |_| watch.watch())? {
        Ran::Ended(exit) => Ok(exit),
        Ran::Left => Ok(Exit::Interrupted),
    }
}

impl Watch {
    fn watch(&mut self) -> Result<Exit> {
        if !self.run.graph.graph.exists() {
            // Waits for a file to be fixed, but not for one with a misspelt name.
            return Err(UsageError(format!("there is no graph file {}", self.run.graph.graph.display())).into());
        }
        let mut seen = Instant::now();
        loop {
            // Taken before the files are read: later saves count as changes.
            let graph = &self.run.graph;
            let graph = Stamps::of(files(&graph.graph, &graph.sets, graph.plugins.kinds_apart()?));
            let stamps = match self.look(seen)? {
                Looked::Files(files) => graph.and(&files),
                Looked::Interrupted => return Ok(Exit::Interrupted),
            };
            match stamps.wait(&|| self.options.cancelled.load(Ordering::Relaxed)) {
                Some(change) => seen = change,
                None => return Ok(Exit::Done),
            }
        }
    }

    /// Checks the graph, and runs what has changed.
    fn look(&mut self, seen: Instant) -> Result<Looked> {
        let kinds = self.run.graph.plugins.kinds_apart()?;
        let (path, sets) = (&self.run.graph.graph, &self.run.graph.sets);
        let Checked { plan, warnings, registry, .. } = match check(path, sets, &kinds) {
            Ok(checked) => checked,
            Err(faults) => {
                match self.global.format {
                    Format::Text => graph_args::print_faults(&faults, &self.global)?,
                    Format::Json => print_line(&graph_args::as_json(&faults))?,
                }
                // A missing file may be created.
                let text = fs::read_to_string(path).unwrap_or_default();
                let files = check_recorded(&text, path, sets, &kinds).map(|checked| Stamps::of_plan(&checked.plan));
                return Ok(Looked::Files(files.unwrap_or_default()));
            }
        };
        graph_args::warn(&warnings, &self.global)?;
        let next = self.session.next(plan);
        let files = next.files().clone();
        if let Some(node) = next.live_source() {
            let message =
                format!("node \"{node}\" is a live source, whose items cannot be repeated; watch a recording of it");
            return self.refuse(message).map(|()| Looked::Files(files));
        }
        if next.is_unchanged() {
            self.print_unchanged()?;
            return Ok(Looked::Files(files));
        }
        let dir = self.run.leave.folder(next.plan(), self.n_runs)?;
        let what = RerunNotice::of(&next, self.n_runs > 0);
        if self.global.format == Format::Text && !self.global.quiet {
            what.print_changes()?;
        }
        let options = RunOptions {
            out_dir: Some(dir.to_path_buf()),
            record: !self.run.no_record,
            latency: !self.run.no_record || self.global.verbose > 0,
            ..self.options.clone()
        };
        let progress = match self.n_runs {
            0 => Progress::of_run(next.plan(), options.workers, &self.global),
            _ => {
                let (computed, nodes) = (what.computed.len(), what.computed.len() + what.kept.len());
                let message = format!("running {}: {computed} of {nodes} nodes", next.plan().name);
                Progress::begin(&message, Some(nodes), &self.global)
            }
        };
        let plan_results: Vec<_> = next.plan().results.iter().map(|entry| entry.key.clone()).collect();
        let ran = self.session.run(next, &registry, &options, &progress);
        progress.end();
        let report = match ran {
            Ok(report) => report,
            Err(error @ RunError::Build(_)) => {
                dir.remove_if_empty();
                return self.refuse(error.to_string()).map(|()| Looked::Files(files));
            }
            Err(error) => return Err(run_error(error)),
        };
        self.n_runs += 1;
        self.print_end(report, &what, &plan_results, &dir, seen)
            .map(|exit| if exit == Exit::Interrupted { Looked::Interrupted } else { Looked::Files(files) })
    }

    /// Prints the faults of a graph; a later save may fix them. In the first look they are faults of the command line.
    fn refuse(&self, message: String) -> Result<()> {
        if self.n_runs == 0 {
            return Err(UsageError(message).into());
        }
        match self.global.format {
            Format::Text => writeln!(terminal::stderr(), "{}: {message}", self.global.paint_err("error", "1;31"))?,
            Format::Json => {
                print_line(&json!({ "outcome": Exit::Usage.to_json(), "faults": [{ "message": message }] }))?
            }
        }
        Ok(())
    }

    fn print_unchanged(&self) -> Result<()> {
        match self.global.format {
            Format::Text if self.global.quiet => {}
            Format::Text => writeln!(terminal::stderr(), "no node has changed; nothing was run")?,
            Format::Json => {
                let mut outcome = Exit::Done.to_json();
                outcome["watch"] = json!({ "computed": [] });
                print_line(&json!({ "outcome": outcome }))?;
            }
        }
        Ok(())
    }

    fn print_end(
        &mut self,
        mut report: RunReport,
        what: &RerunNotice,
        keys: &[String],
        dir: &Path,
        seen: Instant,
    ) -> Result<Exit> {
        // Warnings of cached nodes were printed when they ran.
        report.warnings.retain(|warning| what.computed.contains(&warning.node));
        let exit = run_end::print_warnings_and_failure(&report, &self.global)?;
        let complete = report.outcome == Outcome::Complete;
        let earlier = self.results.as_ref().filter(|_| complete);
        let differ: Option<Vec<_>> = earlier.map(|earlier| {
            keys.iter().filter(|key| at(earlier, key) != at(&report.results, key)).map(String::as_str).collect()
        });
        match self.global.format {
            Format::Json => {
                let mut all = run_end::with_outcome(&report, exit, dir);
                all["outcome"]["watch"] = json!({
                    "changes": what.changes,
                    "removed": what.removed,
                    "computed": what.computed,
                    "kept": what.kept,
                    "differ": differ,
                    "elapsed_s": seen.elapsed().as_secs_f64(),
                    "kept_bytes": self.session.n_bytes(),
                });
                print_line(&all)?;
            }
            Format::Text => {
                let table = match earlier {
                    Some(earlier) => result_table::text_beside(&report.results, earlier, &self.global),
                    None => result_table::text(&report.results, &self.global),
                };
                run_end::print_text(&report, &table, dir, &self.global)?;
                let mut out = terminal::stdout().lock();
                match differ.as_deref() {
                    Some([]) => writeln!(out, "no result differs from the previous run")?,
                    Some(keys) => writeln!(out, "changed since the previous run: {}", keys.join(", "))?,
                    None => {}
                }
                let (computed, nodes) = (what.computed.len(), what.computed.len() + what.kept.len());
                let seconds = seen.elapsed().as_secs_f64();
                writeln!(out, "{computed} of {nodes} nodes computed, {seconds:.2} s after the change was seen\n")?;
                if self.n_runs == 1 && !self.global.quiet {
                    let mb = self.session.n_bytes() as f64 / 1e6;
                    writeln!(
                        terminal::stderr(),
                        "watching {}, {mb:.1} MB kept; Ctrl-C ends it",
                        self.run.graph.graph.display()
                    )?;
                }
            }
        }
        if complete {
            self.results = Some(report.results);
        }
        Ok(exit)
    }
}

/// An observer that collects the announcements of a run.
struct RerunNotice {
    changes: Vec<String>,
    removed: Vec<String>,
    computed: Vec<String>,
    kept: Vec<String>,
}

impl RerunNotice {
    fn of(next: &Next, again: bool) -> Self {
        let names = |names: Vec<&str>| names.into_iter().map(str::to_owned).collect();
        let changes = next.changes().iter().map(|change| format!("{}: {}", change.node, change.why.join(", ")));
        let mut changes: Vec<_> = changes.collect();
        if again && changes.is_empty() && next.removed().is_empty() {
            changes.push("graph: only which items are recorded or reported".into());
        }
        Self { changes, removed: next.removed().to_vec(), computed: names(next.computed()), kept: names(next.kept()) }
    }

    fn print_changes(&self) -> Result<()> {
        let mut err = terminal::stderr().lock();
        for change in &self.changes {
            writeln!(err, "{change}")?;
        }
        for node in &self.removed {
            writeln!(err, "{node}: removed")?;
        }
        Ok(())
    }
}

/// The value at a dotted key.
fn at<'a>(results: &'a Value, key: &str) -> Option<&'a Value> {
    key.split('.').try_fold(results, |value, key| value.get(key))
}

/// Prints one JSON value on one line.
fn print_line(value: &Value) -> Result<()> {
    writeln!(terminal::stdout(), "{value}").map_err(|error| anyhow!("stdout cannot be written: {error}"))
}
