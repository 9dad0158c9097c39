use super::range::Range;
use osteoflow_node::FilePath;
use serde_json::Value as Json;

/// What a schema takes.
pub(super) enum Shape<'a> {
    Bool,
    Int(Range),
    Number(Range),
    Text,
    Path,
    /// One of some words, each with what its author says of it.
    Words(Vec<(&'a str, Option<&'a str>)>),
    /// Items of one schema.
    List {
        items: Option<&'a Json>,
        min: usize,
        max: Option<usize>,
    },
    /// Items each of its own schema.
    Tuple(Vec<&'a Json>),
    /// A struct or a map.
    Table,
    /// One of several.
    Union(Vec<&'a Json>),
    Any,
}

/// The schema behind references.
pub(super) fn resolve<'a>(root: &'a Json, mut schema: &'a Json) -> &'a Json {
    // A reference to a reference is never deep; the bound only keeps a circle from hanging.
    for _ in 0..16 {
        let Some(reference) = schema.get("$ref").and_then(Json::as_str) else { break };
        match reference.strip_prefix('#').and_then(|pointer| root.pointer(pointer)) {
            Some(target) => schema = target,
            None => break,
        }
    }
    schema
}

pub(super) fn shape<'a>(root: &'a Json, schema: &'a Json) -> Shape<'a> {
    let schema = resolve(root, schema);
    if let Some(branches) = ["oneOf", "anyOf"].iter().find_map(|key| schema.get(*key)?.as_array()) {
        return union(root, branches);
    }
    if let Some(words) = schema.get("enum").and_then(Json::as_array) {
        return Shape::Words(words.iter().filter_map(|word| Some((word.as_str()?, None))).collect());
    }
    if let Some(word) = schema.get("const").and_then(Json::as_str) {
        return Shape::Words(vec![(word, doc(schema))]);
    }
    match type_of(schema) {
        "boolean" => Shape::Bool,
        "integer" => Shape::Int(Range::of(schema)),
        "number" => Shape::Number(Range::of(schema)),
        "string" if schema.get("format").and_then(Json::as_str) == Some(FilePath::SCHEMA_FORMAT) => Shape::Path,
        "string" => Shape::Text,
        "array" => list(schema),
        "object" => Shape::Table,
        _ => Shape::Any,
    }
}

fn list(schema: &Json) -> Shape<'_> {
    if let Some(items) = schema.get("prefixItems").and_then(Json::as_array) {
        return Shape::Tuple(items.iter().collect());
    }
    let count = |key: &str| schema.get(key).and_then(Json::as_u64).map(|n| n as usize);
    Shape::List { items: schema.get("items"), min: count("minItems").unwrap_or(0), max: count("maxItems") }
}

/// The branches without `null`, which a graph file cannot say; branches of words are one.
fn union<'a>(root: &'a Json, branches: &'a [Json]) -> Shape<'a> {
    let branches: Vec<_> = branches.iter().filter(|b| type_of(resolve(root, b)) != "null").collect();
    if let [only] = branches.as_slice() {
        return shape(root, only);
    }
    let mut words = Vec::new();
    for branch in &branches {
        match shape(root, branch) {
            Shape::Words(more) => words.extend(more),
            _ => return Shape::Union(branches),
        }
    }
    Shape::Words(words)
}

/// The type, where an optional one may say `["number", "null"]`.
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

/// What a schema takes, in words: `a number from 0.1 to 100`.
pub(super) fn describe(root: &Json, schema: &Json) -> String {
    match shape(root, schema) {
        Shape::Bool => "true or false".into(),
        Shape::Int(range) => range.describe("a whole number"),
        Shape::Number(range) => range.describe("a number"),
        Shape::Text => "a text".into(),
        Shape::Path => "the path of a file or folder".into(),
        Shape::Words(words) => {
            let words: Vec<_> = words.iter().map(|(word, _)| format!("\"{word}\"")).collect();
            match words.as_slice() {
                [only] => only.clone(),
                _ => format!("one of {}", words.join(", ")),
            }
        }
        Shape::List { min, max, .. } => match (min, max) {
            (min, Some(max)) if min == max => format!("a list of {min}"),
            (min, Some(max)) => format!("a list of {min} to {max}"),
            (0, None) => "a list".into(),
            (min, None) => format!("a list of at least {min}"),
        },
        Shape::Tuple(items) => format!("a list of {}", items.len()),
        Shape::Table => "a table".into(),
        Shape::Union(branches) => {
            let mut texts: Vec<_> = branches.iter().map(|b| describe(root, b)).collect();
            texts.dedup();
            texts.join(" or ")
        }
        Shape::Any => "any value".into(),
    }
}
