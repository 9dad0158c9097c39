//! The summary of a sweep as tables for a terminal.

use super::text_table::TextTable;
use osteoflow_report::{
    Cell,
    summary::{TableRow, about_few, comparison, statistics, under_heads, units, word},
};
use serde_json::Value;

/// Columns of the page and the file that a terminal has no room for.
const LEFT_OUT: [&str; 2] = ["mean |.|", "min"];

/// The statistics of each column under each setting, and the comparisons.
pub(crate) fn text(summary: &Value) -> String {
    let mut parts = Vec::new();
    let simulated = if summary["simulated"] == true { "SIMULATED, " } else { "" };
    parts.push(format!("{simulated}{}\n", summary["notice"].as_str().unwrap_or_default()));
    for group in summary["groups"].as_array().into_iter().flatten() {
        parts.push(of_group(group));
    }
    if summary["groups"].as_array().is_some_and(|groups| groups.len() > 1) {
        parts.extend(verdicts(summary).map(|counts| format!("verdicts in all: {counts}\n")));
    }
    parts.extend(about_few(summary).map(|about| about + "\n"));
    parts.extend(of_comparisons(summary));
    parts.join("\n")
}

fn of_group(group: &Value) -> String {
    let setting = group["setting"].as_object().into_iter().flatten();
    let setting: Vec<_> = setting.map(|(name, value)| format!("{name} = {}", word(value))).collect();
    let of = units(&group["units"]);
    let title = match setting.as_slice() {
        [] => of.clone(),
        setting => format!("{} ({of})", setting.join(", ")),
    };
    let columns = group["columns"].as_object().into_iter().flatten();
    let columns = columns.map(|(name, column)| (name.clone(), column));
    let points = group["points"].as_object().into_iter().flatten().flat_map(|(measure, axes)| {
        let axes = axes.as_object().into_iter().flatten();
        axes.map(move |(axis, statistics)| (format!("{measure} {axis}"), statistics))
    });
    let rows = columns.chain(points).map(|(name, numbers)| {
        let mut remarks = Vec::new();
        let mut row = statistics(numbers);
        row.retain(|(head, cell)| {
            // If some runs have no results, a column has fewer units than the title says.
            let (below, units) = (head.starts_with("below "), head == "of");
            if below {
                remarks.push(format!("{head}: {}", cell.plain()));
            } else if units && cell.plain() != of {
                remarks.push(format!("of {}", cell.plain()));
            }
            !below && !units && !LEFT_OUT.contains(&head.as_str())
        });
        (name, row, remarks.join("; "))
    });
    let verdicts = verdicts(group).map(|counts| format!("  verdicts: {counts}\n")).unwrap_or_default();
    table(&title, rows.collect()) + &verdicts
}

/// The number of runs with each verdict in words; `None` if no run has one.
fn verdicts(of: &Value) -> Option<String> {
    let counts = of["verdicts"].as_object()?;
    let judged: u64 = counts.values().filter_map(Value::as_u64).sum();
    let mut words: Vec<_> = counts.iter().map(|(answer, n)| format!("{n} {answer}")).collect();
    let without = of["n_runs"].as_u64().unwrap_or_default().saturating_sub(judged);
    words.extend((without > 0).then(|| format!("{without} without a verdict")));
    (judged > 0).then(|| words.join(", "))
}

/// The comparisons, if there are any.
pub(crate) fn of_comparisons(summary: &Value) -> Option<String> {
    let comparisons = summary["comparisons"].as_array().filter(|all| !all.is_empty())?;
    let rows = comparisons.iter().map(|c| {
        let setting = c["setting"].as_object().into_iter().flatten();
        let setting: String = setting.map(|(name, value)| format!(" at {name} = {}", word(value))).collect();
        let name = format!("{}{setting}: {} -> {}", word(&c["column"]), word(&c["a"]), word(&c["b"]));
        let mut row = comparison(c);
        let remark = row.pop_if(|(head, _)| head == "remark").map(|(_, cell)| cell.plain()).unwrap_or_default();
        (name, row, remark)
    });
    Some(table("second against first, paired", rows.collect()))
}

/// A table of named rows with remarks at their ends.
fn table(title: &str, rows: Vec<(String, TableRow, String)>) -> String {
    let cells: Vec<TableRow> = rows.iter().map(|(_, row, _)| row.clone()).collect();
    let (heads, cells) = under_heads(&cells);
    let mut table = TextTable::new(title, &heads.iter().map(String::as_str).collect::<Vec<_>>());
    for ((name, _, remark), cells) in rows.into_iter().zip(cells) {
        table.row(name, cells.iter().map(Cell::plain).chain(Some(remark).filter(|remark| !remark.is_empty())));
    }
    table.lines()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn verdicts_are_counted_below_each_setting_and_in_all_if_there_are_any() {
        let summary = |verdicts: [Value; 3]| {
            let [a, b, all] = verdicts;
            let group =
                |icp: &str, verdicts: Value| json!({ "setting": { "icp": icp }, "n_runs": 3, "verdicts": verdicts });
            json!({ "notice": "", "n_runs": 6, "verdicts": all, "groups": [group("p", a), group("q", b)] })
        };
        let counts = |trusted: u64, refused: u64| json!({ "trusted": trusted, "doubtful": 1, "refused": refused });
        let shown = text(&summary([counts(2, 0), counts(0, 1), counts(2, 1)]));
        for line in [
            "  verdicts: 2 trusted, 1 doubtful, 0 refused\n",
            "  verdicts: 0 trusted, 1 doubtful, 1 refused, 1 without a verdict\n",
            "verdicts in all: 2 trusted, 1 doubtful, 1 refused, 2 without a verdict\n",
        ] {
            assert!(shown.contains(line), "{shown}\nlacks\n{line}");
        }
        // Summaries of earlier versions count none.
        let none = json!({ "trusted": 0, "doubtful": 0, "refused": 0 });
        for nothing in [none, Value::Null] {
            assert!(!text(&summary([nothing.clone(), nothing.clone(), nothing])).contains("verdict"));
        }
    }
}
