use super::{
    Exit, Format, Global, UsageError, graph_args,
    plugins::PluginArgs,
    print_json,
    run::Keep,
    running,
    summary::{self, word},
    sweep::{self as sweep_command, SUMMARY},
};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::sweep::{self, Folder, SweepOptions, Watcher};
use serde::Deserialize;
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs,
    io::Write,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

/// Where the page lies in the project.
const PAGE: &str = "docs/paper-reproduction.md";

/// The experiments, in the order of the paper, then ours.
const EXPERIMENTS: [&str; 11] = [
    "calibration",
    "accuracy_camera",
    "accuracy_stylus",
    "cutting",
    "sensitivity",
    "point_count",
    "laser_spot",
    "in_vivo",
    "variants",
    "roi_extent",
    "error_terms",
];

/// Run the paper's experiments, and write the page that sets our numbers beside the paper's.
///
/// Every graph of graphs/paper/ is swept into a folder of its own under --out. The page says for each number of the paper
/// what ours is, of how many and of what, by which command, and whether it lies outside the paper's spread. In the
/// project's folder it is docs/paper-reproduction.md, else paper-reproduction.md in --out.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow reproduce                                     all of it, on the built-in bones
  osteoflow reproduce --bone TIBIA.stl --plan PLAN.json --out R    on a bone of your own
  osteoflow reproduce --only sensitivity --out R
  osteoflow reproduce --out R --resume                    goes on where it was stopped")]
pub(crate) struct Reproduce {
    /// The folder with the experiments' graphs.
    #[arg(long, value_name = "DIR", default_value = "graphs/paper")]
    graphs: PathBuf,

    /// The folder to leave the sweeps in; one that is not empty is refused. Default: a new one under runs/.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,

    /// Go on in --out: runs that are there stay.
    #[arg(long, requires = "out")]
    resume: bool,

    /// Only these experiments; then the page lies in --out.
    #[arg(long, value_name = "NAME", num_args = 1.., value_parser = EXPERIMENTS)]
    only: Vec<String>,

    /// A closed surface of a fibula (STL, PLY), in the place of the built-in bones.
    #[arg(long, value_name = "FILE", requires = "plan")]
    bone: Option<PathBuf>,

    /// Its plan, or its anatomy only: malleolus tip and directions, as `osteoflow simulate --plan` takes it.
    #[arg(long, value_name = "FILE", requires = "bone")]
    plan: Option<PathBuf>,

    /// Change any key of all graphs; may be given again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,

    /// How many runs go on at a time. Default: the number of cores.
    #[arg(long, value_name = "N")]
    workers: Option<NonZeroUsize>,

    #[command(flatten)]
    keep: Keep,
}

/// What `published.toml` holds.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Published {
    row: Vec<Row>,
    reading: Vec<Reading>,
    table: Vec<Table>,
}

/// A number of the paper.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    experiment: String,
    section: String,
    what: String,
    paper: String,
    low: Option<f64>,
    high: Option<f64>,
    /// Whether the sign of ours does not count.
    #[serde(default)]
    magnitude: bool,
    ours: String,
    show: Option<String>,
    #[serde(default)]
    setting: BTreeMap<String, Value>,
    #[serde(default)]
    remark: String,
}

/// A place where the paper can be read in more than one way.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Reading {
    question: String,
    reading: String,
    #[serde(default)]
    shows: Vec<Shown>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Shown {
    name: String,
    experiment: String,
    ours: String,
    #[serde(default)]
    setting: BTreeMap<String, Value>,
}

/// A table of all settings of an experiment.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    experiment: String,
    title: String,
    columns: Vec<String>,
}

fn published() -> Result<Published> {
    toml::from_str(include_str!("published.toml"))
        .context("the table of the paper's numbers is not sound, a bug of ours")
}

