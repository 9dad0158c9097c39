use super::common::{
    exit::{Exit, UsageError},
    folder_lock::HOLDER,
    global::{Format, Global},
    graph_args,
    out_dir::{self, OutDir},
    plugins::PluginArgs,
    progress::Progress,
    result_table::NOTICE,
    run_args::Keep,
    running, summary_table,
    terminal::{self, print_json},
};
use anyhow::Result;
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use osteoflow_engine::sweep::{
    self, Done, Folder, FolderError, RUNS_DIR, Shard, Sweep as Checked, SweepCounts, SweepOptions, Watcher,
};
use serde_json::{Value, json};
use std::{
    fs,
    io::{IsTerminal, Write},
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicBool},
    time::{Duration, Instant},
};

/// Run a graph many times as its table [sweep] says, and write tables of the results.
///
/// Writes runs.csv (one row per run), points.csv (one row per run, point and axis), summary.json, and the results of each
/// run. A run that fails is a row with its reason. An interrupted sweep continues with --resume.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow sweep graphs/paper/sensitivity.toml
  osteoflow sweep graphs/paper/sensitivity.toml --set sweep.repeat=20 --set recording.camera.depth_noise_mm=0.0
  osteoflow sweep graphs/paper/sensitivity.toml --out S          stopped half-way, by kill -9 or a power cut:
  osteoflow sweep graphs/paper/sensitivity.toml --out S --resume
  osteoflow sweep G.toml --shard 2/8 --out S2                    the second of eight machines, or of a job array:
  osteoflow sweep --merge S1 S2 S3 S4 S5 S6 S7 S8 --out S

In a graph file:
  [sweep]
  repeat = 10                                         seeds graph.seed, +1, +2 ...
  [sweep.factor]
  icp = { key = \"icp.kind\", values = [\"icp.point_to_point\", \"icp.point_to_plane\"] }
  [sweep.columns]
  tre_mm = \"metrics.tre_true_mm.mean_abs.norm\"        path in results.json
All keys: docs/use/sweeps.md")]
pub(crate) struct Sweep {
    /// The graph file, with a table [sweep].
    #[arg(required_unless_present = "merge")]
    graph: Option<PathBuf>,

    /// Change any key of the graph in all runs, also of [sweep]: sweep.repeat=20; may be given again. Refused for a key that a
    /// factor or a draw sets; change the factor instead: sweep.factor.NAME.values=[..].
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    #[command(flatten)]
    plugins: PluginArgs,

    /// The folder to write the files into; refused if not empty. Default: a new one under runs/.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Resume the sweep in --out: finished runs stay. Refused if graph, inputs, plugins or the program have changed.
    #[arg(long, requires = "out")]
    resume: bool,

    /// Run the K-th of N parts of the sweep, from 1; --merge combines them.
    #[arg(long, value_name = "K/N", value_parser = shard)]
    shard: Option<Shard>,

    /// Combine the runs of shards in the folder of --out.
    #[arg(long, value_name = "DIR", num_args = 1.., requires = "out", conflicts_with_all = ["graph", "shard", "resume"])]
    merge: Vec<PathBuf>,

    /// Number of runs at a time; the tables do not depend on it. Default: the number of cores.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,

    /// List the runs, or those of --shard, with the keys that each sets; run nothing.
    #[arg(long)]
    dry_run: bool,

    /// Compute what several runs have in common in each of them, instead of once for all. The tables are the same.
    #[arg(long)]
    no_share: bool,

    #[command(flatten)]
    keep: Keep,
}

fn shard(text: &str) -> Result<Shard, String> {
    let parts = text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((index, of)) if 1 <= index && index <= of => Ok(Shard { index, of }),
        _ => Err("a shard must be K/N with K from 1 to N, such as 2/8".into()),
    }
}

impl Sweep {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        match &self.graph {
            None => self.merged(global),
            Some(graph) => self.swept(graph, global),
        }
    }

    fn merged(&self, global: &Global) -> Result<Exit> {
        let folder = self.merged_folder()?;
        let swept = SweepCounts { n_before: folder.n_runs(), ..SweepCounts::default() };
        print_end(&folder, &swept, Duration::ZERO, global)
    }

    fn swept(&self, graph: &Path, global: &Global) -> Result<Exit> {
        let cancelled = Arc::default();
        let workers = running::options(self.workers, &cancelled)?.workers;
        let sweep = match sweep::check(graph, &self.sets, self.plugins.kinds_apart()?, workers) {
            Ok(sweep) => sweep,
            Err(faults) => {
                graph_args::print_faults(&faults, global)?;
                return Ok(Exit::Usage);
            }
        };
        graph_args::warn(&sweep.warnings, global)?;
        if self.dry_run {
            return list(&sweep, self.shard, global);
        }
        let options = self.options(&cancelled)?;
        let folder = self.folder(&sweep, &options)?;
        let began = Instant::now();
        let bar = Bar::begin(&sweep, &folder, &options, global)?;
        let of_thread = folder.clone();
        let ran = running::watch(Progress::hidden(), cancelled, move |_| {
            let swept = sweep.run(&of_thread, &options, &bar)?;
            bar.end();
            Ok(swept)
        })?;
        match ran {
            running::Ran::Ended(swept) => print_end(&folder, &swept, began.elapsed(), global),
            running::Ran::Left => Ok(Exit::Interrupted),
        }
    }
}

