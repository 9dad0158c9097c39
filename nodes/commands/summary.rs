//! The statistics of a sweep: each column under each setting, with what it is counted by, and what is compared.

use anyhow::Result;
use osteoflow_engine::sweep::{Done, Folder, Spec, at_path, point_values};
use osteoflow_statistics::{
    BootstrapParams, Share, StatisticsError, Summary, Units, WilcoxonParams, bland_altman, bootstrap_mean, holm,
    pearson, repeatability, spearman, tost, unit_means, wilcoxon, wilson_clustered,
};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// The confidence of every interval.
const LEVEL: f64 = 0.95;
/// Of the test of equivalence: 5 % on either side.
const ALPHA: f64 = 0.05;
/// With fewer units than so many a paired test cannot come below 5 %, whatever it is given: 2 / 2⁶ = 3 %.
const FEWEST_PAIRS: usize = 6;

/// What `summary.json` holds.
pub(crate) fn summary(folder: &Folder) -> Result<Value> {
    let spec = folder.spec()?;
    let done = folder.done()?.collect::<Result<Vec<_>, _>>()?;
    let mut notes = Vec::new();
    let groups: Vec<_> = groups(&spec, &done).iter().map(|(setting, rows)| group(&spec, setting, rows)).collect();
    let comparisons = match &spec.compare {
        Some(compare) => {
            let side = |label: &Value| done.iter().filter(|d| d.value(&compare.factor) == Some(label)).collect();
            let others = spec.factors.iter().find(|factor| factor.name == compare.factor);
            let others = others.into_iter().flat_map(|factor| &factor.levels).filter(|level| level.label != compare.to);
            let base: Vec<&Done> = side(&compare.to);
            let mut out = Vec::new();
            for level in others {
                let key = |d: &Done| key_without(d, &compare.factor);
                let (a, b) = (word(&compare.to), word(&level.label));
                out.extend(compared(&spec, (&a, &base), (&b, &side(&level.label)), &key, &compare.margins));
            }
            with_holm(out)
        }
        None => Vec::new(),
    };
    let simulated = done.iter().any(|d| d.results["simulated"] == true);
    let missing = missing(&spec, &done);
    notes.extend(
        missing.into_iter().map(|(name, path)| format!("column {name}: no run with results has anything at {path}")),
    );
    if simulated {
        notes.push("SIMULATED".into());
    }
    Ok(json!({
        "notice": super::result_table::NOTICE,
        "simulated": simulated,
        "graph": folder.about["graph"], "hash": folder.hash(),
        "n_runs": done.len(), "n_without_results": done.iter().filter(|d| d.status != "complete").count(),
        "units": units_of(&spec, &done.iter().collect::<Vec<_>>()).map(|units| levels(&units)),
        "groups": groups, "comparisons": comparisons, "notes": notes,
    }))
}

/// Columns that no run has anything for, though some have results.
fn missing<'a>(spec: &'a Spec, done: &[Done]) -> Vec<(&'a str, &'a str)> {
    let with: Vec<_> = done.iter().filter(|d| d.status == "complete").collect();
    let paths = spec.columns.iter().map(|c| (&*c.name, &*c.path));
    let paths = paths.chain(spec.points.iter().map(|p| (&*p.name, &*p.path)));
    let found = |path: &str| with.is_empty() || with.iter().any(|d| at_path(&d.results, path).is_some());
    paths.filter(|(_, path)| !found(path)).collect()
}

/// The runs by setting: the factors that are varied and are no units.
pub(crate) fn groups<'a>(spec: &Spec, done: &'a [Done]) -> Vec<(Map<String, Value>, Vec<&'a Done>)> {
    let varied = spec.factors.iter().filter(|f| f.levels.len() > 1 && !spec.units.contains(&f.name));
    let names: Vec<_> = varied.map(|factor| factor.name.as_str()).collect();
    let mut groups: Vec<(Map<String, Value>, Vec<&Done>)> = Vec::new();
    for run in done {
        let setting: Map<_, _> =
            names.iter().map(|name| ((*name).to_owned(), run.value(name).cloned().unwrap_or_default())).collect();
        match groups.iter_mut().find(|(known, _)| *known == setting) {
            Some((_, runs)) => runs.push(run),
            None => groups.push((setting, vec![run])),
        }
    }
    groups
}

fn group(spec: &Spec, setting: &Map<String, Value>, runs: &[&Done]) -> Value {
    let mut columns = Map::new();
    for column in &spec.columns {
        let with: Vec<_> =
            runs.iter().filter_map(|d| Some((*d, number(at_path(&d.results, &column.path)?)?))).collect();
        if with.is_empty() {
            continue;
        }
        let (rows, values): (Vec<&Done>, Vec<f64>) = with.into_iter().unzip();
        let mut told = statistics(units_of(spec, &rows).as_ref(), &values);
        if let Some((_, limit)) = spec.limits.iter().find(|(name, _)| *name == column.name) {
            // A run without results did not stay below any limit.
            let hits: Vec<_> = runs
                .iter()
                .map(|d| at_path(&d.results, &column.path).and_then(number).is_some_and(|x| x.abs() < *limit))
                .collect();
            let share = units_of(spec, runs).map(|units| wilson_clustered(&units, &hits, LEVEL));
            told["share_below"] = share.map_or(Value::Null, |share| share_json(*limit, share));
        }
        columns.insert(column.name.clone(), told);
    }
    let n_without = runs.iter().filter(|d| d.status != "complete").count();
    json!({
        "setting": setting, "n_runs": runs.len(), "n_without_results": n_without,
        "units": units_of(spec, runs).map(|units| levels(&units)),
        "columns": columns, "points": points(spec, runs), "correlations": correlations(spec, runs),
    })
}

