//! `run --watch`: runs the graph again whenever one of its files has changed.

use super::Run;
use crate::app::{GraphArgs, UsageError, run_error};
use crate::commands::common::{
    Exit, Format, Global, graph_args,
    progress::Progress,
    rerun::{Rerun, Runs, Turn, rerun},
    result_table, run_end, running, terminal,
};
use anyhow::{Result, anyhow};
use osteoflow_engine::{
    Checked, Faults,
    run::{Outcome, RunError, RunOptions, RunReport},
    watch::{Next, Session},
};
use serde_json::{Value, json};
use std::{io::Write, path::Path, sync::Arc, time::Instant};

/// A graph whose unchanged nodes keep their items from run to run.
struct Watch {
    graph: GraphArgs,
    runs: Runs,
    session: Session,
    /// The results of the last run that had any.
    results: Option<Value>,
}

/// Runs until the user ends it.
pub(super) fn execute(run: &Run, global: &Global) -> Result<Exit> {
    let (request, cancelled) = (&run.request, Arc::default());
    let options = RunOptions {
        record: !request.no_record,
        latency: !request.no_record || global.verbose > 0,
        shuffle: run.shuffle,
        store: request.keep.store()?,
        ..running::options(request.leave.workers, &cancelled)?
    };
    let graph = request.graph.clone();
    if !graph.graph.exists() {
        // Waits for a file to be fixed, but not for one with a misspelt name.
        usage!("there is no graph file {}", graph.graph.display());
    }
    let runs = Runs { options, global: global.clone(), leave: request.leave.clone(), n: 0 };
    let mut watch = Watch { graph, runs, session: Session::default(), results: None };
    let until = Arc::clone(&cancelled);
    // The output shows each run.
    let exit = running::watch(Progress::hidden(), cancelled, move |_| rerun(&mut watch, &until))?;
    Ok(exit.unwrap_or(Exit::Interrupted))
}

impl Rerun for Watch {
    fn graph(&self) -> GraphArgs {
        self.graph.clone()
    }

    fn show_faults(&mut self, faults: &Faults) -> Result<Option<Exit>> {
        match self.runs.global.format {
            Format::Text => graph_args::print_faults(faults, &self.runs.global)?,
            Format::Json => print_line(&graph_args::as_json(faults))?,
        }
        Ok(None)
    }

    fn run(&mut self, checked: Checked, seen: Instant) -> Result<Turn> {
        let Checked { plan, warnings, registry, .. } = checked;
        let (n_before, global) = (self.runs.n, self.runs.global.clone());
        graph_args::warn(&warnings, &global)?;
        let next = self.session.next(plan);
        let files = next.files.clone();
        if let Some(node) = next.live_source() {
            let message =
                format!("node \"{node}\" is a live source, whose items cannot be repeated; watch a recording of it");
            return self.refuse(message).map(|()| Turn::Wait(files));
        }
        if next.is_unchanged {
            return self.print_unchanged().map(|()| Turn::Wait(files));
        }
        let dir = self.runs.folder(&next.plan)?;
        let what = RerunNotice::of(&next, n_before > 0);
        if global.format == Format::Text && !global.quiet {
            what.print_changes()?;
        }
        let options = self.runs.options.clone();
        let progress = match n_before {
            0 => Progress::of_run(&next.plan, options.workers, &global),
            _ => {
                let (computed, nodes) = (what.computed.len(), what.computed.len() + what.kept.len());
                let message = format!("running {}: {computed} of {nodes} nodes", next.plan.name);
                Progress::begin(&message, Some(nodes), &global)
            }
        };
        let keys: Vec<_> = next.plan.results.iter().map(|entry| entry.key.clone()).collect();
        let session = &mut self.session;
        let run = |options: &RunOptions| session.run(next, &registry, options, &progress);
        match self.runs.run(dir, options, &progress, run) {
            Ok((report, dir)) => match self.print_end(report, &what, &keys, &dir, seen)? {
                Exit::Interrupted => Ok(Turn::End(Exit::Interrupted)),
                _ => Ok(Turn::Wait(files)),
            },
            Err(error @ RunError::Build(_)) => self.refuse(error.to_string()).map(|()| Turn::Wait(files)),
            Err(error) => Err(run_error(error)),
        }
    }
}

impl Watch {
    /// Prints the faults of a graph; a later save may fix them. In the first look they are faults of the command line.
    fn refuse(&self, message: String) -> Result<()> {
        if self.runs.n == 0 {
            return Err(UsageError(message).into());
        }
        match self.runs.global.format {
            Format::Text => self.runs.global.say("error", message)?,
            Format::Json => {
                print_line(&json!({ "outcome": Exit::Usage.to_json(), "faults": [{ "message": message }] }))?
            }
        }
        Ok(())
    }

    fn print_unchanged(&self) -> Result<()> {
        match self.runs.global.format {
            Format::Text if self.runs.global.quiet => {}
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
        let exit = run_end::print_warnings_and_failure(&report, &self.runs.global)?;
        let complete = report.outcome == Outcome::Complete;
        let earlier = self.results.as_ref().filter(|_| complete);
        let differ: Option<Vec<_>> = earlier.map(|earlier| {
            keys.iter().filter(|key| at(earlier, key) != at(&report.results, key)).map(String::as_str).collect()
        });
        match self.runs.global.format {
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
                    Some(earlier) => result_table::text_beside(&report.results, earlier, &self.runs.global),
                    None => result_table::text(&report.results, &self.runs.global),
                };
                run_end::print_text(&report, &table, dir, &self.runs.global)?;
                let mut out = terminal::stdout().lock();
                match differ.as_deref() {
                    Some([]) => writeln!(out, "no result differs from the previous run")?,
                    Some(keys) => writeln!(out, "changed since the previous run: {}", keys.join(", "))?,
                    None => {}
                }
                let (computed, nodes) = (what.computed.len(), what.computed.len() + what.kept.len());
                let seconds = seen.elapsed().as_secs_f64();
                writeln!(out, "{computed} of {nodes} nodes computed, {seconds:.2} s after the change was seen\n")?;
                if self.runs.n == 1 && !self.runs.global.quiet {
                    let mb = self.session.n_bytes() as f64 / 1e6;
                    writeln!(
                        terminal::stderr(),
                        "watching {}, {mb:.1} MB kept; Ctrl-C ends it",
                        self.graph.graph.display()
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
        let changes = next.changes.iter().map(|change| format!("{}: {}", change.node, change.why.join(", ")));
        let mut changes: Vec<_> = changes.collect();
        if again && changes.is_empty() && next.removed.is_empty() {
            changes.push("graph: only which items are recorded or reported".into());
        }
        Self { changes, removed: next.removed.clone(), computed: names(next.computed()), kept: names(next.kept()) }
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
