use super::{
    Quantity, Walker,
    range::int_limits,
    value_type::{ValueType, describe, resolve, value_type},
};
use crate::{
    fault::Fault,
    graph::{Spanned, Value, unit},
    names::nearest,
};
use serde_json::{Number, Value as Json};

impl<'a> Walker<'a> {
    /// Reads a value by its schema; `None` if it has a fault.
    pub(super) fn read(&mut self, schema: &'a Json, value: &Spanned, what: &Quantity) -> Option<Json> {
        let root = self.root;
        match (value_type(root, schema), &value.value) {
            (ValueType::Bool, Value::Bool(value)) => Some(Json::Bool(*value)),
            (ValueType::Int(range), Value::Int(number)) => {
                let (low, high) = int_limits(resolve(root, schema));
                let limit = if *number < low { Some("too small") } else { None };
                let limit = limit.or((*number > high).then_some("too large"));
                match range.refuses(*number as f64).or(limit) {
                    Some(why) => self.refuse(schema, value, what, why),
                    None => Some(value.to_json()),
                }
            }
            (ValueType::Int(_), Value::Float(_)) => self.refuse(schema, value, what, "not a whole number"),
            (ValueType::Number(range), Value::Int(_) | Value::Float(_)) => {
                let number = value.as_number()?;
                if !number.is_finite() {
                    return self.refuse(schema, value, what, "not finite");
                }
                match range.refuses(number) {
                    Some(why) => self.refuse(schema, value, what, why),
                    None => Number::from_f64(number).map(Json::Number),
                }
            }
            (ValueType::Text, _) if value.as_text_or_written().is_some() => value.as_text_or_written().map(Json::from),
            (ValueType::Path, _) if value.as_text_or_written().is_some() => {
                self.path(value, value.as_text_or_written()?, what)
            }
            (ValueType::Words(words), _) if value.as_text_or_written().is_some() => {
                let given = value.as_text_or_written()?;
                match words.iter().find(|(word, _)| *word == given) {
                    Some((word, _)) => Some(Json::from(*word)),
                    None => self.unknown_word(schema, value, what, &words),
                }
            }
            (ValueType::List { items, min, max }, Value::Array(values)) => {
                if values.len() < min || max.is_some_and(|max| values.len() > max) {
                    return self.refuse(schema, value, what, &format!("{} here", values.len()));
                }
                self.list(values.iter().map(|value| (items, value)), what)
            }
            (ValueType::Tuple(items), Value::Array(values)) => {
                if values.len() != items.len() {
                    return self.refuse(schema, value, what, &format!("{} here", values.len()));
                }
                self.list(items.into_iter().map(Some).zip(values), what)
            }
            (ValueType::Table, Value::Table(table)) => {
                let prefix = format!("{}.", what.name);
                self.table(resolve(root, schema), table, &value.at, &prefix, &[]).map(Json::Object)
            }
            (ValueType::Union(branches), _) => self.union(schema, &branches, value, what),
            (ValueType::Any, _) => self.any(value, what),
            (ValueType::Number(_) | ValueType::Int(_), Value::Text(found)) => {
                self.text_for_number(schema, value, found, what)
            }
            _ => self.refuse(schema, value, what, "of another type"),
        }
    }

