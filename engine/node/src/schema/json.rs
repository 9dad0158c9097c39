//! Schema entries as JSON: in recordings, and in the descriptions of plugins.

use super::{EntryType, SchemaEntry};
use crate::{ColumnType, intern::intern};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error, ser::SerializeMap};

/// A field is `{"name", "field", "length"}` with field `bool`, `int`, `float`, `floats` or `text`, and a length only where
/// it is fixed; a column is `{"name", "column", "width"}` with column `f64` and the like. `optional`, `unit` and `doc`
/// are omitted where they are false or empty.
impl Serialize for SchemaEntry {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("name", self.name)?;
        let field = match self.ty {
            EntryType::Bool => "bool",
            EntryType::Int => "int",
            EntryType::Float => "float",
            EntryType::Floats(_) | EntryType::FloatList => "floats",
            EntryType::Text => "text",
            EntryType::Column { .. } => "",
        };
        match self.ty {
            EntryType::Column { kind, width } => {
                map.serialize_entry("column", kind.name())?;
                map.serialize_entry("width", &width)?;
            }
            _ => map.serialize_entry("field", field)?,
        }
        if let EntryType::Floats(n) = self.ty {
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

/// The texts are interned: they live until the program ends.
impl<'de> Deserialize<'de> for SchemaEntry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        struct Json {
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
        let json = Json::deserialize(deserializer)?;
        let ty = match (json.field.as_deref(), json.length, json.column.as_deref(), json.width) {
            (Some("bool"), None, None, None) => Some(EntryType::Bool),
            (Some("int"), None, None, None) => Some(EntryType::Int),
            (Some("float"), None, None, None) => Some(EntryType::Float),
            (Some("floats"), None, None, None) => Some(EntryType::FloatList),
            (Some("floats"), Some(n), None, None) => Some(EntryType::Floats(n)),
            (Some("text"), None, None, None) => Some(EntryType::Text),
            (None, None, Some(kind), Some(width)) => {
                ColumnType::ALL.into_iter().find(|t| t.name() == kind).map(|kind| EntryType::Column { kind, width })
            }
            _ => None,
        };
        let unknown = || D::Error::custom(format!("entry \"{}\" is neither a head field nor a column", json.name));
        let (ty, optional) = (ty.ok_or_else(unknown)?, json.optional);
        Ok(Self { name: intern(&json.name), ty, optional, unit: intern(&json.unit), doc: intern(&json.doc) })
    }
}
