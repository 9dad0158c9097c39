use crate::fault::Span;

/// A value and where it was written.
#[derive(Debug, Clone)]
pub(crate) struct Spanned {
    pub(crate) value: Value,
    pub(crate) at: Span,
}

/// A value of a graph file.
#[derive(Debug, Clone)]
pub(crate) enum Value {
    Bool(bool),
    Int(i128),
    Float(f64),
    Text(String),
    Date(String),
    Array(Vec<Spanned>),
    Table(Table),
    /// A placeholder for the wire that the graph using this module connects to the input of that name.
    Outside(String),
}

/// A key and its value.
#[derive(Debug, Clone)]
pub(crate) struct Entry {
    pub(crate) key: String,
    pub(crate) key_at: Span,
    pub(crate) value: Spanned,
}

/// Entries in the order of the file.
#[derive(Debug, Clone, Default)]
pub(crate) struct Table(pub(crate) Vec<Entry>);

impl Table {
    pub(crate) fn get(&self, key: &str) -> Option<&Entry> {
        self.0.iter().find(|entry| entry.key == key)
    }

    pub(crate) fn get_mut(&mut self, key: &str) -> Option<&mut Entry> {
        self.0.iter_mut().find(|entry| entry.key == key)
    }

    pub(crate) fn remove(&mut self, key: &str) -> Option<Entry> {
        let index = self.0.iter().position(|entry| entry.key == key)?;
        Some(self.0.remove(index))
    }

    pub(crate) fn keys(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|entry| entry.key.as_str())
    }
}

impl Spanned {
    pub(crate) fn as_text(&self) -> Option<&str> {
        match &self.value {
            Value::Text(text) => Some(text),
            _ => None,
        }
    }

    /// The text; on the command line, where a text needs no quotes, also a number or a date as written.
    pub(crate) fn as_text_or_written(&self) -> Option<&str> {
        match &self.value {
            Value::Text(text) => Some(text),
            Value::Array(_) | Value::Table(_) | Value::Outside(_) => None,
            _ => self.at.source.command_line.then(|| self.at.text()),
        }
    }

    pub(crate) fn as_table(&self) -> Option<&Table> {
        match &self.value {
            Value::Table(table) => Some(table),
            _ => None,
        }
    }

    pub(crate) fn as_number(&self) -> Option<f64> {
        match self.value {
            Value::Int(number) => Some(number as f64),
            Value::Float(number) => Some(number),
            _ => None,
        }
    }

    /// `"a.b"` as `{ KEY = "a.b" }`, for which it is short.
    pub(crate) fn lengthen(&mut self, key: &str) {
        let entry = Entry { key: key.into(), key_at: self.at.clone(), value: self.clone() };
        self.value = Value::Table(Table(vec![entry]));
    }

    /// The value as JSON.
    pub(crate) fn to_json(&self) -> serde_json::Value {
        match &self.value {
            Value::Bool(value) => (*value).into(),
            Value::Int(value) => match (i64::try_from(*value), u64::try_from(*value)) {
                (Ok(value), _) => value.into(),
                (_, Ok(value)) => value.into(),
                _ => (*value as f64).into(),
            },
            Value::Float(value) => (*value).into(),
            Value::Text(text) | Value::Date(text) => text.as_str().into(),
            Value::Array(items) => items.iter().map(Self::to_json).collect(),
            Value::Table(table) => table.0.iter().map(|e| (e.key.clone(), e.value.to_json())).collect(),
            Value::Outside(_) => serde_json::Value::Null,
        }
    }

    /// Describes the value for a fault: `the text "5 mm"`, `a list`.
    pub(crate) fn found(&self) -> String {
        match &self.value {
            Value::Bool(value) => value.to_string(),
            Value::Int(value) => value.to_string(),
            Value::Float(value) => format!("{value:?}"),
            Value::Text(text) => format!("the text {text:?}"),
            Value::Date(text) => format!("the date {text}"),
            Value::Array(items) => format!("a list of {}", items.len()),
            Value::Table(_) => "a table".into(),
            Value::Outside(name) => format!("the module's input \"{name}\""),
        }
    }
}
