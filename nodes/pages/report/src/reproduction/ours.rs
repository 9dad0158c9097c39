//! Finds a number of ours in the summary of a sweep.

use super::template::Setting;
use crate::summary::{units, word};
use osteoflow_statistics::counted;
use serde_json::Value;

/// A number of ours.
#[derive(Debug, PartialEq)]
pub(super) struct Ours {
    /// The number to compare with the paper's; `None` if several are shown at once.
    pub(super) value: Option<f64>,
    pub(super) text: String,
    /// The count and the units.
    pub(super) n: String,
}

impl Ours {
    /// The sweep was run and has no such number.
    pub(super) fn none(path: &str) -> Self {
        Self { value: None, text: format!("**none**: the sweep has no {path}"), n: "0".into() }
    }

    /// Finds `path` in a summary under a setting and shows its key `show`, or mean, SD and range.
    pub(super) fn find(summary: &Value, path: &str, setting: &Setting, show: Option<&str>) -> Option<Self> {
        // `100` and `100.0` are equal.
        let same = |a: &Value, b: &Value| a == b || (a.as_f64().is_some() && a.as_f64() == b.as_f64());
        let groups = summary["groups"].as_array()?;
        let group =
            groups.iter().find(|group| setting.iter().all(|(name, value)| same(&group["setting"][name], value)))?;
        if path.contains(".*") {
            let axes = ["x", "y", "z"].map(|axis| Self::of(group, &path.replace('*', axis), show));
            let [Some(x), Some(y), Some(z)] = axes else { return None };
            return Some(Self { value: None, text: format!("[{}; {}; {}]", x.text, y.text, z.text), n: x.n });
        }
        Self::of(group, path, show)
    }

    fn of(group: &Value, path: &str, show: Option<&str>) -> Option<Self> {
        let parts: Vec<_> = path.split('.').collect();
        if let ["correlation", draw, column] = parts[..] {
            let all = group["correlations"].as_array()?;
            let correlation = all.iter().find(|c| c["draw"] == draw && c["column"] == column)?;
            let value = correlation["pearson"]["r"].as_f64()?;
            let n = counted(correlation["n"].as_u64()? as usize, &word(&correlation["unit"]));
            return Some(Self { value: Some(value), text: format!("{value:.3}"), n });
        }
        let mut at = group;
        let mut n = String::new();
        for part in parts {
            at = &at[part];
            if at["n_units"].is_array() {
                n = units(&at["n_units"]);
            }
        }
        let number = |key: &str| at[key].as_f64();
        let (value, text) = match show {
            Some(key) => (number(key)?, format!("{:.2}", number(key)?)),
            None => {
                let sd = number("sd").map_or_else(String::new, |sd| format!(" ± {sd:.2}"));
                let range = format!("({:.2} to {:.2})", number("min")?, number("max")?);
                (number("mean")?, format!("{:.2}{sd} {range}", number("mean")?))
            }
        };
        Some(Self { value: Some(value), text, n })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_number_is_found_by_its_setting_with_the_units_that_it_is_of() {
        let axis = |sd: f64| {
            json!({
                "mean": 0.5, "sd": 0.1, "min": 0.3, "max": 0.9, "n_units": [{ "name": "bone", "n": 3 }],
                "within_points": { "sd_within": sd },
            })
        };
        let summary = json!({ "groups": [
            { "setting": { "n": 100.0 }, "points": { "e_mm": { "x": axis(0.1), "y": axis(0.2), "z": axis(0.3) } } },
            { "setting": { "n": 200.0 }, "correlations": [
                { "draw": "first_mm", "column": "z_mm", "n": 200, "unit": "placement", "pearson": { "r": -0.98 } },
            ] },
        ] });
        let find = |path: &str, n: u64, show| {
            Ours::find(&summary, path, &Setting::from([("n".to_owned(), n.into())]), show)
                .map(|o| (o.value, o.text, o.n))
        };
        let ours = |value, text: &str, n: &str| Some((value, text.to_owned(), n.to_owned()));
        assert_eq!(find("points.e_mm.x", 100, None), ours(Some(0.5), "0.50 ± 0.10 (0.30 to 0.90)", "3 bones"));
        let within = find("points.e_mm.*.within_points", 100, Some("sd_within"));
        assert_eq!(within, ours(None, "[0.10; 0.20; 0.30]", "3 bones"));
        assert_eq!(find("correlation.first_mm.z_mm", 200, None), ours(Some(-0.98), "-0.980", "200 placements"));
        assert_eq!(find("points.e_mm.x", 200, None), None);
    }
}
