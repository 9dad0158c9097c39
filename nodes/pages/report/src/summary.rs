//! The summary of a sweep: statistics of each column under each setting, and paired comparisons.

mod compared;
mod group;
mod rows;

pub use crate::degrees::{in_degrees, shown_unit};
pub use compared::{NoPairs, between, with_holm};
pub(crate) use compared::{Pairs, pairs};
pub(crate) use rows::from_to;
pub use rows::{TableRow, about_few, comparison, statistics, under_heads, units};

use crate::{ReportError, run_folder};
use osteoflow_engine::{
    run::Answer,
    sweep::{Column, Done, Factor, Folder, Spec, at_path, without_value},
};
use osteoflow_statistics::{StatisticsError, Units};
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};

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
    let mut notes: Vec<_> =
        missing.map(|(name, path)| format!("{name} has no value in any run: no result is at {path}")).collect();
    let twice = twice(&done);
    notes.extend(twice.iter().flat_map(|twice| twice["unsteady"].as_array()).flatten().map(unsteady_note));
    let mut summary = json!({
        "notice": notice,
        "simulated": simulated,
        "graph": folder.about["graph"], "hash": folder.hash(),
        "n_runs": done.len(), "n_without_results": done.iter().filter(|d| !d.is_complete()).count(),
        "verdicts": verdicts(done.iter()),
        "units": units_of(&spec, &done.iter().collect::<Vec<_>>()).map(|units| levels(&units)),
        "groups": groups, "comparisons": compared::within(&spec, &done), "notes": notes,
    });
    if let Some(twice) = twice {
        summary["twice"] = twice;
    }
    let failed: Vec<_> = done.iter().filter(|run| run.is_failed()).collect();
    if let Some(first) = failed.first() {
        let reason = first.reason.as_deref().unwrap_or("no reason given");
        let first = format!("run {}: {reason}", first.run);
        summary["incomplete"] = json!({ "n_failed": failed.len(), "first": first });
    }
    Ok(summary)
}

/// What the runs show that were computed twice: their number, and of each kind that answered otherwise the second time in how many
/// of them, and by how much the columns differ at most. `None` if none was computed twice.
fn twice(done: &[Done]) -> Option<Value> {
    let twice: Vec<_> = done.iter().filter_map(|run| run.twice.as_ref()).collect();
    let mut kinds: BTreeMap<&str, (usize, BTreeMap<&str, f64>)> = BTreeMap::new();
    for unsteady in twice.iter().flat_map(|nodes| *nodes) {
        let (n_runs, columns) = kinds.entry(&unsteady.kind).or_default();
        *n_runs += 1;
        for (column, difference) in &unsteady.columns {
            let largest = columns.entry(column).or_default();
            *largest = largest.max(*difference);
        }
    }
    let unsteady: Vec<_> = kinds
        .iter()
        .map(|(kind, (n_runs, columns))| json!({ "kind": kind, "n_differ": n_runs, "n_runs": twice.len(), "columns": columns }))
        .collect();
    (!twice.is_empty()).then(|| json!({ "n_runs": twice.len(), "unsteady": unsteady }))
}

/// What is said of a kind that answers otherwise the second time.
fn unsteady_note(kind: &Value) -> String {
    let columns = kind["columns"].as_object().into_iter().flatten();
    let columns: Vec<_> = columns.map(|(column, largest)| format!("{column} by up to {largest}")).collect();
    let columns = if columns.is_empty() { "no column of the table".into() } else { columns.join(", ") };
    format!(
        "{} answers otherwise the second time, in {} of {} runs that were computed twice: {columns}; its rows cannot be \
         repeated to the bit",
        kind["kind"].as_str().unwrap_or_default(),
        kind["n_differ"],
        kind["n_runs"]
    )
}

/// The factors of settings: those with several values that are neither units nor paired with one, such as the file of each bone.
pub(crate) fn setting_factors(spec: &Spec) -> impl Iterator<Item = &Factor> {
    let is_unit = |factor: &Factor| spec.units.contains(&factor.name);
    let labels = |factor: &Factor| factor.levels.iter().map(|level| word(&level.label)).collect::<BTreeSet<_>>();
    let differ = move |factor: &Factor| labels(factor).len() == factor.levels.len();
    let with_unit = move |factor: &Factor| {
        let others = spec.pair.iter().filter(|group| group.contains(&factor.name));
        let mut others = others.flat_map(|group| spec.factors.iter().filter(|other| group.contains(&other.name)));
        differ(factor) && others.any(|other| is_unit(other) && differ(other))
    };
    spec.factors.iter().filter(move |factor| factor.levels.len() > 1 && !is_unit(factor) && !with_unit(factor))
}

