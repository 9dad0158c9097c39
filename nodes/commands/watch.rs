//! `run --watch`: the graph is run again whenever one of its files has changed.

use super::{
    Exit, Format, Global, UsageError, graph_args, out_dir,
    progress::Progress,
    result_table,
    run::{self, Run},
    running::{self, Ran},
};
use anyhow::{Result, anyhow};
use osteoflow_engine::{
    Checked, check,
    check::files,
    check_recorded,
    plan::Plan,
    run::{Outcome, RunError, RunOptions, RunReport},
    watch::{Next, Session, Stamps},
};
use serde_json::{Value, json};
use std::{
    fs,
    io::Write,
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

/// A watch under way.
struct Watch {
    run: Run,
    global: Global,
    options: RunOptions,
    session: Session,
    /// How many runs there were.
    n_runs: usize,
    /// The results of the last run that had any.
    results: Option<Value>,
}

/// What became of a look at the graph.
enum Looked {
    /// The files that parameters name, as they were when they were read.
    Files(Stamps),
    /// The user has ended a run.
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
    // Each run shows itself.
    match running::watch(Progress::hidden(), cancelled, move |_| watch.watch())? {
        Ran::Ended(exit) => Ok(exit),
        Ran::Left => Ok(Exit::Interrupted),
    }
}

impl Watch {
    fn watch(&mut self) -> Result<Exit> {
        if !self.run.graph.graph.exists() {
            // A watch waits for a file to be mended, not for one that is misspelt.
            return Err(UsageError(format!("there is no graph file {}", self.run.graph.graph.display())).into());
        }
        let mut seen = Instant::now();
        loop {
            // Before they are read: what is saved from here on is seen as a change.
            let graph = &self.run.graph;
            let graph = Stamps::of(files(&graph.graph, &graph.sets, graph.plugins.kinds()?));
            let stamps = match self.look(seen)? {
                Looked::Files(files) => graph.and(&files),
                Looked::Interrupted => return Ok(Exit::Interrupted),
            };
            match stamps.wait(&self.options.cancelled) {
                Some(change) => seen = change,
                None => return Ok(Exit::Done),
            }
        }
    }

    /// Checks the graph, and runs what has changed.
    fn look(&mut self, seen: Instant) -> Result<Looked> {
        let kinds = self.run.graph.plugins.kinds()?;
        let (path, sets) = (&self.run.graph.graph, &self.run.graph.sets);
        let Checked { plan, warnings, registry, .. } = match check(path, sets, &kinds) {
            Ok(checked) => checked,
            Err(faults) => {
                match self.global.format {
                    Format::Text => graph_args::tell(&faults, &self.global)?,
                    Format::Json => print_line(&graph_args::as_json(&faults))?,
                }
                // A file that is missing may come.
                let text = fs::read_to_string(path).unwrap_or_default();
                let files = check_recorded(&text, path, sets, &kinds).map(|checked| Stamps::of_plan(&checked.plan));
                return Ok(Looked::Files(files.unwrap_or_default()));
            }
        };
        graph_args::warn(&warnings, &self.global)?;
        let next = self.session.next(plan);
        let files = next.files().clone();
        if let Some(node) = next.live_source() {
            let said =
                format!("node \"{node}\" is a live source, which gives its items only once; watch a recording of it");
            return self.refuse(said).map(|()| Looked::Files(files));
        }
        if next.is_nothing() {
            self.tell_nothing()?;
            return Ok(Looked::Files(files));
        }
        let dir = self.folder(next.plan())?;
        let what = Told::of(&next, self.n_runs > 0);
        if self.global.format == Format::Text && !self.global.quiet {
            what.say_changes()?;
        }
        let options = RunOptions {
            out_dir: Some(dir.clone()),
            record: !self.run.no_record,
            latency: !self.run.no_record || self.global.verbose > 0,
            ..self.options.clone()
        };
        let progress = match self.n_runs {
            0 => Progress::of_run(next.plan(), options.workers, &self.global),
            _ => {
                let (computed, nodes) = (what.computed.len(), what.computed.len() + what.kept.len());
                let said = format!("running {}: {computed} of {nodes} nodes", next.plan().name);
                Progress::begin(&said, Some(nodes), &self.global)
            }
        };
        let plan_results: Vec<_> = next.plan().results.iter().map(|entry| entry.key.clone()).collect();
        let ran = self.session.run(next, &registry, &options, &progress);
        progress.end();
        let report = match ran {
            Ok(report) => report,
            Err(error @ RunError::Build(_)) => {
                let _ = fs::remove_dir(&dir);
                return self.refuse(error.to_string()).map(|()| Looked::Files(files));
            }
            Err(error) => return Err(running::told(error)),
        };
        self.n_runs += 1;
        self.tell(report, &what, &plan_results, &dir, seen)
            .map(|exit| if exit == Exit::Interrupted { Looked::Interrupted } else { Looked::Files(files) })
    }

    /// The folder of the next run.
    fn folder(&self, plan: &Plan) -> Result<PathBuf> {
        let leave = &self.run.leave;
        let dir = match &leave.out {
            Some(first) if self.n_runs > 0 => out_dir::make_after(first)?,
            asked => out_dir::make(asked.as_deref(), &plan.name, leave.force)?,
        };
        let within = |file: &&PathBuf| match (dir.canonicalize(), file.canonicalize()) {
            (Ok(dir), Ok(file)) => dir.starts_with(file),
            _ => false,
        };
        if let Some(read) = plan.input_files.iter().find(within) {
            let (dir, read) = (dir.display(), read.display());
            let said = format!(
                "{dir} lies in {read}, which the graph reads, so that each run would begin the next; name another folder with --out"
            );
            return Err(UsageError(said).into());
        }
        Ok(dir)
    }

    /// What cannot be run as it is written; the next save may mend it. The first one is a fault of the command line.
    fn refuse(&self, said: String) -> Result<()> {
        if self.n_runs == 0 {
            return Err(UsageError(said).into());
        }
        match self.global.format {
            Format::Text => writeln!(std::io::stderr(), "{}: {said}", self.global.paint_err("error", "1;31"))?,
            Format::Json => print_line(&json!({ "outcome": Exit::Usage.to_json(), "faults": [{ "message": said }] }))?,
        }
        Ok(())
    }

    fn tell_nothing(&self) -> Result<()> {
        match self.global.format {
            Format::Text if self.global.quiet => {}
            Format::Text => writeln!(std::io::stderr(), "nothing that is computed has changed; nothing was run")?,
            Format::Json => {
                let mut outcome = Exit::Done.to_json();
                outcome["watch"] = json!({ "computed": [] });
                print_line(&json!({ "outcome": outcome }))?;
            }
        }
        Ok(())
    }

    fn tell(&mut self, mut report: RunReport, what: &Told, keys: &[String], dir: &Path, seen: Instant) -> Result<Exit> {
        // What kept nodes said was told when they ran.
        report.warnings.retain(|warning| what.computed.contains(&warning.node));
        let exit = run::tell_end(&report, &self.global)?;
        let complete = report.outcome == Outcome::Complete;
        let earlier = self.results.as_ref().filter(|_| complete);
        let differ: Option<Vec<_>> = earlier.map(|earlier| {
            keys.iter().filter(|key| at(earlier, key) != at(&report.results, key)).map(String::as_str).collect()
        });
        match self.global.format {
            Format::Json => {
                let mut all = run::with_outcome(&report, exit, dir);
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
                    Some(earlier) => result_table::text_beside(&report.results, earlier),
                    None => result_table::text(&report.results),
                };
                run::print_text(&report, &table, dir, &self.global)?;
                let mut out = std::io::stdout().lock();
                match differ.as_deref() {
                    Some([]) => writeln!(out, "no result differs from the run before")?,
                    Some(keys) => writeln!(out, "other than in the run before: {}", keys.join(", "))?,
                    None => {}
                }
                let (computed, nodes) = (what.computed.len(), what.computed.len() + what.kept.len());
                let seconds = seen.elapsed().as_secs_f64();
                writeln!(out, "{computed} of {nodes} nodes computed, {seconds:.2} s after the change was seen\n")?;
                if self.n_runs == 1 && !self.global.quiet {
                    let mb = self.session.n_bytes() as f64 / 1e6;
                    writeln!(
                        std::io::stderr(),
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

/// What is said of a run that is going to be.
struct Told {
    changes: Vec<String>,
    removed: Vec<String>,
    computed: Vec<String>,
    kept: Vec<String>,
}

impl Told {
    fn of(next: &Next, again: bool) -> Self {
        let names = |names: Vec<&str>| names.into_iter().map(str::to_owned).collect();
        let changes = next.changes().iter().map(|change| format!("{}: {}", change.node, change.why.join(", ")));
        let mut changes: Vec<_> = changes.collect();
        if again && changes.is_empty() && next.removed().is_empty() {
            changes.push("graph: only what is kept of a run".into());
        }
        Self { changes, removed: next.removed().to_vec(), computed: names(next.computed()), kept: names(next.kept()) }
    }

    fn say_changes(&self) -> Result<()> {
        let mut err = std::io::stderr().lock();
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

/// One JSON value on one line.
fn print_line(value: &Value) -> Result<()> {
    writeln!(std::io::stdout(), "{value}").map_err(|error| anyhow!("stdout takes nothing more: {error}"))
}
