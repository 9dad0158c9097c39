//! The numbers of a run that people publish, in the order in which a table shows them.

use crate::app::judged;
use osteoflow_report::summary::word;
use serde_json::Value;

/// A row of the table: its name, and a value for each run.
pub(super) struct Published {
    pub(super) name: String,
    pub(super) values: Vec<Option<f64>>,
    /// Digits after the point.
    pub(super) digits: usize,
}

/// Names, paths in `results.json` and digits of single numbers; those of the cuts come after the errors of targets.
const ERRORS: [(&str, &str, usize); 7] = [
    ("TRE, true, mean mm", "/metrics/tre_true_mm/mean_abs/norm", 3),
    ("TRE, true, RMS mm", "/metrics/tre_true_mm/rms/norm", 3),
    ("TRE, true, max mm", "/metrics/tre_true_mm/max/norm", 3),
    ("TRE by stylus, mean mm", "/metrics/tre_measured_mm/mean_abs/norm", 3),
    ("TRE by stylus, RMS mm", "/metrics/tre_measured_mm/rms/norm", 3),
    ("TRE by stylus, max mm", "/metrics/tre_measured_mm/max/norm", 3),
    ("TRE predicted, mean mm", "/verdict/predicted/assessment/mean_tre_mm", 3),
];
const STEPS: [(&str, &str, usize); 4] = [
    ("FRE, RMS mm", "/metrics/fre_mm/rms_mm", 3),
    ("surface, RMS mm", "/metrics/surface_mm/rms_kept_mm", 3),
    ("icp, RMS mm", "/icp/rms_mm", 4),
    ("icp, iterations", "/icp/iterations", 0),
];

/// The rows that at least one run has a number for.
pub(super) fn rows(runs: &[Value]) -> Vec<Published> {
    let row = |name: &str, path: &str, digits, scale: f64| {
        let values: Vec<_> = runs.iter().map(|run| Some(run.pointer(path)?.as_f64()? * scale)).collect();
        values.iter().any(Option::is_some).then(|| Published { name: name.into(), values, digits })
    };
    let of = |list: &[(&str, &str, usize)]| -> Vec<Published> {
        list.iter().filter_map(|(name, path, digits)| row(name, path, *digits, 1.0)).collect()
    };
    let mut rows = of(&ERRORS);
    let degrees = 1.0_f64.to_degrees();
    let of_cut = [
        ("offset mm", "offset_mm", 3, 1.0),
        ("tilt deg", "tilt_rad", 2, degrees),
        ("roll deg", "roll_rad", 2, degrees),
    ];
    let cuts = runs[0].pointer("/metrics/cuts/cuts").and_then(Value::as_array);
    for (index, cut) in cuts.into_iter().flatten().enumerate() {
        let name = word(&cut["name"]);
        for (what, key, digits, scale) in of_cut {
            rows.extend(row(&format!("{name}, {what}"), &format!("/metrics/cuts/cuts/{index}/{key}"), digits, scale));
        }
    }
    rows.extend(of(&STEPS));
    rows
}

/// The answer of each run's verdict; `None` if no run has one.
pub(super) fn verdicts(runs: &[Value]) -> Option<Vec<String>> {
    let answers: Vec<_> = runs.iter().map(|run| judged(run).map(|verdict| verdict.answer().name())).collect();
    let any = answers.iter().any(Option::is_some);
    any.then(|| answers.iter().map(|answer| answer.unwrap_or("-").to_owned()).collect())
}
