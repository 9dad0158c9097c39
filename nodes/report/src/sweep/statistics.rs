//! The statistics that a sweep has left in `summary.json`, as tables: n and its unit stand in every row.

use super::{Swept, word};
use crate::{
    chart::named,
    html::{Cell, Page, number},
    tables,
};
use serde_json::Value as Json;

/// The statistics of one column under one setting, in the order of the table.
const STATISTICS: [(&str, &str); 9] = [
    ("mean", "mean"),
    ("sd", "SD"),
    ("rms", "RMS"),
    ("mean_abs", "mean |.|"),
    ("median", "median"),
    ("p95", "p95"),
    ("min", "min"),
    ("max", "max"),
    ("share_below", "share below"),
];

/// All tables of a summary.
pub(super) fn tables(page: &mut Page, sweep: &Swept, summary: &Json) {
    let groups: Vec<&Json> = summary["groups"].as_array().into_iter().flatten().collect();
    for column in &sweep.spec.columns {
        let rows = groups.iter().filter_map(|group| {
            let of = &group["columns"][&column.name];
            of.is_object().then(|| row(group, None, of))
        });
        table(page, &named(&column.name), &groups, rows.collect());
    }
    for measure in &sweep.spec.points {
        let mut rows = Vec::new();
        for group in &groups {
            for (axis, of) in group["points"][&measure.name].as_object().into_iter().flatten() {
                rows.push(row(group, Some(axis), of));
            }
        }
        table(page, &format!("{} at the points", named(&measure.name)), &groups, rows);
    }
    let comparisons: Vec<_> =
        summary["comparisons"].as_array().into_iter().flatten().filter_map(Json::as_object).cloned().collect();
    tables::objects(page, "Comparisons, paired; p-values after Holm's correction where named so", &comparisons);
    for note in summary["notes"].as_array().into_iter().flatten().filter_map(Json::as_str) {
        page.text(note);
    }
}

/// Cells of a row by the heading of their column.
type Row = Vec<(String, Cell)>;

fn row(group: &Json, axis: Option<&str>, of: &Json) -> Row {
    let mut row = Row::new();
    let setting = group["setting"].as_object().into_iter().flatten();
    row.extend(setting.map(|(name, value)| (name.clone(), Cell::word(word(value)))));
    row.extend(axis.map(|axis| ("axis".into(), Cell::word(axis))));
    let units = group["units"].as_array().into_iter().flatten();
    let units = units.filter_map(|unit| Some(format!("{} {}", unit["n"].as_u64()?, unit["name"].as_str()?)));
    row.push(("n".into(), Cell::of(&of["n"])));
    row.push(("of units".into(), Cell::word(units.collect::<Vec<_>>().join(", "))));
    row.push(("without results".into(), Cell::of(&group["n_without_results"])));
    for (key, head) in STATISTICS {
        match &of[key] {
            Json::Number(value) => row.push((head.into(), Cell::Number(value.as_f64().unwrap_or(f64::NAN)))),
            Json::Object(share) => {
                let limit = share.get("limit").and_then(Json::as_f64).map(number).unwrap_or_default();
                let percent = share.get("share").and_then(Json::as_f64).unwrap_or(f64::NAN) * 100.0;
                let counts = |key: &str| share.get(key).and_then(Json::as_u64).unwrap_or(0);
                let interval = interval(share.get("interval").unwrap_or(&Json::Null), 100.0);
                let told = format!("{percent:.1} % ({} of {}), {interval}", counts("n_hits"), counts("n"));
                row.push((format!("{head} {limit}"), Cell::word(told)));
            }
            _ => {}
        }
        if key == "mean" {
            row.push(("interval of the mean".into(), Cell::word(interval(&of["mean_interval"], 1.0))));
        }
    }
    for (key, value) in of.as_object().into_iter().flatten().filter(|(key, _)| key.starts_with("sd_within_")) {
        row.push((key.replace('_', " ").replacen("sd", "SD", 1), Cell::of(value)));
    }
    row
}

