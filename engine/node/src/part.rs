//! What a payload type says its views hold: the schema of its head fields and columns.

use crate::{Column, ColumnType, Field, View, ViewError, free::kept};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error, ser::SerializeMap};
use std::fmt;

/// One head field or column of a payload's view. A schema is a list of them, fields before columns:
///
/// ```
/// use osteoflow_node::{ColumnType, Part, View};
///
/// const SCHEMA: &[Part] = &[
///     Part::text("frame"),
///     Part::float_list("viewpoint").optional().unit("pose"),
///     Part::column("points", ColumnType::F64, 3).unit("mm"),
///     Part::column("extra/*", ColumnType::F64, 1).doc("values of the points, by name"),
/// ];
/// let error = View::new().with("frame", "camera").check(SCHEMA).unwrap_err();
/// assert_eq!(error.to_string(), "the view has no column \"points\"");
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Its name. A column's that ends in `/*` stands for any number of columns, none too, whose names begin so.
    pub name: &'static str,
    /// What it holds.
    pub shape: Shape,
    /// Whether a view may lack it.
    pub optional: bool,
    /// The unit where the name does not say it by a suffix such as `_mm`: a unit, or `pose` for rows of translation
    /// x, y, z in mm and quaternion x, y, z, w. Otherwise empty.
    pub unit: &'static str,
    /// What it means, where the name does not say it. Otherwise empty.
    pub doc: &'static str,
}

/// What a part of a view holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Yes or no.
    Bool,
    /// A count or a stamp.
    Int,
    /// A number.
    Float,
    /// So many numbers, always.
    Floats(u32),
    /// Any number of numbers.
    FloatList,
    /// Text in UTF-8.
    Text,
    /// Rows.
    Column {
        /// The type of each value.
        kind: ColumnType,
        /// Values in a row.
        width: u32,
    },
}

/// A longer schema is a mistake, and would be walked for each item.
const MAX_PARTS: usize = 1024;

/// A list of parts that is no schema.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the schema is not valid: {0}")]
pub struct SchemaError(pub(crate) String);

impl Part {
    /// A yes or no.
    pub const fn bool(name: &'static str) -> Self {
        Self::new(name, Shape::Bool)
    }

    /// A count or a stamp.
    pub const fn int(name: &'static str) -> Self {
        Self::new(name, Shape::Int)
    }

    /// A number.
    pub const fn float(name: &'static str) -> Self {
        Self::new(name, Shape::Float)
    }

    /// `n` numbers, always.
    pub const fn floats(name: &'static str, n: u32) -> Self {
        Self::new(name, Shape::Floats(n))
    }

    /// Any number of numbers.
    pub const fn float_list(name: &'static str) -> Self {
        Self::new(name, Shape::FloatList)
    }

    /// Text in UTF-8.
    pub const fn text(name: &'static str) -> Self {
        Self::new(name, Shape::Text)
    }

    /// Rows of `width` values.
    pub const fn column(name: &'static str, kind: ColumnType, width: u32) -> Self {
        Self::new(name, Shape::Column { kind, width })
    }

    const fn new(name: &'static str, shape: Shape) -> Self {
        Self { name, shape, optional: false, unit: "", doc: "" }
    }

    /// The same, which a view may lack. Only a text, a number, a list of any length and a column may: across the C
    /// boundary an absent text, list or column has no pointer, and an absent number is NaN, so that an optional number
    /// must not be NaN where it is there. So many numbers that may be absent are a [`Part::float_list`].
    ///
    /// # Panics
    /// For another shape, in a constant when it is compiled.
    pub const fn optional(mut self) -> Self {
        assert!(self.shape.may_be_absent(), "only a text, a number, a list of any length and a column may be absent");
        self.optional = true;
        self
    }

    /// The same, in this unit.
    pub const fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// The same, with what it means.
    pub const fn doc(mut self, doc: &'static str) -> Self {
        self.doc = doc;
        self
    }

    /// Whether it is a column and no head field.
    pub const fn is_column(&self) -> bool {
        matches!(self.shape, Shape::Column { .. })
    }