/// The runs by setting: by the values of the factors of settings.
pub(crate) fn groups<'a>(spec: &Spec, done: &'a [Done]) -> Vec<(Map<String, Value>, Vec<&'a Done>)> {
    let names: Vec<_> = setting_factors(spec).map(|factor| factor.name.as_str()).collect();
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

/// The number of runs with each answer of the verdict.
pub(crate) fn verdicts<'a>(runs: impl Iterator<Item = &'a Done> + Clone) -> Map<String, Value> {
    let n = |answer| runs.clone().filter(|run| run.verdict() == Some(answer)).count();
    Answer::ALL.into_iter().map(|answer| (answer.name().to_owned(), n(answer).into())).collect()
}

/// The units of these runs; `None` if the sweep has none.
pub(crate) fn units_of(spec: &Spec, runs: &[&Done]) -> Option<Units> {
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

pub(crate) fn levels(units: &Units) -> Value {
    let names = units.levels().zip(units.n_units());
    names.map(|(name, n)| json!({ "name": name.to_string(), "n": n })).collect()
}

/// The number of a complete run in a column. Refused runs do not enter any statistics.
fn value(run: &Done, column: &Column) -> Option<f64> {
    at_path(&run.results, &column.path).filter(|_| run.is_complete()).and_then(number)
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

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> Spec {
        let spec = json!({
            "repeat": 6, "repeat_name": "procedure", "same_seed": true, "units": ["procedure"], "pair": [], "draws": [],
            "factors": [], "columns": [{ "name": "tre_mm", "path": "tre" }], "limits": [["tre_mm", 5.0]], "compare": [],
            "points": [{ "name": "errors_mm", "path": "points", "label": "name", "axes": ["x"] }],
        });
        serde_json::from_value(spec).unwrap()
    }

    /// Runs with their status, verdict and error in mm.
    fn runs(of: &[(&str, Option<&str>, Option<f64>)]) -> Vec<Done> {
        let run = |(run, (status, answer, tre_mm)): (usize, &(&str, Option<&str>, Option<f64>))| {
            let mut results = json!({});
            if let Some(answer) = answer {
                let reason = json!({ "rule": "order", "answer": answer, "reason": "swapped", "remedy": "" });
                results["verdict"] = json!({ "answer": answer, "reasons": [reason] });
            }
            if let Some(tre_mm) = tre_mm {
                results["tre"] = json!(tre_mm);
                results["points"] = json!([{ "name": "A1", "x": tre_mm }]);
            }
            Done {
                run,
                seed: 1,
                values: [("procedure".into(), run.into())].into_iter().collect(),
                sets: Vec::new(),
                status: (*status).into(),
                reason: None,
                warnings: Vec::new(),
                results,
                twice: None,
                asked: None,
            }
        };
        of.iter().enumerate().map(run).collect()
    }

    #[test]
    fn verdicts_are_counted_and_refused_runs_enter_no_statistics_though_they_have_values() {
        let done = runs(&[
            ("complete", Some("trusted"), Some(1.0)),
            ("complete", Some("doubtful"), Some(3.0)),
            ("complete", None, Some(2.0)),
            ("refused", Some("refused"), Some(4.0)),
            ("refused", Some("refused"), None),
            ("failed", None, None),
        ]);
        let group = group::group(&spec(), &Map::new(), &done.iter().collect::<Vec<_>>());
        assert_eq!(group["verdicts"], json!({ "trusted": 1, "doubtful": 1, "refused": 2 }));
        assert_eq!((&group["n_runs"], &group["n_without_results"]), (&6.into(), &3.into()));
        let (tre, x) = (&group["columns"]["tre_mm"], &group["points"]["errors_mm"]["x"]);
        for of in [tre, x] {
            assert_eq!((&of["n"], &of["mean"], &of["max"]), (&3.into(), &2.0.into(), &3.0.into()), "{of}");
        }
        assert_eq!((&tre["share_below"]["n_hits"], &tre["share_below"]["n"]), (&3.into(), &6.into()), "{tre}");
    }

    #[test]
    fn words_are_counted_and_of_a_refused_run_only_its_verdict() {
        let mut spec = spec();
        for (name, path) in [("answer", "verdict.answer"), ("stopped", "stopped"), ("number", "tre")] {
            spec.columns.push(Column { name: name.into(), path: path.into() });
        }
        let mut done = runs(&[
            ("complete", Some("trusted"), Some(1.0)),
            ("complete", Some("trusted"), Some(1.0)),
            ("complete", Some("doubtful"), None),
            ("refused", Some("refused"), None),
            ("failed", None, None),
        ]);
        for run in [0, 2, 3] {
            done[run].results["stopped"] = "step".into();
        }
        let group = group::group(&spec, &Map::new(), &done.iter().collect::<Vec<_>>());
        let expected = json!({ "answer": { "doubtful": 1, "refused": 1, "trusted": 2 }, "stopped": { "step": 2 } });
        assert_eq!(group["words"], expected);
    }

    #[test]
    fn the_file_of_each_bone_makes_no_settings_and_what_several_bones_share_does() {
        let factor = |name: &str, labels: [&str; 4]| {
            let levels: Vec<_> = labels.iter().map(|label| json!({ "label": label, "sets": [] })).collect();
            serde_json::from_value::<Factor>(json!({ "name": name, "levels": levels })).unwrap()
        };
        let settings = |units: &[&str], pair: Value, file: [&str; 4], bone: [&str; 4]| -> Vec<String> {
            let spec = Spec {
                units: units.iter().map(|unit| (*unit).to_owned()).collect(),
                pair: serde_json::from_value(pair).unwrap(),
                factors: vec![factor("bone", bone), factor("file", file), factor("icp", ["a", "b", "c", "d"])],
                ..spec()
            };
            setting_factors(&spec).map(|factor| factor.name.clone()).collect()
        };
        let (units, paired) = (["bone", "procedure"], json!([["bone", "file"]]));
        let (bones, files) = (["1", "2", "3", "4"], ["a.stl", "b.stl", "c.stl", "d.stl"]);
        assert_eq!(settings(&units, paired.clone(), files, bones), ["icp"]);
        assert_eq!(settings(&units, json!([]), files, bones), ["file", "icp"], "crossed");
        assert_eq!(settings(&["procedure"], paired.clone(), files, bones), ["bone", "file", "icp"], "no unit");
        let sides = ["left", "left", "right", "right"];
        assert_eq!(settings(&units, paired.clone(), sides, bones), ["file", "icp"], "two bones have one side");
        assert_eq!(settings(&units, paired, files, sides), ["file", "icp"], "two files of one bone");
    }

    #[test]
    fn bones_that_are_paired_with_their_files_are_counted_in_one_setting() {
        let mut spec = spec();
        spec.units = vec!["bone".into(), "procedure".into()];
        spec.pair = vec![vec!["bone".into(), "file".into()]];
        for (name, labels) in [("bone", ["1", "2"]), ("file", ["a", "b"])] {
            let levels = labels.map(|label| json!({ "label": label, "sets": [] }));
            spec.factors.push(serde_json::from_value(json!({ "name": name, "levels": levels })).unwrap());
        }
        let mut done = runs(&[("complete", None, Some(1.0)); 4]);
        for (k, run) in done.iter_mut().enumerate() {
            run.values.insert("bone".into(), ["1", "2"][k / 2].into());
            run.values.insert("file".into(), ["a", "b"][k / 2].into());
        }
        let groups = groups(&spec, &done);
        assert_eq!(groups.len(), 1, "one setting");
        let group = group::group(&spec, &groups[0].0, &groups[0].1);
        assert_eq!(units(&group["columns"]["tre_mm"]["n_units"]), "2 bones, 4 procedures");
        assert!(group["columns"]["tre_mm"]["mean_interval"]["low"].is_number(), "{group}");
    }

    #[test]
    fn a_refused_run_is_no_partner_of_a_comparison() {
        let first = runs(&[("complete", Some("trusted"), Some(1.0)), ("complete", None, Some(2.0))]);
        let second = runs(&[("complete", Some("trusted"), Some(1.5)), ("refused", Some("refused"), Some(9.0))]);
        let compared = between(("[1]", &spec(), &first), ("[2]", &spec(), &second), &[], &[]).unwrap();
        assert_eq!(compared.len(), 1);
        assert_eq!((&compared[0]["n_pairs"], &compared[0]["mean_difference"]), (&1.into(), &0.5.into()));
        assert!(compared[0]["note"].as_str().unwrap().contains("1 of 2 pairs left out"), "{}", compared[0]);
    }
}
