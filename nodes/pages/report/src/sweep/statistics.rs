//! The statistics in `summary.json` as tables; every row has n and its units.

use super::SweepResults;
use crate::{
    cell::Cell,
    chart::axis_label,
    html::Page,
    summary::{TableRow, about_few, comparison, from_to, in_degrees, statistics, word},
};
use osteoflow_statistics::counted;
use serde_json::Value as Json;

/// Maximum number of words of a column that are counted in a table.
const MAX_WORDS: usize = 12;
const INTERVALS: &str = "Intervals: bootstrap of whole units.";

/// All tables of a summary.
pub(super) fn tables(page: &mut Page, sweep: &SweepResults, summary: &Json) {
    let comparisons: Vec<_> = summary["comparisons"].as_array().into_iter().flatten().map(compared).collect();
    if !comparisons.is_empty() {
        let caption = "Second against first, paired, over n units: difference is second minus first, p of Wilcoxon's signed ranks \
                       (two-sided; effect: rank-biserial), Bland-Altman's limits of agreement, equivalence by two one-sided tests.";
        page.rows(caption, &comparisons);
    }
    if let Some(about) = about_few(summary) {
        page.text(&about);
    }
    let groups: Vec<&Json> = summary["groups"].as_array().into_iter().flatten().collect();
    let columns = sweep.spec.columns.iter().map(|column| {
        let rows = groups.iter().filter(|group| group["columns"][&column.name].is_object());
        let of = |group: &&&Json| in_degrees(&column.name, &group["columns"][&column.name]).1;
        (axis_label(&column.name), rows.map(|group| row(group, None, &of(&group))).collect())
    });
    gathered(page, "by column: n runs, and the number of units", groups.len(), columns.collect());
    let points = sweep.spec.points.iter().map(|measure| {
        let axes = groups.iter().flat_map(|group| {
            let of = &group["points"][&measure.name];
            let there = measure.axes.iter().filter(|axis| of[axis.as_str()].is_object());
            there.map(move |axis| row(group, Some(axis), &in_degrees(&measure.name, &of[axis.as_str()]).1))
        });
        (axis_label(&measure.name), axes.collect())
    });
    gathered(page, "at the points, signed: n values, and the number of units", groups.len(), points.collect());
    let verdicts =
        "Verdicts on the results: runs with each answer. Refused results do not enter any figure or statistics";
    words(page, verdicts, &groups, |group| &group["verdicts"]);
    for name in sweep.spec.columns.iter().filter(|column| column.path != "verdict.answer").map(|column| &column.name) {
        words(page, &format!("{name}: runs with each word"), &groups, |group| &group["words"][name]);
    }
    for note in summary["notes"].as_array().into_iter().flatten().filter_map(Json::as_str) {
        page.text(note);
    }
}

/// The number of runs with each word, by setting.
fn words<'a>(page: &mut Page, what: &str, groups: &[&'a Json], of: impl Fn(&'a Json) -> &'a Json) {
    let mut words: Vec<&str> = Vec::new();
    for (word, _) in groups.iter().filter_map(|group| of(group).as_object()).flatten() {
        if !words.contains(&word.as_str()) {
            words.push(word);
        }
    }
    if words.len() > MAX_WORDS {
        return page.text(&format!("{what}: {} different words, see runs.csv.", words.len()));
    }
    let n = |value: &Json| value.as_u64().unwrap_or(0);
    let cells = |group: &&'a Json| -> Vec<Cell> {
        let counts = words.iter().map(|word| n(&of(group)[word]));
        let none = n(&group["n_runs"]).saturating_sub(counts.clone().sum());
        let numbers = [n(&group["n_runs"])].into_iter().chain(counts).chain([none]).map(|n| Cell::of(&n.into()));
        settings(&group["setting"]).into_iter().map(|(_, cell)| cell).chain(numbers).collect()
    };
    if groups.iter().any(|group| words.iter().any(|word| n(&of(group)[word]) > 0)) {
        let heads = settings(&groups[0]["setting"]).into_iter().map(|(name, _)| name);
        let counts = ["runs"].into_iter().chain(words.iter().copied()).chain(["none"]).map(String::from);
        let rows: Vec<_> = groups.iter().map(cells).collect();
        page.table(&format!("{what}, by setting."), &heads.chain(counts).collect::<Vec<_>>(), &rows);
    }
}

