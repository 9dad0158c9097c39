//! The tables of a sweep: one row for each run, and one for each run, point and axis.

use super::folder::{Done, Folder, FolderError};
use crate::check::sweep::{Column, PointColumn, Spec};
use serde_json::Value as Json;
use std::io::Write;

/// Looks up a run's results at a path such as `metrics.tre_true_mm.mean_signed.z`.
///
/// Each segment is a key of an object, the index of a list item from 0, or the `name` of one.
pub fn at_path<'a>(results: &'a Json, path: &str) -> Option<&'a Json> {
    path.split('.').try_fold(results, |at, part| match at {
        Json::Object(object) => object.get(part),
        Json::Array(items) => match part.parse::<usize>() {
            Ok(index) => items.get(index),
            Err(_) => items.iter().find(|item| item.get("name").and_then(Json::as_str) == Some(part)),
        },
        _ => None,
    })
}

/// Formats a cell: numbers in full precision, strings without quotes, null as empty.
fn cell(value: &Json) -> String {
    match value {
        Json::Null => String::new(),
        Json::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// Names of factors, draws and repeats, as columns.
fn names(spec: &Spec) -> impl Iterator<Item = &str> {
    let factors = spec.factors.iter().map(|factor| factor.name.as_str());
    factors.chain([spec.repeat_name.as_str()]).chain(spec.draws.iter().map(|draw| draw.name.as_str()))
}

/// Writes `runs.csv`: run, factors, repeat, draws, seed, status, the answer of the verdict, the columns of the sweep, and
/// the reason why there are no results. Of a run whose verdict refuses the results, the columns have what its reports
/// hold.
///
/// # Errors
/// If a run cannot be read or the table cannot be written.
pub fn write_runs(folder: &Folder, spec: &Spec, out: impl Write) -> Result<(), FolderError> {
    let mut table = csv::Writer::from_writer(out);
    let head = ["run"].into_iter().chain(names(spec)).chain(["seed", "status", "verdict"]);
    let head = head.chain(spec.columns.iter().map(|column| column.name.as_str())).chain(["reason"]);
    table.write_record(head).map_err(|e| folder.cannot_write(super::folder::RUNS, e))?;
    for done in folder.done()? {
        let done = done?;
        let mut row = vec![done.run.to_string()];
        row.extend(names(spec).map(|name| done.value(name).map(cell).unwrap_or_default()));
        let verdict = done.verdict().map(|answer| answer.name().to_owned());
        row.extend([done.seed.to_string(), done.status.clone(), verdict.unwrap_or_default()]);
        row.extend(
            spec.columns.iter().map(|column| at_path(&done.results, &column.path).map(cell).unwrap_or_default()),
        );
        row.push(done.reason.clone().unwrap_or_default());
        table.write_record(row).map_err(|e| folder.cannot_write(super::folder::RUNS, e))?;
    }
    table.flush().map_err(|e| folder.cannot_write(super::folder::RUNS, e))
}

/// Value of a measure at a point along an axis.
#[derive(Debug, Clone, PartialEq)]
pub struct PointValue<'a> {
    /// The measure, with its unit.
    pub measure: &'a str,
    /// Name of the point, or its index from 0.
    pub point: String,
    /// The axis.
    pub axis: &'a str,
    /// The value, signed.
    pub value: f64,
}

/// Values of a run at its points.
pub fn point_values<'a>(spec: &'a Spec, done: &Done) -> Vec<PointValue<'a>> {
    let mut out = Vec::new();
    for column in &spec.points {
        let Some(Json::Array(items)) = at_path(&done.results, &column.path) else { continue };
        for (index, item) in items.iter().enumerate() {
            let point = item.get(&column.label).map_or_else(|| index.to_string(), cell);
            for axis in &column.axes {
                if let Some(value) = at_path(item, axis).and_then(Json::as_f64) {
                    out.push(PointValue { measure: &column.name, point: point.clone(), axis, value });
                }
            }
        }
    }
    out
}

/// Header of the value column: includes the unit if all measures have the same; otherwise each measure's name has its
/// own.
fn value_head(spec: &Spec) -> &'static str {
    match spec.points.iter().all(|column| column.name.ends_with("_mm")) {
        true => "value_mm",
        false => "value",
    }
}