impl Sweep {
    /// The graph and the settings for all runs.
    pub(crate) fn graph(&self) -> Option<(&Path, &[String])> {
        Some((self.graph.as_deref()?, &self.sets))
    }

    /// The folder of all shards.
    pub(crate) fn merged_folder(&self) -> Result<Folder> {
        let shards =
            self.merge.iter().map(|dir| Folder::open(dir)).collect::<Result<Vec<_>, _>>().map_err(folder_error)?;
        sweep::merge(&shards, &new_dir(self.out.as_deref(), "")?).map_err(folder_error)
    }

    pub(crate) fn kinds(&self) -> Result<osteoflow_engine::plugin::Kinds> {
        self.plugins.kinds_apart()
    }

    /// How many runs at a time, which store, and which part.
    pub(crate) fn options(&self, cancelled: &Arc<AtomicBool>) -> Result<SweepOptions> {
        let run = running::options_alone(self.workers, cancelled);
        let run = osteoflow_engine::RunOptions { store: self.keep.store()?, ..run };
        Ok(SweepOptions { workers: run.workers, run, share: !self.no_share, shard: self.shard })
    }

    /// The new folder of a sweep, or the one to resume.
    pub(crate) fn folder(&self, sweep: &Checked, options: &SweepOptions) -> Result<Folder> {
        match (&self.out, self.resume) {
            (Some(dir), true) => sweep.resume(dir, self.shard).map_err(folder_error),
            (dir, _) => sweep.begin(&new_dir(dir.as_deref(), &sweep.plan.name)?, options).map_err(folder_error),
        }
    }
}

/// Converts an error: a wrong folder is a fault of the command line.
pub(crate) fn folder_error(error: FolderError) -> anyhow::Error {
    match error {
        FolderError::NoSweep { .. }
        | FolderError::Other { .. }
        | FolderError::Part { .. }
        | FolderError::Missing { .. } => UsageError(error.to_string()).into(),
        other => other.into(),
    }
}

/// Creates the folder, or takes an empty one; for a folder with a sweep the error suggests --resume.
pub(crate) fn new_dir(asked: Option<&Path>, graph: &str) -> Result<OutDir> {
    if let Some(dir) = asked.filter(|dir| dir.join(sweep::DESIGN).is_file()) {
        let dir = dir.display();
        let message = format!("{dir} holds a sweep already; continue it with --resume, or name another folder");
        return Err(UsageError(message).into());
    }
    if let Some(dir) = asked.filter(|dir| {
        fs::read_dir(dir)
            .is_ok_and(|mut entries| entries.any(|entry| entry.is_ok_and(|entry| entry.file_name() != HOLDER)))
    }) {
        return Err(UsageError(format!("{} is not empty; name another folder", dir.display())).into());
    }
    out_dir::make(asked, graph, false)
}

/// Progress of a sweep and its remaining time.
pub(crate) struct Bar(ProgressBar);

impl Bar {
    pub(crate) fn begin(sweep: &Checked, folder: &Folder, options: &SweepOptions, global: &Global) -> Result<Self> {
        let there = folder.runs().map_err(folder_error)?.len();
        let n = sweep.part(options.shard).count();
        let shard = options.shard.map_or_else(String::new, |shard| format!(", part {shard}"));
        let what = format!("sweeping {}{shard}", sweep.plan.name);
        Self::of(n.saturating_sub(there), &what, options.workers, global)
    }

