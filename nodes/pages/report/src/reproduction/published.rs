//! The content of `published.toml`: the paper's numbers, the interpretations of the paper, and where to find our numbers.

use crate::summary::word;
use osteoflow_engine::run::NodeStats;
use serde::Deserialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// Values of factors that select a setting.
pub(super) type Setting = BTreeMap<String, Value>;

/// The file as it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    fact: Vec<Fact>,
    row: Vec<FileRow>,
    time: Vec<Time>,
    independent: Vec<FileRow>,
    reading: Vec<Reading>,
    pair: Vec<ExperimentPair>,
    table: Vec<Table>,
}

/// The content of the file, with a row for each number.
#[derive(Debug)]
pub(super) struct Published {
    pub(super) fact: Vec<Fact>,
    pub(super) row: Vec<PublishedNumber>,
    pub(super) time: Vec<Time>,
    /// Numbers of another implementation.
    pub(super) independent: Vec<PublishedNumber>,
    pub(super) reading: Vec<Reading>,
    pub(super) pair: Vec<ExperimentPair>,
    pub(super) table: Vec<Table>,
}

/// What the paper says of one quantity: one number, or one for each axis or each value of a factor.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Fact {
    pub(super) id: String,
    pub(super) section: String,
    /// The definition of the quantity.
    pub(super) what: String,
    #[serde(default)]
    pub(super) unit: String,
    /// Name and values of what the numbers are listed over: `axis`, or a factor of the experiment.
    #[serde(default)]
    over: BTreeMap<String, Vec<Value>>,
    #[serde(default)]
    mean: Vec<f64>,
    #[serde(default)]
    sd: Vec<f64>,
    min: Option<f64>,
    max: Option<f64>,
    /// Single values.
    #[serde(default)]
    values: Vec<f64>,
    /// The range of ours that agrees, where the paper gives no spread and [`RULE`] names another.
    #[serde(default)]
    within: Vec<f64>,
}

/// A row as it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileRow {
    /// What the paper says; `None` for a number that it does not give.
    fact: Option<String>,
    experiment: String,
    /// How ours is computed; the whole description where there is no fact.
    #[serde(default)]
    what: String,
    /// Values of a factor; one row for each.
    #[serde(default)]
    over: BTreeMap<String, Vec<Value>>,
    /// Numbers of another implementation.
    #[serde(default)]
    theirs: String,
    #[serde(default)]
    section: String,
    spread: Option<[f64; 2]>,
    #[serde(default)]
    magnitude: bool,
    ours: String,
    show: Option<String>,
    #[serde(default)]
    setting: Setting,
    #[serde(default)]
    remark: String,
}

/// A number of the paper, or of another implementation, and where to find ours.
#[derive(Debug, Default)]
pub(super) struct PublishedNumber {
    pub(super) experiment: String,
    pub(super) section: String,
    pub(super) what: String,
    pub(super) theirs: String,
    spread: Option<[f64; 2]>,
    /// Whether to ignore the sign of our number.
    magnitude: bool,
    pub(super) ours: String,
    pub(super) show: Option<String>,
    pub(super) setting: Setting,
    pub(super) remark: String,
}

/// A time that the paper gives, and the nodes of ours that have a share in it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Time {
    pub(super) fact: String,
    pub(super) experiment: String,
    /// The nodes; none: all but sources, which simulate, and metrics.
    pub(super) nodes: Vec<String>,
    /// What the rest of the paper's time goes to.
    pub(super) rest: String,
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
pub(super) const RULE: &str = "The paper's spread is its mean ± its SD, or the range of its single values. Where it gives \
     neither, half to one and a half of its number is taken; of a correlation a size of 0.9 to 1; what the field wants is an \
     upper limit. Ours can be outside on either side: smaller errors than the paper's are reported as below.";

impl Fact {
    /// Number of numbers.
    fn n(&self) -> usize {
        self.over.values().map(Vec::len).next().unwrap_or(1)
    }

    /// The numbers as text, at the index of [`Fact::over`].
    pub(super) fn text(&self, k: usize) -> String {
        if !self.values.is_empty() {
            return self.values.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
        }
        let mut text = match (self.mean.get(k), self.max) {
            (Some(mean), _) => mean.to_string(),
            (None, Some(max)) => format!("at most {max}"),
            (None, None) => String::new(),
        };
        if let Some(sd) = self.sd.get(k) {
            text += &format!(" ± {sd}");
        }
        if let (Some(_), Some(min), Some(max)) = (self.mean.get(k), self.min, self.max) {
            text += &format!(" ({min} to {max})");
        }
        text
    }