/// Columns and lists of points, with their paths, that have no value in any run; empty if no run is complete.
pub fn without_value<'a>(spec: &'a Spec, runs: &[Done]) -> Vec<(&'a str, &'a str)> {
    if !runs.iter().any(Done::is_complete) {
        return Vec::new();
    }
    // Refused runs count too: the reasons of a verdict may be in these alone.
    let has = |column: &&Column| {
        runs.iter().any(|run| at_path(&run.results, &column.path).is_some_and(|value| !value.is_null()))
    };
    let tells = |points: &&PointColumn| {
        // Without axes no values are looked up.
        points.axes.is_empty()
            || runs.iter().any(|run| point_values(spec, run).iter().any(|value| value.measure == points.name))
    };
    let columns = spec.columns.iter().filter(|column| !has(column)).map(|column| (&*column.name, &*column.path));
    let points = spec.points.iter().filter(|points| !tells(points)).map(|points| (&*points.name, &*points.path));
    columns.chain(points).collect()
}

/// Writes `points.csv` of the complete runs in long format: run, factors, repeat, draws, seed, measure, point, axis, value; `value_mm` if
/// every measure is in mm.
///
/// # Errors
/// If a run cannot be read or the table cannot be written.
pub fn write_points(folder: &Folder, spec: &Spec, out: impl Write) -> Result<(), FolderError> {
    let mut table = csv::Writer::from_writer(out);
    let head = ["run"].into_iter().chain(names(spec)).chain(["seed", "measure", "point", "axis", value_head(spec)]);
    table.write_record(head).map_err(|e| folder.cannot_write(super::folder::POINTS, e))?;
    for done in folder.done()? {
        let done = done?;
        if !done.is_complete() {
            continue;
        }
        let mut own = vec![done.run.to_string()];
        own.extend(names(spec).map(|name| done.value(name).map(cell).unwrap_or_default()));
        own.push(done.seed.to_string());
        for point in point_values(spec, &done) {
            let value = Json::from(point.value).to_string();
            let row = own.iter().map(String::as_str).chain([point.measure, &point.point, point.axis, &value]);
            table.write_record(row).map_err(|e| folder.cannot_write(super::folder::POINTS, e))?;
        }
    }
    table.flush().map_err(|e| folder.cannot_write(super::folder::POINTS, e))
}

/// Writes `times.csv`: run, factors, repeat, draws, seed, and for each node its kind, where its items come from, firings and times; the row
/// without a node is the run's, with the sums over the nodes that it computed.
///
/// # Errors
/// If a run cannot be read or the table cannot be written.
pub(super) fn write_times(folder: &Folder, spec: &Spec, out: impl Write) -> Result<(), FolderError> {
    let mut table = csv::Writer::from_writer(out);
    let failed = |error: csv::Error| folder.cannot_write(super::folder::TIMES, error);
    let head = ["run"].into_iter().chain(names(spec)).chain(["seed", "node", "kind", "from", "firings"]);
    table.write_record(head.chain(["busy_ms", "cpu_ms", "wall_ms"])).map_err(failed)?;
    for done in folder.done()? {
        let done = done?;
        let Some(times) = folder.times(done.run)? else { continue };
        let mut own = vec![done.run.to_string()];
        own.extend(names(spec).map(|name| done.value(name).map(cell).unwrap_or_default()));
        own.push(done.seed.to_string());
        let mut row = |of: [&str; 4], times: [Option<f64>; 3]| {
            let times = times.map(|time| time.map(|time| Json::from(time).to_string()).unwrap_or_default());
            let row = own.iter().map(String::as_str).chain(of).chain(times.iter().map(String::as_str));
            table.write_record(row).map_err(failed)
        };
        let (busy_ms, cpu_ms) = times.sums();
        row(["", "", "", ""], [Some(busy_ms), cpu_ms, Some(times.wall_ms)])?;
        for node in &times.nodes {
            let firings = node.firings.to_string();
            let measured = [Some(node.busy_ms), node.cpu_ms, Some(node.wall_ms)];
            row([&node.node, &node.kind, &node.from, &firings], measured)?;
        }
    }
    table.flush().map_err(|error| folder.cannot_write(super::folder::TIMES, error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_path_leads_through_objects_numbers_and_names() {
        let results = json!({ "cuts": { "planes": [{ "name": "plane_1", "offset_mm": 1.5 }, { "name": "plane_2" }] } });
        assert_eq!(at_path(&results, "cuts.planes.0.offset_mm"), Some(&json!(1.5)));
        assert_eq!(at_path(&results, "cuts.planes.plane_1.offset_mm"), Some(&json!(1.5)));
        assert_eq!(at_path(&results, "cuts.planes.plane_3.offset_mm"), None);
        assert_eq!(at_path(&results, "cuts.planes.7"), None);
    }
}
