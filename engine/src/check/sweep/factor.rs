//! Reads `[sweep.factor]`: a list of values, a range of numbers, or files.

use super::{
    Reader,
    spec::{Factor, Level},
};
use crate::{
    fault::Fault,
    graph::{
        Entry, Spanned, Table, Value,
        extract::{self, Section},
        grammar,
    },
};
use serde_json::Value as Json;

/// Most values of a factor: each is compared with all others, and is a row of the tables.
pub(super) const MAX_LEVELS: u64 = 10_000;

impl Reader<'_> {
    pub(super) fn factor(&mut self, entry: &Entry) -> Option<Factor> {
        let (owner, before) = (format!("factor \"{}\"", entry.key), self.faults.len());
        let table = extract::table(&entry.value, &owner, self.faults)?;
        let section = Section::new(table, &grammar::FACTOR, &owner, &*owner, self.faults);
        let mut ways = ["values", "files", "variants"].iter().filter_map(|way| table.get(way));
        let (way, second) = (ways.next(), ways.next());
        if let (Some(way), Some(second)) = (way, second) {
            let message = format!("{owner} has {} and {}", way.key, second.key);
            self.fault(&second.key_at, message, "the second", "keep one of them");
        }
        let levels = match way {
            Some(values) => {
                if let Some(entry) = ["from", "to", "n", "log"].iter().find_map(|key| section.get(key)) {
                    let message = format!("{owner} has {} and a range", values.key);
                    self.fault(&entry.key_at, message, "a range", "keep one of them");
                }
                match values.key.as_str() {
                    "values" => self.listed(&section, values, &owner)?,
                    "files" => self.files(&section, values, &owner)?,
                    _ => self.variants(&section, values, &owner)?,
                }
            }
            // A misspelt key is that fault alone.
            None if self.faults.len() > before && ["from", "to", "n"].iter().all(|key| table.get(key).is_none()) => {
                return None;
            }
            // Faults of the range do not name the factor.
            None => self.grid(&section, &Section::known(table, &grammar::FACTOR, ""), entry, &owner)?,
        };
        if levels.is_empty() {
            if self.faults.len() == before {
                self.fault(&entry.key_at, format!("{owner} has no value"), "empty", "give at least one value");
            }
            return None;
        }
        for (index, level) in levels.iter().enumerate() {
            if levels[..index].iter().any(|before| before.label == level.label) {
                let message = format!("{owner} has the value {} twice", level.label);
                self.fault(&entry.key_at, message, "twice", "take one away, or tell them apart by labels = [..]");
                return None;
            }
        }
        Some(Factor { name: entry.key.clone(), levels })
    }

    /// `values = [..]`; a value that is a table sets the keys it names.
    fn listed(&mut self, table: &Section<'_>, values: &Entry, owner: &str) -> Option<Vec<Level>> {
        let Value::Array(items) = &values.value.value else {
            let takes = format!("{owner}: values takes a list");
            self.faults.push(extract::refused(&values.value, takes, "a list is needed"));
            return None;
        };
        if items.len() as u64 > MAX_LEVELS {
            let message = format!("{owner} has {} values, at most {MAX_LEVELS} are possible", items.len());
            self.fault(&values.key_at, message, "too many", "split the sweep, or draw the values at random");
            return None;
        }
        let keyed = table.get("key").is_some() || table.get("keys").is_some();
        let keys = self.keys(table, owner, items.iter().any(|item| item.as_table().is_none()));
        let labels = self.labels(table, items.len(), owner)?;
        let level = |(index, item): (usize, &Spanned)| {
            let sets = match (item.as_table(), keyed) {
                (Some(table), false) => leaves(table, ""),
                _ => keys.iter().map(|key| format!("{key}={}", literal(item))).collect(),
            };
            let label = match &labels {
                Some(labels) => labels[index].clone().into(),
                None => item.to_json(),
            };
            Level { label, sets, variant: None }
        };
        Some(items.iter().enumerate().map(level).collect())
    }

    /// The labels of `n` values, if they have any; `None` after a fault.
    pub(super) fn labels(&mut self, table: &Section<'_>, n: usize, owner: &str) -> Option<Option<Vec<String>>> {
        let Some(labels) = table.get("labels") else { return Some(None) };
        let texts = self.texts(&labels.value, &table.what("labels"));
        if texts.len() != n {
            let message = format!("{owner} has {n} values and {} labels", texts.len());
            self.fault(&labels.key_at, message, "one for each value", "give each value its label");
            return None;
        }
        Some(Some(texts))
    }

    /// `from = 0.0, to = 0.2, n = 5`: evenly spaced, or spaced in the logarithm with `log = true`.
    fn grid(&mut self, table: &Section<'_>, range: &Section<'_>, entry: &Entry, owner: &str) -> Option<Vec<Level>> {
        let keys = self.keys(table, owner, true);
        let mut number = |key: &str| {
            let value = table.get(key).map(|entry| &entry.value);
            let number = value.and_then(Spanned::as_number).filter(|number| number.is_finite());
            if number.is_none() {
                let at = value.map_or(&entry.key_at, |value| &value.at);
                let fault = Fault::new(format!("{owner} needs values = [..], or from, to and n"));
                let fault = fault.at(at, format!("no number for {key}"));
                self.faults.push(fault.help("such as from = 0.0, to = 1.0, n = 5"));
            }
            number
        };
        let (from, to) = (number("from")?, number("to")?);
        if table.get("n").is_none() {
            self.fault(&entry.key_at, format!("{owner} does not say how many values"), "no n", "add n = 5");
            return None;
        }
        let n: u64 = range.whole("n", MAX_LEVELS, self.faults)?;
        let log = range.flag("log", self.faults);
        if log && (from <= 0.0 || to <= 0.0) {
            self.fault(
                &entry.key_at,
                format!("{owner}: a range by logarithm lies above zero"),
                "not above zero",
                "begin above zero",
            );
            return None;
        }
        let value = |k: u64| {
            let s = k as f64 / (n - 1) as f64;
            let even = |a: f64, b: f64| a + s * (b - a);
            match (k, log) {
                (0, _) => from,
                (k, _) if k == n - 1 => to,
                (_, false) => even(from, to),
                (_, true) => even(from.ln(), to.ln()).exp(),
            }
        };
        let level = |k| {
            let value = value(k);
            let sets = keys.iter().map(|key| format!("{key}={value:?}")).collect();
            Level { label: value.into(), sets, variant: None }
        };
        Some((0..n).map(level).collect())
    }
}

/// A value in the syntax of a graph file.
fn literal(value: &Spanned) -> String {
    match &value.value {
        // On the command line the text may be unquoted.
        Value::Text(text) => Json::from(text.as_str()).to_string(),
        _ => value.at.text().to_owned(),
    }
}

/// `{ a.b = 1, "c.d" = 2 }` as `a.b=1` and `c.d=2`.
fn leaves(table: &Table, prefix: &str) -> Vec<String> {
    let leaf = |entry: &Entry| {
        let key = format!("{prefix}{}", entry.key);
        match entry.value.as_table() {
            Some(inner) => leaves(inner, &format!("{key}.")),
            None => vec![format!("{key}={}", literal(&entry.value))],
        }
    };
    table.0.iter().flat_map(leaf).collect()
}