    /// Begins to show the progress of `n_runs` runs.
    pub(crate) fn of(n_runs: usize, what: &str, workers: usize, global: &Global) -> Result<Self> {
        let shown = !global.quiet && global.format == Format::Text;
        let terminal = std::io::stderr().is_terminal();
        if shown && !terminal {
            writeln!(terminal::stderr(), "{what}: {n_runs} runs, {workers} at a time")?;
        }
        let target = if shown && terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(n_runs as u64), target);
        let style =
            ProgressStyle::with_template("{spinner} {bar:24} {pos}/{len} runs  {elapsed} gone, {eta} left  {msg}");
        bar.set_style(style.expect("the template is fixed").progress_chars("=> "));
        if shown && terminal {
            bar.enable_steady_tick(Duration::from_millis(120));
        }
        Ok(Self(bar))
    }

    /// Shows the current step.
    pub(crate) fn message(&self, what: &str) {
        self.0.set_message(terminal::escape(what));
    }

    /// Counts runs that have ended on other machines.
    pub(crate) fn ended_elsewhere(&self, n_runs: usize) {
        self.0.inc(n_runs as u64);
    }

    /// Removes the line.
    pub(crate) fn end(&self) {
        self.0.finish_and_clear();
    }
}

impl Watcher for Bar {
    fn ended(&self, done: &Done) {
        if let Some(reason) = &done.reason {
            self.0.set_message(terminal::escape(&format!("run {}: {reason}", done.run)));
        }
        self.0.inc(1);
    }
}

fn list(sweep: &Checked, shard: Option<Shard>, global: &Global) -> Result<Exit> {
    if global.format == Format::Json {
        let runs = sweep.part(shard).map(|row| {
            let values: serde_json::Map<_, _> = row.values.iter().cloned().collect();
            json!({ "run": row.run, "seed": row.seed, "values": values, "set": row.sets })
        });
        print_json(&json!({ "hash": sweep.hash().to_string(), "runs": runs.collect::<Vec<_>>() }))?;
        return Ok(Exit::Done);
    }
    let mut out = terminal::stdout().lock();
    for row in sweep.part(shard) {
        writeln!(out, "run {}: {}", row.run, row.sets.join(" "))?;
    }
    Ok(Exit::Done)
}

/// Writes the tables and returns the summary.
pub(crate) fn summary(folder: &Folder) -> Result<Value> {
    Ok(osteoflow_report::summary::write(folder, NOTICE)?)
}

/// Writes the tables, and prints how the sweep ended.
fn print_end(folder: &Folder, swept: &SweepCounts, took: Duration, global: &Global) -> Result<Exit> {
    let summary = summary(folder)?;
    let (dir, n_here) = (folder.dir().display(), swept.n_before + swept.n_run);
    let n_without = summary["n_without_results"].as_u64().unwrap_or_default();
    let nothing = n_without > 0 && summary["n_runs"] == n_without;
    let exit = match (swept.n_missing, nothing) {
        (1.., _) => Exit::Interrupted,
        (0, true) => Exit::Refused,
        (0, false) => Exit::Done,
    };
    let mut err = terminal::stderr().lock();
    if let (true, Some(first)) = (nothing, folder.done().map_err(folder_error)?.next()) {
        let (first, word) = (first.map_err(folder_error)?, global.paint_err("refused", "1;31"));
        let reason = first.reason.as_deref().unwrap_or("no reason given");
        writeln!(err, "{word}: none of {n_without} runs has results; run {}: {reason}", first.run)?;
    }
    if !global.quiet {
        let word = global.paint_err("warning", "1;33");
        for note in summary["notes"].as_array().into_iter().flatten().filter_map(Value::as_str) {
            writeln!(err, "{word}: {note}; look into {dir}/{RUNS_DIR}")?;
        }
    }
    drop(err);
    if global.format == Format::Json {
        let mut outcome = exit.to_json();
        outcome["out_dir"] = dir.to_string().into();
        let runs = json!({
            "there_before": swept.n_before, "run": swept.n_run, "without_results": n_without,
            "missing": swept.n_missing, "nodes_computed": swept.n_computed, "nodes_shared": swept.n_shared,
        });
        print_json(&json!({ "outcome": outcome, "runs": runs, "summary": summary }))?;
        return Ok(exit);
    }
    if swept.n_missing > 0 && !global.quiet {
        let word = global.paint_err("interrupted", "1;33");
        writeln!(
            terminal::stderr(),
            "{word}: {} runs are missing; continue with --out {dir} --resume",
            swept.n_missing
        )?;
    }
    let mut out = terminal::stdout().lock();
    writeln!(out, "{}", summary_table::text(&summary))?;
    if n_without > 0 {
        writeln!(out, "{n_without} of {n_here} runs have no results; runs.csv says why")?;
    }
    if global.verbose > 0 {
        writeln!(out, "{} nodes computed, {} taken from other runs", swept.n_computed, swept.n_shared)?;
    }
    writeln!(out, "{n_here} runs in {dir} after {:.2} s", took.as_secs_f64())?;
    Ok(exit)
}
