//! Axes: labels, scales and ticks.

use crate::degrees::shown_unit;

/// An axis of a chart.
#[derive(Debug, Clone)]
pub(crate) enum Axis {
    /// A linear axis, with its name and unit.
    Linear(String),
    /// A logarithmic axis; values that are not positive are drawn at its lower end.
    Log(String),
    /// Categories at 0, 1, 2 ...
    Categories {
        /// The name of the axis.
        label: String,
        /// The names of the categories.
        names: Vec<String>,
    },
}

/// The mapping from values to positions.
#[derive(Debug, Clone)]
pub(crate) struct Scale {
    pub(crate) log: bool,
    /// The range; logarithms on a logarithmic axis.
    from: f64,
    to: f64,
    start: f64,
    end: f64,
    /// Values with their labels.
    pub(crate) ticks: Vec<(f64, String)>,
}

impl Scale {
    pub(crate) fn place(&self, value: f64) -> f64 {
        let value = if self.log { value.max(f64::MIN_POSITIVE).log10().max(self.from) } else { value };
        self.start + (value - self.from) / (self.to - self.from) * (self.end - self.start)
    }

    pub(crate) fn holds(&self, value: f64) -> bool {
        (self.from..=self.to).contains(&value)
    }
}

impl Axis {
    pub(crate) fn label(&self) -> &str {
        match self {
            Self::Linear(label) | Self::Log(label) | Self::Categories { label, .. } => label,
        }
    }

    /// The names of the categories.
    pub(crate) fn categories(&self) -> &[String] {
        match self {
            Self::Categories { names, .. } => names,
            _ => &[],
        }
    }

    /// A scale that shows these values between two positions.
    pub(crate) fn scale(&self, values: &[f64], start: f64, end: f64) -> Scale {
        match self {
            Self::Categories { names, .. } => {
                let ticks = names.iter().enumerate().map(|(k, name)| (k as f64, name.clone())).collect();
                Scale { log: false, from: -0.5, to: names.len().max(1) as f64 - 0.5, start, end, ticks }
            }
            Self::Linear(_) => linear(values, start, end),
            Self::Log(_) => logarithmic(values, start, end),
        }
    }
}

fn linear(values: &[f64], start: f64, end: f64) -> Scale {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
    // A range near zero starts at zero.
    let (low, high) = match high - low {
        _ if low > 0.0 && low < 0.5 * high => (0.0, high),
        _ if high < 0.0 && high > 0.5 * low => (low, 0.0),
        span if span <= 1e-9 * high.abs().max(low.abs()).max(1e-12) => (low - 0.5, high + 0.5),
        _ => (low, high),
    };
    let margin = 0.04 * (high - low);
    let from = if low == 0.0 { 0.0 } else { low - margin };
    let to = if high == 0.0 { 0.0 } else { high + margin };
    let raw = (to - from) / 6.0;
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 2.5, 5.0, 10.0].map(|m| m * power).into_iter().find(|step| *step >= raw).unwrap_or(raw);
    let one_more = if (step / power - 2.5).abs() < 1e-9 { 1.0 } else { 0.0 };
    let digits = (one_more - (step.log10() + 1e-9).floor()).max(0.0) as usize;
    let first = (from / step - 1e-9).ceil() as i64;
    let last = (to / step + 1e-9).floor() as i64;
    let ticks = (first..=last).map(|k| (k as f64 * step, tick_label(k as f64 * step, digits))).collect();
    Scale { log: false, from, to, start, end, ticks }
}

fn logarithmic(values: &[f64], start: f64, end: f64) -> Scale {
    let above = || values.iter().copied().filter(|v| *v > 0.0);
    let low = above().fold(f64::INFINITY, f64::min);
    let high = above().fold(f64::NEG_INFINITY, f64::max);
    let (low, high) = if low <= high { (low.log10(), high.log10()) } else { (0.0, 1.0) };
    let margin = (0.05 * (high - low)).max(0.05);
    let (from, to) = (low - margin, high + margin);
    let decades = (from.ceil() as i32..=to.floor() as i32).collect::<Vec<_>>();
    let every = decades.len().div_ceil(7).max(1);
    let mut ticks: Vec<_> = decades.iter().step_by(every).map(|&k| (10f64.powi(k), power(k))).collect();
    if decades.len() <= 2 {
        for k in from.floor() as i32..=to.floor() as i32 {
            let between = [2.0, 5.0].map(|m| m * 10f64.powi(k)).into_iter();
            let between = between.filter(|v| (from..=to).contains(&v.log10()));
            ticks.extend(between.map(|v| (v, tick_label(v, (1 - k).clamp(0, 9) as usize * usize::from(k < 0)))));
        }
    }
    Scale { log: true, from, to, start, end, ticks }
}