/// An interval with its level, or why there is none.
fn interval(of: &Json, times: f64) -> String {
    match (of["low"].as_f64(), of["high"].as_f64()) {
        (Some(low), Some(high)) => {
            let level = of["level"].as_f64().map(|level| format!(" ({:.0} %)", level * 100.0)).unwrap_or_default();
            format!("{} to {}{level}", number(low * times), number(high * times))
        }
        _ => of["no_interval"].as_str().map_or_else(|| "none".into(), |why| format!("none: {why}")),
    }
}

/// A table of rows that may have different columns.
fn table(page: &mut Page, what: &str, groups: &[&Json], rows: Vec<Row>) {
    let mut head: Vec<String> = Vec::new();
    for (name, _) in rows.iter().flatten() {
        if !head.contains(name) {
            head.push(name.clone());
        }
    }
    let lost = groups.iter().any(|group| group["n_without_results"].as_u64().unwrap_or(0) > 0);
    head.retain(|name| lost || name != "without results");
    let cell = |row: &Row, name: &String| {
        row.iter().find(|(of, _)| of == name).map_or_else(|| Cell::word(""), |(_, cell)| cell.clone())
    };
    let cells: Vec<Vec<Cell>> = rows.iter().map(|row| head.iter().map(|name| cell(row, name)).collect()).collect();
    page.table(&format!("{what}: n rows, and of how many units."), &head, &cells);
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_row_has_n_its_units_and_an_interval_or_why_there_is_none() {
        let spec = json!({
            "repeat": 4, "repeat_name": "procedure", "same_seed": false, "factors": [], "pair": [], "draws": [],
            "units": ["bone", "procedure"], "columns": [{ "name": "tre_mm", "path": "a" }, { "name": "z_mm", "path": "b" }],
            "points": [{ "name": "tre_true_mm", "path": "p", "label": "name", "axes": ["x"] }], "limits": [], "compare": null,
        });
        let of = |interval: Json| json!({ "n": 4, "mean": 0.5, "sd": 0.1, "mean_interval": interval, "sd_within_points": 0.07 });
        let mut tre = of(json!({ "no_interval": "1 bone only" }));
        tre["share_below"] = json!({
            "limit": 2.0, "share": 0.75, "n_hits": 3, "n": 4, "interval": { "level": 0.95, "low": 0.3, "high": 0.95 },
        });
        let summary = json!({
            "groups": [{
                "setting": { "icp": "icp.point_to_plane" }, "n_runs": 4, "n_without_results": 1,
                "units": [{ "name": "bone", "n": 1 }, { "name": "procedure", "n": 4 }],
                "columns": { "tre_mm": tre, "z_mm": of(json!({ "level": 0.95, "low": 0.4, "high": 0.6 })) },
                "points": { "tre_true_mm": { "x": of(Json::Null) } },
            }],
            "comparisons": [{ "column": "tre_mm", "a": "p", "b": "q", "n": 4, "unit": "procedure", "wilcoxon": { "p": 0.125 } }],
            "notes": ["two runs were refused"],
        });
        let spec = serde_json::from_value(spec).unwrap();
        let sweep = Swept { spec, about: Json::Null, runs: Vec::new() };
        let mut page = Page::new("a sweep", false);
        tables(&mut page, &sweep, &summary);
        let (html, _) = page.finish("");
        for word in [
            "1 bone, 4 procedure",
            "none: 1 bone only",
            "75.0 % (3 of 4), 30 to 95 (95 %)",
            "share below 2",
            "0.400 to 0.600 (95 %)",
            "SD within points",
            "without results",
            "wilcoxon.p",
            "two runs were refused",
            "icp.point_to_plane",
        ] {
            assert!(html.contains(word), "{word} is missing:\n{html}");
        }
    }
}
