//! The page of a sweep: design, figures of every column, statistics.

mod again;
mod figures;
mod statistics;

use crate::{
    Report, ReportError, citations,
    html::Page,
    methods,
    paths::Paths,
    provenance,
    summary::{self, SUMMARY, word},
};
use osteoflow_engine::plugin::Kinds;
use osteoflow_engine::sweep::{
    Column, Distribution, Done, Factor, Folder, Level, PointValue, Spec, at_path, point_values,
};
use osteoflow_node::Registry;
use serde_json::Value as Json;
use std::{collections::BTreeMap, path::Path};

/// A sweep to report on.
struct SweepResults {
    spec: Spec,
    about: Json,
    runs: Vec<Done>,
}

/// The report of a sweep, given its folder.
///
/// The folder holds no surfaces. The median run and the worst run are repeated with `kinds` to map their
/// fragments; if the results differ from the stored ones, the page says so and shows no map.
///
/// # Errors
/// If the folder holds no sweep or its files cannot be read.
pub fn of_sweep(dir: &Path, registry: &Registry, kinds: &Kinds) -> Result<Report, ReportError> {
    let folder = Folder::open(dir)?;
    let runs = folder.done()?.collect::<Result<Vec<_>, _>>()?;
    let sweep = SweepResults { spec: folder.spec()?, about: folder.about.clone(), runs };
    let name = sweep.about["graph"]["name"].as_str().unwrap_or("graph");
    let simulated = sweep.runs.iter().any(|run| run.results["simulated"] == true);
    let mut page = Page::new(&format!("Sweep of {name}"), simulated);
    page.hide(Paths::of(&sweep.about, dir));

    page.section("Statistics");
    failures(&mut page, &sweep);
    match dir.join(SUMMARY).is_file() {
        true => statistics::tables(&mut page, &sweep, &summary::read(&folder)?),
        false => {
            page.missing("The table of statistics", "the folder holds no summary.json, which a finished sweep writes")
        }
    }
    page.section("Design");
    page.text(&sweep.design());
    page.section("Figures");
    figures::columns(&mut page, &sweep);
    figures::differences(&mut page, &sweep);
    figures::points(&mut page, &sweep);
    figures::draws(&mut page, &sweep);
    figures::times(&mut page, &sweep);
    again::maps(&mut page, &sweep, &folder, kinds);
    page.section("The graph as run");
    let graphs = again::graphs(&sweep, &folder, kinds);
    again::picture(&mut page, &sweep, &graphs);
    page.section("Methods");
    let (steps, registry) = match &graphs {
        Ok(graphs) => (again::steps(graphs), graphs.first().map_or(registry, |checked| &checked.registry)),
        Err(_) => (methods::nodes_of(&folder.graph()?), registry),
    };
    methods::of_sweep(&mut page, &sweep.methods(simulated), &steps, registry);
    if let Err(why) = &graphs {
        page.missing("The steps with the kinds of each run (these are the base graph's)", why);
    }
    page.section("Provenance");
    provenance::of_sweep(&mut page, dir, &sweep.about);
    page.section("References");
    let bibliography = citations::section(&mut page, &methods::kinds_of(&steps), registry);
    let made = provenance::dates(dir).map_or_else(String::new, |[_, ended]| format!(", {ended}"));
    let (html, figures) = page.finish(&format!("{}{made}", provenance::folder_name(dir)));
    Ok(Report { html, figures, bibliography, fault: None })
}

impl SweepResults {
    /// The factors that distinguish settings in figures: those of settings or, if there are none, the units.
    fn varied(&self) -> Vec<&Factor> {
        let no_units: Vec<_> = summary::setting_factors(&self.spec).collect();
        let is_varied = |factor: &&Factor| factor.levels.len() > 1 && self.spec.units.contains(&factor.name);
        if no_units.is_empty() { self.spec.factors.iter().filter(is_varied).collect() } else { no_units }
    }

