//! Checks a view against a schema.

use super::{Column, Field, View, ViewError};
use crate::{ColumnType, EntryType, SchemaEntry};

/// Refuses the first duplicate, in alphabetical order.
fn no_duplicate<'a>(what: &str, names: impl ExactSizeIterator<Item = &'a str>) -> Result<(), ViewError> {
    if names.len() < 2 {
        return Ok(());
    }
    let mut names: Vec<_> = names.collect();
    names.sort_unstable();
    match names.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(ViewError::Mismatch(format!("the view has two {what} \"{}\"", pair[0]))),
        None => Ok(()),
    }
}

fn unknown(what: &str, name: &str) -> ViewError {
    ViewError::Mismatch(format!("the view has a {what} \"{name}\" that its payload does not have"))
}

impl View {
    /// Checks that the view has every entry of the schema, each with its type, and no other.
    ///
    /// # Errors
    /// [`ViewError`] with the first head field or column that is missing, wrong or not in the schema.
    pub fn check(&self, schema: &[SchemaEntry]) -> Result<(), ViewError> {
        for entry in schema.iter().filter(|entry| !entry.is_column() && !entry.optional) {
            if self.field(entry.name).is_none() {
                return Err(ViewError::Missing { what: entry.ty.noun(), name: entry.name.into() });
            }
        }
        for (name, field) in &self.head {
            let Some(entry) = schema.iter().find(|entry| !entry.is_column() && entry.name == name) else {
                return Err(unknown("field", name));
            };
            if !entry.ty.accepts(field) {
                let (found, expected) = (EntryType::of(field), entry.ty);
                return Err(ViewError::Mismatch(format!("field \"{name}\" is {found}, {expected} needed")));
            }
        }
        no_duplicate("fields", self.head.iter().map(|(name, _)| &**name))?;
        self.check_columns(schema)
    }

    /// Checks the columns only, for a head that was read by the schema.
    ///
    /// # Errors
    /// [`ViewError`] with the first column that is missing, wrong or not in the schema.
    pub fn check_columns(&self, schema: &[SchemaEntry]) -> Result<(), ViewError> {
        for entry in schema.iter().filter(|entry| entry.is_column() && !entry.optional && entry.prefix().is_none()) {
            if !self.columns.iter().any(|column| column.name == entry.name) {
                return Err(ViewError::Missing { what: entry.ty.noun(), name: entry.name.into() });
            }
        }
        for column in &self.columns {
            let of_name = schema.iter().find(|entry| entry.is_column() && entry.name == column.name);
            let entry = of_name.or_else(|| schema.iter().find(|entry| entry.matches_column(&column.name)));
            let Some(EntryType::Column { kind, width }) = entry.map(|entry| entry.ty) else {
                return Err(unknown("column", &column.name));
            };
            column.check(kind, width)?;
        }
        no_duplicate("columns", self.columns.iter().map(|column| &*column.name))
    }
}

impl Column {
    /// Checks that the column has whole rows of `width` values of `kind`.
    fn check(&self, kind: ColumnType, width: u32) -> Result<(), ViewError> {
        let (bytes, row) = (self.bytes().len(), kind.size() * width as usize);
        let fault = if self.kind != kind {
            format!("holds {}, {} needed", self.kind.name(), kind.name())
        } else if self.width != width {
            format!("has {} values in a row, {width} needed", self.width)
        } else if !bytes.is_multiple_of(row) {
            format!("ends within a row: {bytes} bytes in rows of {row}")
        } else {
            return Ok(());
        };
        Err(ViewError::Mismatch(format!("column \"{}\" {fault}", self.name)))
    }
}

impl EntryType {
    fn accepts(self, field: &Field) -> bool {
        match (self, field) {
            (Self::Bool, Field::Bool(_))
            | (Self::Int, Field::Int(_))
            | (Self::Float, Field::Float(_))
            | (Self::FloatList, Field::Floats(_))
            | (Self::Text, Field::Text(_)) => true,
            (Self::Floats(n), Field::Floats(values)) => values.len() == n as usize,
            _ => false,
        }
    }

    fn of(field: &Field) -> Self {
        match field {
            Field::Bool(_) => Self::Bool,
            Field::Int(_) => Self::Int,
            Field::Float(_) => Self::Float,
            Field::Floats(values) => Self::Floats(values.len() as u32),
            Field::Text(_) => Self::Text,
        }
    }
}