    fn list<'v>(
        &mut self,
        values: impl Iterator<Item = (Option<&'a Json>, &'v Spanned)>,
        what: &Quantity,
    ) -> Option<Json> {
        let mut out = Some(Vec::new());
        for (index, (schema, value)) in values.enumerate() {
            let item = Quantity { name: format!("{}[{index}]", what.name), doc: what.doc.clone() };
            let read = match schema {
                Some(schema) => self.read(schema, value, &item),
                None => self.any(value, &item),
            };
            // Read every item, so that all faults are reported.
            out = out.zip(read).map(|(mut list, read)| {
                list.push(read);
                list
            });
        }
        out.map(Json::Array)
    }

    /// Reads a value that has no schema.
    pub(super) fn any(&mut self, value: &Spanned, what: &Quantity) -> Option<Json> {
        match &value.value {
            Value::Bool(value) => Some(Json::Bool(*value)),
            Value::Int(_) => Some(value.to_json()),
            Value::Float(number) => match Number::from_f64(*number) {
                Some(number) => Some(Json::Number(number)),
                None => {
                    self.faults.push(self.fault(what, "a finite number", value).at(&value.at, "not finite"));
                    None
                }
            },
            Value::Text(text) | Value::Date(text) => Some(Json::String(text.clone())),
            Value::Array(values) => self.list(values.iter().map(|value| (None, value)), what),
            Value::Table(table) => {
                let mut out = serde_json::Map::new();
                for entry in &table.0 {
                    let inner = Quantity { name: format!("{}.{}", what.name, entry.key), doc: None };
                    out.insert(entry.key.clone(), self.any(&entry.value, &inner)?);
                }
                Some(Json::Object(out))
            }
            // Only inputs are fed from outside a module.
            Value::Outside(_) => None,
        }
    }

    /// `node "icp": max_iterations takes a whole number from 1 to 1000, found 0`.
    pub(super) fn fault(&self, what: &Quantity, takes: &str, value: &Spanned) -> Fault {
        let message = format!("{}: {} takes {takes}, found {}", self.owner, what.name, found(value));
        Fault::new(message).note_if(what.doc.clone())
    }

    pub(super) fn refuse(&mut self, schema: &Json, value: &Spanned, what: &Quantity, why: &str) -> Option<Json> {
        let takes = describe(self.root, schema);
        let mut fault = self.fault(what, &takes, value).at(&value.at, why);
        if let (ValueType::Int(_), Value::Float(number)) = (value_type(self.root, schema), &value.value)
            && number.fract() == 0.0
            && number.abs() < 1e15
        {
            fault = fault.help(format!("write {} = {number:.0}", last(&what.name)));
        }
        self.faults.push(fault);
        None
    }

    fn unknown_word(
        &mut self,
        schema: &Json,
        value: &Spanned,
        what: &Quantity,
        words: &[(&str, Option<&str>)],
    ) -> Option<Json> {
        let takes = describe(self.root, schema);
        let near = nearest::help(value.as_text_or_written().unwrap_or_default(), words.iter().map(|(word, _)| *word));
        let mut fault = self.fault(what, &takes, value).at(&value.at, "not one of them").help_if(near);
        for (word, doc) in words {
            fault = fault.note_if(doc.map(|doc| format!("\"{word}\": {}", super::table::first_paragraph(doc))));
        }
        self.faults.push(fault);
        None
    }

    fn text_for_number(&mut self, schema: &Json, value: &Spanned, found: &str, what: &Quantity) -> Option<Json> {
        let takes = describe(self.root, schema);
        let name = last(&what.name);
        let number = match unit::with_unit(found) {
            Some((number, unit)) => unit::in_unit_of(name, number, unit),
            None => found.trim().parse::<f64>().ok().filter(|n| n.is_finite()),
        };
        let with_point = found.trim().replacen(',', ".", 1);
        if number.is_none() && found.contains(',') && with_point.parse::<f64>().is_ok_and(f64::is_finite) {
            let help = format!("a decimal comma? write {}", written(name, &with_point));
            let fault = self.fault(what, &takes, value).at(&value.at, "a text").help(help);
            self.faults.push(fault);
            return None;
        }
        let help =
            number.map(|number| format!("write {}, without quotes and unit", written(name, &number.to_string())));
        let fault = self.fault(what, &takes, value).at(&value.at, "a text").help_if(help);
        self.faults.push(fault);
        None
    }
}

/// A value as written in a graph: of a list alone, else with its name.
fn written(name: &str, value: &str) -> String {
    if name.ends_with(']') { value.to_owned() } else { format!("{name} = {value}") }
}

/// The last part of a dotted name.
fn last(name: &str) -> &str {
    name.rsplit('.').next().unwrap_or(name)
}

/// The value as written if that is short, so that `1e3` is not shown as `1000.0`.
fn found(value: &Spanned) -> String {
    match &value.value {
        Value::Int(_) | Value::Float(_) => value.at.text().to_owned(),
        _ => value.found(),
    }
}