impl Reproduce {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let published = published()?;
        if !self.graphs.is_dir() {
            let said = format!(
                "there is no folder {}; run this in the project's folder, or name the experiments' graphs by --graphs",
                self.graphs.display()
            );
            return Err(UsageError(said).into());
        }
        let cancelled = Arc::default();
        let run = running::options(self.workers, &cancelled)?;
        let workers = run.workers;
        let run = osteoflow_engine::RunOptions { store: self.keep.store()?, ..run };
        let options = SweepOptions { workers, run, share: true, shard: None };
        let out = match (&self.out, self.resume) {
            (Some(dir), true) => dir.clone(),
            (dir, _) => sweep_command::new_dir(dir.as_deref(), "reproduce")?,
        };
        let bone = self.bone_sets()?;
        let names: Vec<String> = match self.only.as_slice() {
            [] => EXPERIMENTS.map(str::to_owned).to_vec(),
            only => only.to_vec(),
        };
        let began = Instant::now();
        let mut sweeps = Vec::new();
        for name in &names {
            // Everything is checked before the first run of an experiment; its own faults stop it there.
            let graph = self.graphs.join(format!("{name}.toml"));
            let sets: Vec<_> = self.sets.iter().cloned().chain(bone.iter().flat_map(|b| b.of(name))).collect();
            match sweep::check(&graph, &sets, PluginArgs::default().kinds()?, workers) {
                Ok(sweep) => sweeps.push((name, sweep)),
                Err(faults) => {
                    graph_args::tell(&faults, global)?;
                    return Ok(Exit::Usage);
                }
            }
        }
        let mut folders = Vec::new();
        for (name, sweep) in &sweeps {
            let dir = out.join(name.as_str());
            folders.push(match dir.join(sweep::DESIGN).is_file() {
                true => sweep.resume(&dir).map_err(sweep_command::told)?,
                false => sweep.begin(&dir, &options).map_err(sweep_command::told)?,
            });
        }
        let all = folders.clone();
        let n_runs: usize = sweeps.iter().map(|(_, sweep)| sweep.n_runs()).sum();
        let jobs: Vec<_> = sweeps.into_iter().map(|(name, sweep)| (name.clone(), sweep)).collect();
        let bar = sweep_command::Bar::of(n_runs, &format!("reproducing {} experiments", jobs.len()), workers, global)?;
        let cancelled_too = cancelled.clone();
        let ran = running::watch(super::progress::Progress::hidden(), cancelled, move |_| {
            for ((name, sweep), folder) in jobs.iter().zip(&folders) {
                bar.say(name);
                sweep.run(folder, &options, &bar as &dyn Watcher)?;
                if cancelled_too.load(Ordering::Relaxed) {
                    return Ok(false);
                }
                folder.write_tables()?;
                let summary = summary::summary(folder)?;
                folder.write(SUMMARY, format!("{summary:#}\n").as_bytes())?;
            }
            bar.end();
            Ok(true)
        })?;
        let running::Ran::Ended(true) = ran else {
            if !global.quiet {
                let word = global.paint_err("interrupted", "1;33");
                writeln!(std::io::stderr(), "{word}: go on with --out {} --resume", out.display())?;
            }
            return Ok(Exit::Interrupted);
        };
        let page = Page::new(&names, &all)?;
        let text = page.text(&published, self.command());
        let path = self.page(&out);
        fs::write(&path, &text).with_context(|| format!("{} cannot be written", path.display()))?;
        let outside = page.outside(&published);
        if global.format == Format::Json {
            let mut outcome = Exit::Done.to_json();
            outcome["out_dir"] = out.display().to_string().into();
            print_json(&json!({ "outcome": outcome, "page": path.display().to_string(), "outside": outside }))?;
            return Ok(Exit::Done);
        }
        let mut to = std::io::stdout().lock();
        for line in &outside {
            writeln!(to, "outside the paper's spread: {line}")?;
        }
        writeln!(
            to,
            "{} and the sweeps in {} after {:.0} s",
            path.display(),
            out.display(),
            began.elapsed().as_secs_f64()
        )?;
        Ok(Exit::Done)
    }

    fn page(&self, out: &Path) -> PathBuf {
        let whole = self.only.is_empty() && self.bone.is_none() && self.sets.is_empty();
        match whole && Path::new(PAGE).is_file() {
            true => PAGE.into(),
            false => out.join("paper-reproduction.md"),
        }
    }

    /// The command, as somebody would repeat it.
    fn command(&self) -> String {
        let mut command = "osteoflow reproduce".to_owned();
        for (option, path) in [("--bone", &self.bone), ("--plan", &self.plan)] {
            if let Some(path) = path {
                let _ = write!(command, " {option} {}", path.display());
            }
        }
        for set in &self.sets {
            let _ = write!(command, " --set '{set}'");
        }
        command
    }

    fn bone_sets(&self) -> Result<Option<BoneSets>> {
        let (Some(bone), Some(plan)) = (&self.bone, &self.plan) else { return Ok(None) };
        let absolute = |path: &PathBuf| {
            let there = fs::canonicalize(path).with_context(|| format!("{} cannot be read", path.display()))?;
            Ok::<_, anyhow::Error>(there.to_string_lossy().into_owned())
        };
        let name = bone.file_stem().map_or_else(|| "bone".into(), |stem| stem.to_string_lossy().into_owned());
        Ok(Some(BoneSets { name, bone: absolute(bone)?, plan: absolute(plan)? }))
    }
}

