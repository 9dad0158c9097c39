//! Statistics of the runs of one setting: of each column, of each axis of the points, and correlations with draws.

use super::{LEVEL, levels, number, or_reason, path, path_of_highest, units_of, value, verdicts};
use osteoflow_engine::sweep::{Done, Spec, at_path, point_values};
use osteoflow_statistics::{
    BootstrapParams, Summary, Units, bootstrap_mean, pearson, plural, repeatability, spearman, wilson_clustered,
};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// The statistics of the runs of one setting.
pub(super) fn group(spec: &Spec, setting: &Map<String, Value>, runs: &[&Done]) -> Value {
    let mut columns = Map::new();
    for column in &spec.columns {
        let with: Vec<_> = runs.iter().filter_map(|d| Some((*d, value(d, column)?))).collect();
        if with.is_empty() {
            continue;
        }
        let (rows, values): (Vec<&Done>, Vec<f64>) = with.into_iter().unzip();
        let mut entry = statistics(units_of(spec, &rows).as_ref(), &values);
        if let Some((_, limit)) = spec.limits.iter().find(|(name, _)| *name == column.name) {
            // A run without results is not below any limit.
            let hits: Vec<_> = runs.iter().map(|d| value(d, column).is_some_and(|x| x.abs() < *limit)).collect();
            if let Some(units) = units_of(spec, runs) {
                entry["share_below"] = or_reason(wilson_clustered(&units, &hits, LEVEL));
                entry["share_below"]["limit"] = (*limit).into();
            }
        }
        columns.insert(column.name.clone(), entry);
    }
    let n_without = runs.iter().filter(|d| !d.is_complete()).count();
    json!({
        "setting": setting, "n_runs": runs.len(), "n_without_results": n_without,
        "verdicts": verdicts(runs.iter().copied()),
        "units": units_of(spec, runs).map(|units| levels(&units)),
        "columns": columns, "words": words(spec, runs),
        "points": points(spec, runs), "correlations": correlations(spec, runs),
    })
}

/// The number of runs with each word, by column. A refused run has its verdict only.
fn words(spec: &Spec, runs: &[&Done]) -> BTreeMap<String, BTreeMap<String, usize>> {
    let mut counts: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (column, run) in spec.columns.iter().flat_map(|column| runs.iter().map(move |run| (column, run))) {
        let holds = run.is_complete() || column.path.starts_with("verdict.");
        if let Some(word) = at_path(&run.results, &column.path).and_then(Value::as_str).filter(|_| holds) {
            *counts.entry(column.name.clone()).or_default().entry(word.to_owned()).or_default() += 1;
        }
    }
    counts
}

/// Statistics of the points, by measure and axis.
fn points(spec: &Spec, runs: &[&Done]) -> Map<String, Value> {
    /// A run, the name of a point, and a value.
    type PointRow<'a> = (&'a Done, String, f64);
    // By measure and axis.
    let mut by_axis: BTreeMap<(String, String), Vec<PointRow<'_>>> = BTreeMap::new();
    for &run in runs.iter().filter(|run| run.is_complete()) {
        for point in point_values(spec, run) {
            let key = (point.measure.to_owned(), point.axis.to_owned());
            by_axis.entry(key).or_default().push((run, point.point, point.value));
        }
    }
    let mut out = Map::new();
    for ((measure, axis), rows) in by_axis {
        let values: Vec<f64> = rows.iter().map(|(.., value)| *value).collect();
        let names: Vec<_> = spec.units.iter().map(String::as_str).chain(["point"]).collect();
        let path = |(run, point, _): &PointRow<'_>| {
            let mut path = path(spec, run);
            path.push(point.clone());
            path
        };
        let units = Units::new(&names, &rows.iter().map(path).collect::<Vec<_>>()).ok();
        let mut entry = statistics(units.as_ref(), &values);
        // Repeatability of the same point over procedures, and of the points within a procedure.
        let of_run = |(run, ..): &PointRow<'_>| path_of_highest(spec, run);
        let by_point: Vec<_> = rows.iter().map(|row| (of_run(row), row.1.clone())).collect();
        let by_run: Vec<_> = rows.iter().map(|(run, ..)| run.run).collect();
        entry["within_points"] = or_reason(repeatability(&by_point, &values));
        entry[format!("within_{}", plural(&spec.repeat_name))] = or_reason(repeatability(&by_run, &values));
        let of_measure = out.entry(measure).or_insert_with(|| json!({}));
        of_measure[axis] = entry;
    }
    out
}

/// Correlations between drawn numbers and columns.
fn correlations(spec: &Spec, runs: &[&Done]) -> Vec<Value> {
    let mut out = Vec::new();
    for draw in &spec.draws {
        for column in &spec.columns {
            let pairs = runs.iter().filter_map(|d| Some((number(d.value(&draw.name)?)?, value(d, column)?)));
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

/// Summary, interval of the mean and units of a list of values.
fn statistics(units: Option<&Units>, values: &[f64]) -> Value {
    let mut entry = or_reason(Summary::of(values));
    let mean =
        units.map(|units| bootstrap_mean(units, values, &BootstrapParams { level: LEVEL, ..Default::default() }));
    if let Some(mean) = mean {
        match mean {
            Ok(mean) => {
                entry["mean_interval"] = match &mean.interval {
                    Ok(interval) => json!(interval),
                    Err(none) => json!({ "no_interval": none.to_string() }),
                };
                entry["interval_by"] = mean.unit.clone().into();
                entry["few_units"] = mean.few_units.into();
            }
            Err(error) => entry["mean_interval"] = json!({ "no_interval": error.to_string() }),
        }
    }
    entry["n_units"] = units.map_or(Value::Null, levels);
    entry
}
