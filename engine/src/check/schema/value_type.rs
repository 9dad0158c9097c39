use super::range::Range;
use osteoflow_node::FilePath;
use serde_json::Value as Json;

/// The values that a schema accepts.
pub(super) enum ValueType<'a> {
    Bool,
    Int(Range),
    Number(Range),
    Text,
    Path,
    /// One of a set of words, each with its doc.
    Words(Vec<(&'a str, Option<&'a str>)>),
    /// A list whose items share one schema.
    List {
        items: Option<&'a Json>,
        min: usize,
        max: Option<usize>,
    },
    /// A list with a schema for each item.
    Tuple(Vec<&'a Json>),
    /// A struct or a map.
    Table,
    /// A value that matches one of several schemas.
    Union(Vec<&'a Json>),
    Any,
}

/// Follows references to the schema itself, and an optional value's to that of the value.
pub(super) fn resolve<'a>(root: &'a Json, mut schema: &'a Json) -> &'a Json {
    // References are never nested this deeply; the bound stops a cycle.
    for _ in 0..16 {
        let target = match schema.get("$ref").and_then(Json::as_str) {
            Some(reference) => reference.strip_prefix('#').and_then(|pointer| root.pointer(pointer)),
            None => match branches(schema).as_deref() {
                Some([only]) => Some(*only),
                _ => None,
            },
        };
        match target {
            Some(target) => schema = target,
            None => break,
        }
    }
    schema
}

/// The branches of a union without `null`, which TOML cannot express.
fn branches(schema: &Json) -> Option<Vec<&Json>> {
    let branches = ["oneOf", "anyOf"].iter().find_map(|key| schema.get(*key)?.as_array())?;
    Some(branches.iter().filter(|branch| type_of(branch) != "null").collect())
}

pub(super) fn value_type<'a>(root: &'a Json, schema: &'a Json) -> ValueType<'a> {
    let schema = resolve(root, schema);
    if let Some(branches) = branches(schema) {
        return union(root, branches);
    }
    if let Some(words) = schema.get("enum").and_then(Json::as_array) {
        return ValueType::Words(words.iter().filter_map(|word| Some((word.as_str()?, None))).collect());
    }
    if let Some(word) = schema.get("const").and_then(Json::as_str) {
        return ValueType::Words(vec![(word, doc(schema))]);
    }
    match type_of(schema) {
        "boolean" => ValueType::Bool,
        "integer" => ValueType::Int(Range::of(schema)),
        "number" => ValueType::Number(Range::of(schema)),
        "string" if schema.get("format").and_then(Json::as_str) == Some(FilePath::SCHEMA_FORMAT) => ValueType::Path,
        "string" => ValueType::Text,
        "array" => list(schema),
        "object" => ValueType::Table,
        _ => ValueType::Any,
    }
}

fn list(schema: &Json) -> ValueType<'_> {
    if let Some(items) = schema.get("prefixItems").and_then(Json::as_array) {
        return ValueType::Tuple(items.iter().collect());
    }
    let count = |key: &str| schema.get(key).and_then(Json::as_u64).map(|n| n as usize);
    ValueType::List { items: schema.get("items"), min: count("minItems").unwrap_or(0), max: count("maxItems") }
}

/// Branches of words are merged into one.
fn union<'a>(root: &'a Json, branches: Vec<&'a Json>) -> ValueType<'a> {
    let mut words = Vec::new();
    for branch in &branches {
        match value_type(root, branch) {
            ValueType::Words(more) => words.extend(more),
            _ => return ValueType::Union(branches),
        }
    }
    ValueType::Words(words)
}

/// The type; for an optional value, the type beside `"null"`.
fn type_of(schema: &Json) -> &str {
    match schema.get("type") {
        Some(Json::String(name)) => name,
        Some(Json::Array(names)) => names.iter().filter_map(Json::as_str).find(|n| *n != "null").unwrap_or("null"),
        _ if schema.get("properties").is_some() => "object",
        _ => "",
    }
}

pub(super) fn doc(schema: &Json) -> Option<&str> {
    schema.get("description").and_then(Json::as_str)
}

/// Describes the accepted values: `a number from 0.1 to 100`.
pub(super) fn describe(root: &Json, schema: &Json) -> String {
    match value_type(root, schema) {
        ValueType::Bool => "true or false".into(),
        ValueType::Int(range) => range.describe("a whole number"),
        ValueType::Number(range) => range.describe("a number"),
        ValueType::Text => "a text".into(),
        ValueType::Path => "the path of a file or folder".into(),
        ValueType::Words(words) => {
            let words: Vec<_> = words.iter().map(|(word, _)| format!("\"{word}\"")).collect();
            match words.as_slice() {
                [only] => only.clone(),
                _ => format!("one of {}", words.join(", ")),
            }
        }
        ValueType::List { min, max, .. } => match (min, max) {
            (min, Some(max)) if min == max => format!("a list of {min}"),
            (min, Some(max)) => format!("a list of {min} to {max}"),
            (0, None) => "a list".into(),
            (min, None) => format!("a list of at least {min}"),
        },
        ValueType::Tuple(items) => format!("a list of {}", items.len()),
        ValueType::Table => "a table".into(),
        ValueType::Union(branches) => {
            let mut texts: Vec<_> = branches.iter().map(|b| describe(root, b)).collect();
            texts.dedup();
            texts.join(" or ")
        }
        ValueType::Any => "any value".into(),
    }
}