    /// What the columns' names begin with, where it stands for any number of them: `extra/` of `extra/*`.
    pub fn prefix(&self) -> Option<&'static str> {
        self.name.strip_suffix('*').filter(|prefix| prefix.ends_with('/') && self.is_column())
    }

    /// Whether the list is a schema: at most 1024 parts, each name once, fields before columns, and optional only what
    /// may be.
    ///
    /// # Errors
    /// [`SchemaError`] with the first part that is wrong.
    pub fn check_all(schema: &[Self]) -> Result<(), SchemaError> {
        if schema.len() > MAX_PARTS {
            return Err(SchemaError(format!("it has {} parts, {MAX_PARTS} are the most", schema.len())));
        }
        for (index, part) in schema.iter().enumerate() {
            let before = &schema[..index];
            let wrong = if part.name.is_empty() {
                "it has no name"
            } else if before.iter().any(|other| other.name == part.name) {
                "the name stands there twice"
            } else if !part.is_column() && before.iter().any(Self::is_column) {
                "a head field stands before all columns"
            } else if part.name.contains('*') && part.prefix().is_none() {
                "only the name of a column ends in \"/*\", and no name has another *"
            } else if part.optional && !part.shape.may_be_absent() {
                "only a text, a number, a list of any length and a column may be absent"
            } else if matches!(part.shape, Shape::Floats(0) | Shape::Column { width: 0, .. }) {
                "it holds no values; one at least is needed"
            } else {
                continue;
            };
            return Err(SchemaError(format!("part \"{}\": {wrong}", part.name)));
        }
        Ok(())
    }

    /// Units of head fields and columns whose names do not say them: columns first, as recordings have them.
    pub(crate) fn units(schema: &'static [Self]) -> Vec<(&'static str, &'static str)> {
        let of = |columns: bool| schema.iter().filter(move |part| part.is_column() == columns && !part.unit.is_empty());
        of(true).chain(of(false)).map(|part| (part.name, part.unit)).collect()
    }

    /// The first two parts in which schemas differ; what is said of a part is not looked at.
    pub(crate) fn first_difference(a: &[Self], b: &[Self]) -> Option<(Option<Self>, Option<Self>)> {
        let bare = |part: Option<&Self>| part.map(|part| Self { doc: "", ..*part });
        let parts = (0..a.len().max(b.len())).map(|index| (bare(a.get(index)), bare(b.get(index))));
        parts.into_iter().find(|(a, b)| a != b)
    }

    fn stands_for(&self, column: &str) -> bool {
        self.is_column() && (self.name == column || self.prefix().is_some_and(|prefix| column.starts_with(prefix)))
    }
}

impl Shape {
    const fn may_be_absent(self) -> bool {
        matches!(self, Self::Float | Self::FloatList | Self::Text | Self::Column { .. })
    }

    /// The kind of thing, as [`ViewError::Missing`] names it.
    fn what(self) -> &'static str {
        match self {
            Self::Bool => "yes or no",
            Self::Int => "integer field",
            Self::Float => "number field",
            Self::Floats(_) | Self::FloatList => "number list",
            Self::Text => "text field",
            Self::Column { .. } => "column",
        }
    }

    fn takes(self, field: &Field) -> bool {
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

    /// The shape of a field's value.
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

/// For messages: `column "points" of 3 x f64 in mm`.
impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, shape, optional, unit, .. } = self;
        f.write_str(if *optional { "optional " } else { "" })?;
        match shape {
            Shape::Column { kind, width } => write!(f, "column \"{name}\" of {width} x {}", kind.name())?,
            shape => write!(f, "field \"{name}\", {shape}")?,
        }
        if unit.is_empty() { Ok(()) } else { write!(f, " in {unit}") }
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool => write!(f, "a yes or no"),
            Self::Int => write!(f, "an integer"),
            Self::Float => write!(f, "a number"),
            Self::Floats(n) => write!(f, "a list of {n} numbers"),
            Self::FloatList => write!(f, "a list of numbers"),
            Self::Text => write!(f, "a text"),
            Self::Column { kind, width } => write!(f, "a column of {width} x {}", kind.name()),
        }
    }
}

