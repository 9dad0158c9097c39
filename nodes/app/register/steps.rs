//! The steps of a registration as rows of numbers.

use osteoflow_algorithms::icp::IcpStep;
use osteoflow_geometry::matrix_rows;
use osteoflow_report::summary::word;
use serde_json::{Map, Value};
use std::fmt::Write as _;

/// Key of a step's pose.
const POSE: &str = "t_target_source";

/// The numbers and words of a step by name, without its pose.
pub(crate) fn cells(step: &IcpStep) -> Map<String, Value> {
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
        let cells = cells.values().map(|value| if value.is_null() { String::new() } else { word(value) });
        let pose = rows[..3].iter().flatten().map(|c| format!("{c:?}"));
        let _ = writeln!(out, "{}", cells.chain(pose).collect::<Vec<_>>().join(","));
    }
    out
}
