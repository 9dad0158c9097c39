//! The numbers of a run's results that no table of their own shows: reports, and metrics of the user.

use osteoflow_report::summary::in_degrees;
use serde_json::Value;

/// Width of the terminal that lines are wrapped to.
const WIDTH: usize = 100;
/// Keys whose numbers other tables show.
const SHOWN: [&str; 7] = ["verdict", "refused", "reasons", "poses", "laser_points", "planes_at_scan", "planes"];
/// What the steps of a registration report of themselves. A verdict has judged it, so it is for --verbose.
const OF_STEPS: [&str; 11] = [
    "calibration",
    "coarse",
    "start",
    "icp",
    "slide",
    "holes",
    "metrics.tre_measured_mm",
    "metrics.tre_true_mm",
    "metrics.cuts",
    "metrics.fre_mm",
    "metrics.surface_mm",
];
/// Parts of a report that a table shows, by its key.
const SHOWN_PARTS: [(&str, &str); 1] = [("metrics.cuts", "cuts")];
/// Parts of the results of a target error that a table shows.
const SHOWN_OF_TRE: [&str; 2] = ["points", "mean_abs"];
/// How deep objects are followed below a key of the results; deeper numbers are counted.
const MAX_DEPTH: usize = 2;

/// Numbers by the path of what holds them, wrapped. Those of long lists and of nested parts, and those of the steps of a
/// registration unless `shows_steps`, are counted.
pub(crate) fn text(results: &Value, shows_steps: bool) -> Numbers {
    let mut numbers = Numbers { shows_steps, ..Numbers::default() };
    for (key, value) in results.as_object().into_iter().flatten().filter(|(key, _)| !SHOWN.contains(&key.as_str())) {
        numbers.add(key, value, 0);
    }
    numbers
}

/// Numbers of the results that no table shows.
#[derive(Default)]
pub(crate) struct Numbers {
    rows: Vec<(String, Vec<String>)>,
    /// Number of those that are left out.
    pub(crate) n_left_out: usize,
    shows_steps: bool,
}

impl Numbers {
    /// The lines; `None` if there are none.
    pub(crate) fn lines(&self) -> Option<String> {
        if self.rows.is_empty() {
            return None;
        }
        let width = self.rows.iter().map(|(path, _)| path.chars().count()).max().unwrap_or_default();
        let mut out = String::from("other results\n");
        for (path, row) in &self.rows {
            let mut line = format!("  {path:width$}");
            for number in row {
                if line.chars().count() + 2 + number.chars().count() > WIDTH && !line.ends_with("  ") {
                    out.push_str(line.trim_end());
                    out.push('\n');
                    line = " ".repeat(width + 2);
                }
                line.push_str("  ");
                line.push_str(number);
            }
            out.push_str(line.trim_end());
            out.push('\n');
        }
        if self.shows_steps && self.n_left_out > 0 {
            out.push_str(&format!("  {} more numbers, of lists and nested parts, in results.json\n", self.n_left_out));
        }
        Some(out)
    }

    fn add(&mut self, path: &str, value: &Value, depth: usize) {
        if !self.shows_steps && OF_STEPS.contains(&path) {
            self.n_left_out += count(value);
            return;
        }
        match value {
            Value::Number(_) => {
                let (name, number) = in_degrees(path, value);
                self.rows.push((name, vec![shown(&number)]));
            }
            Value::Object(object) => {
                let own = object.iter().map(|(name, value)| in_degrees(name, value));
                let own = own.filter_map(|(name, value)| Some((name, short(&value)?)));
                let numbers: Vec<_> = own.map(|(name, numbers)| format!("{name} {numbers}")).collect();
                if !numbers.is_empty() {
                    self.rows.push((path.into(), numbers));
                }
                let is_tre = path.starts_with("metrics.tre_");
                for (name, value) in object.iter().filter(|(_, value)| short(value).is_none()) {
                    if is_tre && SHOWN_OF_TRE.contains(&name.as_str()) {
                        continue;
                    }
                    if SHOWN_PARTS.contains(&(path, name.as_str())) {
                        continue;
                    }
                    match value {
                        Value::Object(_) | Value::Array(_) if depth < MAX_DEPTH => {
                            self.add(&format!("{path}.{name}"), value, depth + 1);
                        }
                        _ => self.n_left_out += count(value),
                    }
                }
            }
            // The items of a wire, or parts with names.
            Value::Array(items) if depth == 0 || items.iter().any(|item| item.get("name").is_some()) => {
                for (index, item) in items.iter().enumerate() {
                    let name =
                        item.get("name").and_then(Value::as_str).map_or_else(|| index.to_string(), str::to_owned);
                    self.add(&format!("{path}.{name}"), item, depth + 1);
                }
            }
            _ => self.n_left_out += count(value),
        }
    }
}

