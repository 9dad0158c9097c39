//! Generates the JSON Schema of a graph file from the nodes' descriptions, for completion and checks in editors.
//!
//! The schema is draft 7, which TOML language servers support. They complete without evaluating conditions, so kinds
//! are branches of one `anyOf`, each with its kind as a constant, its ports and its parameters.

use crate::graph::grammar::{self, JOINS};
use osteoflow_node::{Description, FilePath, InputPort, OutputPorts, Registry};
use serde_json::{Map, Value, json};

const DRAFT: &str = "http://json-schema.org/draft-07/schema#";

/// Maximum depth of nested parameters; recursive schemas are cut off there.
const MAX_DEPTH: usize = 16;

/// The schema of a graph file.
pub fn schema(registry: &Registry) -> Value {
    let branches = registry
        .kinds()
        .map(|kind| reference(kind.description.kind))
        .chain([reference("module"), reference("partial")]);
    let branches: Vec<_> = branches.collect();
    let mut definitions = common(registry);
    for kind in registry.kinds() {
        definitions.insert(kind.description.kind.into(), node(&kind.description));
    }
    definitions.insert(
        "node".into(),
        json!({ "description": "A node: its kind, what it takes, its parameters.", "anyOf": branches }),
    );
    json!({
        "$schema": DRAFT,
        "title": "Osteoflow graph",
        "description": "A graph of nodes: what they are, what each takes from which other, and what is kept of a run.",
        "type": "object",
        "properties": *grammar::TOP,
        "additionalProperties": false,
        "anyOf": [{ "required": ["graph"] }, { "required": ["extends"] }],
        "definitions": definitions,
    })
}

/// The schema of a node's table of one kind; `None` if there is no such kind.
pub fn kind_schema(registry: &Registry, kind: &str) -> Option<Value> {
    let description = &registry.kind(kind)?.description;
    let Value::Object(mut schema) = node(description) else { return None };
    schema.insert("$schema".into(), DRAFT.into());
    schema.insert("definitions".into(), Value::Object(common(registry)));
    Some(Value::Object(schema))
}

fn reference(definition: &str) -> Value {
    json!({ "$ref": format!("#/definitions/{definition}") })
}

/// Definitions shared by all kinds.
fn common(registry: &Registry) -> Map<String, Value> {
    let input = |joins: &[&str]| {
        let mut table = grammar::table(&grammar::INPUT);
        table["properties"]["join"]["enum"] = json!(joins);
        if joins.contains(&"collect") {
            table["properties"]["from"] = json!({ "anyOf": [reference("wire"), reference("wires")] });
            return json!({ "anyOf": [reference("wire"), reference("wires"), table] });
        }
        json!({ "anyOf": [reference("wire"), table] })
    };
    let (of_many, single): (Vec<_>, Vec<_>) = JOINS.iter().partition(|join| **join == "collect");
    let payloads: Vec<_> = registry.payload_types().map(|ty| ty.name).collect();
    let of_module = "Another graph file, whose nodes take this one's place.";
    let mut module = grammar::MODULE_NODE.clone();
    module.insert("kind".into(), constant("module", of_module));
    let mut partial = grammar::NODE.clone();
    partial.shift_remove("kind");
    partial.extend(of_every_kind());
    let Value::Object(mut out) = json!({
        "wire": { "type": "string", "pattern": "^[^.]+\\..+$", "description": "The producer: \"node.port\"." },
        "wires": {
            "type": "array", "items": reference("wire"), "minItems": 1, "uniqueItems": true,
            "description": "Several producers, whose items come in the order of the list.",
        },
        "input": input(&single),
        "input_of_many": input(&of_many),
        "payload": { "enum": payloads, "description": "The payload type." },
        "result": { "anyOf": [reference("wire"), {
            "description": "A wire, or a group of results.",
            "type": "object",
            "properties": *grammar::RESULT,
            "additionalProperties": reference("result"),
        }] },
        "module": {
            "title": "module", "description": of_module, "type": "object", "properties": module, "required": ["kind"],
        },
        "partial": {
            "description": "What a variant changes of a node whose kind the extended graph or a module chose.",
            "type": "object", "properties": partial, "not": { "required": ["kind"] },
        },
    }) else {
        return Map::new();
    };
    out.extend(of_every_kind().map(|(key, _)| (key.clone(), grammar::NODE[&key].clone())));
    out
}

/// The keys that nodes of every kind have beside their ports, by reference to their definitions.
fn of_every_kind() -> impl Iterator<Item = (String, Value)> {
    let keys = grammar::names(&grammar::NODE).filter(|key| !["kind", "in", "out"].contains(key));
    keys.map(|key| (key.to_owned(), reference(key)))
}

fn constant(kind: &str, summary: &str) -> Value {
    json!({ "const": kind, "description": summary, "x-taplo": { "docs": { "constValue": summary } } })
}