fn row(group: &Json, axis: Option<&str>, of: &Json) -> TableRow {
    let mut row = settings(&group["setting"]);
    row.extend(axis.map(|axis| ("axis".into(), Cell::word(axis))));
    row.extend(statistics(of));
    if let Some(lost) = group["n_without_results"].as_u64().filter(|n| *n > 0) {
        for (_, cell) in row.iter_mut().filter(|(head, _)| head == "of") {
            let Cell::Word(units) = &*cell else { continue };
            *cell = Cell::word(format!("{units}; {} without results", counted(lost as usize, "run")));
        }
    }
    row
}

/// A table for each measure or, with a single setting, one table for all.
fn gathered(page: &mut Page, what: &str, n_settings: usize, measures: Vec<(String, Vec<TableRow>)>) {
    if n_settings > 1 {
        measures.into_iter().for_each(|(name, rows)| page.rows(&format!("{name} {what}. {INTERVALS}"), &rows));
        return;
    }
    let rows = measures.into_iter().flat_map(|(name, rows)| {
        let measure = ("measure".to_owned(), Cell::word(name));
        rows.into_iter().map(move |row| [measure.clone()].into_iter().chain(row).collect())
    });
    page.rows(&format!("Statistics {what}. {INTERVALS}"), &rows.collect::<Vec<_>>());
}

fn compared(of: &Json) -> TableRow {
    let mut row = TableRow::from([("column".into(), Cell::word(axis_label(&word(&of["column"]))))]);
    row.extend(settings(&of["setting"]));
    row.extend([("first", "a"), ("second", "b")].map(|(head, key)| (head.into(), Cell::word(word(&of[key])))));
    let of = in_degrees(&word(&of["column"]), of).1;
    let interval = ["low", "high"].map(|end| of["bland_altman"]["bias_interval"][end].as_f64());
    for (head, cell) in comparison(&of) {
        let is_difference = head == "difference";
        row.push(match cell {
            Cell::Number(p) if head.starts_with("p") && p < 0.001 => (head, Cell::word("< 0.001")),
            Cell::Number(p) if head.starts_with("p") => (head, Cell::word(format!("{p:.3}"))),
            cell => (head, cell),
        });
        if let (true, [Some(low), Some(high)]) = (is_difference, interval) {
            row.push(("95 % interval of the difference".into(), Cell::word(from_to(low, high))));
        }
    }
    row
}