    /// The spread, by [`RULE`].
    fn spread(&self, k: usize) -> Option<[f64; 2]> {
        if let [low, high] = self.within[..] {
            return Some([low, high]);
        }
        if !self.values.is_empty() {
            let range = self.values.iter().fold([f64::MAX, f64::MIN], |[a, b], v| [v.min(a), v.max(b)]);
            return Some(range);
        }
        match (self.mean.get(k), self.sd.get(k)) {
            (Some(mean), Some(sd)) => Some([mean - sd, mean + sd]),
            (Some(mean), None) => Some([0.5 * mean, 1.5 * mean]),
            (None, _) => self.max.map(|max| [0.0, max]),
        }
    }
}

impl Time {
    /// What the nodes took, in seconds; `None` if one of them is missing.
    pub(super) fn computed_s(&self, nodes: &[NodeStats]) -> Option<f64> {
        let all_there = self.nodes.iter().all(|name| nodes.iter().any(|node| node.name == *name));
        let own = nodes.iter().filter(|node| self.nodes.is_empty() || self.nodes.contains(&node.name));
        all_there.then(|| own.map(|node| node.busy.as_secs_f64()).sum())
    }

    /// What the paper gives, in seconds.
    pub(super) fn seconds(&self, fact: &Fact) -> Option<f64> {
        let unit_s = match fact.unit.as_str() {
            "min" => 60.0,
            "ms" => 1e-3,
            _ => 1.0,
        };
        fact.mean.first().map(|mean| mean * unit_s)
    }
}

impl Published {
    pub(super) fn new() -> Self {
        let file: File = toml::from_str(include_str!("published.toml")).expect("a test reads it");
        let fact = |id: &str| file.fact.iter().find(|fact| fact.id == id);
        let row = file.row.iter().flat_map(|row| row.expand(row.fact.as_deref().and_then(fact))).collect();
        let independent = file.independent.iter().flat_map(|row| row.expand(None)).collect();
        let File { fact, time, reading, pair, table, .. } = file;
        Self { fact, row, time, independent, reading, pair, table }
    }

    /// The fact of that name.
    pub(super) fn fact(&self, id: &str) -> Option<&Fact> {
        self.fact.iter().find(|fact| fact.id == id)
    }
}

impl FileRow {
    /// A row for each number of the fact.
    fn expand(&self, fact: Option<&Fact>) -> Vec<PublishedNumber> {
        let settings = self.over.iter().flat_map(|(name, values)| values.iter().map(move |value| Some((name, value))));
        let mut settings: Vec<_> = settings.collect();
        if settings.is_empty() {
            settings.push(None);
        }
        let n = fact.map_or(1, Fact::n);
        let mut rows: Vec<_> =
            settings.into_iter().flat_map(|setting| (0..n).map(move |k| self.one(fact, k, setting))).collect();
        // The remark is about all of them and is shown once.
        rows.iter_mut().skip(1).for_each(|row| row.remark.clear());
        rows
    }

    fn one(&self, fact: Option<&Fact>, k: usize, setting: Option<(&String, &Value)>) -> PublishedNumber {
        let mut row = PublishedNumber {
            experiment: self.experiment.clone(),
            section: self.section.clone(),
            what: self.what.clone(),
            theirs: self.theirs.clone(),
            spread: self.spread,
            magnitude: self.magnitude,
            ours: self.ours.clone(),
            show: self.show.clone(),
            setting: self.setting.clone(),
            remark: self.remark.clone(),
        };
        let mut parts: Vec<String> = fact.map(|fact| fact.what.clone()).into_iter().collect();
        parts.extend(Some(self.what.clone()).filter(|what| !what.is_empty()));
        if let Some((name, value)) = setting {
            parts.push(word(value));
            row.setting.insert(name.clone(), value.clone());
        }
        if let Some(fact) = fact {
            row.section.clone_from(&fact.section);
            row.theirs = fact.text(k);
            row.spread = fact.spread(k);
            for (name, values) in &fact.over {
                let value = word(&values[k]);
                parts.push(format!("{} {value}", name.trim_start_matches("n_")));
                match name.as_str() {
                    "axis" => row.ours = row.ours.replace('*', &value),
                    _ => drop(row.setting.insert(name.clone(), values[k].clone())),
                }
            }
        } else if row.theirs.is_empty() {
            row.theirs = "not given".into();
        }
        row.what = parts.join("; ");
        if let Some(unit) = fact.map(|fact| &fact.unit).filter(|unit| !unit.is_empty()) {
            row.what += &format!(", {unit}");
        }
        row
    }
}

impl PublishedNumber {
    /// The spread as text, and on which side of it `ours` is.
    pub(super) fn judged(&self, ours: f64) -> Option<Judged> {
        let [low, high] = self.spread?;
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
mod tests;
