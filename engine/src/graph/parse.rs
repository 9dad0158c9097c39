use super::tree::{Entry, Spanned, Table, Value};
use crate::fault::{Fault, SourceText, Span};
use std::{ops::Range, sync::Arc};
use toml::de::{DeTable, DeValue, Error};

/// The tree of a text, as far as it could be read, and its syntax faults.
pub(super) fn parse(source: &Arc<SourceText>, faults: &mut Vec<Fault>) -> Table {
    let (table, errors) = DeTable::parse_recoverable(&source.text);
    let tree = convert_table(table.get_ref(), source, 0);
    faults.extend(errors.iter().map(|error| fault(error, source, &tree)));
    tree
}

/// The value in a part of a text, if that part is one.
pub(super) fn parse_value(source: &Arc<SourceText>, range: Range<usize>) -> Option<Spanned> {
    let text = &source.text[range.clone()];
    let value = DeValue::parse(text).ok()?;
    Some(convert(value.get_ref(), value.span(), source, range.start))
}

fn convert_table(table: &DeTable<'_>, source: &Arc<SourceText>, offset: usize) -> Table {
    let entry = |(key, value): (&toml::Spanned<_>, &toml::Spanned<DeValue<'_>>)| {
        let key_at = Span::new(source, shift(key.span(), offset));
        let value = convert(value.get_ref(), value.span(), source, offset);
        let key: &std::borrow::Cow<'_, str> = key.get_ref();
        Entry { key: key.to_string(), key_at, value }
    };
    let mut entries: Vec<_> = table.iter().map(entry).collect();
    // The parser moves entries about when a table is opened twice; the order of the text is the one that is meant.
    entries.sort_by_key(|entry| entry.key_at.range.start);
    Table(entries)
}

fn convert(value: &DeValue<'_>, span: Range<usize>, source: &Arc<SourceText>, offset: usize) -> Spanned {
    let at = Span::new(source, shift(span, offset));
    let value = match value {
        DeValue::String(text) => Value::Text(text.to_string()),
        DeValue::Boolean(value) => Value::Bool(*value),
        DeValue::Datetime(date) => Value::Date(date.to_string()),
        DeValue::Integer(int) => match i128::from_str_radix(int.as_str(), int.radix()) {
            Ok(value) => Value::Int(value),
            Err(_) => Value::Float(f64::INFINITY),
        },
        DeValue::Float(float) => Value::Float(float.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Array(items) => {
            let item = |item: &toml::Spanned<DeValue<'_>>| convert(item.get_ref(), item.span(), source, offset);
            Value::Array(items.iter().map(item).collect())
        }
        DeValue::Table(table) => Value::Table(convert_table(table, source, offset)),
    };
    Spanned { value, at }
}

fn shift(range: Range<usize>, offset: usize) -> Range<usize> {
    range.start + offset..range.end + offset
}

fn fault(error: &Error, source: &Arc<SourceText>, tree: &Table) -> Fault {
    let range = error.span().unwrap_or(0..0);
    let at = Span::new(source, range.clone());
    if error.message() == "duplicate key" {
        return duplicate(&at, tree);
    }
    let (what, expected) = error.message().split_once(", expected ").unwrap_or((error.message(), ""));
    let label = if expected.is_empty() { String::new() } else { format!("expected {expected}") };
    Fault::new(format!("this is not TOML: {what}")).at(&at, label)
}

/// A key written twice; the tree holds the first.
fn duplicate(at: &Span, tree: &Table) -> Fault {
    let key = at.text().trim_matches(['"', '\'']);
    let mut path = Vec::new();
    let first = first_of(tree, key, at, &mut path);
    let is_input = matches!(path.as_slice(), [node, _, inputs] if node == "node" && inputs == "in");
    let message = match path.as_slice() {
        [node, name, inputs] if node == "node" && inputs == "in" => {
            format!("node \"{name}\": input \"{key}\" is given two producers")
        }
        [node] if node == "node" => format!("two nodes are called \"{key}\""),
        _ => format!("\"{key}\" is given twice"),
    };
    let fault = Fault::new(message).at(at, "the second");
    let fault = match &first {
        Some(first) => fault.also(first, "the first"),
        None => fault,
    };
    if is_input {
        return fault.help("an input has one producer; let a node of its own bring two wires together");
    }
    fault.help("keep one of them")
}

/// The latest key of that name before `at`, and the path of the table that holds it.
fn first_of(table: &Table, key: &str, at: &Span, path: &mut Vec<String>) -> Option<Span> {
    let mut best: Option<(Span, Vec<String>)> = None;
    let mut here = Vec::new();
    visit(table, &mut here, &mut |entry, path| {
        let before = entry.key == key && entry.key_at.range.end <= at.range.start;
        if before && best.as_ref().is_none_or(|(span, _)| span.range.start <= entry.key_at.range.start) {
            best = Some((entry.key_at.clone(), path.to_vec()));
        }
    });
    let (span, found) = best?;
    *path = found;
    Some(span)
}

fn visit(table: &Table, path: &mut Vec<String>, see: &mut impl FnMut(&Entry, &[String])) {
    for entry in &table.0 {
        see(entry, path);
        if let Value::Table(inner) = &entry.value.value {
            path.push(entry.key.clone());
            visit(inner, path, see);
            path.pop();
        }
    }
}