/// A bone of the user's own in the place of the built-in ones.
struct BoneSets {
    name: String,
    bone: String,
    plan: String,
}

impl BoneSets {
    fn of(&self, experiment: &str) -> Vec<String> {
        if experiment == "calibration" {
            // No bone is looked at there.
            return Vec::new();
        }
        let text = |text: &str| Value::from(text).to_string();
        let files = ["recording", "plan", "bone", "real_bone"]
            .map(|node| format!("{node}.bone_file = {}, {node}.plan_file = {}", text(&self.bone), text(&self.plan)));
        vec![
            format!("sweep.factor.bone.values=[{{ {} }}]", files.join(", ")),
            format!("sweep.factor.bone.labels=[{}]", text(&self.name)),
        ]
    }
}

/// The sweeps that a page is made of.
struct Page {
    summaries: BTreeMap<String, Value>,
}

/// A number of ours.
struct Ours {
    value: f64,
    text: String,
    n: String,
}

impl Page {
    fn new(names: &[String], folders: &[Folder]) -> Result<Self> {
        let read = |(name, folder): (&String, &Folder)| -> Result<(String, Value)> {
            let path = folder.dir().join(SUMMARY);
            let text = fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
            Ok((name.clone(), serde_json::from_str(&text)?))
        };
        Ok(Self { summaries: names.iter().zip(folders).map(read).collect::<Result<_>>()? })
    }

    fn group(&self, experiment: &str, setting: &BTreeMap<String, Value>) -> Option<&Value> {
        let groups = self.summaries.get(experiment)?["groups"].as_array()?;
        // `100` and `100.0` are one value.
        let same = |a: &Value, b: &Value| a == b || (a.as_f64().is_some() && a.as_f64() == b.as_f64());
        groups.iter().find(|group| setting.iter().all(|(name, value)| same(&group["setting"][name], value)))
    }

    fn ours(
        &self,
        experiment: &str,
        path: &str,
        setting: &BTreeMap<String, Value>,
        show: Option<&str>,
    ) -> Option<Ours> {
        let group = self.group(experiment, setting)?;
        let parts: Vec<_> = path.split('.').collect();
        if let ["correlation", draw, column] = parts[..] {
            let all = group["correlations"].as_array()?;
            let found = all.iter().find(|c| c["draw"] == draw && c["column"] == column)?;
            let value = found["pearson"]["r"].as_f64()?;
            return Some(Ours {
                value,
                text: format!("{value:.3}"),
                n: format!("{} {}s", found["n"], word(&found["unit"])),
            });
        }
        let statistics = parts.iter().fold(group, |at, part| &at[*part]);
        let number = |key: &str| statistics[key].as_f64();
        let (value, text) = match show {
            Some(key) => (number(key)?, format!("{:.2}", number(key)?)),
            None => {
                let sd = number("sd").map_or_else(String::new, |sd| format!(" ± {sd:.2}"));
                (
                    number("mean")?,
                    format!("{:.2}{sd} ({:.2} to {:.2})", number("mean")?, number("min")?, number("max")?),
                )
            }
        };
        Some(Ours { value, text, n: units(&statistics["n_units"]) })
    }

