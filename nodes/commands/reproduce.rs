use super::common::{
    Exit, Format, Global, graph_args,
    plugins::PluginArgs,
    print_json,
    progress::{Progress, SweepProgress},
    run_args::Keep,
    running, terminal,
};
use crate::app::{
    Plugins, SweepRequest, UsageError, program, registry,
    sweep::{new_dir, summary},
};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::{
    Outcome, RunOptions,
    plan::PlanNode,
    run::NodeStats,
    sweep::{self, Folder},
};
use osteoflow_node::Role;
use osteoflow_report::{
    format::shell_word,
    reproduction::{EXPERIMENTS, Reproduction, TIMED, WITH_MAPS},
};
use osteoflow_simulation::{Procedure, ProcedureParams};
use osteoflow_standard::own_bone;
use serde_json::{Value, json};
use std::{
    fmt::Write as _,
    fs,
    io::Write,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

/// The folder of the experiments' graphs in the project.
const GRAPHS: &str = "graphs/paper";

/// The page in the project.
const PAGE: &str = "docs/method/paper-reproduction.md";

/// Run the paper's experiments, and write a page that compares our numbers with the paper's.
///
/// Every graph of graphs/paper/ is swept into a folder of its own under --out. For each number of the paper the page has ours,
/// its n and units, the command, and whether it is outside the paper's spread. In the project's folder the page is
/// docs/method/paper-reproduction.md, otherwise paper-reproduction.md in --out. Each sweep's folder gets the page that
/// `osteoflow report` writes. An experiment without any result is listed with the first reason, a row without a number of
/// ours with what it lacks, and the exit code is 3. A bone that `osteoflow simulate` refuses is refused before anything is run.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow reproduce                                     all of it, on the built-in bones
  osteoflow reproduce --bone TIBIA.stl --plan PLAN.json --out R    on a bone of your own
  osteoflow reproduce --only sensitivity --out R
  osteoflow reproduce --out R --resume                    goes on where it was stopped")]
pub(crate) struct Reproduce {
    /// The folder with the experiments' graphs.
    #[arg(long, value_name = "DIR", default_value = GRAPHS)]
    graphs: PathBuf,

    /// The folder to write the sweeps into; refused if not empty. Default: a new one under runs/.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Resume in --out: finished runs stay.
    #[arg(long, requires = "out")]
    resume: bool,

    /// Only these experiments; the page is then written to --out.
    #[arg(long, value_name = "NAME", num_args = 1.., value_parser = EXPERIMENTS)]
    only: Vec<String>,

    /// A closed surface of a fibula (STL, PLY), instead of the built-in bones.
    #[arg(long, value_name = "FILE", requires = "plan")]
    bone: Option<PathBuf>,

    /// Its plan, or its anatomy only: malleolus tip and directions, as for `osteoflow simulate --plan`.
    #[arg(long, value_name = "FILE", requires = "bone")]
    plan: Option<PathBuf>,

    /// Change any key of all graphs; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    /// Number of runs at a time. Default: the number of cores.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,

    #[command(flatten)]
    keep: Keep,
}

impl Reproduce {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        if !self.graphs.is_dir() {
            let message = format!(
                "there is no folder {}; run this in the project's folder, or name the experiments' graphs by --graphs",
                self.graphs.display()
            );
            return Err(UsageError(message).into());
        }
        let cancelled = Arc::default();
        // First, because the check of a bone uses several threads too.
        running::make_pool(self.workers)?;
        if let (Some(bone), Some(plan)) = (&self.bone, &self.plan) {
            check_bone(bone, plan, self.sets.is_empty())?;
        }
        let out = match (&self.out, self.resume) {
            (Some(dir), true) => dir.clone(),
            (dir, _) => new_dir(dir.as_deref(), "reproduce")?.to_path_buf(),
        };
        let names: Vec<String> = match self.only.as_slice() {
            [] => EXPERIMENTS.map(str::to_owned).to_vec(),
            only => only.to_vec(),
        };
        let began = Instant::now();
        let mut sweeps = Vec::new();
        for name in names {
            // Everything is checked before the first run of an experiment; an experiment's own faults stop it there.
            let dir = out.join(&name);
            let request = SweepRequest {
                graph: self.graphs.join(format!("{name}.toml")),
                settings: self.sets_of(&name)?.into(),
                plugins: Plugins::default(),
                resume: dir.join(sweep::DESIGN).is_file(),
                out: Some(dir),
                shard: None,
                workers: self.workers,
                share: true,
                cache: self.keep.cache(),
            };
            let Some(sweep) = graph_args::or_faults(request.checked(), global)? else { return Ok(Exit::Usage) };
            sweeps.push((name, request, sweep));
        }
        let what = format!("reproducing {} experiments", sweeps.len());
        let n_runs: usize = sweeps.iter().map(|(.., sweep)| sweep.n_runs()).sum();
        let runs = sweeps.into_iter().map(|(name, request, sweep)| Ok((name, request.folder(sweep, &cancelled)?)));
        let runs = runs.collect::<Result<Vec<_>>>()?;
        let all: Vec<_> = runs.iter().map(|(name, run)| (name.clone(), run.folder.clone())).collect();
        let bar = SweepProgress::begin(n_runs, &what, program::n_workers(self.workers), global);
        let cancelled_too = cancelled.clone();
        let ran = running::watch(Progress::hidden(), cancelled, move |_| {
            for (name, run) in &runs {
                bar.message(name);
                run.make(&bar)?;
                if cancelled_too.load(Ordering::Relaxed) {
                    return Ok(false);
                }
                summary(&run.folder)?;
            }
            bar.end();
            Ok(true)
        })?;
        let running::Ran::Ended(true) = ran else {
            if !global.quiet {
                let word = global.paint_err("interrupted", "1;33");
                writeln!(terminal::stderr(), "{word}: continue with --out {} --resume", out.display())?;
            }
            return Ok(Exit::Interrupted);
        };
        self.print_end(&all, &out, began, global)
    }

    /// Writes the pages, and prints their paths and the numbers outside the paper's spread.
    fn print_end(&self, sweeps: &[(String, Folder)], out: &Path, began: Instant, global: &Global) -> Result<Exit> {
        let reproduction = Reproduction::new(sweeps)?;
        let mut times = Vec::new();
        for (name, _) in sweeps.iter().filter(|(name, _)| TIMED.contains(&&**name)) {
            times.extend(self.time(name)?.map(|nodes| (name.clone(), nodes)));
        }
        let path = self.page(out);
        let page = reproduction.page(&self.command(&self.only), &|name| self.command_of(name), &times)?;
        fs::write(&path, page).with_context(|| format!("{} cannot be written", path.display()))?;
        let outside = reproduction.outside();
        let empty = reproduction.without_results();
        for line in &empty {
            writeln!(terminal::stderr(), "{} {line}", global.paint_err("without results:", "1;33"))?;
        }
        let missing = reproduction.missing();
        for line in &missing {
            writeln!(terminal::stderr(), "{} {line}", global.paint_err("without a number:", "1;33"))?;
        }
        let exit = if empty.is_empty() && missing.is_empty() { Exit::Done } else { Exit::Refused };
        let reports = reports(sweeps)?;
        if global.format == Format::Json {
            let mut outcome = exit.to_json();
            outcome["out_dir"] = out.display().to_string().into();
            print_json(&json!({
                "outcome": outcome, "page": path.display().to_string(), "reports": reports, "outside": outside,
                "without_results": empty, "without_a_number": missing,
            }))?;
            return Ok(exit);
        }
        let mut to = terminal::stdout().lock();
        for line in &outside {
            writeln!(to, "outside the paper's spread: {line}")?;
        }
        writeln!(
            to,
            "figures and tables of each experiment: {}",
            out.join("NAME").join(osteoflow_report::PAGE).display()
        )?;
        writeln!(
            to,
            "{} and the sweeps in {} after {:.0} s",
            path.display(),
            out.display(),
            began.elapsed().as_secs_f64()
        )?;
        Ok(exit)
    }

    /// Times of the nodes that compute in one procedure of an experiment, or `None` if it is refused.
    fn time(&self, experiment: &str) -> Result<Option<Vec<NodeStats>>> {
        let graph = self.graphs.join(format!("{experiment}.toml"));
        let own = self.bone_keys()?.into_iter().map(|(key, file)| format!("{key}={file}"));
        let sets: Vec<_> = self.sets.iter().cloned().chain(own).collect();
        let registry = registry();
        let Ok(checked) = osteoflow_engine::check(&graph, &sets, &registry) else { return Ok(None) };
        let report = osteoflow_engine::run(&checked.plan, &registry, &RunOptions::default(), &())?;
        if report.outcome != Outcome::Complete {
            return Ok(None);
        }
        let computes = |node: &&PlanNode| node.role == Role::Node && !node.kind.starts_with("metrics.");
        let names: Vec<_> = checked.plan.nodes.iter().filter(computes).map(|node| &*node.name).collect();
        Ok(Some(report.nodes.into_iter().filter(|node| names.contains(&node.name.as_str())).collect()))
    }

    fn page(&self, out: &Path) -> PathBuf {
        let whole = self.only.is_empty() && self.bone.is_none() && self.sets.is_empty();
        match whole && Path::new(PAGE).is_file() {
            true => PAGE.into(),
            false => out.join("paper-reproduction.md"),
        }
    }

    /// The command that repeats these experiments; all experiments if empty.
    fn command(&self, only: &[String]) -> String {
        let mut command = "osteoflow reproduce".to_owned();
        if self.graphs != Path::new(GRAPHS) {
            let _ = write!(command, " --graphs {}", shell_word(&self.graphs.to_string_lossy()));
        }
        for (option, path) in [("--bone", &self.bone), ("--plan", &self.plan)] {
            if let Some(path) = path {
                let _ = write!(command, " {option} {}", shell_word(&path.to_string_lossy()));
            }
        }
        if !only.is_empty() {
            let _ = write!(command, " --only {}", only.join(" "));
        }
        for set in &self.sets {
            let _ = write!(command, " --set {}", shell_word(set));
        }
        command
    }

    /// The command that computes the numbers of one experiment.
    fn command_of(&self, experiment: &str) -> String {
        match self.bone.is_none() && self.sets.is_empty() && self.only.is_empty() {
            true => format!("osteoflow sweep {}/{experiment}.toml", self.graphs.display()),
            false => self.command(&[experiment.to_owned()]),
        }
    }

    /// The settings of the sweep of an experiment.
    fn sets_of(&self, experiment: &str) -> Result<Vec<String>> {
        let mut sets = self.sets.clone();
        // The calibration has no bone.
        if let Some(bone) = self.bone.as_ref().filter(|_| experiment != "calibration") {
            let keys: Vec<_> = self.bone_keys()?.iter().map(|(key, file)| format!("{key} = {file}")).collect();
            let name = bone.file_stem().map_or("bone".into(), |stem| stem.to_string_lossy());
            sets.push(format!("sweep.factor.bone.values=[{{ {} }}]", keys.join(", ")));
            sets.push(format!("sweep.factor.bone.labels=[{}]", Value::from(name)));
        }
        Ok(sets)
    }

    /// The keys that set a bone of the user's own instead of the built-in ones, with their values; none without --bone.
    fn bone_keys(&self) -> Result<Vec<(String, String)>> {
        let mut keys = Vec::new();
        for node in ["recording", "plan", "bone", "real_bone"] {
            for (key, file) in [("bone_file", &self.bone), ("plan_file", &self.plan)] {
                let Some(path) = file else { continue };
                let path = fs::canonicalize(path).with_context(|| format!("{} cannot be read", path.display()))?;
                keys.push((format!("{node}.{key}"), Value::from(path.to_string_lossy()).to_string()));
            }
        }
        Ok(keys)
    }
}

