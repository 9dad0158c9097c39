//! What a sweep says on a terminal: `summary.json` in columns.

use super::{summary::word, text_table::TextTable};
use serde_json::Value;

/// The statistics of each column under each setting, and the comparisons.
pub(crate) fn text(summary: &Value) -> String {
    let mut parts = Vec::new();
    let simulated = if summary["simulated"] == true { "SIMULATED, " } else { "" };
    parts.push(format!("{simulated}{}\n", summary["notice"].as_str().unwrap_or_default()));
    for group in summary["groups"].as_array().into_iter().flatten() {
        parts.push(of_group(group));
    }
    parts.extend(of_comparisons(summary));
    parts.join("\n")
}

fn of_group(group: &Value) -> String {
    let setting = group["setting"].as_object().into_iter().flatten();
    let setting: Vec<_> = setting.map(|(name, value)| format!("{name} = {}", word(value))).collect();
    let units: Vec<_> = group["units"].as_array().into_iter().flatten().map(units_text).collect();
    let title = match setting.as_slice() {
        [] => units.join(", "),
        setting => format!("{} ({})", setting.join(", "), units.join(", ")),
    };
    let mut table =
        TextTable::new(title, &["n", "mean", "sd", "rms", "median", "p95", "max", "95 % interval of the mean"]);
    for (name, column) in group["columns"].as_object().into_iter().flatten() {
        table.row(name, cells(column));
        if let Some(share) = column["share_below"]["share"].as_f64() {
            let below = &column["share_below"];
            let interval = interval(&below["interval"]);
            let limit = &below["limit"];
            table.row(
                format!("  below {limit}"),
                [below["n"].to_string(), format!("{:.1} %", 100.0 * share)]
                    .into_iter()
                    .chain([""; 5].map(str::to_owned))
                    .chain([interval]),
            );
        }
    }
    for (measure, axes) in group["points"].as_object().into_iter().flatten() {
        for (axis, statistics) in axes.as_object().into_iter().flatten() {
            table.row(format!("{measure} {axis}"), cells(statistics));
        }
    }
    table.lines()
}

fn units_text(unit: &Value) -> String {
    format!("n = {} {}", unit["n"], unit["name"].as_str().unwrap_or_default())
}

fn cells(statistics: &Value) -> impl Iterator<Item = String> {
    let numbers = ["mean", "sd", "rms", "median", "p95", "max"].map(|key| told(&statistics[key]));
    [statistics["n"].to_string()].into_iter().chain(numbers).chain([interval(&statistics["mean_interval"])])
}

/// Three decimals, or four figures where that says more.
fn told(value: &Value) -> String {
    match value.as_f64() {
        Some(x) if x != 0.0 && x.abs() < 0.01 => format!("{x:.2e}"),
        Some(x) => format!("{x:.3}"),
        None => "-".into(),
    }
}

fn interval(value: &Value) -> String {
    match (value["low"].as_f64(), value["high"].as_f64()) {
        (Some(low), Some(high)) => format!("{low:.3} to {high:.3}"),
        // `n = 1 bone: one bone does not show ..`
        _ => value["no_interval"].as_str().and_then(|why| why.split(':').next()).unwrap_or("-").into(),
    }
}

/// The comparisons, where there are some.
pub(crate) fn of_comparisons(summary: &Value) -> Option<String> {
    let comparisons = summary["comparisons"].as_array().filter(|all| !all.is_empty())?;
    let head = [
        "n",
        "unit",
        "first",
        "second",
        "difference",
        "95 % limits of agreement",
        "p",
        "p (Holm)",
        "effect",
        "equivalent",
    ];
    let mut table = TextTable::new("second against first, paired", &head);
    for c in comparisons {
        let agreement = &c["bland_altman"];
        let limits = match (agreement["lower_limit"].as_f64(), agreement["upper_limit"].as_f64()) {
            (Some(low), Some(high)) => format!("{low:.3} to {high:.3}"),
            _ => "-".into(),
        };
        let equivalent = match c["tost"]["equivalent"].as_bool() {
            Some(true) => format!("within {}", c["tost"]["margin"]),
            Some(false) => format!("not shown within {}", c["tost"]["margin"]),
            None => "-".into(),
        };
        let setting = c["setting"].as_object().into_iter().flatten();
        let setting: String = setting.map(|(name, value)| format!(" at {name} = {}", word(value))).collect();
        let name = format!("{}{setting}: {} -> {}", word(&c["column"]), word(&c["a"]), word(&c["b"]));
        let numbers = ["mean_a", "mean_b", "mean_difference"].map(|key| told(&c[key]));
        let tests = [&c["wilcoxon"]["p"], &c["p_holm"], &c["wilcoxon"]["rank_biserial"]].map(told);
        let cells = [c["n"].to_string(), word(&c["unit"])].into_iter().chain(numbers).chain([limits]).chain(tests);
        let note = c["note"].as_str().map(str::to_owned);
        table.row(name, cells.chain([equivalent]).chain(note));
    }
    Some(table.lines())
}
