//! Statistics and comparisons of a summary as rows of tables, for pages and terminals.

use super::word;
use crate::{cell::Cell, format::numbers};
use osteoflow_statistics::{FEW_UNITS, counted};
use serde_json::Value;

/// The cells of a row with the heads of their columns.
pub type TableRow = Vec<(String, Cell)>;

/// Head of the column of intervals.
const INTERVAL: &str = "95 % interval of the mean";

/// Formats the statistics of a column or axis in `summary.json`.
pub fn statistics(of: &Value) -> TableRow {
    let mut row = TableRow::new();
    let mut put = |head: &str, cell: Cell| row.push((head.to_owned(), cell));
    put("n", Cell::of(&of["n"]));
    put("of", Cell::word(unbroken(&units(&of["n_units"]))));
    put("mean", Cell::of(&of["mean"]));
    put(INTERVAL, Cell::word(interval(&of["mean_interval"], 1.0) + &few(of)));
    put("SD", Cell::of(&of["sd"]));
    for (key, value) in of.as_object().into_iter().flatten() {
        if let Some(groups) = key.strip_prefix("within_") {
            put(&format!("SD within {}", groups.replace('_', " ")), or_none(&value["sd_within"]));
        }
    }
    for (key, head) in
        [("rms", "RMS"), ("mean_abs", "mean |.|"), ("median", "median"), ("p95", "p95"), ("min", "min"), ("max", "max")]
    {
        put(head, Cell::of(&of[key]));
    }
    let below = &of["share_below"];
    if let Some(share) = below["share"].as_f64() {
        let interval = interval(&below["interval"], 100.0);
        let text = format!("{:.1}\u{a0}% ({} of {}), {interval}", 100.0 * share, below["n_hits"], below["n"]);
        put(&format!("below {}", Cell::of(&below["limit"]).plain()), Cell::word(text));
    }
    row
}

/// Formats a paired comparison in `summary.json`, without the names of what is compared.
pub fn comparison(of: &Value) -> TableRow {
    let agreement = &of["bland_altman"];
    let limits = match (agreement["lower_limit"].as_f64(), agreement["upper_limit"].as_f64()) {
        (Some(low), Some(high)) => from_to(low, high),
        _ => String::new(),
    };
    let margin = Cell::of(&of["tost"]["margin"]).plain();
    let equivalent = match of["tost"]["equivalent"].as_bool() {
        Some(true) => format!("within {margin}"),
        Some(false) => format!("not shown within {margin}"),
        None => String::new(),
    };
    let remarks = [&of["note"], &of["wilcoxon"]["none"]].into_iter().filter_map(Value::as_str);
    [
        ("n", Cell::of(&of["n"])),
        ("unit", Cell::word(word(&of["unit"]))),
        ("mean of first", or_none(&of["mean_a"])),
        ("mean of second", or_none(&of["mean_b"])),
        ("difference", or_none(&of["mean_difference"])),
        ("95 % limits of agreement", Cell::word(limits)),
        ("p", or_none(&of["wilcoxon"]["p"])),
        ("p (Holm)", or_none(&of["p_holm"])),
        ("effect", or_none(&of["wilcoxon"]["rank_biserial"])),
        ("equivalent", Cell::word(equivalent)),
        ("remark", Cell::word(remarks.collect::<Vec<_>>().join("; "))),
    ]
    .map(|(head, cell)| (head.to_owned(), cell))
    .into()
}

/// Arranges rows with different columns under common heads: a cell of every row under each head, without empty columns.
pub fn under_heads(rows: &[TableRow]) -> (Vec<String>, Vec<Vec<Cell>>) {
    let mut heads: Vec<String> = Vec::new();
    for (head, _) in rows.iter().flatten().filter(|(_, cell)| !cell.is_empty()) {
        if !heads.contains(head) {
            heads.push(head.clone());
        }
    }
    let cell = |row: &TableRow, head: &String| {
        row.iter().find(|(of, _)| of == head).map_or_else(|| Cell::word(""), |(_, cell)| cell.clone())
    };
    let cells = rows.iter().map(|row| heads.iter().map(|head| cell(row, head)).collect()).collect();
    (heads, cells)
}

/// Formats levels of units in `summary.json`, such as `3 bones, 30 procedures`.
pub fn units(levels: &Value) -> String {
    let levels = levels.as_array().map(Vec::as_slice).unwrap_or_default();
    let counts = levels.iter().map(|level| counted(level["n"].as_u64().unwrap_or(0) as usize, &word(&level["name"])));
    counts.collect::<Vec<_>>().join(", ")
}

/// An explanation of intervals of few units, if the summary has any.
pub fn about_few(summary: &Value) -> Option<String> {
    let groups = summary["groups"].as_array().into_iter().flatten();
    let columns = groups.clone().flat_map(|group| group["columns"].as_object().into_iter().flatten());
    let axes = groups.flat_map(|group| group["points"].as_object().into_iter().flatten());
    let axes = axes.flat_map(|(_, axes)| axes.as_object().into_iter().flatten());
    let any = columns.chain(axes).any(|(_, of)| !few(of).is_empty());
    any.then(|| {
        format!(
            "few: an interval of fewer than {FEW_UNITS} units is too narrow. Of 2, 3 or 4 it goes from the least of their \
             means to the greatest, and holds the mean of all such units in 50, 75 or 88 % of cases instead of 95 %."
        )
    })
}

/// ` (few: 3 bones)` after an interval that is probably too narrow.
fn few(of: &Value) -> String {
    let known = of["few_units"] == true && of["mean_interval"]["low"].is_number();
    let highest = of["n_units"].as_array().and_then(|levels| levels.first());
    match highest.filter(|_| known) {
        Some(level) => format!(" (few: {})", unbroken(&units(&Value::from(vec![level.clone()])))),
        None => String::new(),
    }
}

/// Text that may be wrapped only after commas.
fn unbroken(text: &str) -> String {
    text.replace(' ', "\u{a0}").replace(",\u{a0}", ", ")
}

/// Formats an interval, or the reason why there is none in short.
fn interval(of: &Value, times: f64) -> String {
    match (of["low"].as_f64(), of["high"].as_f64()) {
        (Some(low), Some(high)) => from_to(low * times, high * times),
        // The reason reads `n = 1 bone: one bone does not show ..`.
        _ => of["no_interval"]
            .as_str()
            .and_then(|why| why.split(':').next())
            .map_or_else(String::new, |why| format!("none: {why}")),
    }
}

/// An interval with non-breaking spaces, and as many decimals at either end.
pub(crate) fn from_to(low: f64, high: f64) -> String {
    let [low, high] = numbers([low, high]);
    format!("{low}\u{a0}to\u{a0}{high}")
}

/// A number, or an empty cell.
fn or_none(value: &Value) -> Cell {
    value.as_f64().map_or_else(|| Cell::word(""), Cell::Number)
}