/// A number, or up to three in brackets.
fn short(value: &Value) -> Option<String> {
    match value {
        Value::Number(_) => Some(shown(value)),
        Value::Array(list) if (1..=3).contains(&list.len()) && list.iter().all(Value::is_number) => {
            Some(format!("[{}]", list.iter().map(shown).collect::<Vec<_>>().join(" ")))
        }
        _ => None,
    }
}

fn shown(number: &Value) -> String {
    match number.as_f64() {
        _ if number.is_i64() || number.is_u64() => number.to_string(),
        Some(0.0) => "0".into(),
        Some(v) if v.abs() < 1e-3 || v.abs() >= 1e6 => format!("{v:.3e}"),
        Some(v) => format!("{v:.4}"),
        None => number.to_string(),
    }
}

fn count(value: &Value) -> usize {
    match value {
        Value::Number(_) => 1,
        Value::Array(items) => items.iter().map(count).sum(),
        Value::Object(object) => object.values().map(count).sum(),
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn each_number_of_the_results_is_shown_or_counted() {
        let results = json!({
            "verdict": { "answer": "trusted", "predicted": { "mean_tre_mm": 0.5 } },
            "my_metric": 3.25,
            "metrics": {
                "own": { "gap_mm": 0.125, "n": 7, "tilt_rad": 2e-5, "at": [1, 2.5, -3] },
                "cuts": { "cuts": [{ "name": "plane_1", "offset_mm": 0.5 }], "n": 1 },
                "tre_true_mm": { "points": [{ "name": "M1", "x": 1.5 }], "mean_abs": { "x": 1.5 }, "rms": { "x": 1.75 }, "n": 1 },
            },
            "holes": [{ "n_hole": 72 }, { "n_hole": 61 }],
            "icp": { "iterations": 13, "normal_matrix": [[1, 2, 3, 4, 5, 6]], "a": { "b": { "c": { "x": 1 } } } },
        });
        let steps = text(&results, false).lines().unwrap();
        assert!(
            steps.contains("metrics.own") && !steps.contains("holes.1") && !steps.contains("iterations"),
            "{steps}"
        );
        let text = text(&results, true).lines().unwrap();
        let line = |start: &str| {
            let numbers = text.lines().find(|line| line.trim_start().starts_with(&format!("{start} ")));
            numbers
                .unwrap_or_else(|| panic!("no {start}: {text}"))
                .split_whitespace()
                .skip(1)
                .collect::<Vec<_>>()
                .join(" ")
        };
        assert_eq!(line("my_metric"), "3.2500");
        assert_eq!(line("metrics.own"), "gap_mm 0.1250 n 7 tilt_deg 0.0011 at [1 2.5000 -3]");
        assert!(!text.contains("plane_1"), "a table shows it: {text}");
        assert_eq!(line("metrics.tre_true_mm.rms"), "x 1.7500");
        assert_eq!(line("holes.1"), "n_hole 61");
        assert_eq!(line("icp"), "iterations 13");
        assert!(!text.contains("M1") && !text.contains("mean_tre_mm"), "tables show them: {text}");
        assert!(text.ends_with("  7 more numbers, of lists and nested parts, in results.json\n"), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
    }

    #[test]
    fn results_without_numbers_have_no_such_lines() {
        let none = json!({ "notice": "research use only", "simulated": true, "planes": [] });
        assert_eq!(super::text(&none, true).lines(), None);
    }
}