/// A field is `{"name", "field", "length"}` with field `bool`, `int`, `float`, `floats` or `text`, and a length where it
/// is fixed; a column is `{"name", "column", "width"}` with column `f64` and the like. `optional`, `unit` and `doc`
/// follow where there is something to say.
impl Serialize for Part {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("name", self.name)?;
        let field = match self.shape {
            Shape::Bool => "bool",
            Shape::Int => "int",
            Shape::Float => "float",
            Shape::Floats(_) | Shape::FloatList => "floats",
            Shape::Text => "text",
            Shape::Column { .. } => "",
        };
        match self.shape {
            Shape::Column { kind, width } => {
                map.serialize_entry("column", kind.name())?;
                map.serialize_entry("width", &width)?;
            }
            _ => map.serialize_entry("field", field)?,
        }
        if let Shape::Floats(n) = self.shape {
            map.serialize_entry("length", &n)?;
        }
        if self.optional {
            map.serialize_entry("optional", &true)?;
        }
        for (key, text) in [("unit", self.unit), ("doc", self.doc)] {
            if !text.is_empty() {
                map.serialize_entry(key, text)?;
            }
        }
        map.end()
    }
}

/// As it was written; its texts are kept until the program ends.
impl<'de> Deserialize<'de> for Part {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        struct Told {
            name: String,
            field: Option<String>,
            length: Option<u32>,
            column: Option<String>,
            width: Option<u32>,
            #[serde(default)]
            optional: bool,
            #[serde(default)]
            unit: String,
            #[serde(default)]
            doc: String,
        }
        let told = Told::deserialize(deserializer)?;
        let shape = match (told.field.as_deref(), told.length, told.column.as_deref(), told.width) {
            (Some("bool"), None, None, None) => Some(Shape::Bool),
            (Some("int"), None, None, None) => Some(Shape::Int),
            (Some("float"), None, None, None) => Some(Shape::Float),
            (Some("floats"), None, None, None) => Some(Shape::FloatList),
            (Some("floats"), Some(n), None, None) => Some(Shape::Floats(n)),
            (Some("text"), None, None, None) => Some(Shape::Text),
            (None, None, Some(kind), Some(width)) => {
                ColumnType::ALL.into_iter().find(|t| t.name() == kind).map(|kind| Shape::Column { kind, width })
            }
            _ => None,
        };
        let unknown = || D::Error::custom(format!("part \"{}\" is neither a head field nor a column", told.name));
        let (shape, optional) = (shape.ok_or_else(unknown)?, told.optional);
        Ok(Self { name: kept(&told.name), shape, optional, unit: kept(&told.unit), doc: kept(&told.doc) })
    }
}

/// The first name that stands there twice.
fn twice<'a>(names: impl Iterator<Item = &'a str>) -> Option<String> {
    let mut names: Vec<_> = names.collect();
    names.sort_unstable();
    names.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0].to_owned())
}

impl View {
    /// Whether the view has all that a schema says, of the types it says, and nothing else.
    ///
    /// # Errors
    /// [`ViewError`] with the first head field or column that is missing, wrong or too many.
    pub fn check(&self, schema: &[Part]) -> Result<(), ViewError> {
        for part in schema.iter().filter(|part| !part.is_column() && !part.optional) {
            if self.field(part.name).is_none() {
                return Err(ViewError::Missing { what: part.shape.what(), name: part.name.into() });
            }
        }
        for (name, field) in &self.head {
            let Some(part) = schema.iter().find(|part| !part.is_column() && part.name == name) else {
                return Err(ViewError::Unknown { what: "field", name: name.to_string() });
            };
            if !part.shape.takes(field) {
                let (found, expected) = (Shape::of(field), part.shape);
                return Err(ViewError::FieldType { name: name.to_string(), found, expected });
            }
        }
        if let Some(name) = twice(self.head.iter().map(|(name, _)| &**name)) {
            return Err(ViewError::Twice { what: "fields", name });
        }
        self.check_columns(schema)
    }