fn share_json(limit: f64, share: Result<Share, StatisticsError>) -> Value {
    let mut told = or_reason(share);
    told["limit"] = limit.into();
    told
}

/// The points of a group, axis by axis.
fn points(spec: &Spec, runs: &[&Done]) -> Map<String, Value> {
    /// A run, a point, and its value.
    type At<'a> = (&'a Done, String, f64);
    // By measure and axis.
    let mut found: BTreeMap<(String, String), Vec<At<'_>>> = BTreeMap::new();
    for &run in runs {
        for point in point_values(spec, run) {
            let key = (point.measure.to_owned(), point.axis.to_owned());
            found.entry(key).or_default().push((run, point.point, point.value));
        }
    }
    let mut out = Map::new();
    for ((measure, axis), rows) in found {
        let values: Vec<f64> = rows.iter().map(|(.., value)| *value).collect();
        let names: Vec<_> = spec.units.iter().map(String::as_str).chain(["point"]).collect();
        let path = |(run, point, _): &At<'_>| {
            let mut path = path(spec, run);
            path.push(point.clone());
            path
        };
        let units = Units::new(&names, &rows.iter().map(path).collect::<Vec<_>>()).ok();
        let mut told = statistics(units.as_ref(), &values);
        // The same point in one procedure after the other; and the points of one procedure.
        let of_run = |(run, ..): &At<'_>| path_of_highest(spec, run);
        let by_point: Vec<_> = rows.iter().map(|row| (of_run(row), row.1.clone())).collect();
        let by_run: Vec<_> = rows.iter().map(|(run, ..)| run.run).collect();
        told["within_points"] = or_reason(repeatability(&by_point, &values));
        told[format!("within_{}s", spec.repeat_name)] = or_reason(repeatability(&by_run, &values));
        let of_measure = out.entry(measure).or_insert_with(|| json!({}));
        of_measure[axis] = told;
    }
    out
}

/// How what was drawn goes with the columns.
fn correlations(spec: &Spec, runs: &[&Done]) -> Vec<Value> {
    let mut out = Vec::new();
    for draw in &spec.draws {
        for column in &spec.columns {
            let pairs = runs
                .iter()
                .filter_map(|d| Some((number(d.value(&draw.name)?)?, number(at_path(&d.results, &column.path)?)?)));
            let (x, y): (Vec<f64>, Vec<f64>) = pairs.unzip();
            if x.len() > 3 {
                out.push(json!({
                    "draw": draw.name, "column": column.name, "n": x.len(), "unit": spec.repeat_name,
                    "pearson": or_reason(pearson(&x, &y, LEVEL)), "spearman": or_reason(spearman(&x, &y, LEVEL)),
                }));
            }
        }
    }
    out
}

/// What every list of numbers is told by.
fn statistics(units: Option<&Units>, values: &[f64]) -> Value {
    let mut told = or_reason(Summary::of(values));
    let mean =
        units.map(|units| bootstrap_mean(units, values, &BootstrapParams { level: LEVEL, ..Default::default() }));
    if let Some(mean) = mean {
        match mean {
            Ok(mean) => {
                told["mean_interval"] = match &mean.interval {
                    Ok(interval) => json!(interval),
                    Err(none) => json!({ "no_interval": none.to_string() }),
                };
                told["interval_by"] = mean.unit.clone().into();
                told["few_units"] = mean.few_units.into();
            }
            Err(error) => told["mean_interval"] = json!({ "no_interval": error.to_string() }),
        }
    }
    told["n_units"] = units.map_or(Value::Null, levels);
    told
}