    /// The rows whose number of ours lies outside the paper's spread.
    fn outside(&self, published: &Published) -> Vec<String> {
        let told = |row: &Row| {
            let ours = self.of_row(row)?;
            let side = side(row, &ours)?;
            Some(format!("{} ({}): paper {}, ours {}, {side}", row.what, row.section, row.paper, ours.text))
        };
        published.row.iter().filter_map(told).collect()
    }

    fn of_row(&self, row: &Row) -> Option<Ours> {
        self.ours(&row.experiment, &row.ours, &row.setting, row.show.as_deref())
    }

    fn text(&self, published: &Published, command: String) -> String {
        let mut out = String::new();
        let line = &mut |text: &str| {
            out.push_str(text);
            out.push('\n');
        };
        line("# The paper's numbers and ours\n");
        line(&format!("Written by `{command}`; not edited by hand.\n"));
        line(
            "**SIMULATED; research use only, not for clinical use.** Every number of ours comes from the simulated procedure \
              ([simulation.md](simulation.md)), whose error terms were set from their sources and not from the numbers \
              below. n says of what: starts on one scan of one bone are n = 1 bone. Values are mean ± SD (least to \
              greatest); [statistics.md](statistics.md) has the formulas, each sweep's `summary.json` the intervals.\n",
        );
        line("| section | what | paper | ours | n | within the paper's spread | remark |");
        line("| --- | --- | --- | --- | --- | --- | --- |");
        for row in &published.row {
            let Some(ours) = self.of_row(row) else { continue };
            let judged = match (row.low, row.high) {
                (Some(low), Some(high)) => side(row, &ours).unwrap_or_else(|| format!("yes ({low} to {high})")),
                _ => "-".into(),
            };
            line(&format!(
                "| {} | {} | {} | {} | {} | {judged} | {} |",
                row.section, row.what, row.paper, ours.text, ours.n, row.remark
            ));
        }
        line("\n## Outside the paper's spread\n");
        match self.outside(published).as_slice() {
            [] => line("None."),
            all => all.iter().for_each(|told| line(&format!("- {told}"))),
        }
        line("\n## The command of each experiment\n");
        line("| experiment | command | runs | without results |");
        line("| --- | --- | --- | --- |");
        for (name, summary) in &self.summaries {
            let (n, without) = (&summary["n_runs"], &summary["n_without_results"]);
            line(&format!("| {name} | `osteoflow sweep graphs/paper/{name}.toml` | {n} | {without} |"));
        }
        line(
            "\nA run without results is a procedure that was refused, mostly because a laser spot lay at the silhouette of the \
              bone and its hole could not be found; `runs.csv` says why for each. A surgeon would point again.\n",
        );
        line("## How we read the paper\n");
        for reading in &published.reading {
            line(&format!("**{}** {}", reading.question, reading.reading));
            for shown in &reading.shows {
                if let Some(ours) = self.ours(&shown.experiment, &shown.ours, &shown.setting, None) {
                    line(&format!("- {}: {}, n = {}", shown.name, ours.text, ours.n));
                }
            }
            line("");
        }
        for table in &published.table {
            let Some(summary) = self.summaries.get(&table.experiment) else { continue };
            line(&format!("## {}\n", table.title));
            line(&format!("`graphs/paper/{}.toml`; SIMULATED; mean ± SD.\n", table.experiment));
            for told in of_table(table, summary) {
                line(&told);
            }
            line("");
        }
        out.truncate(out.trim_end().len());
        out.push('\n');
        out
    }
}

