//! `page.md`: the page's prose and the paper's numbers, with a request instead of each number of ours.
//!
//! A request is an inline table of TOML. It names the experiment `of` which it asks for a number of its summary, for the time of
//! its nodes, for a table of its settings, or for its comparison with another experiment.

use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;
use toml::de::ValueDeserializer;

const TEMPLATE: &str = include_str!("page.md");

/// Values of factors that select a setting.
pub(super) type Setting = BTreeMap<String, Value>;

#[derive(Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum Request {
    Number(Number),
    Time(Time),
    Pair(Pair),
    Table(Table),
}

/// A number of ours. In a row it becomes four cells: the number, its n, whether it is within the paper's spread, the command.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Number {
    pub(super) of: String,
    /// A path in summary.json: columns.NAME, points.MEASURE.AXIS or correlation.DRAW.COLUMN; * stands for x, y and z.
    pub(super) path: String,
    /// The key to show; without it mean, SD, minimum and maximum.
    pub(super) show: Option<String>,
    #[serde(default)]
    pub(super) setting: Setting,
    /// Whether to ignore the sign of our number.
    #[serde(default)]
    magnitude: bool,
    /// The range of ours that agrees, where the number beside it does not give one.
    within: Option<[f64; 2]>,
}

/// What nodes took; none: all but sources, which simulate, and metrics. In a row it becomes two cells: the time, and its share
/// of the paper's.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Time {
    pub(super) of: String,
    pub(super) nodes: Vec<String>,
}

/// The paired comparison with another experiment.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Pair {
    pub(super) of: String,
    pub(super) against: String,
    pub(super) columns: Vec<String>,
    /// The largest difference that does not matter.
    pub(super) margin_mm: f64,
}

/// A table of all settings.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Table {
    pub(super) of: String,
    pub(super) columns: Vec<String>,
}

impl Request {
    /// The experiments that it needs.
    pub(super) fn experiments(&self) -> Vec<&str> {
        match self {
            Self::Number(Number { of, .. }) | Self::Time(Time { of, .. }) | Self::Table(Table { of, .. }) => vec![of],
            Self::Pair(Pair { of, against, .. }) => vec![of, against],
        }
    }
}

/// A line of the template.
pub(super) struct Line {
    pub(super) before: &'static str,
    pub(super) request: Option<Request>,
    pub(super) after: &'static str,
}

impl Line {
    fn new(text: &'static str) -> Self {
        let Some((from, to)) = text.find("{ of").zip(text.rfind('}')) else {
            return Self { before: text, request: None, after: "" };
        };
        let request = ValueDeserializer::parse(&text[from..=to]).and_then(Request::deserialize);
        let request = Some(request.expect("a test reads every line"));
        Self { before: &text[..from], request, after: &text[to + 1..] }
    }

    /// The last cell before the request: what the paper gives.
    pub(super) fn theirs(&self) -> &'static str {
        self.before.trim_end_matches(" | ").rsplit(" | ").next().unwrap_or_default()
    }
}

/// The template by its sections; the first is what comes before them.
pub(super) fn sections() -> impl Iterator<Item = Vec<Line>> {
    let lines: Vec<&str> = TEMPLATE.lines().collect();
    let sections: Vec<_> = lines
        .chunk_by(|_, next| !next.starts_with("## "))
        .map(|lines| lines.iter().copied().map(Line::new))
        .map(Iterator::collect)
        .collect();
    sections.into_iter()
}

/// A row of the template with a number of ours.
pub(super) struct Row {
    /// Where the paper gives it; `None` for a number of another implementation.
    pub(super) section: Option<&'static str>,
    pub(super) what: &'static str,
    pub(super) theirs: &'static str,
    pub(super) number: Number,
}

impl Row {
    /// Whether a number of ours is within the spread of theirs; `None` if they give none.
    pub(super) fn judgement(&self, ours: f64) -> Option<Judgement> {
        self.number.judgement(self.theirs, ours)
    }
}

/// The rows of all tables.
pub(super) fn rows() -> impl Iterator<Item = Row> {
    sections().flatten().filter_map(|line| {
        let (theirs, before) = (line.theirs(), line.before.strip_prefix("| ")?);
        let (Some(Request::Number(number)), [head @ .., _, _]) =
            (line.request, &before.split(" | ").collect::<Vec<_>>()[..])
        else {
            return None;
        };
        let (section, what) = match head {
            [section, what] => (Some(*section), *what),
            [what] => (None, *what),
            _ => return None,
        };
        Some(Row { section, what, theirs, number })
    })
}

/// Whether a number of ours is within a spread, and how the page states it.
pub(super) struct Judgement {
    pub(super) is_within: bool,
    pub(super) text: String,
}

impl Number {
    /// Compares a number of ours with the spread of `theirs`.
    pub(super) fn judgement(&self, theirs: &str, ours: f64) -> Option<Judgement> {
        let [low, high] = self.within.or_else(|| spread(theirs))?;
        let ours = if self.magnitude { ours.abs() } else { ours };
        let round = |x: f64| (1e4 * x).round() / 1e4;
        let spread = format!("{} to {}", round(low), round(high));
        let (is_within, text) = match ours {
            ours if ours < low => (false, format!("**below** {spread}")),
            ours if ours > high => (false, format!("**above** {spread}")),
            _ => (true, format!("yes ({spread})")),
        };
        Some(Judgement { is_within, text })
    }
}

/// The spread of a number as the paper gives it: `0.3 ± 0.2 (0.1 to 0.8)`, `1.9, 1.7, 3.6`, `at most 2`, or `5.5`. The page
/// states the rule.
fn spread(theirs: &str) -> Option<[f64; 2]> {
    let numbers: Vec<f64> = theirs.split([' ', ',']).filter_map(|word| word.parse().ok()).collect();
    let first = *numbers.first()?;
    Some(match numbers[..] {
        [_, sd, ..] if theirs.contains('\u{b1}') => [first - sd, first + sd],
        _ if theirs.starts_with("at most") => [0.0, first],
        [_] => [0.5 * first, 1.5 * first],
        _ => [numbers.iter().copied().fold(f64::MAX, f64::min), numbers.iter().copied().fold(f64::MIN, f64::max)],
    })
}

#[cfg(test)]
mod tests;
