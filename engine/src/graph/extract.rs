//! Reads values of the graph file's own keys.

use super::{Entry, Spanned, Table, Value};
use crate::{fault::Fault, names::nearest};

/// The text of an entry; a fault if it is something else.
pub(crate) fn text<'a>(value: &'a Spanned, what: &str, faults: &mut Vec<Fault>) -> Option<&'a str> {
    let text = value.as_text().or_else(|| match &value.value {
        // On the command line a text needs no quotes, even if it looks like a number.
        Value::Array(_) | Value::Table(_) | Value::Outside(_) => None,
        _ => value.at.source.command_line.then(|| value.at.text()),
    });
    if text.is_none() {
        faults.push(wrong(value, what, "a text"));
    }
    text
}

pub(crate) fn boolean(value: &Spanned, what: &str, faults: &mut Vec<Fault>) -> Option<bool> {
    if let Value::Bool(value) = value.value {
        return Some(value);
    }
    faults.push(wrong(value, what, "true or false"));
    None
}

/// A whole number from `min` to `max`.
pub(crate) fn whole(value: &Spanned, what: &str, min: u64, max: u64, faults: &mut Vec<Fault>) -> Option<u64> {
    if let Value::Int(number) = value.value
        && let Some(number) = u64::try_from(number).ok().filter(|n| (min..=max).contains(n))
    {
        return Some(number);
    }
    let is_too_large = matches!(value.value, Value::Int(number) if number > i128::from(max));
    let takes = match is_too_large {
        true => format!("a whole number from {min} to {max}"),
        false => format!("a whole number of at least {min}"),
    };
    faults.push(wrong(value, what, &takes));
    None
}

/// A number of bytes of at least 1: a whole number, or a text with a unit such as `64 MiB`.
pub(crate) fn bytes(value: &Spanned, what: &str, faults: &mut Vec<Fault>) -> Option<u64> {
    let n = match &value.value {
        Value::Int(number) => u64::try_from(*number).ok(),
        Value::Text(text) => bytes_of(text),
        _ => None,
    };
    if let Some(n) = n.filter(|n| *n > 0) {
        return Some(n);
    }
    faults.push(wrong(value, what, "a whole number of bytes of at least 1, or a text such as \"64 MiB\""));
    None
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

/// A duration in milliseconds, at least 0; returns nanoseconds.
pub(crate) fn milliseconds(value: &Spanned, what: &str, faults: &mut Vec<Fault>) -> Option<i64> {
    let ms = match value.value {
        Value::Int(number) => number as f64,
        Value::Float(number) => number,
        _ => f64::NAN,
    };
    // At most about a thousand years, so that nothing overflows.
    if (0.0..3.2e13).contains(&ms) {
        return Some((ms * 1e6).round() as i64);
    }
    faults.push(wrong(value, what, "a number of milliseconds of at least 0"));
    None
}

/// A number of seconds above 0 and at most a day.
pub(crate) fn seconds(value: &Spanned, what: &str, faults: &mut Vec<Fault>) -> Option<f64> {
    let s = match value.value {
        Value::Int(number) => number as f64,
        Value::Float(number) => number,
        _ => f64::NAN,
    };
    if s > 0.0 && s <= 86_400.0 {
        return Some(s);
    }
    faults.push(wrong(value, what, "a number of seconds above 0 and at most 86400"));
    None
}

pub(crate) fn table<'a>(value: &'a Spanned, what: &str, faults: &mut Vec<Fault>) -> Option<&'a Table> {
    let table = value.as_table();
    if table.is_none() {
        faults.push(wrong(value, what, "a table"));
    }
    table
}

fn wrong(value: &Spanned, what: &str, takes: &str) -> Fault {
    let message = format!("{what} takes {takes}, found {}", value.found());
    Fault::new(message).at(&value.at, format!("{takes} is needed"))
}

/// Faults for unknown keys of a table.
pub(crate) fn only(table: &Table, known: &[&str], place: &str, faults: &mut Vec<Fault>) {
    for Entry { key, key_at, .. } in table.0.iter().filter(|entry| !known.contains(&entry.key.as_str())) {
        let fault = Fault::new(format!("{place} has no key \"{key}\"")).at(key_at, "unknown");
        let help = nearest::help(key, known.iter().copied());
        faults.push(fault.help_if(help).note_if(nearest::list("known here", known.iter().copied())));
    }
}

/// Whether the text is a valid node name: a name, or names joined by `/`, as for nodes of modules.
pub(crate) fn is_node_name(name: &str) -> bool {
    name.split('/').all(is_name)
}

/// Whether the text may be a name in a wire: letters, digits, `_` and `-`.
pub(crate) fn is_name(name: &str) -> bool {
    !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
}
