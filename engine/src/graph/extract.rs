//! Reads values of the graph file's own keys.

use super::{
    Entry, Spanned, Table, Value,
    grammar::{self, Keys},
};
use crate::{fault::Fault, names::nearest};
use serde_json::Value as Json;
use std::fmt;

/// A table of the graph file, read by the keys of the grammar.
pub(crate) struct Section<'t> {
    table: &'t Table,
    keys: &'static Keys,
    /// Begins the faults of its values, unless it is empty: `OWNER: KEY takes ..`.
    owner: String,
}

impl<'t> Section<'t> {
    /// Adds a fault for each unknown key, which says that `place` has no such key.
    pub(crate) fn new(
        table: &'t Table,
        keys: &'static Keys,
        place: &str,
        owner: impl Into<String>,
        faults: &mut Vec<Fault>,
    ) -> Self {
        for Entry { key, key_at, .. } in table.0.iter().filter(|entry| !grammar::has(keys, &entry.key)) {
            let fault = Fault::new(format!("{place} has no key \"{key}\"")).at(key_at, "unknown");
            let help = nearest::help(key, grammar::names(keys));
            faults.push(fault.help_if(help).note_if(nearest::list("known here", grammar::names(keys))));
        }
        Self::known(table, keys, owner)
    }

    /// A table whose other keys are not of the grammar, such as the parameters of a node.
    pub(crate) fn known(table: &'t Table, keys: &'static Keys, owner: impl Into<String>) -> Self {
        Self { table, keys, owner: owner.into() }
    }

    /// The entry of a key.
    pub(crate) fn get(&self, key: &str) -> Option<&'t Entry> {
        self.table.get(key)
    }

    pub(crate) fn first(&self) -> Option<&'t Entry> {
        self.table.0.first()
    }

    /// The name of a key in faults.
    pub(crate) fn what(&self, key: &str) -> String {
        if self.owner.is_empty() { key.into() } else { format!("{}: {key}", self.owner) }
    }

    /// The schema of a key.
    ///
    /// # Panics
    /// If the grammar does not have the key, which is a bug of ours.
    fn schema(&self, key: &str) -> &'static Json {
        &self.keys[key]
    }

    pub(crate) fn text(&self, key: &str, faults: &mut Vec<Fault>) -> Option<&'t str> {
        text(&self.get(key)?.value, &self.what(key), faults)
    }

    /// The flag of a key, or its default.
    pub(crate) fn flag(&self, key: &str, faults: &mut Vec<Fault>) -> bool {
        self.flag_if_set(key, faults).unwrap_or(self.schema(key)["default"] == true)
    }

    pub(crate) fn flag_if_set(&self, key: &str, faults: &mut Vec<Fault>) -> Option<bool> {
        let value = &self.get(key)?.value;
        let flag = if let Value::Bool(flag) = value.value { Some(flag) } else { None };
        expected(flag, value, &self.what(key), "true or false", faults)
    }

    /// The whole number of a key, from what the grammar states to `max`.
    pub(crate) fn whole<T: TryFrom<u64>>(&self, key: &str, max: u64, faults: &mut Vec<Fault>) -> Option<T> {
        let min = self.schema(key)["minimum"].as_u64().unwrap_or(0);
        let value = &self.get(key)?.value;
        let number = if let Value::Int(number) = value.value { Some(number) } else { None };
        let takes = match number.is_some_and(|number| number > i128::from(max)) {
            true => format!("a whole number from {min} to {max}"),
            false => format!("a whole number of at least {min}"),
        };
        let number = number.and_then(|number| u64::try_from(number).ok()).filter(|n| (min..=max).contains(n));
        T::try_from(expected(number, value, &self.what(key), &takes, faults)?).ok()
    }

    /// The word of a key, one of those that the grammar lists.
    pub(crate) fn word(&self, key: &str, faults: &mut Vec<Fault>) -> Option<&'static str> {
        let words = || self.schema(key)["enum"].as_array().into_iter().flatten().filter_map(Json::as_str);
        let (value, what) = (&self.get(key)?.value, self.what(key));
        let given = text(value, &what, faults)?;
        let word = words().find(|word| *word == given);
        if word.is_none() {
            let list: Vec<_> = words().map(|word| format!("\"{word}\"")).collect();
            let fault = Fault::new(format!("{what} takes one of {}, found the text {given:?}", list.join(", ")));
            let help = nearest::help(given, words());
            faults.push(fault.at(&value.at, "not one of them").help_if(help));
        }
        word
    }

    /// The number of milliseconds of a key, at least 0, in nanoseconds.
    pub(crate) fn milliseconds(&self, key: &str, faults: &mut Vec<Fault>) -> Option<i64> {
        let value = &self.get(key)?.value;
        // At most about a thousand years, so that nothing overflows.
        let ms = value.as_number().filter(|ms| (0.0..3.2e13).contains(ms));
        let ms = expected(ms, value, &self.what(key), "a number of milliseconds of at least 0", faults)?;
        Some((ms * 1e6).round() as i64)
    }

    /// The number of bytes of a key, at least 1: a whole number, or a text with a unit such as `64 MiB`.
    pub(crate) fn bytes(&self, key: &str, faults: &mut Vec<Fault>) -> Option<u64> {
        let value = &self.get(key)?.value;
        let n = match &value.value {
            Value::Int(number) => u64::try_from(*number).ok(),
            Value::Text(text) => bytes_of(text),
            _ => None,
        };
        let takes = "a whole number of bytes of at least 1, or a text such as \"64 MiB\"";
        expected(n.filter(|n| *n > 0), value, &self.what(key), takes, faults)
    }

    /// The number of seconds of a key, above 0 and at most what the grammar states.
    pub(crate) fn seconds(&self, key: &str, faults: &mut Vec<Fault>) -> Option<f64> {
        self.positive(key, "seconds", faults)
    }

    /// The number of a key in this unit, above 0 and at most what the grammar states.
    pub(crate) fn positive(&self, key: &str, unit: &str, faults: &mut Vec<Fault>) -> Option<f64> {
        let (value, most) = (&self.get(key)?.value, &self.schema(key)["maximum"]);
        let number = value.as_number().filter(|s| *s > 0.0 && most.as_f64().is_some_and(|most| *s <= most));
        let takes = format!("a number of {unit} above 0 and at most {most}");
        expected(number, value, &self.what(key), &takes, faults)
    }

    /// The share of a key, from 0 to 1.
    pub(crate) fn share(&self, key: &str, faults: &mut Vec<Fault>) -> Option<f64> {
        let value = &self.get(key)?.value;
        let share = value.as_number().filter(|share| (0.0..=1.0).contains(share));
        expected(share, value, &self.what(key), "a number from 0 to 1", faults)
    }
}

