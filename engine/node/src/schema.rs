//! The schema of a payload type: the head fields and columns of its views.

mod column_type;
mod json;

pub use column_type::ColumnType;

use std::fmt;

/// A head field or column of a payload's view. A schema is a list of entries, fields before columns:
///
/// ```
/// use osteoflow_node::{ColumnType, SchemaEntry, View};
///
/// const SCHEMA: &[SchemaEntry] = &[
///     SchemaEntry::text("frame"),
///     SchemaEntry::float_list("viewpoint").optional().unit("pose"),
///     SchemaEntry::column("points", ColumnType::F64, 3).unit("mm"),
///     SchemaEntry::column("extra/*", ColumnType::F64, 1).doc("values of the points, by name"),
/// ];
/// let error = View::new().with("frame", "camera").check(SCHEMA).unwrap_err();
/// assert_eq!(error.to_string(), "the view has no column \"points\"");
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SchemaEntry {
    /// The name. A column name that ends in `/*` matches any number of columns with that prefix, including none.
    pub name: &'static str,
    /// The type of the value.
    pub ty: EntryType,
    /// Whether a view may lack the entry.
    pub optional: bool,
    /// The unit, where the name has no suffix such as `_mm`; `pose` means rows of translation x, y, z in mm and
    /// quaternion x, y, z, w. Empty if there is none.
    pub unit: &'static str,
    /// The meaning, where the name does not say it. May be empty.
    pub doc: &'static str,
}

/// The type of a head field or column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EntryType {
    /// A boolean.
    Bool,
    /// A count or a stamp.
    Int,
    /// A number.
    Float,
    /// A list of exactly this many numbers.
    Floats(u32),
    /// A list of numbers of any length.
    FloatList,
    /// UTF-8 text.
    Text,
    /// A column of rows.
    Column {
        /// The type of each value.
        kind: ColumnType,
        /// Values in a row.
        width: u32,
    },
}

/// Maximum number of entries: a schema is walked for each item.
const MAX_ENTRIES: usize = 1024;

const NOT_OPTIONAL: &str = "only a text, a number, a list of any length and a column may be optional";

/// An invalid schema.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the schema is not valid: {0}")]
pub struct SchemaError(pub(crate) String);

impl SchemaEntry {
    /// A boolean field.
    pub const fn bool(name: &'static str) -> Self {
        Self::new(name, EntryType::Bool)
    }

    /// A count or a stamp.
    pub const fn int(name: &'static str) -> Self {
        Self::new(name, EntryType::Int)
    }

    /// A number.
    pub const fn float(name: &'static str) -> Self {
        Self::new(name, EntryType::Float)
    }

    /// A list of exactly `n` numbers.
    pub const fn floats(name: &'static str, n: u32) -> Self {
        Self::new(name, EntryType::Floats(n))
    }

    /// A list of numbers of any length.
    pub const fn float_list(name: &'static str) -> Self {
        Self::new(name, EntryType::FloatList)
    }

    /// UTF-8 text.
    pub const fn text(name: &'static str) -> Self {
        Self::new(name, EntryType::Text)
    }

    /// A column with `width` values in a row.
    pub const fn column(name: &'static str, kind: ColumnType, width: u32) -> Self {
        Self::new(name, EntryType::Column { kind, width })
    }

    const fn new(name: &'static str, ty: EntryType) -> Self {
        Self { name, ty, optional: false, unit: "", doc: "" }
    }

    /// Makes the entry optional. Only a text, a number, a list of any length and a column may be: across the C boundary an
    /// absent text, list or column is a null pointer and an absent number is NaN, so an optional number cannot hold NaN.
    /// Use [`SchemaEntry::float_list`] for an optional list of fixed length.
    ///
    /// # Panics
    /// For any other type; at compile time in a constant.
    pub const fn optional(mut self) -> Self {
        assert!(self.ty.may_be_optional(), "{}", NOT_OPTIONAL);
        self.optional = true;
        self
    }

    /// Sets the unit.
    pub const fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// Sets the doc text.
    pub const fn doc(mut self, doc: &'static str) -> Self {
        self.doc = doc;
        self
    }

    /// Whether the entry is a column rather than a head field.
    pub const fn is_column(&self) -> bool {
        matches!(self.ty, EntryType::Column { .. })
    }