/// The table of a node of one kind. Required parameters may be set by the extended graph, so none is required here.
fn node(of: &Description) -> Value {
    let mut keys = Map::new();
    keys.insert("kind".into(), constant(of.kind, &of.summary));
    let inputs: Map<_, _> = of.inputs.iter().map(|port| (port.name.to_owned(), input(port))).collect();
    if !inputs.is_empty() {
        keys.insert(
            "in".into(),
            json!({
                "type": "object", "description": "What it takes: port = \"node.port\".",
                "properties": inputs, "additionalProperties": false,
            }),
        );
    }
    if let OutputPorts::Declared { schema } = &of.outputs {
        let mut port = object(plain(schema, schema, 0));
        if let Some(Value::Object(known)) = port.get_mut("properties") {
            known.extend(grammar::OUTPUT.clone());
        }
        port.remove("required");
        keys.insert("out".into(), json!({
            "type": "object", "description": "What it gives: a table for each output.", "additionalProperties": port,
        }));
    }
    keys.extend(of_every_kind());
    let params = object(plain(&of.params, &of.params, 0));
    let open = params.get("additionalProperties").filter(|more| **more != Value::Bool(false)).cloned();
    if let Some(Value::Object(known)) = params.get("properties") {
        keys.extend(known.clone());
    }
    json!({
        "title": of.kind,
        "description": of.summary,
        "type": "object",
        "properties": keys,
        "required": ["kind"],
        "additionalProperties": open.unwrap_or(Value::Bool(false)),
    })
}

fn input(port: &InputPort) -> Value {
    let definition = if port.join.collects() { "input_of_many" } else { "input" };
    let optional = if port.optional { " Optional." } else { "" };
    let doc = format!("Takes {}, joins by {}.{optional} {}", port.payload.name(), port.join.name(), one_line(port.doc));
    json!({ "description": doc.trim(), "anyOf": [{ "$ref": format!("#/definitions/{definition}") }] })
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn object(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(map) => map,
        _ => Map::new(),
    }
}

/// Converts a parameter's schema to draft 7 without references, and without null, which TOML cannot express.
fn plain(root: &Value, schema: &Value, depth: usize) -> Value {
    let Value::Object(schema) = schema else { return schema.clone() };
    if depth > MAX_DEPTH {
        return json!({});
    }
    let next = |inner: &Value| plain(root, inner, depth + 1);
    let mut out = Map::new();
    if let Some(target) = schema.get("$ref").and_then(|r| root.pointer(r.as_str()?.strip_prefix('#')?)) {
        out = object(next(target));
    }
    for (key, value) in schema {
        let value = match (key.as_str(), value) {
            ("$ref" | "$defs" | "$schema", _) => continue,
            ("default", Value::Null) => continue,
            ("format", Value::String(format)) if format == FilePath::SCHEMA_FORMAT => continue,
            // The numeric formats of schemars are not formats of JSON Schema.
            ("format", Value::String(format)) if format.starts_with(['u', 'i', 'f', 'd']) => continue,
            ("description", Value::String(text)) => {
                Value::from(text.split("\n\n").map(one_line).collect::<Vec<_>>().join("\n\n"))
            }
            ("type", Value::Array(names)) => {
                let names: Vec<_> = names.iter().filter(|name| *name != "null").cloned().collect();
                if names.len() == 1 { names[0].clone() } else { Value::Array(names) }
            }
            ("enum", Value::Array(words)) => words.iter().filter(|word| !word.is_null()).cloned().collect(),
            ("properties", Value::Object(inner)) => {
                Value::Object(inner.iter().map(|(name, inner)| (name.clone(), next(inner))).collect())
            }
            ("oneOf" | "anyOf" | "allOf", Value::Array(branches)) => {
                let branches = branches.iter().filter(|branch| branch["type"] != "null");
                let branches: Vec<_> = branches.map(next).collect();
                if let [only] = branches.as_slice() {
                    for (key, value) in object(only.clone()) {
                        out.entry(key).or_insert(value);
                    }
                    continue;
                }
                out.insert("anyOf".into(), Value::Array(branches));
                continue;
            }
            ("prefixItems", Value::Array(items)) => {
                out.insert("items".into(), items.iter().map(next).collect());
                out.insert("additionalItems".into(), false.into());
                out.insert("minItems".into(), items.len().into());
                continue;
            }
            ("items" | "additionalProperties" | "not", inner) => next(inner),
            (_, value) => value.clone(),
        };
        out.insert(key.clone(), value);
    }
    // Unknown keys are faults unless the table is a map.
    if out.contains_key("properties") && !out.contains_key("additionalProperties") {
        out.insert("additionalProperties".into(), false.into());
    }
    Value::Object(out)
}
