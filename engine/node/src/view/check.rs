//! Checks a view against a schema.

use super::{Column, Field, View, ViewError};
use crate::{ColumnType, EntryType, SchemaEntry};

/// The first duplicate, in alphabetical order.
fn duplicate<'a>(names: impl Iterator<Item = &'a str>) -> Option<String> {
    let mut names: Vec<_> = names.collect();
    names.sort_unstable();
    names.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0].to_owned())
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
                return Err(ViewError::Unknown { what: "field", name: name.to_string() });
            };
            if !entry.ty.accepts(field) {
                let (found, expected) = (EntryType::of(field), entry.ty);
                return Err(ViewError::FieldType { name: name.to_string(), found, expected });
            }
        }
        if let Some(name) = duplicate(self.head.iter().map(|(name, _)| &**name)) {
            return Err(ViewError::Twice { what: "fields", name });
        }
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
                return Err(ViewError::Unknown { what: "column", name: column.name.to_string() });
            };
            column.check(kind, width)?;
        }
        if self.columns.len() > 1
            && let Some(name) = duplicate(self.columns.iter().map(|column| &*column.name))
        {
            return Err(ViewError::Twice { what: "columns", name });
        }
        Ok(())
    }
}

impl Column {
    /// Checks that the column has whole rows of `width` values of `kind`.
    fn check(&self, kind: ColumnType, width: u32) -> Result<(), ViewError> {
        let name = || self.name.to_string();
        if self.kind != kind {
            return Err(ViewError::ColumnType { name: name(), found: self.kind, expected: kind });
        }
        if self.width != width {
            return Err(ViewError::Width { name: name(), found: self.width, expected: width });
        }
        let (bytes, row) = (self.bytes().len(), kind.size() * width as usize);
        if !bytes.is_multiple_of(row) {
            return Err(ViewError::CutRow { name: name(), bytes, row });
        }
        Ok(())
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