fn settings(of: &Json) -> TableRow {
    of.as_object().into_iter().flatten().map(|(name, value)| (axis_label(name), Cell::word(word(value)))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn words_are_counted_by_setting_with_zeros_and_a_word_may_be_that_of_a_head() {
        let group = |icp: &str, n_runs: u64, stopped: Json| {
            json!({
                "setting": { "icp": icp }, "n_runs": n_runs, "words": { "stopped": stopped },
                "verdicts": { "trusted": n_runs - 1, "doubtful": 0, "refused": 1 },
            })
        };
        let spec = json!({
            "repeat": 4, "repeat_name": "procedure", "same_seed": false, "factors": [], "pair": [], "draws": [],
            "units": ["procedure"], "points": [], "limits": [], "compare": [],
            "columns": [{ "name": "stopped", "path": "icp.stop_reason" }, { "name": "answer", "path": "verdict.answer" }],
        });
        let sweep = SweepResults { spec: serde_json::from_value(spec).unwrap(), about: Json::Null, runs: Vec::new() };
        let shown = |groups: Json| {
            let mut page = Page::new("a sweep", false);
            tables(&mut page, &sweep, &json!({ "groups": groups }));
            page.finish("").0.replace(" class=\"n\"", "")
        };
        let cells = |row: &str, kind: &str| -> Vec<String> {
            let start = format!("<{kind}");
            let cells = row.split(&start).skip(1);
            cells.map(|cell| cell.split_once('>').unwrap().1.split("</").next().unwrap().to_owned()).collect()
        };
        let html = shown(json!([group("p", 9, json!({ "step": 5, "runs": 2 })), group("q", 4, json!({ "icp": 4 }))]));
        let table = html.split("<table>").find(|table| table.contains("stopped: runs with each word")).unwrap();
        let rows: Vec<&str> = table.split("<tr>").skip(1).collect();
        assert_eq!(cells(rows[0], "th "), ["icp", "runs", "step", "runs", "icp", "none"]);
        assert_eq!(cells(rows[1], "td"), ["p", "9", "5", "2", "0", "2"]);
        assert_eq!(cells(rows[2], "td"), ["q", "4", "0", "0", "4", "0"]);
        let verdicts = html.split("<table>").find(|table| table.contains("Verdicts on the results")).unwrap();
        let rows: Vec<&str> = verdicts.split("<tr>").skip(1).collect();
        assert_eq!(cells(rows[0], "th "), ["icp", "runs", "trusted", "doubtful", "refused", "none"]);
        assert_eq!(cells(rows[1], "td"), ["p", "9", "8", "0", "1", "0"]);
        let reasons: serde_json::Map<_, _> = (0..13).map(|k| (format!("reason {k}"), 1.into())).collect();
        let html = shown(json!([group("p", 13, reasons.into())]));
        assert!(html.contains("13 different words, see runs.csv") && !html.contains("reason 3"), "{html}");
        let none = json!({ "setting": {}, "n_runs": 2, "verdicts": { "trusted": 0, "doubtful": 0, "refused": 0 } });
        assert!(!shown(json!([none])).contains("Verdicts"), "nothing was judged");
    }

    #[test]
    fn every_row_has_n_its_units_and_an_interval_or_the_reason_for_none() {
        let spec = json!({
            "repeat": 4, "repeat_name": "procedure", "same_seed": false, "factors": [], "pair": [], "draws": [],
            "units": ["bone", "procedure"], "columns": [{ "name": "tre_mm", "path": "a" }, { "name": "z_mm", "path": "b" }],
            "points": [{ "name": "tre_true_mm", "path": "p", "label": "name", "axes": ["x"] }], "limits": [], "compare": [],
        });
        let of = |interval: Json| json!({ "n": 4, "mean": 0.5, "sd": 0.1, "mean_interval": interval });
        let mut tre = of(json!({ "no_interval": "n = 1 bone: one bone does not show how others differ" }));
        tre["n_units"] = json!([{ "name": "bone", "n": 1 }, { "name": "procedure", "n": 3 }]);
        let mut x = of(json!({ "level": 0.95, "low": -0.4, "high": 0.6 }));
        x["few_units"] = true.into();
        x["n_units"] = json!([{ "name": "bone", "n": 2 }, { "name": "procedure", "n": 4 }]);
        x["within_points"] = json!({ "sd_within": 0.07, "sd_between": 0.02 });
        x["within_procedures"] = json!({ "sd_within": 0.05, "sd_between": 0.0 });
        tre["share_below"] = json!({
            "limit": 2.0, "share": 0.75, "n_hits": 3, "n": 4, "interval": { "level": 0.95, "low": 0.3, "high": 0.95 },
        });
        let summary = json!({
            "groups": [{
                "setting": { "icp": "icp.point_to_plane" }, "n_runs": 4, "n_without_results": 1,
                "units": [{ "name": "bone", "n": 1 }, { "name": "procedure", "n": 4 }],
                "columns": { "tre_mm": tre, "z_mm": of(json!({ "level": 0.95, "low": 0.4, "high": 0.6 })) },
                "points": { "tre_true_mm": { "x": x } },
            }],
            "comparisons": [{
                "column": "tre_mm", "a": "p", "b": "q", "n": 4, "unit": "procedure", "mean_difference": -0.02,
                "wilcoxon": { "p": 0.125, "rank_biserial": 0.2, "w_plus": 6.0 }, "p_holm": 2.5e-4,
                "bland_altman": { "lower_limit": -0.12, "upper_limit": 0.09, "bias_interval": { "low": -0.25, "high": 1.0 } },
            }],
            "notes": ["two runs were refused"],
        });
        let spec = serde_json::from_value(spec).unwrap();
        let sweep = SweepResults { spec, about: Json::Null, runs: Vec::new() };
        let mut page = Page::new("a sweep", false);
        tables(&mut page, &sweep, &summary);
        let html = page.finish("").0.replace("<wbr>", "");
        for word in [
            "1\u{a0}bone, 3\u{a0}procedures; 1 run without results",
            "none: n = 1 bone",
            "75.0\u{a0}% (3 of 4), 30\u{a0}to\u{a0}95",
            "below 2",
            "0.400\u{a0}to\u{a0}0.600<",
            "\u{2212}0.400\u{a0}to\u{a0}0.600 (few: 2\u{a0}bones)",
            "holds the mean of all such units in 50, 75 or 88 % of cases",
            "SD within points",
            "SD within procedures",
            "p (Holm)",
            "\u{2212}0.120\u{a0}to\u{a0}0.090",
            "95 % interval of the difference",
            "\u{2212}0.250\u{a0}to\u{a0}1.000",
            "<td>0.125</td><td>&lt; 0.001</td>",
            "two runs were refused",
            "icp.point_to_plane",
        ] {
            assert!(html.contains(word), "{word} is missing:\n{html}");
        }
        assert!(!html.contains("w_plus") && !html.contains("bias_interval"), "keys for programs are not shown");
    }
}