fn power(k: i32) -> String {
    match k {
        -3..=5 => tick_label(10f64.powi(k), (-k).max(0) as usize),
        _ => {
            let digit = |c: char| match c {
                '-' => '\u{207b}',
                c => [
                    '\u{2070}', '\u{b9}', '\u{b2}', '\u{b3}', '\u{2074}', '\u{2075}', '\u{2076}', '\u{2077}',
                    '\u{2078}', '\u{2079}',
                ][c.to_digit(10).unwrap_or(0) as usize],
            };
            format!("10{}", k.to_string().chars().map(digit).collect::<String>())
        }
    }
}

/// Formats with this number of decimals, a minus sign and thin spaces between thousands.
fn tick_label(value: f64, digits: usize) -> String {
    let text = format!("{:.digits$}", value.abs());
    let (whole, rest) = text.split_once('.').map_or((text.as_str(), None), |(w, r)| (w, Some(r)));
    let mut out = String::new();
    if value < 0.0 && text.bytes().any(|b| (b'1'..=b'9').contains(&b)) {
        out.push('\u{2212}');
    }
    for (k, digit) in whole.chars().enumerate() {
        if k > 0 && (whole.len() - k).is_multiple_of(3) && whole.len() > 4 {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    if let Some(rest) = rest {
        out.push('.');
        out.push_str(rest);
    }
    out
}

/// The label of a column, with its unit: `tre_z_mm` becomes `tre z (mm)`.
pub(crate) fn axis_label(column: &str) -> String {
    const UNITS: [(&str, &str); 10] = [
        ("_per_mm", "per mm"),
        ("_mm2", "mm\u{b2}"),
        ("_mm", "mm"),
        ("_rad", "rad"),
        ("_deg", "\u{b0}"),
        ("_ms", "ms"),
        ("_ns", "ns"),
        ("_hz", "Hz"),
        ("_s", "s"),
        ("_share", "share"),
    ];
    // Angles are shown in degrees.
    let (column, _) = shown_unit(column);
    let unit = UNITS.iter().find_map(|(end, unit)| Some((column.strip_suffix(end)?, unit)));
    match unit {
        Some((name, unit)) if !name.is_empty() => format!("{} ({unit})", name.replace('_', " ")),
        _ => column.replace('_', " "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_lie_within() {
        let scale = Axis::Linear("a".into()).scale(&[-0.31, 0.72], 0.0, 100.0);
        let words: Vec<_> = scale.ticks.iter().map(|(_, word)| word.as_str()).collect();
        assert_eq!(words, ["\u{2212}0.2", "0.0", "0.2", "0.4", "0.6"]);
        assert!(scale.place(-0.31) > 0.0 && scale.place(0.72) < 100.0);
        let scale = Axis::Linear("a".into()).scale(&[3.0, 3.0], 0.0, 100.0);
        assert!((scale.place(3.0) - 50.0).abs() < 1e-9, "one value lies in the middle");
        let scale = Axis::Linear("a".into()).scale(&[0.0, 140.0], 0.0, 100.0);
        assert_eq!(scale.ticks[1].1, "25", "quarters of a hundred have no digits behind the point");
        let counts = Axis::Log("n".into()).scale(&[100.0, 20_000.0], 0.0, 100.0);
        let words: Vec<_> = counts.ticks.iter().map(|(_, word)| word.as_str()).collect();
        assert_eq!(words, ["100", "1000", "10\u{202f}000"]);
        let empty = Axis::Linear("a".into()).scale(&[], 0.0, 100.0);
        assert!(empty.place(0.5).is_finite());
    }

    #[test]
    fn a_column_is_named_with_its_unit() {
        let names = ["tre_z_mm", "icp_time_ms", "inlier_share", "iterations", "tilt_rad"].map(axis_label);
        assert_eq!(names, ["tre z (mm)", "icp time (ms)", "inlier (share)", "iterations", "tilt (\u{b0})"]);
    }
}
