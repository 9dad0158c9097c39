//! The content of `published.toml`: the paper's numbers, the interpretations of the paper, and where to find our numbers.

use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// Values of factors that select a setting.
pub(super) type Setting = BTreeMap<String, Value>;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Published {
    pub(super) row: Vec<PublishedNumber>,
    /// Numbers of another implementation.
    pub(super) independent: Vec<PublishedNumber>,
    pub(super) reading: Vec<Reading>,
    pub(super) pair: Vec<ExperimentPair>,
    pub(super) table: Vec<Table>,
}

/// A number of the paper, or of another implementation.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PublishedNumber {
    pub(super) experiment: String,
    #[serde(default)]
    pub(super) section: String,
    pub(super) what: String,
    #[serde(alias = "paper")]
    pub(super) theirs: String,
    mean: Option<f64>,
    sd: Option<f64>,
    spread: Option<[f64; 2]>,
    /// Whether to ignore the sign of our number.
    #[serde(default)]
    magnitude: bool,
    pub(super) ours: String,
    pub(super) show: Option<String>,
    #[serde(default)]
    pub(super) setting: Setting,
    #[serde(default)]
    pub(super) remark: String,
}

/// A statement of the paper that can be understood in several ways.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Reading {
    pub(super) question: String,
    pub(super) reading: String,
    #[serde(default)]
    pub(super) shows: Vec<Shown>,
}

/// A number of ours beside an interpretation.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Shown {
    pub(super) name: String,
    pub(super) experiment: String,
    pub(super) ours: String,
    #[serde(default)]
    pub(super) setting: Setting,
}

/// Two experiments that are compared in pairs.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExperimentPair {
    pub(super) title: String,
    pub(super) section: String,
    pub(super) first: String,
    pub(super) second: String,
    pub(super) columns: Vec<String>,
    /// The largest difference that does not matter.
    pub(super) margin_mm: f64,
    /// The reason for the margin.
    pub(super) margin_reason: String,
}

/// A table of all settings of an experiment.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Table {
    pub(super) experiment: String,
    pub(super) title: String,
    pub(super) columns: Vec<String>,
}

/// The definition of the spread, as the page states it.
pub(super) const RULE: &str = "The paper's spread is its mean ± its SD. Where it gives no SD, half to one \
     and a half of its number is taken instead, by one rule for all such rows; of three single values it is their range, of \
     a correlation a size of 0.9 to 1. Ours can be outside on either side: smaller errors than the paper's are reported as \
     below.";

impl Published {
    pub(super) fn new() -> Self {
        toml::from_str(include_str!("published.toml")).expect("a test reads it")
    }
}

impl PublishedNumber {
    /// The paper's spread, by [`RULE`].
    pub(super) fn spread(&self) -> Option<[f64; 2]> {
        match (self.mean, self.sd) {
            (Some(mean), Some(sd)) => Some([mean - sd, mean + sd]),
            (Some(mean), None) => Some([0.5 * mean, 1.5 * mean]),
            (None, _) => self.spread,
        }
    }

    /// The spread as text, and on which side of it `ours` is.
    pub(super) fn judged(&self, ours: f64) -> Option<Judged> {
        let [low, high] = self.spread()?;
        let ours = if self.magnitude { ours.abs() } else { ours };
        let round = |x: f64| (1e4 * x).round() / 1e4;
        let spread = format!("{} to {}", round(low), round(high));
        Some(match ours {
            ours if ours < low => Judged::Outside(format!("**below** {spread}")),
            ours if ours > high => Judged::Outside(format!("**above** {spread}")),
            _ => Judged::Within(format!("yes ({spread})")),
        })
    }
}

/// Whether a number of ours is within the paper's spread.
#[derive(Debug, PartialEq)]
pub(super) enum Judged {
    Within(String),
    Outside(String),
}

#[cfg(test)]
mod tests {
    use super::{super::EXPERIMENTS, *};

    #[test]
    fn the_table_of_the_papers_numbers_is_sound_and_names_experiments_that_are_there() {
        let published = Published::new();
        let rows = || published.row.iter().chain(&published.independent);
        let shown = published.reading.iter().flat_map(|reading| &reading.shows).map(|shown| &shown.experiment);
        let paired = published.pair.iter().flat_map(|pair| [&pair.first, &pair.second]);
        for name in rows()
            .map(|row| &row.experiment)
            .chain(shown)
            .chain(paired)
            .chain(published.table.iter().map(|table| &table.experiment))
        {
            assert!(EXPERIMENTS.contains(&name.as_str()), "{name}");
        }
        for row in rows() {
            assert!(row.mean.is_none() || row.spread.is_none(), "{} has two spreads", row.what);
            assert!(row.sd.is_none() || row.mean.is_some(), "{} has an SD about nothing", row.what);
            assert!(row.spread().is_none_or(|[low, high]| low < high), "{}", row.what);
        }
    }

    #[test]
    fn a_number_outside_the_spread_is_shown_with_its_side() {
        let judged = |row: &PublishedNumber, ours| match row.judged(ours) {
            Some(Judged::Within(text) | Judged::Outside(text)) => text,
            None => "not judged".into(),
        };
        let with_sd = PublishedNumber { mean: Some(0.3), sd: Some(0.2), ..PublishedNumber::default() };
        let texts = [0.3, 0.6, 0.05].map(|ours| judged(&with_sd, ours));
        assert_eq!(texts, ["yes (0.1 to 0.5)", "**above** 0.1 to 0.5", "**below** 0.1 to 0.5"]);
        let without = PublishedNumber { mean: Some(0.9), ..PublishedNumber::default() };
        assert_eq!([0.2, 0.5].map(|ours| judged(&without, ours)), ["**below** 0.45 to 1.35", "yes (0.45 to 1.35)"]);
        let size = PublishedNumber { spread: Some([0.9, 1.0]), magnitude: true, ..PublishedNumber::default() };
        assert_eq!(judged(&size, -0.95), "yes (0.9 to 1)");
        assert_eq!(judged(&PublishedNumber::default(), 1.0), "not judged");
    }
}
