//! Thresholds that are laxer than by default.

use osteoflow_algorithms::trust::{EvidenceParams, RuleParams, When};
use serde_json::Value;
use std::collections::HashMap;

/// Thresholds whose names do not say which way is laxer.
const LAXER_IF_SMALLER: [&str; 1] = ["max_latency_s"];
const LAXER_EITHER_WAY: [&str; 1] = ["min_shape_clearness"];

/// What is taken for granted because these thresholds are laxer than by default, each by name, value and default; `None` if none is.
pub(super) fn loosened(rules: &RuleParams, examine: &EvidenceParams) -> Option<String> {
    let numbers = |rules: &RuleParams| {
        let mut all = Vec::new();
        collect("rules", &serde_json::to_value(rules).unwrap_or_default(), &mut all);
        all
    };
    let default: HashMap<String, f64> = numbers(&RuleParams::default()).into_iter().collect();
    let mut laxer: Vec<String> = numbers(rules)
        .into_iter()
        .filter_map(|(name, value)| default.get(&name).map(|default| (name, value, *default)))
        .filter(|(name, value, default)| is_laxer(name, *value, *default))
        .map(|(name, value, default)| format!("{name} = {value} (default {default})"))
        .collect();
    if !examine.shape {
        laxer.push("examine.shape = false (default true)".into());
    }
    if examine.mirror == When::Never {
        laxer.push("examine.mirror = \"never\" (default \"if_raised\")".into());
    }
    (!laxer.is_empty())
        .then(|| format!("thresholds are laxer than by default, as the graph sets them: {}", laxer.join(", ")))
}

fn is_laxer(name: &str, value: f64, default: f64) -> bool {
    let key = name.rsplit('.').next().unwrap_or(name);
    if LAXER_EITHER_WAY.contains(&key) {
        return value != default;
    }
    if LAXER_IF_SMALLER.contains(&key) || key.starts_with("min_") { value < default } else { value > default }
}

/// The numbers of a table, by their paths.
fn collect(path: &str, value: &Value, into: &mut Vec<(String, f64)>) {
    match value {
        Value::Object(table) => table.iter().for_each(|(key, value)| collect(&format!("{path}.{key}"), value, into)),
        value => into.extend(value.as_f64().map(|number| (path.to_owned(), number))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_algorithms::trust::Limits;

    fn told(rules: &RuleParams) -> Option<String> {
        loosened(rules, &EvidenceParams::default())
    }

    #[test]
    fn a_laxer_threshold_is_told_by_name_value_and_default_and_a_stricter_one_is_not() {
        let default = RuleParams::default();
        assert_eq!(told(&default), None);
        let stricter = RuleParams { max_misfit_mm: 0.1, min_on_surface: 0.5, max_latency_s: 0.2, ..default.clone() };
        assert_eq!(told(&stricter), None);
        let limits = Limits { max_tre_mm: 3.0, ..Limits::default() };
        let laxer = RuleParams { limits, min_on_surface: 0.1, max_latency_s: 0.01, ..default.clone() };
        let words = "thresholds are laxer than by default, as the graph sets them: ";
        let text = told(&laxer).unwrap();
        assert!(text.starts_with(words), "{text}");
        for one in [
            "rules.limits.max_tre_mm = 3 (default 1.5)",
            "rules.min_on_surface = 0.1 (default 0.35)",
            "rules.max_latency_s = 0.01 (default 0.1)",
        ] {
            assert!(text.contains(one), "{text}");
        }
        assert!(!text.contains("max_misfit_mm"), "{text}");
        let none = EvidenceParams { shape: false, mirror: When::Never };
        let text = loosened(&default, &none).unwrap();
        assert!(
            text.ends_with("examine.shape = false (default true), examine.mirror = \"never\" (default \"if_raised\")"),
            "{text}"
        );
    }
}