/// Paired comparisons of the runs of two sides, column by column; the runs with one key are a pair.
pub(crate) fn compared(
    spec: &Spec,
    (a, runs_a): (&str, &[&Done]),
    (b, runs_b): (&str, &[&Done]),
    key: &dyn Fn(&Done) -> String,
    margins: &[(String, f64)],
) -> Vec<Value> {
    let of_a: BTreeMap<String, &Done> = runs_a.iter().map(|d| (key(d), *d)).collect();
    let pairs: Vec<_> = runs_b.iter().filter_map(|d| Some((*of_a.get(&key(d))?, *d))).collect();
    let mut out = Vec::new();
    // Where margins are stated, these columns are what is asked.
    let asked = |name: &String| margins.is_empty() || margins.iter().any(|(margin, _)| margin == name);
    for column in spec.columns.iter().filter(|column| asked(&column.name)) {
        let values = |d: &Done| at_path(&d.results, &column.path).and_then(number);
        let with: Vec<_> = pairs.iter().filter_map(|(a, b)| Some((*b, values(a)?, values(b)?))).collect();
        if with.is_empty() {
            continue;
        }
        let rows: Vec<&Done> = with.iter().map(|(run, ..)| *run).collect();
        let differences: Vec<f64> = with.iter().map(|(_, a, b)| b - a).collect();
        let (unit, differences, note) = by_unit(spec, &rows, differences);
        let margin = margins.iter().find(|(name, _)| *name == column.name).map(|(_, margin)| *margin);
        let n = differences.len();
        out.push(json!({
            "column": column.name, "a": a, "b": b, "unit": unit, "n": n, "n_pairs": rows.len(),
            "mean_a": mean(with.iter().map(|(_, a, _)| *a)), "mean_b": mean(with.iter().map(|(.., b)| *b)),
            "mean_difference": mean(differences.iter().copied()),
            "wilcoxon": or_reason(wilcoxon(&differences, &WilcoxonParams::default())),
            "tost": margin.map_or(Value::Null, |margin| or_reason(tost(&differences, margin, ALPHA))),
            "bland_altman": or_reason(bland_altman(&differences, LEVEL)),
            "note": note,
        }));
    }
    out
}

/// The differences of the highest units that are enough for a test, each the mean of its runs.
fn by_unit(spec: &Spec, rows: &[&Done], differences: Vec<f64>) -> (String, Vec<f64>, Value) {
    for depth in 1..=spec.units.len() {
        let names: Vec<_> = spec.units[..depth].iter().map(String::as_str).collect();
        let paths: Vec<Vec<String>> =
            rows.iter().map(|run| path(spec, run)[..depth].join("\u{1f}")).map(|p| vec![p]).collect();
        let Ok(units) = Units::new(&[names.join(", ")], &paths) else { continue };
        let Ok(means) = unit_means(&units, &differences) else { continue };
        let last = depth == spec.units.len();
        if means.means.len() >= FEWEST_PAIRS || last {
            let highest = &spec.units[0];
            let n_highest =
                rows.iter().map(|run| path(spec, run)[0].clone()).collect::<std::collections::BTreeSet<_>>();
            let note = (depth > 1).then(|| {
                format!(
                    "tested over {}s within n = {} {highest}: says nothing of others",
                    spec.units[depth - 1],
                    n_highest.len()
                )
            });
            return (spec.units[depth - 1].clone(), means.means, json!(note));
        }
    }
    ("run".into(), differences, Value::Null)
}

/// Holm's correction over all comparisons.
pub(crate) fn with_holm(mut comparisons: Vec<Value>) -> Vec<Value> {
    let with: Vec<usize> = (0..comparisons.len()).filter(|&i| comparisons[i]["wilcoxon"]["p"].is_number()).collect();
    let p: Vec<f64> = with.iter().filter_map(|&i| comparisons[i]["wilcoxon"]["p"].as_f64()).collect();
    if let Ok(corrected) = holm(&p) {
        with.iter().zip(corrected).for_each(|(&i, p)| comparisons[i]["p_holm"] = p.into());
    }
    comparisons
}

/// The units of these runs; `None` where there are none.
fn units_of(spec: &Spec, runs: &[&Done]) -> Option<Units> {
    let paths: Vec<_> = runs.iter().map(|run| path(spec, run)).collect();
    Units::new(&spec.units, &paths).ok()
}

fn path(spec: &Spec, run: &Done) -> Vec<String> {
    spec.units.iter().map(|unit| run.value(unit).map(word).unwrap_or_default()).collect()
}

/// The units above the repeats: what stays while a procedure is repeated.
fn path_of_highest(spec: &Spec, run: &Done) -> Vec<String> {
    let above = spec.units.iter().filter(|unit| **unit != spec.repeat_name);
    above.map(|unit| run.value(unit).map(word).unwrap_or_default()).collect()
}

fn levels(units: &Units) -> Value {
    let names = units.levels().zip(units.n_units());
    names.map(|(name, n)| json!({ "name": name.to_string(), "n": n })).collect()
}

/// All that tells a run from others but one factor.
fn key_without(run: &Done, factor: &str) -> String {
    let values = run.values.iter().filter(|(name, _)| name != factor);
    values.map(|(name, value)| format!("{name}={value}\u{1f}")).collect()
}

/// A number, or whether something is so.
fn number(value: &Value) -> Option<f64> {
    value.as_f64().or_else(|| value.as_bool().map(|so| f64::from(u8::from(so))))
}

pub(crate) fn word(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count() as f64;
    values.sum::<f64>() / n
}

/// What was computed, or why it could not be.
fn or_reason<T: serde::Serialize>(computed: Result<T, StatisticsError>) -> Value {
    match computed {
        Ok(value) => json!(value),
        Err(error) => json!({ "none": error.to_string() }),
    }
}
