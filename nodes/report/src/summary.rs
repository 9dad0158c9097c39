//! The summary of a sweep: statistics of each column under each setting, and paired comparisons.

mod compared;
mod group;
mod rows;

pub use compared::{NoPairs, between, with_holm};
pub use rows::{TableRow, about_few, comparison, statistics, under_heads, units};

use crate::{ReportError, run_folder};
use osteoflow_engine::sweep::{Done, Folder, Spec, without_value};
use osteoflow_statistics::{StatisticsError, Units};
use serde_json::{Map, Value, json};

/// File name of the summary in a sweep's folder.
pub const SUMMARY: &str = "summary.json";

/// Confidence level of every interval.
const LEVEL: f64 = 0.95;

/// Writes the tables of a finished sweep and its summary, which contains `notice`; returns the summary.
///
/// # Errors
/// If a file of the folder cannot be read or written.
pub fn write(folder: &Folder, notice: &str) -> Result<Value, ReportError> {
    folder.write_tables()?;
    let summary = summary(folder, notice)?;
    folder.write(SUMMARY, format!("{summary:#}\n").as_bytes())?;
    Ok(summary)
}

/// Reads the summary of a sweep.
///
/// # Errors
/// If the file does not exist or is not JSON.
pub fn read(folder: &Folder) -> Result<Value, ReportError> {
    run_folder::json(&folder.dir().join(SUMMARY))
}

/// Computes the content of `summary.json`.
fn summary(folder: &Folder, notice: &str) -> Result<Value, ReportError> {
    let spec = folder.spec()?;
    let done = folder.done()?.collect::<Result<Vec<_>, _>>()?;
    let groups: Vec<_> =
        groups(&spec, &done).iter().map(|(setting, rows)| group::group(&spec, setting, rows)).collect();
    let simulated = done.iter().any(|d| d.results["simulated"] == true);
    let missing = without_value(&spec, &done).into_iter();
    let notes: Vec<_> =
        missing.map(|(name, path)| format!("{name} has no value in any run: no result is at {path}")).collect();
    Ok(json!({
        "notice": notice,
        "simulated": simulated,
        "graph": folder.about["graph"], "hash": folder.hash(),
        "n_runs": done.len(), "n_without_results": done.iter().filter(|d| d.status != "complete").count(),
        "units": units_of(&spec, &done.iter().collect::<Vec<_>>()).map(|units| levels(&units)),
        "groups": groups, "comparisons": compared::within(&spec, &done), "notes": notes,
    }))
}

/// The runs by setting: by the values of all varied factors that are not units.
fn groups<'a>(spec: &Spec, done: &'a [Done]) -> Vec<(Map<String, Value>, Vec<&'a Done>)> {
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

/// The units of these runs; `None` if the sweep has none.
fn units_of(spec: &Spec, runs: &[&Done]) -> Option<Units> {
    let paths: Vec<_> = runs.iter().map(|run| path(spec, run)).collect();
    Units::new(&spec.units, &paths).ok()
}

fn path(spec: &Spec, run: &Done) -> Vec<String> {
    spec.units.iter().map(|unit| run.value(unit).map(word).unwrap_or_default()).collect()
}

/// The names of a run's units above the repeats, such as its bone.
fn path_of_highest(spec: &Spec, run: &Done) -> Vec<String> {
    let above = spec.units.iter().filter(|unit| **unit != spec.repeat_name);
    above.map(|unit| run.value(unit).map(word).unwrap_or_default()).collect()
}

fn levels(units: &Units) -> Value {
    let names = units.levels().zip(units.n_units());
    names.map(|(name, n)| json!({ "name": name.to_string(), "n": n })).collect()
}

/// A number; booleans as 0 or 1.
fn number(value: &Value) -> Option<f64> {
    value.as_f64().or_else(|| value.as_bool().map(|so| f64::from(u8::from(so))))
}

/// A value as text.
pub fn word(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// The result as JSON, or the reason why there is none under `none`.
fn or_reason<T: serde::Serialize>(computed: Result<T, StatisticsError>) -> Value {
    match computed {
        Ok(value) => json!(value),
        Err(error) => json!({ "none": error.to_string() }),
    }
}