    /// The same of its columns alone: the fields have been read by the schema.
    ///
    /// # Errors
    /// [`ViewError`] with the first column that is missing, wrong or too many.
    pub fn check_columns(&self, schema: &[Part]) -> Result<(), ViewError> {
        for part in schema.iter().filter(|part| part.is_column() && !part.optional && part.prefix().is_none()) {
            if !self.columns.iter().any(|column| column.name == part.name) {
                return Err(ViewError::Missing { what: part.shape.what(), name: part.name.into() });
            }
        }
        for column in &self.columns {
            let of_name = schema.iter().find(|part| part.is_column() && part.name == column.name);
            let part = of_name.or_else(|| schema.iter().find(|part| part.stands_for(&column.name)));
            let Some(Shape::Column { kind, width }) = part.map(|part| part.shape) else {
                return Err(ViewError::Unknown { what: "column", name: column.name.to_string() });
            };
            column.check(kind, width)?;
        }
        if self.columns.len() > 1
            && let Some(name) = twice(self.columns.iter().map(|column| &*column.name))
        {
            return Err(ViewError::Twice { what: "columns", name });
        }
        Ok(())
    }
}

impl Column {
    /// Whether it has whole rows of `width` values of `kind`.
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    const SCHEMA: &[Part] = &[
        Part::bool("is_whole"),
        Part::int("stamp_ns"),
        Part::float("gain_mm").optional(),
        Part::floats("centre", 3).unit("mm"),
        Part::float_list("viewpoint").optional().unit("pose"),
        Part::text("label").optional(),
        Part::column("points", ColumnType::F64, 3).unit("mm"),
        Part::column("faces", ColumnType::U32, 3).optional().doc("corners of triangles"),
        Part::column("extra/*", ColumnType::F32, 1),
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
    fn a_view_fits_its_schema_with_and_without_what_is_optional() {
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
    fn each_way_not_to_fit_has_a_message_of_its_own() {
        let without = |name: &str| {
            let mut view = view();
            view.head.retain(|(n, _)| n != name);
            view.columns.retain(|c| c.name != name);
            view
        };
        let cases = [
            (without("is_whole"), "the view has no yes or no \"is_whole\""),
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
    fn what_is_no_schema_is_refused() {
        assert_eq!(Part::check_all(SCHEMA), Ok(()));
        let points = Part::column("points", ColumnType::F64, 3);
        let may_lack = Part { optional: true, ..Part::floats("centre", 3) };
        let cases: [(&[Part], &str); 7] = [
            (&[points, points], "twice"),
            (&[points, Part::text("frame")], "before all columns"),
            (&[may_lack], "may be absent"),
            (&[Part::text("extra/*")], "/*"),
            (&[Part::column("a*b", ColumnType::U8, 1)], "/*"),
            (&[Part::column("a", ColumnType::U8, 0)], "no values"),
            (&[Part::text("")], "no name"),
        ];
        for (schema, expected) in cases {
            let error = Part::check_all(schema).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    #[should_panic(expected = "may be absent")]
    fn an_integer_cannot_be_optional() {
        let _ = Part::int("stamp_ns").optional();
    }

    #[test]
    fn units_are_told_columns_first() {
        assert_eq!(Part::units(SCHEMA), [("points", "mm"), ("centre", "mm"), ("viewpoint", "pose")]);
    }

    #[test]
    fn a_schema_is_told_in_json_without_what_goes_without_saying() {
        let told = serde_json::to_string(&[SCHEMA[1], SCHEMA[3], SCHEMA[4], SCHEMA[7]]).unwrap();
        let expected = [
            r#"[{"name":"stamp_ns","field":"int"}"#,
            r#"{"name":"centre","field":"floats","length":3,"unit":"mm"}"#,
            r#"{"name":"viewpoint","field":"floats","optional":true,"unit":"pose"}"#,
            r#"{"name":"faces","column":"u32","width":3,"optional":true,"doc":"corners of triangles"}]"#,
        ];
        assert_eq!(told, expected.join(","));
        let back: Vec<Part> = serde_json::from_str(&serde_json::to_string(SCHEMA).unwrap()).unwrap();
        assert_eq!(back, SCHEMA);
        for wrong in [r#"{"name":"a","field":"colour"}"#, r#"{"name":"a","column":"f64"}"#, r#"{"name":"a"}"#] {
            let error = serde_json::from_str::<Part>(wrong).unwrap_err().to_string();
            assert!(error.contains("part \"a\" is neither a head field nor a column"), "{error}");
        }
    }
}