    /// The common prefix of the columns that the entry matches, if it matches several: `extra/` for `extra/*`.
    pub fn prefix(&self) -> Option<&'static str> {
        self.name.strip_suffix('*').filter(|prefix| prefix.ends_with('/') && self.is_column())
    }

    /// Checks that the entries form a schema: at most 1024 entries, unique names, fields before columns, and only types
    /// that may be optional are.
    ///
    /// # Errors
    /// [`SchemaError`] with the first invalid entry.
    pub fn check_all(schema: &[Self]) -> Result<(), SchemaError> {
        if schema.len() > MAX_ENTRIES {
            return Err(SchemaError(format!("it has {} entries, at most {MAX_ENTRIES} are allowed", schema.len())));
        }
        for (index, entry) in schema.iter().enumerate() {
            let before = &schema[..index];
            let wrong = if entry.name.is_empty() {
                "it has no name"
            } else if before.iter().any(|other| other.name == entry.name) {
                "the name occurs twice"
            } else if !entry.is_column() && before.iter().any(Self::is_column) {
                "head fields must come before all columns"
            } else if entry.name.contains('*') && entry.prefix().is_none() {
                "only the name of a column may end in \"/*\", and no name may have another *"
            } else if entry.optional && !entry.ty.may_be_optional() {
                NOT_OPTIONAL
            } else if matches!(entry.ty, EntryType::Floats(0) | EntryType::Column { width: 0, .. }) {
                "it holds no values; at least one is needed"
            } else {
                continue;
            };
            return Err(SchemaError(format!("entry \"{}\": {wrong}", entry.name)));
        }
        Ok(())
    }

    /// Name and unit of each entry with a unit: columns first, the order of recordings.
    pub(crate) fn units(schema: &'static [Self]) -> Vec<(&'static str, &'static str)> {
        let of = |columns: bool| schema.iter().filter(move |e| e.is_column() == columns && !e.unit.is_empty());
        of(true).chain(of(false)).map(|entry| (entry.name, entry.unit)).collect()
    }

    /// The first pair of entries in which two schemas differ, ignoring docs.
    pub(crate) fn first_difference(a: &[Self], b: &[Self]) -> Option<(Option<Self>, Option<Self>)> {
        let bare = |entry: Option<&Self>| entry.map(|entry| Self { doc: "", ..*entry });
        let pairs = (0..a.len().max(b.len())).map(|index| (bare(a.get(index)), bare(b.get(index))));
        pairs.into_iter().find(|(a, b)| a != b)
    }

    pub(crate) fn matches_column(&self, column: &str) -> bool {
        self.is_column() && (self.name == column || self.prefix().is_some_and(|prefix| column.starts_with(prefix)))
    }
}

impl EntryType {
    const fn may_be_optional(self) -> bool {
        matches!(self, Self::Float | Self::FloatList | Self::Text | Self::Column { .. })
    }

    /// The noun that [`crate::ViewError::Missing`] uses.
    pub(crate) fn noun(self) -> &'static str {
        match self {
            Self::Bool => "boolean field",
            Self::Int => "integer field",
            Self::Float => "number field",
            Self::Floats(_) | Self::FloatList => "number list",
            Self::Text => "text field",
            Self::Column { .. } => "column",
        }
    }
}

/// For messages: `column "points" of 3 x f64 in mm`.
impl fmt::Display for SchemaEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, ty, optional, unit, .. } = self;
        f.write_str(if *optional { "optional " } else { "" })?;
        match ty {
            EntryType::Column { kind, width } => write!(f, "column \"{name}\" of {width} x {}", kind.name())?,
            ty => write!(f, "field \"{name}\", {ty}")?,
        }
        if unit.is_empty() { Ok(()) } else { write!(f, " in {unit}") }
    }
}