/// Refuses a bone that cannot be simulated, with the message of `osteoflow simulate`, before anything is run. Whether the
/// scanned stretch is on the bone is checked only if no other setting is made.
fn check_bone(bone: &Path, plan: &Path, as_it_is: bool) -> Result<()> {
    let subject = own_bone::read(bone, plan).map_err(|error| anyhow::anyhow!("{error}"))?;
    for note in &subject.notes {
        writeln!(terminal::stderr(), "warning: {note}")?;
    }
    if !as_it_is {
        return Ok(());
    }
    let mut params = ProcedureParams::default();
    // The surface and the plan matter, not the number of points.
    params.camera.n_points = 1000;
    Procedure::simulate_for(&subject, &params, 1)?;
    Ok(())
}

/// Writes the report of each experiment into its folder, and returns the paths of the pages.
fn reports(sweeps: &[(String, Folder)]) -> Result<Vec<String>> {
    let registry = registry();
    let kinds = PluginArgs::default().kinds_apart()?;
    let write = |(name, folder): &(String, Folder)| -> Result<String> {
        let maps = WITH_MAPS.contains(&name.as_str());
        let page = folder.dir().join(osteoflow_report::PAGE);
        osteoflow_report::of_sweep(folder.dir(), &registry, &kinds, maps)?.write(folder.dir(), &page)?;
        Ok(page.display().to_string())
    };
    sweeps.iter().map(write).collect()
}
