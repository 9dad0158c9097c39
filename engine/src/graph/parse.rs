use super::{
    limits, syntax,
    tree::{Entry, Spanned, Table, Value},
};
use crate::fault::{Fault, SourceText, Span};
use std::{ops::Range, sync::Arc};
use toml::de::{DeTable, DeValue};

/// The tree of a text, as far as it can be parsed; adds its syntax faults.
pub(super) fn parse(source: &Arc<SourceText>, faults: &mut Vec<Fault>) -> Table {
    let (table, errors) = DeTable::parse_recoverable(&source.text);
    let mut tree = convert_table(table.get_ref(), source, 0);
    limits::enforce(&mut tree, faults);
    faults.extend(syntax::faults(&errors, source, &tree));
    tree
}

/// The value in a range of a text, if it parses as one.
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
    // The parser reorders entries when a table is opened twice; restore the order of the text.
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
