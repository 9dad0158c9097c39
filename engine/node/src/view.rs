//! Views: a payload as a small head of named fields and named typed columns.

mod check;
pub(crate) mod json;

use crate::ColumnType;
use bytemuck::Pod;
use std::{borrow::Cow, fmt, sync::Arc};

/// Immutable shared bytes.
pub type Buffer = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// The name of a head field or column; borrowed from the schema where possible.
pub type Name = Cow<'static, str>;

/// A payload as the recorder, plugins and `diff` see it: head fields and columns, both in order.
#[derive(Clone, Default, Debug, PartialEq)]
pub struct View {
    /// Small named values.
    pub head: Vec<(Name, Field)>,
    /// Bulk data.
    pub columns: Vec<Column>,
}

/// A value in the head of a view.
#[derive(Clone, Debug, PartialEq)]
pub enum Field {
    /// A boolean.
    Bool(bool),
    /// A count or a stamp.
    Int(i64),
    /// A number.
    Float(f64),
    /// A few numbers, such as the rows of a matrix.
    Floats(Vec<f64>),
    /// UTF-8 text.
    Text(Arc<str>),
}

/// A named column: rows of `width` values of one type, little-endian, contiguous in memory.
#[derive(Clone)]
pub struct Column {
    /// The column's name.
    pub name: Name,
    /// The type of each value.
    pub kind: ColumnType,
    /// Values in a row: 3 for points.
    pub width: u32,
    /// The bytes of the rows.
    pub data: Buffer,
}

impl Column {
    /// A column over the bytes of `data`.
    pub fn new(name: impl Into<Name>, kind: ColumnType, width: u32, data: Buffer) -> Self {
        Self { name: name.into(), kind, width, data }
    }

    /// The bytes of the rows.
    pub fn bytes(&self) -> &[u8] {
        (*self.data).as_ref()
    }

    /// The number of rows.
    pub fn rows(&self) -> usize {
        self.bytes().len() / (self.kind.size() * self.width as usize).max(1)
    }

    /// The rows as values of `T`: borrowed where aligned, otherwise copied.
    ///
    /// # Errors
    /// [`ViewError`] if a row is not the size of a `T` or the bytes end within a row.
    pub fn rows_of<T: Pod>(&self) -> Result<std::borrow::Cow<'_, [T]>, ViewError> {
        let (row, size) = (self.kind.size() * self.width as usize, size_of::<T>());
        if row != size || !self.bytes().len().is_multiple_of(size) {
            let (name, bytes) = (&self.name, self.bytes().len());
            let fault = format!("column \"{name}\" has rows of {row} bytes in {bytes} bytes, {size} needed");
            return Err(ViewError::Mismatch(fault));
        }
        Ok(match bytemuck::try_cast_slice(self.bytes()) {
            Ok(rows) => rows.into(),
            Err(_) => bytemuck::pod_collect_to_vec(self.bytes()).into(),
        })
    }
}

impl fmt::Debug for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} x {} {:?}", self.name, self.rows(), self.width, self.kind)
    }
}

impl PartialEq for Column {
    fn eq(&self, other: &Self) -> bool {
        (&self.name, self.kind, self.width, self.bytes()) == (&other.name, other.kind, other.width, other.bytes())
    }
}

/// A view that does not match its payload type.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ViewError {
    /// A head field or column is missing or has another type.
    #[error("the view has no {what} \"{name}\"")]
    Missing {
        /// The noun for what is missing, such as `column`.
        what: &'static str,
        /// Its name.
        name: String,
    },
    /// A head field or column is not as the schema says.
    #[error("{0}")]
    Mismatch(String),
    /// The values are not valid for the payload.
    #[error("the view is not a valid payload: {0}")]
    Invalid(String),
}

fn missing(what: &'static str, name: &str) -> ViewError {
    ViewError::Missing { what, name: name.into() }
}

impl View {
    /// A view without fields or columns.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a head field.
    pub fn with(mut self, name: impl Into<Name>, field: impl Into<Field>) -> Self {
        self.head.push((name.into(), field.into()));
        self
    }

    /// Adds a column.
    pub fn with_column(mut self, column: Column) -> Self {
        self.columns.push(column);
        self
    }

    /// The head field with this name.
    pub fn field(&self, name: &str) -> Option<&Field> {
        self.head.iter().find(|(n, _)| n == name).map(|(_, f)| f)
    }

    /// The column with this name.
    ///
    /// # Errors
    /// [`ViewError::Missing`] if there is none.
    pub fn column(&self, name: &str) -> Result<&Column, ViewError> {
        self.columns.iter().find(|c| c.name == name).ok_or_else(|| missing("column", name))
    }

    /// The text with this name.
    ///
    /// # Errors
    /// [`ViewError::Missing`] if there is none.
    pub fn text(&self, name: &str) -> Result<&str, ViewError> {
        match self.field(name) {
            Some(Field::Text(text)) => Ok(text),
            _ => Err(missing("text field", name)),
        }
    }

    /// The text with this name, shared with the view.
    ///
    /// # Errors
    /// [`ViewError::Missing`] if there is none.
    pub fn shared_text(&self, name: &str) -> Result<Arc<str>, ViewError> {
        match self.field(name) {
            Some(Field::Text(text)) => Ok(text.clone()),
            _ => Err(missing("text field", name)),
        }
    }

    /// The integer with this name.
    ///
    /// # Errors
    /// [`ViewError::Missing`] if there is none.
    pub fn int(&self, name: &str) -> Result<i64, ViewError> {
        match self.field(name) {
            Some(Field::Int(value)) => Ok(*value),
            _ => Err(missing("integer field", name)),
        }
    }

    /// The number with this name.
    ///
    /// # Errors
    /// [`ViewError::Missing`] if there is none.
    pub fn float(&self, name: &str) -> Result<f64, ViewError> {
        match self.field(name) {
            Some(Field::Float(value)) => Ok(*value),
            _ => Err(missing("number field", name)),
        }
    }

    /// The `N` numbers with this name.
    ///
    /// # Errors
    /// [`ViewError::Missing`] if there is no such list, or its length is not `N`.
    pub fn floats<const N: usize>(&self, name: &str) -> Result<[f64; N], ViewError> {
        let missing = || missing("number list", &format!("{name} of {N}"));
        match self.field(name) {
            Some(Field::Floats(values)) => values.as_slice().try_into().map_err(|_| missing()),
            _ => Err(missing()),
        }
    }
}

impl From<bool> for Field {
    fn from(value: bool) -> Self {
        Self::Bool(value)
    }
}

impl From<i64> for Field {
    fn from(value: i64) -> Self {
        Self::Int(value)
    }
}

impl From<f64> for Field {
    fn from(value: f64) -> Self {
        Self::Float(value)
    }
}

impl From<Vec<f64>> for Field {
    fn from(values: Vec<f64>) -> Self {
        Self::Floats(values)
    }
}

impl From<&str> for Field {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<Arc<str>> for Field {
    fn from(text: Arc<str>) -> Self {
        Self::Text(text)
    }
}

impl From<String> for Field {
    fn from(text: String) -> Self {
        Self::Text(text.into())
    }
}