impl fmt::Display for EntryType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool => write!(f, "a boolean"),
            Self::Int => write!(f, "an integer"),
            Self::Float => write!(f, "a number"),
            Self::Floats(n) => write!(f, "a list of {n} numbers"),
            Self::FloatList => write!(f, "a list of numbers"),
            Self::Text => write!(f, "a text"),
            Self::Column { kind, width } => write!(f, "a column of {width} x {}", kind.name()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Column, View};
    use std::sync::Arc;

    const SCHEMA: &[SchemaEntry] = &[
        SchemaEntry::bool("is_whole"),
        SchemaEntry::int("stamp_ns"),
        SchemaEntry::float("gain_mm").optional(),
        SchemaEntry::floats("centre", 3).unit("mm"),
        SchemaEntry::float_list("viewpoint").optional().unit("pose"),
        SchemaEntry::text("label").optional(),
        SchemaEntry::column("points", ColumnType::F64, 3).unit("mm"),
        SchemaEntry::column("faces", ColumnType::U32, 3).optional().doc("corners of triangles"),
        SchemaEntry::column("extra/*", ColumnType::F32, 1),
    ];

    fn column(name: &'static str, kind: ColumnType, width: u32, n_bytes: usize) -> Column {
        Column::new(name, kind, width, Arc::new(vec![0_u8; n_bytes]))
    }

    fn view() -> View {
        View::new().with("stamp_ns", 7).with("is_whole", true).with("centre", vec![0.0; 3]).with_column(column(
            "points",
            ColumnType::F64,
            3,
            48,
        ))
    }

    #[test]
    fn a_view_fits_its_schema_with_and_without_optional_entries() {
        assert_eq!(view().check(SCHEMA), Ok(()));
        let full = view()
            .with("gain_mm", 1.5)
            .with("viewpoint", vec![0.0; 7])
            .with("label", "a")
            .with_column(column("faces", ColumnType::U32, 3, 0))
            .with_column(column("extra/grey", ColumnType::F32, 1, 8))
            .with_column(column("extra/heat", ColumnType::F32, 1, 8));
        assert_eq!(full.check(SCHEMA), Ok(()));
    }

    #[test]
    fn each_mismatch_has_its_own_message() {
        let without = |name: &str| {
            let mut view = view();
            view.head.retain(|(n, _)| n != name);
            view.columns.retain(|c| c.name != name);
            view
        };
        let cases = [
            (without("is_whole"), "the view has no boolean field \"is_whole\""),
            (without("points"), "the view has no column \"points\""),
            (
                without("centre").with("centre", vec![0.0; 2]),
                "field \"centre\" is a list of 2 numbers, a list of 3 numbers needed",
            ),
            (without("stamp_ns").with("stamp_ns", 1.0), "field \"stamp_ns\" is a number, an integer needed"),
            (
                without("points").with_column(column("points", ColumnType::F32, 3, 24)),
                "column \"points\" holds f32, f64 needed",
            ),
            (
                without("points").with_column(column("points", ColumnType::F64, 2, 48)),
                "column \"points\" has 2 values in a row, 3 needed",
            ),
            (
                without("points").with_column(column("points", ColumnType::F64, 3, 40)),
                "column \"points\" ends within a row: 40 bytes in rows of 24",
            ),
            (
                view().with_column(column("extra/grey", ColumnType::F64, 1, 8)),
                "column \"extra/grey\" holds f64, f32 needed",
            ),
            (view().with("colour", "red"), "the view has a field \"colour\" that its payload does not have"),
            (view().with("points", "red"), "the view has a field \"points\" that its payload does not have"),
            (
                view().with_column(column("extra", ColumnType::F32, 1, 8)),
                "the view has a column \"extra\" that its payload does not have",
            ),
            (view().with("stamp_ns", 8), "the view has two fields \"stamp_ns\""),
            (view().with_column(column("points", ColumnType::F64, 3, 24)), "the view has two columns \"points\""),
        ];
        for (view, expected) in cases {
            assert_eq!(view.check(SCHEMA).unwrap_err().to_string(), expected);
        }
    }

    #[test]
    fn an_invalid_schema_is_refused() {
        assert_eq!(SchemaEntry::check_all(SCHEMA), Ok(()));
        let points = SchemaEntry::column("points", ColumnType::F64, 3);
        let optional_list = SchemaEntry { optional: true, ..SchemaEntry::floats("centre", 3) };
        let cases: [(&[SchemaEntry], &str); 7] = [
            (&[points, points], "twice"),
            (&[points, SchemaEntry::text("frame")], "before all columns"),
            (&[optional_list], "may be optional"),
            (&[SchemaEntry::text("extra/*")], "/*"),
            (&[SchemaEntry::column("a*b", ColumnType::U8, 1)], "/*"),
            (&[SchemaEntry::column("a", ColumnType::U8, 0)], "no values"),
            (&[SchemaEntry::text("")], "no name"),
        ];
        for (schema, expected) in cases {
            let error = SchemaEntry::check_all(schema).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    #[should_panic(expected = "may be optional")]
    fn an_integer_cannot_be_optional() {
        let _ = SchemaEntry::int("stamp_ns").optional();
    }

    #[test]
    fn units_list_columns_first() {
        assert_eq!(SchemaEntry::units(SCHEMA), [("points", "mm"), ("centre", "mm"), ("viewpoint", "pose")]);
    }

    #[test]
    fn the_json_of_a_schema_omits_defaults() {
        let json = serde_json::to_string(&[SCHEMA[1], SCHEMA[3], SCHEMA[4], SCHEMA[7]]).unwrap();
        let expected = [
            r#"[{"name":"stamp_ns","field":"int"}"#,
            r#"{"name":"centre","field":"floats","length":3,"unit":"mm"}"#,
            r#"{"name":"viewpoint","field":"floats","optional":true,"unit":"pose"}"#,
            r#"{"name":"faces","column":"u32","width":3,"optional":true,"doc":"corners of triangles"}]"#,
        ];
        assert_eq!(json, expected.join(","));
        let back: Vec<SchemaEntry> = serde_json::from_str(&serde_json::to_string(SCHEMA).unwrap()).unwrap();
        assert_eq!(back, SCHEMA);
        for wrong in [r#"{"name":"a","field":"colour"}"#, r#"{"name":"a","column":"f64"}"#, r#"{"name":"a"}"#] {
            let error = serde_json::from_str::<SchemaEntry>(wrong).unwrap_err().to_string();
            assert!(error.contains("entry \"a\" is neither a head field nor a column"), "{error}");
        }
    }
}