/// Every setting of an experiment as a row.
fn of_table(table: &Table, summary: &Value) -> Vec<String> {
    let groups = summary["groups"].as_array().map(Vec::as_slice).unwrap_or_default();
    let names: Vec<_> =
        groups.first().and_then(|g| g["setting"].as_object()).into_iter().flat_map(|s| s.keys()).collect();
    let head = names.iter().map(|name| name.as_str()).chain(table.columns.iter().map(String::as_str)).chain(["n"]);
    let mut lines = vec![format!("| {} |", head.collect::<Vec<_>>().join(" | "))];
    lines.push(format!("|{}", " --- |".repeat(names.len() + table.columns.len() + 1)));
    for group in groups {
        let setting = names.iter().map(|name| word(&group["setting"][name.as_str()]));
        let cells = table.columns.iter().map(|column| {
            let of = &group["columns"][column];
            match (of["mean"].as_f64(), of["sd"].as_f64()) {
                (Some(mean), Some(sd)) => format!("{mean:.2} ± {sd:.2}"),
                (Some(mean), None) => format!("{mean:.2}"),
                _ => "-".into(),
            }
        });
        let without = group["n_without_results"].as_u64().unwrap_or_default();
        let n = format!(
            "{}{}",
            units(&group["units"]),
            if without > 0 { format!("; {without} without results") } else { String::new() }
        );
        lines.push(format!("| {} |", setting.chain(cells).chain([n]).collect::<Vec<_>>().join(" | ")));
    }
    lines
}

/// `3 bones, 30 procedures`.
fn units(levels: &Value) -> String {
    let levels = levels.as_array().map(Vec::as_slice).unwrap_or_default();
    let told = levels.iter().map(|level| {
        let n = level["n"].as_u64().unwrap_or_default();
        format!("{n} {}{}", word(&level["name"]), if n == 1 { "" } else { "s" })
    });
    told.collect::<Vec<_>>().join(", ")
}

/// On which side of the paper's spread ours lies, if outside.
fn side(row: &Row, ours: &Ours) -> Option<String> {
    let (low, high) = (row.low?, row.high?);
    let value = if row.magnitude { ours.value.abs() } else { ours.value };
    match value {
        value if value < low => Some(format!("**below** {low} to {high}")),
        value if value > high => Some(format!("**above** {low} to {high}")),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_of_the_papers_numbers_is_sound_and_names_experiments_that_are_there() {
        let published = published().expect("it is read");
        let rows = published.row.iter().map(|row| &row.experiment);
        let shown = published.reading.iter().flat_map(|reading| &reading.shows).map(|shown| &shown.experiment);
        for name in rows.chain(shown).chain(published.table.iter().map(|table| &table.experiment)) {
            assert!(EXPERIMENTS.contains(&name.as_str()), "{name}");
        }
        for row in &published.row {
            assert!(row.low.is_some() == row.high.is_some() && row.low <= row.high, "{}", row.what);
        }
    }

    #[test]
    fn a_number_outside_the_spread_is_told_with_its_side() {
        let row = |low, high, magnitude| Row {
            experiment: String::new(),
            section: String::new(),
            what: String::new(),
            paper: String::new(),
            low: Some(low),
            high: Some(high),
            magnitude,
            ours: String::new(),
            show: None,
            setting: BTreeMap::new(),
            remark: String::new(),
        };
        let ours = |value| Ours { value, text: String::new(), n: String::new() };
        assert_eq!(side(&row(0.1, 0.5, false), &ours(0.3)), None);
        assert!(side(&row(0.1, 0.5, false), &ours(0.6)).is_some_and(|told| told.contains("above")));
        assert!(side(&row(0.1, 0.5, false), &ours(0.05)).is_some_and(|told| told.contains("below")));
        assert_eq!(side(&row(0.9, 1.0, true), &ours(-0.95)), None);
    }
}
