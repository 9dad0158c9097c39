use super::common::{
    Exit, Format, Global,
    graph_args::or_faults,
    print_json,
    progress::{Progress, SweepProgress},
    run_end, running, summary_table, terminal,
};
use crate::app::{
    ArchiveArgs, OneRun, SweepRequest, run_error,
    sweep::{check_new, folder_error, merge, summary},
};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::{
    run::{RunOptions, run},
    sweep::{Folder, RUNS_DIR, SweepCounts, SweepRow},
};
use serde_json::{Value, json};
use std::{
    io::Write,
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

/// Run a graph many times with different settings: those of its section [sweep]; the results are written as tables.
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
  osteoflow sweep graphs/paper/sensitivity.toml --out S --resume --retry-failed      runs that failed too
  osteoflow sweep G.toml --shard 2/8 --out S2                    the second of eight machines, or of a job array:
  osteoflow sweep --merge S1 S2 S3 S4 S5 S6 S7 S8 --out S
  osteoflow sweep graphs/paper/sensitivity.toml --set sweep.repeat=20 --out S --resume      ten more repeats
  osteoflow sweep S --only 152 --record R                        one of its runs again, recorded: then report R, replay R
  osteoflow sweep G.toml --only 3,7-9 --record R                 before the sweep; R/000003, R/000007 ...

In a graph file:
  [sweep]
  repeat = 10                                         seeds graph.seed, +1, +2 ...
  [sweep.factor]
  icp = { key = \"icp.kind\", values = [\"icp.point_to_point\", \"icp.point_to_plane\"] }
  scan = { key = \"scan.path\", files = \"scans/*.ply\" }    every file of a folder
  method = { variants = \"variants/*.toml\" }            files of changes, merged as by extends
  [sweep.columns]
  tre_mm = \"metrics.tre_true_mm.mean_abs.norm\"        path in results.json
All keys: docs/use/sweeps.md")]
pub(crate) struct Sweep {
    #[command(flatten)]
    request: SweepRequest,

    #[command(flatten)]
    archive: ArchiveArgs,

    /// Combine the runs of shards in the folder of --out.
    #[arg(long, value_name = "DIR", num_args = 1.., requires = "out", conflicts_with_all = ["graph", "shard", "resume"])]
    merge: Vec<PathBuf>,

    /// List the runs, or those of --shard, with the keys that each sets; run nothing.
    #[arg(long)]
    dry_run: bool,
}

impl Sweep {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let mut request = self.request.clone();
        if let (None, Some(out)) = (&request.graph, &request.out) {
            let folder = merge(&self.merge, out)?;
            for part in folder.about["merged"].as_array().into_iter().flatten() {
                let (dir, otherwise) = (part["dir"].as_str().unwrap_or_default(), part["otherwise"].as_array());
                for what in otherwise.into_iter().flatten().filter_map(Value::as_str) {
                    global.say("warning", format!("the runs of {dir} were made otherwise: {what}"))?;
                }
            }
            let swept = SweepCounts { n_before: folder.n_runs(), ..SweepCounts::default() };
            return print_end(&folder, &swept, Duration::ZERO, global);
        }
        // Checking all runs may take seconds.
        if let (Some(dir), false, false) = (&request.out, request.resume, self.dry_run) {
            check_new(dir)?;
        }
        #[allow(clippy::disallowed_methods, reason = "nothing is written yet, and a check cannot be cancelled")]
        running::on_interrupt(|| {
            let _ = writeln!(
                std::io::stderr(),
                "interrupted: before the first run; start it again, with --resume if its folder is there already"
            );
            std::process::exit(Exit::Interrupted.code().into());
        })?;
        // Before the plugins are looked at, which starts interpreters.
        let began = Instant::now();
        let opened =
            request.graph.as_deref().map(|graph| self.archive.open(graph, &mut request.plugins)).transpose()?;
        if let Some((graph, spec)) = opened.flatten() {
            (request.graph, request.spec) = (Some(graph), spec);
        }
        let cancelled = Arc::default();
        running::make_pool(request.workers)?;
        if !request.only.is_empty() {
            return self.execute_only(request, global);
        }
        let sweep = or_faults(request.check(), |sweep| &sweep.warnings, global)?;
        let Some(sweep) = sweep else { return Ok(Exit::Usage) };
        if self.dry_run {
            let hash = json!({ "hash": sweep.hash().to_string() });
            return list(hash, sweep.part(request.shard), global);
        }
        let run = Arc::new(request.begin(sweep, &cancelled)?);
        let shard = request.shard.map_or_else(String::new, |shard| format!(", part {shard}"));
        let what = format!("sweeping {}{shard}", run.sweep.plan.name);
        let bar = SweepProgress::begin(run.n_left()?, &what, run.options.workers, global);
        let (of_thread, n_left) = (run.clone(), run.n_left()?);
        let ran = running::watch(Progress::hidden(), cancelled, move |_| {
            let swept = of_thread.make(&bar)?;
            bar.end();
            Ok(swept)
        })?;
        let Some(swept) = ran else {
            let (n_left, dir) = (run.n_left().unwrap_or(n_left), run.folder.dir().display());
            let message = format!("{n_left} runs are missing; continue with --out {dir} --resume");
            global.say("interrupted", message)?;
            return Ok(Exit::Interrupted);
        };
        print_end(&run.folder, &swept, began.elapsed(), global)
    }

    /// Runs the runs of --only, each recorded in a folder of its own; the exit code is that of the first without results.
    fn execute_only(&self, request: SweepRequest, global: &Global) -> Result<Exit> {
        let Some(runs) = or_faults(request.only(), |_| &[], global)? else { return Ok(Exit::Usage) };
        if self.dry_run {
            let rows: Vec<_> = runs.iter().map(|run| run.row.clone()).collect();
            return list(json!({}), rows.iter(), global);
        }
        let cancelled = Arc::default();
        let options = request.options_of_only(&cancelled)?;
        let progress = match &runs[..] {
            [run] => Progress::of_run(&run.plan, options.workers, global),
            _ => Progress::hidden(),
        };
        let of_runs = global.clone();
        let ran = running::watch(progress, cancelled, move |progress| {
            let mut exits = Vec::new();
            for one in &runs {
                let exit = run_alone(one, &request, runs.len() == 1, &options, progress, &of_runs)?;
                exits.push(exit);
                if exit == Exit::Interrupted {
                    break;
                }
            }
            Ok(exits.into_iter().find(|exit| *exit != Exit::Done).unwrap_or(Exit::Done))
        })?;
        Ok(ran.unwrap_or(Exit::Interrupted))
    }
}

/// Runs one run of a sweep, and says whether its results are those of the sweep.
fn run_alone(
    one: &OneRun,
    request: &SweepRequest,
    is_alone: bool,
    options: &RunOptions,
    progress: &Progress,
    global: &Global,
) -> Result<Exit> {
    let dir = request.folder_of(one, is_alone)?;
    let mut options = RunOptions { out_dir: Some(dir.to_path_buf()), ..options.clone() };
    options.command["sweep_run"] = one.row.run.into();
    let report = run(&one.plan, &one.registry, &options, progress).map_err(run_error)?;
    progress.end();
    let exit = run_end::print_end(&report, &dir, global)?;
    let (Some(stored), Some(sweep)) = (&one.stored, &request.graph) else { return Ok(exit) };
    let is_equal = stored.gave(&report.results);
    if !is_equal && exit != Exit::Interrupted {
        let (number, sweep) = (one.row.run, sweep.display());
        let why = "an input file, a plugin or the program is another since, or a setting";
        let message =
            format!("run {number} has other results in {sweep}: {why}; compare manifest.json with {sweep}/sweep.json");
        global.say("warning", message)?;
    }
    Ok(exit)
}

fn list<'r>(mut about: Value, rows: impl Iterator<Item = &'r SweepRow>, global: &Global) -> Result<Exit> {
    if global.format == Format::Json {
        let runs = rows.map(|row| {
            let values: serde_json::Map<_, _> = row.values.iter().cloned().collect();
            json!({ "run": row.run, "seed": row.seed, "values": values, "set": row.sets })
        });
        about["runs"] = runs.collect();
        print_json(&about)?;
        return Ok(Exit::Done);
    }
    let mut out = terminal::stdout().lock();
    for row in rows {
        writeln!(out, "run {}: {}", row.run, row.sets.join(" "))?;
    }
    Ok(Exit::Done)
}

/// Writes the tables, and prints how the sweep ended.
fn print_end(folder: &Folder, swept: &SweepCounts, took: Duration, global: &Global) -> Result<Exit> {
    let summary = summary(folder)?;
    let (dir, n_here) = (folder.dir().display(), swept.n_before + swept.n_run);
    let n_without = summary["n_without_results"].as_u64().unwrap_or_default();
    let nothing = n_without > 0 && summary["n_runs"] == n_without;
    let n_failed = summary["incomplete"]["n_failed"].as_u64().unwrap_or_default();
    let exit = match (swept.n_missing, n_failed, nothing) {
        (1.., ..) => Exit::Interrupted,
        (0, 1.., _) => Exit::Incomplete,
        (0, 0, true) => Exit::Refused,
        (0, 0, false) => Exit::Done,
    };
    if n_failed > 0 {
        let first = summary["incomplete"]["first"].as_str().unwrap_or_default();
        let again = format!("run them again with --out {dir} --resume --retry-failed");
        global.say("incomplete", format!("{n_failed} runs failed; {first}; {again}"))?;
    }
    if let (true, Some(first)) = (nothing, folder.done().map_err(folder_error)?.next()) {
        let first = first.map_err(folder_error)?;
        let reason = first.reason.as_deref().unwrap_or("no reason given");
        global.say("refused", format!("none of {n_without} runs has results; run {}: {reason}", first.run))?;
    }
    if !global.quiet {
        for note in summary["notes"].as_array().into_iter().flatten().filter_map(Value::as_str) {
            global.say("warning", format!("{note}; look into {dir}/{RUNS_DIR}"))?;
        }
    }
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
        let message = format!("{} runs are missing; continue with --out {dir} --resume", swept.n_missing);
        global.say("interrupted", message)?;
    }
    let mut out = terminal::stdout().lock();
    writeln!(out, "{}", summary_table::text(&summary, global))?;
    if n_without > 0 {
        writeln!(out, "{n_without} of {n_here} runs have no results; runs.csv says why")?;
    }
    if global.verbose > 0 {
        writeln!(out, "{} nodes computed, {} taken from other runs", swept.n_computed, swept.n_shared)?;
    }
    writeln!(out, "{n_here} runs in {dir} after {:.2} s", took.as_secs_f64())?;
    Ok(exit)
}
