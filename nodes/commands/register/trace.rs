//! The steps of a registration as CSV and text.

use crate::commands::common::text_table::TextTable;
use osteoflow_algorithms::icp::IcpStep;
use osteoflow_geometry::matrix_rows;
use serde_json::{Map, Value};
use std::fmt::Write as _;

/// Key of a step's pose.
const POSE: &str = "t_target_source";

/// The numbers and words of a step by name, without its pose.
fn cells(step: &IcpStep) -> Map<String, Value> {
    let mut step = serde_json::to_value(step).unwrap_or_default();
    let mut cells = step.as_object_mut().map(std::mem::take).unwrap_or_default();
    cells.retain(|key, value| key != POSE && !value.is_object() && !value.is_array());
    cells
}

/// The steps as CSV: the numbers of each, then the pose after it, 12 numbers row by row.
pub(super) fn csv(steps: &[IcpStep]) -> String {
    let mut out = String::new();
    for step in steps {
        let cells = cells(step);
        let rows = matrix_rows(&step.t_target_source);
        if out.is_empty() {
            let names = (0..12).map(|k| format!("t_{}{}", k / 4, k % 4));
            let names: Vec<_> = cells.keys().cloned().chain(names).collect();
            out = names.join(",") + "\n";
        }
        let cells = cells.values().map(|value| if value.is_null() { String::new() } else { plain(value) });
        let pose = rows[..3].iter().flatten().map(|c| format!("{c:?}"));
        let _ = writeln!(out, "{}", cells.chain(pose).collect::<Vec<_>>().join(","));
    }
    out
}

/// The steps as a text table.
pub(super) fn text(steps: &[IcpStep]) -> String {
    let Some(first) = steps.first() else { return "no step was taken\n".into() };
    let names: Vec<_> = cells(first).keys().filter(|key| *key != "iteration").cloned().collect();
    let names: Vec<_> = names.iter().map(String::as_str).collect();
    let mut table = TextTable::new("steps", &names);
    for step in steps {
        let cells = cells(step);
        let row = names.iter().map(|name| match cells.get(*name) {
            Some(Value::Number(number)) if number.is_f64() => short(number.as_f64().unwrap_or(f64::NAN)),
            Some(Value::Bool(true)) => "yes".into(),
            None | Some(Value::Null | Value::Bool(false)) => "-".into(),
            Some(other) => plain(other),
        });
        table.row(step.iteration.to_string(), row);
    }
    table.lines()
}

/// Six digits after the point, or scientific notation for small numbers.
fn short(number: f64) -> String {
    if number != 0.0 && number.abs() < 1e-4 { format!("{number:.2e}") } else { format!("{number:.6}") }
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), String::from)
}