/// The text of an entry; a fault if it is something else.
pub(crate) fn text<'a>(value: &'a Spanned, what: &str, faults: &mut Vec<Fault>) -> Option<&'a str> {
    expected(value.as_text_or_written(), value, what, "a text", faults)
}

/// The bytes of `1.5 GiB`; the unit is required, and values above 2⁶³ are refused.
fn bytes_of(text: &str) -> Option<u64> {
    let text = text.trim();
    let end = text.find(|c: char| c.is_ascii_alphabetic())?;
    let (number, unit) = text.split_at(end);
    let size: u64 = match unit {
        "B" => 1,
        "kB" => 1_000,
        "MB" => 1_000_000,
        "GB" => 1_000_000_000,
        "KiB" => 1 << 10,
        "MiB" => 1 << 20,
        "GiB" => 1 << 30,
        _ => return None,
    };
    let plain = number.trim().chars().all(|c| c.is_ascii_digit() || c == '.');
    let bytes = plain.then(|| number.trim().parse::<f64>().ok())?? * size as f64;
    (bytes < i64::MAX as f64).then_some(bytes.round() as u64)
}

pub(crate) fn table<'a>(value: &'a Spanned, what: &str, faults: &mut Vec<Fault>) -> Option<&'a Table> {
    expected(value.as_table(), value, what, "a table", faults)
}

/// What was read of a value; a fault if that is nothing, because it is not what `what` takes.
fn expected<T>(read: Option<T>, value: &Spanned, what: &str, takes: &str, faults: &mut Vec<Fault>) -> Option<T> {
    if read.is_none() {
        faults.push(refused(value, format!("{what} takes {takes}"), format!("{takes} is needed")));
    }
    read
}

/// The fault of a value that is not what `takes` says, such as `frames takes a list of names`.
pub(crate) fn refused(value: &Spanned, takes: impl fmt::Display, label: impl Into<String>) -> Fault {
    Fault::new(format!("{takes}, found {}", value.found())).at(&value.at, label)
}

/// Whether the text is a valid node name: a name, or names joined by `/`, as for nodes of modules.
pub(crate) fn is_node_name(name: &str) -> bool {
    name.split('/').all(is_name)
}

/// Whether the text may be a name in a wire: letters, digits, `_` and `-`.
pub(crate) fn is_name(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}
