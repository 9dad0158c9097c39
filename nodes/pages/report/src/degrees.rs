//! Angles of a summary in degrees, as pages and terminals show them; the file has radians.

use serde_json::Value;

/// Entries of a column's statistics or comparison that are no quantity of the column: counts, shares and probabilities.
const NO_QUANTITIES: [&str; 11] =
    ["level", "share", "alpha", "icc", "wilcoxon", "p", "p_lower", "p_upper", "p_holm", "n0", "n_effective"];

/// The name of a column with the unit that is shown, and the number by which its values are multiplied.
pub fn shown_unit(column: &str) -> (String, f64) {
    match column.strip_suffix("_rad") {
        Some(of) => (format!("{of}_deg"), 1.0_f64.to_degrees()),
        None => (column.to_owned(), 1.0),
    }
}

/// The name of a column, and its number, list, statistics or comparison, in degrees if they are in radians.
pub fn in_degrees(column: &str, of: &Value) -> (String, Value) {
    let (name, scale) = shown_unit(column);
    let mut of = of.clone();
    if scale != 1.0 {
        // Its interval is of the share, and only its limit of the column.
        let share = of.get_mut("share_below").map(Value::take);
        let has_counts = of.is_object();
        multiply(&mut of, scale, has_counts);
        if let Some(mut share) = share {
            if let Some(limit) = share["limit"].as_f64() {
                share["limit"] = (limit * scale).into();
            }
            of["share_below"] = share;
        }
    }
    (name, of)
}

/// Multiplies all numbers but those that are no quantity of the column and, if it has counts, whole ones.
fn multiply(of: &mut Value, scale: f64, has_counts: bool) {
    match of {
        Value::Object(entries) => {
            for (key, value) in entries.iter_mut() {
                if !NO_QUANTITIES.contains(&key.as_str()) {
                    multiply(value, scale, has_counts);
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| multiply(item, scale, has_counts)),
        Value::Number(number) if number.is_f64() || !has_counts => {
            if let Some(value) = number.as_f64() {
                *of = (value * scale).into();
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn angles_are_in_degrees_and_counts_shares_and_probabilities_stay() {
        let turn = std::f64::consts::FRAC_PI_2;
        let of = json!({
            "n": 4, "mean": turn, "mean_interval": { "level": 0.95, "low": turn, "high": turn }, "p_holm": 0.25,
            "tost": { "margin": turn, "p": 0.125 }, "wilcoxon": { "p": 0.5, "rank_biserial": 1.0 },
            "share_below": { "limit": turn, "share": 0.75, "interval": { "low": 0.5, "high": 1.0 } },
        });
        let (name, shown) = in_degrees("tilt_rad", &of);
        assert_eq!(name, "tilt_deg");
        for path in ["/mean", "/mean_interval/low", "/mean_interval/high", "/tost/margin", "/share_below/limit"] {
            assert_eq!(shown.pointer(path), Some(&json!(90.0)), "{path}");
        }
        for path in ["/n", "/mean_interval/level", "/p_holm", "/tost/p", "/wilcoxon", "/share_below/interval"] {
            assert_eq!(shown.pointer(path), of.pointer(path), "{path}");
        }
        assert_eq!(in_degrees("tre_mm", &of), ("tre_mm".into(), of));
        assert_eq!(
            in_degrees("turn_rad", &json!([turn, 0])),
            ("turn_deg".into(), json!([90.0, 0.0])),
            "a whole number is an angle, too"
        );
    }
}
