//! The numbers that a reader looks for first.

use crate::{cell::Cell, html::Page};
use serde_json::Value as Json;

/// What is shown of each result, if it is there: caption, pointer to the value in mm, pointer to its n, and what n counts.
const NUMBERS: [(&str, &str, &str, &str); 8] = [
    ("TRE measured by stylus, mean", "/metrics/tre_measured_mm/mean_abs/norm", "/metrics/tre_measured_mm/n", "points"),
    ("TRE measured by stylus, largest", "/metrics/tre_measured_mm/max/norm", "/metrics/tre_measured_mm/n", "points"),
    ("TRE true, mean", "/metrics/tre_true_mm/mean_abs/norm", "/metrics/tre_true_mm/n", "points"),
    ("TRE true, largest", "/metrics/tre_true_mm/max/norm", "/metrics/tre_true_mm/n", "points"),
    ("FRE of the landmarks, RMS", "/metrics/fre_mm/rms_mm", "/metrics/fre_mm/n", "landmarks"),
    ("residual of the fine registration, RMS", "/icp/rms_mm", "/icp/n_pairs", "pairs"),
    ("scan to CT surface, RMS", "/metrics/surface_mm/rms_all_mm", "/metrics/surface_mm/n", "points"),
    ("scan to CT surface, 95th percentile", "/metrics/surface_mm/p95_all_mm", "/metrics/surface_mm/n", "points"),
];

/// A table of errors and residuals with their n; nothing of results that have none.
pub(super) fn table(page: &mut Page, results: &Json) {
    let row = |(what, value, n, of): &(&str, &str, &str, &str)| {
        let value = results.pointer(value)?.as_f64()?;
        let n = results.pointer(n).and_then(Json::as_u64).map_or_else(|| "not given".into(), |n| format!("{n} {of}"));
        Some(vec![Cell::word(*what), Cell::Number(value), Cell::word(n)])
    };
    let rows: Vec<_> = NUMBERS.iter().filter_map(row).collect();
    if !rows.is_empty() {
        let caption = "Errors and residuals. Only TRE is accuracy: it is measured at points that the fit did not use.";
        page.table(caption, &["", "mm", "n"], &rows);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn each_number_stands_with_its_n_and_what_is_missing_has_no_row() {
        let mut page = Page::new("", false);
        table(
            &mut page,
            &json!({
                "metrics": { "tre_true_mm": { "mean_abs": { "norm": 0.125 }, "n": 5 } },
                "icp": { "rms_mm": 0.0625, "n_pairs": 19_827 },
            }),
        );
        let (html, _) = page.finish("");
        for text in ["TRE true, mean", "0.125", "5 points", "19827 pairs"] {
            assert!(html.contains(text), "{text} is missing:\n{html}");
        }
        for text in ["stylus", "largest", "FRE of", "CT surface"] {
            assert!(!html.contains(text), "{text} has no value:\n{html}");
        }
    }
}