    /// The settings in the order of the runs, each with its runs that have results.
    fn settings(&self) -> Vec<Setting<'_>> {
        let varied = self.varied();
        let mut settings: Vec<Setting<'_>> = Vec::new();
        for run in &self.runs {
            let values =
                varied.iter().map(|factor| (factor.name.as_str(), run.value(&factor.name).unwrap_or(&Json::Null)));
            let values: Vec<_> = values.collect();
            let at = settings.iter().position(|setting| setting.values == values);
            let at = at.unwrap_or_else(|| {
                settings.push(Setting { name: setting_name(&values), values, runs: Vec::new() });
                settings.len() - 1
            });
            if run.is_complete() {
                settings[at].runs.push(run);
            }
        }
        settings
    }

    /// The columns that hold numbers.
    fn numeric(&self) -> Vec<&Column> {
        let holds = |column: &&Column| self.runs.iter().any(|run| number_of(run, column).is_some());
        self.spec.columns.iter().filter(holds).collect()
    }

    /// The values of the factors and draws that set a kind, in a run.
    fn kinds_set<'a>(&'a self, run: &'a Done) -> Vec<Option<&'a Json>> {
        let is_kind = |set: &str| set.split('=').next().is_some_and(|key| key.trim().ends_with(".kind"));
        // A variant may set kinds.
        let level_sets_kind = |level: &Level| level.variant.is_some() || level.sets.iter().any(|set| is_kind(set));
        let sets_kind = |factor: &&Factor| factor.levels.iter().any(level_sets_kind);
        let factors = self.spec.factors.iter().filter(sets_kind).map(|factor| &factor.name);
        let draws =
            self.spec.draws.iter().filter(|draw| draw.keys.iter().any(|key| is_kind(key))).map(|draw| &draw.name);
        factors.chain(draws).map(|name| run.value(name)).collect()
    }

    /// A paragraph about factors, draws and repeats.
    fn design(&self) -> String {
        let spec = &self.spec;
        let mut words = Vec::new();
        for factor in &spec.factors {
            let levels: Vec<_> = factor.levels.iter().map(|level| label(&level.label)).collect();
            let values = match levels.len() {
                0..=12 => levels.join(", "),
                n => format!("{} ... {} ({n} values)", levels[..3].join(", "), levels[n - 1]),
            };
            words.push(format!("Factor {}: {values}.", factor.name));
        }
        if !spec.pair.is_empty() {
            let pairs: Vec<_> = spec.pair.iter().map(|group| group.join(" with ")).collect();
            words.push(format!("Varied together: {}; all others are crossed.", pairs.join("; ")));
        }
        for draw in &spec.draws {
            words.push(format!(
                "Drawn for each {}: {}, {}.",
                spec.repeat_name,
                draw.name,
                distribution(&draw.distribution)
            ));
        }
        let seeds = match (spec.same_seed, self.about["graph"]["seed"].as_u64()) {
            (true, Some(seed)) => format!("all with seed {seed}"),
            (false, Some(seed)) => format!("seeds {seed} to {}", seed + spec.repeat.max(1) as u64 - 1),
            (_, None) => "seeds unknown".into(),
        };
        words.push(format!(
            "Each setting was run {} times (one run is one {}), {seeds}.",
            spec.repeat, spec.repeat_name
        ));
        words.push(format!("Units, from the highest level: {}.", spec.units.join(" > ")));
        let n_requested = self.about["n_runs"].as_u64().unwrap_or(0);
        let without = self.runs.iter().filter(|run| !run.is_complete()).count();
        words.push(format!(
            "{} of {n_requested} runs are complete or refused, {without} of them have no results.",
            self.runs.len()
        ));
        words.join(" ")
    }

    fn methods(&self, simulated: bool) -> String {
        let origin = if simulated { "All data were simulated" } else { "Data were read from files" };
        let command = &self.about["command"];
        format!(
            "{origin}. The graph \"{}\" was run {} times with osteoflow {} (git {}). {} All settings have the same draws and \
             seeds, so they are paired. n is the number of units at the highest level named; rows of one unit \
             are not independent. Boxes are Tukey's: quartiles and median, whiskers to the last values within 1.5 \
             interquartile ranges. Lengths are in millimetres, angles in degrees.",
            self.about["graph"]["name"].as_str().unwrap_or("?"),
            self.runs.len(),
            command["version"].as_str().unwrap_or("?"),
            command["git_revision"].as_str().unwrap_or("unknown"),
            self.design(),
        )
    }

    /// The values at points of all runs.
    fn point_values(&self) -> Vec<(&Done, PointValue<'_>)> {
        let complete = self.runs.iter().filter(|run| run.is_complete());
        complete.flat_map(|run| point_values(&self.spec, run).into_iter().map(move |value| (run, value))).collect()
    }
}

/// A combination of the factors' values, with its runs.
struct Setting<'a> {
    name: String,
    values: Vec<(&'a str, &'a Json)>,
    runs: Vec<&'a Done>,
}

impl Setting<'_> {
    /// Its values alone, for an axis that names the factors.
    fn short(&self) -> String {
        match self.values.as_slice() {
            [] => self.name.clone(),
            values => values.iter().map(|(_, value)| label(value)).collect::<Vec<_>>().join(", "),
        }
    }
}

/// `icp.point_to_plane` for one factor, `icp = icp.point_to_plane, bone = 2` for several.
fn setting_name(values: &[(&str, &Json)]) -> String {
    match values {
        [] => "all runs".into(),
        [(_, value)] if value.is_string() => word(value),
        values => {
            values.iter().map(|(name, value)| format!("{name} = {}", label(value))).collect::<Vec<_>>().join(", ")
        }
    }
}

/// A value in a list: quoted if it contains a comma.
fn label(value: &Json) -> String {
    let word = word(value);
    if word.contains(',') { format!("\u{201c}{word}\u{201d}") } else { word }
}

/// The number of a complete run in a column, in the unit that is shown: angles in degrees.
fn number_of(run: &Done, column: &Column) -> Option<f64> {
    at_path(&run.results, &column.path)
        .filter(|_| run.is_complete())
        .and_then(Json::as_f64)
        .filter(|value| value.is_finite())
        .map(|value| value * summary::shown_unit(&column.name).1)
}

fn distribution(of: &Distribution) -> String {
    match of {
        Distribution::Uniform([a, b]) => format!("uniform from {a} to {b}"),
        Distribution::Normal([mean, sd]) => format!("normal with mean {mean} and SD {sd}"),
        Distribution::LogUniform([a, b]) => format!("uniform in the logarithm from {a} to {b}"),
        Distribution::Integers([a, b]) => format!("whole numbers from {a} to {b}"),
        Distribution::Choice(values) => {
            format!("one of {}", values.iter().map(label).collect::<Vec<_>>().join(", "))
        }
    }
}

/// A table of the reasons for runs without results.
fn failures(page: &mut Page, sweep: &SweepResults) {
    let mut reasons: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for run in sweep.runs.iter().filter(|run| !run.is_complete()) {
        reasons.entry(run.reason.as_deref().unwrap_or(&run.status)).or_default().push(run.run);
    }
    for (reason, runs) in reasons.iter().take(20) {
        let first: Vec<_> = runs.iter().take(5).map(usize::to_string).collect();
        let more = if runs.len() > 5 { " ..." } else { "" };
        page.text(&format!("{} without results (run {}{more}): {reason}.", runs.len(), first.join(", ")));
    }
}
