//! Generates the JSON Schema of a graph file from the nodes' descriptions, for completion and checks in editors.
//!
//! The schema is draft 7, which TOML language servers support. They complete without evaluating conditions, so kinds
//! are branches of one `anyOf`, each with its kind as a constant, its ports and its parameters.

use crate::graph::grammar::{self, JOINS, POLICIES};
use osteoflow_container::Compression;
use osteoflow_node::{Description, FilePath, InputPort, Join, OutputPorts, Registry};
use serde_json::{Map, Value, json};

const DRAFT: &str = "http://json-schema.org/draft-07/schema#";

/// Maximum depth of nested parameters; recursive schemas are cut off there.
const MAX_DEPTH: usize = 16;

/// The schema of a graph file.
pub fn schema(registry: &Registry) -> Value {
    let branches = registry
        .kinds()
        .map(|kind| reference(kind.description.kind))
        .chain([json!({ "$ref": "#/definitions/module" }), json!({ "$ref": "#/definitions/partial" })]);
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
        "properties": {
            "extends": { "type": "string", "description": "The graph file that this one changes, relative to this file." },
            "plugins": {
                "description": "Libraries with kinds of nodes, relative to this file: \"libmy_nodes.so\", or \"my_nodes\" for short.",
                "type": "array", "items": { "anyOf": [{ "type": "string" }, {
                    "type": "object", "required": ["file"], "additionalProperties": false, "properties": {
                        "file": { "type": "string", "description": "The file, relative to this one." },
                        "interpreter": {
                            "type": "string",
                            "description": "What runs it: a path relative to this file, or a name that the system finds.",
                        },
                    },
                }] },
            },
            "remove": {
                "description": "What is taken away from the extended graph: \"node.x\", \"node.x.key\", \"results.y\".",
                "type": "array", "items": { "type": "string" },
            },
            "graph": graph(),
            "node": {
                "description": "The nodes by name.",
                "type": "object",
                "patternProperties": { "^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$": { "$ref": "#/definitions/node" } },
                "additionalProperties": false,
            },
            "record": record(),
            "results": {
                "description": "What results.json holds: a key with dots, and the wire whose last value it takes.",
                "type": "object",
                "properties": { grammar::VERDICT: verdict(), grammar::REQUIRE: {
                    "enum": grammar::REQUIRED, "default": "doubtful",
                    "description": "The answer that the verdict must give at least: with \"trusted\", doubtful results are refused.",
                } },
                "additionalProperties": { "$ref": "#/definitions/result" },
            },
            "module": module(),
            "sweep": sweep(),
        },
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

/// A table that accepts these keys only; `keys` are those of the reader.
fn closed(keys: &[&str], description: &str, properties: Value) -> Value {
    let described = properties.as_object().map(|properties| properties.keys().map(String::as_str));
    let (mut described, mut keys) = (described.into_iter().flatten().collect::<Vec<_>>(), keys.to_vec());
    described.sort_unstable();
    keys.sort_unstable();
    assert_eq!(described, keys, "the schema describes other keys than the reader takes");
    let mut table = Map::new();
    if !description.is_empty() {
        table.insert("description".into(), description.into());
    }
    table.insert("type".into(), "object".into());
    table.insert("properties".into(), properties);
    table.insert("additionalProperties".into(), false.into());
    Value::Object(table)
}

/// Makes a key of the table required.
fn required(mut table: Value, key: &str) -> Value {
    table["required"] = json!([key]);
    table
}

fn reference(kind: &str) -> Value {
    json!({ "$ref": format!("#/definitions/{kind}") })
}

fn graph() -> Value {
    closed(
        &grammar::GRAPH,
        "The graph as a whole.",
        json!({
            "format": { "const": 1, "description": "The version of the graph format." },
            "name": { "type": "string", "description": "The graph's name, which a run's folder begins with. Default: the file's name." },
            "seed": { "type": "integer", "minimum": 0, "default": 0, "description": "Of everything random in a run." },
            "frames": { "type": "array", "items": { "type": "string" }, "description": "The frames that the graph may name; any if not given." },
            "lossy": { "type": "boolean", "default": false, "description": "Whether wires may lose items anywhere, not only directly after a live source." },
        }),
    )
}

fn record() -> Value {
    let compression: Vec<_> = Compression::ALL.iter().map(|way| way.name()).collect();
    closed(
        &grammar::RECORD,
        "What is recorded of a run.",
        json!({
            "wires": {
                "description": "The wires to record, by patterns: \"icp.*\", \"*.report\"; an output of a module by its name there.",
                "anyOf": [{ "type": "array", "items": { "type": "string" } }, { "type": "string" }],
            },
            "sources": { "enum": [true, false, "hash"], "default": true, "description": "Whether all outputs of sources are recorded as well; \"hash\" names their files instead." },
            "compression": { "enum": compression, "description": "How the recording is packed." },
            "views": { "type": "boolean", "default": true, "description": "Whether pictures for viewers are recorded beside the exact values." },
        }),
    )
}

/// The entry `verdict` of `[results]`.
fn verdict() -> Value {
    let table = closed(&["from"], "", json!({ "from": { "$ref": "#/definitions/wire" } }));
    json!({
        "description": "The wire whose last value is the verdict on all results: trusted, doubtful or refused, with the reasons.",
        "anyOf": [{ "$ref": "#/definitions/wire" }, required(table, "from")],
    })
}

fn module() -> Value {
    let targets = json!({ "anyOf": [{ "type": "string" }, { "type": "array", "items": { "type": "string" } }] });
    let entry = |to: &str, table: Value| {
        let texts = json!({ "type": "array", "items": { "type": "string" } });
        json!({ "anyOf": [{ "type": "string" }, texts, required(table, to)] })
    };
    let doc = || json!({ "type": "string", "description": "What it is, for `osteoflow inspect`." });
    closed(
        &grammar::MODULE,
        "What this file takes, gives and lets be set, when another graph uses it as a node.",
        json!({
            "doc": doc(),
            "inputs": { "type": "object", "description": "Inputs, and the ports within that each feeds.", "additionalProperties": entry("to", closed(&grammar::MODULE_INPUT, "", json!({
                "to": targets, "doc": doc(), "optional": { "type": "boolean", "default": false },
            }))) },
            "outputs": { "type": "object", "description": "Outputs, and the wire within that each is.", "additionalProperties": entry("from", closed(&grammar::MODULE_OUTPUT, "", json!({
                "from": { "type": "string" }, "doc": doc(),
            }))) },
            "params": { "type": "object", "description": "Parameters, and the keys of nodes within that each sets.", "additionalProperties": entry("to", closed(&grammar::MODULE_PARAM, "", json!({
                "to": targets, "doc": doc(), "default": {}, "required": { "type": "boolean", "default": false },
            }))) },
        }),
    )
}

fn sweep() -> Value {
    let texts =
        |description: &str| json!({ "type": "array", "items": { "type": "string" }, "description": description });
    let key = json!({ "type": "string", "description": "What it sets, as --set takes it: \"icp.kind\"." });
    let keys = texts("Several keys that take the same value.");
    let two = |description: &str| json!({ "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2, "description": description });
    let numbers = |description: &str| json!({ "type": "object", "additionalProperties": { "type": "number" }, "description": description });
    let compare = required(
        closed(
            &grammar::COMPARE,
            "",
            json!({
                "factor": { "type": "string", "description": "The factor whose values are compared." },
                "to": { "description": "The value that the others are compared with. Default: the first." },
                "margin": numbers("For columns: the largest difference that does not matter, for the test of equivalence."),
            }),
        ),
        "factor",
    );
    closed(
        &grammar::SWEEP,
        "Which values `osteoflow sweep` runs the graph with, and which numbers it takes out of each run.",
        json!({
            "repeat": { "type": "integer", "minimum": 1, "default": 1, "description": "How often each setting is run: with the seeds graph.seed, +1, +2 and so on." },
            "same_seed": { "type": "boolean", "default": false, "description": "Whether all repeats have the graph's seed, so that only what is drawn tells them apart." },
            "units": texts("What is resampled and counted, the highest first: names of factors, and one name for the repeats."),
            "pair": { "type": "array", "items": { "anyOf": [{ "type": "string" }, { "type": "array", "items": { "type": "string" } }] }, "description": "Factors that go together, value by value; all others are crossed." },
            "factor": {
                "description": "What is varied by a list of values; the first varies slowest.",
                "type": "object",
                "additionalProperties": closed(&grammar::FACTOR, "", json!({
                    "key": key, "keys": keys,
                    "values": { "type": "array", "description": "The values; a table sets keys of its own." },
                    "labels": texts("What stands in the tables for each value."),
                    "from": { "type": "number", "description": "The first of n values." },
                    "to": { "type": "number", "description": "The last of n values." },
                    "n": { "type": "integer", "minimum": 2, "description": "How many values, evenly spaced." },
                    "log": { "type": "boolean", "default": false, "description": "Whether they are evenly spaced in the logarithm." },
                })),
            },
            "draw": {
                "description": "What is drawn anew for each repeat, the same under all factors.",
                "type": "object",
                "additionalProperties": closed(&grammar::DRAW, "", json!({
                    "key": key, "keys": keys,
                    "uniform": two("Evenly from the first number to the second."),
                    "normal": two("Mean and standard deviation."),
                    "log_uniform": two("Evenly in the logarithm, from the first number to the second."),
                    "integers": two("A whole number from the first to the second, both included."),
                    "choice": { "type": "array", "minItems": 1, "description": "One of these." },
                })),
            },
            "columns": { "type": "object", "additionalProperties": { "type": "string" }, "description": "Columns of runs.csv, named with their unit, and where each stands in results.json." },
            "points": {
                "description": "Lists of points for points.csv, named with their unit.",
                "type": "object",
                "additionalProperties": required(closed(&grammar::POINTS, "", json!({
                    "from": { "type": "string", "description": "Where the list stands in results.json." },
                    "name": { "type": "string", "default": "name", "description": "The key of a point's name." },
                    "axes": texts("The keys of its values. Default: x, y, z."),
                })), "from"),
            },
            "limit": numbers("For columns: the share of runs below it is reported."),
            "compare": {
                "description": "What is compared, paired by all that is not the factor; or a list of comparisons, each of another factor.",
                "anyOf": [compare.clone(), { "type": "array", "items": compare }],
            },
        }),
    )
}

/// Definitions shared by all kinds.
fn common(registry: &Registry) -> Map<String, Value> {
    let wire = json!({ "type": "string", "pattern": "^[^.]+\\..+$", "description": "The producer: \"node.port\"." });
    let input = |joins: &[&str]| {
        json!({ "anyOf": [{ "$ref": "#/definitions/wire" }, closed(&grammar::INPUT, "", json!({
                "from": { "$ref": "#/definitions/wire" },
                "join": { "enum": joins, "description": "How items are chosen for a firing. Default: as the kind declares it." },
                "tolerance_ms": { "type": "number", "minimum": 0, "description": "With stamp: the largest difference of stamps." },
                "max_gap_ms": { "type": "number", "minimum": 0, "description": "With interpolate: the longest gap between the neighbours." },
                "n": { "type": "integer", "minimum": 1, "description": "With collect: how many items; all until the end if not given." },
                "capacity": { "type": "integer", "minimum": 1, "description": "How many items wait on the wire." },
                "max_bytes": { "type": ["integer", "string"], "minimum": 1, "description": "How many bytes wait on the wire at most: a number, or a text such as \"64 MiB\"." },
                "policy": { "enum": POLICIES, "description": "What happens to an item that finds the wire full." },
                "every": { "type": "integer", "minimum": 1, "description": "With sample: one item in this many is kept." },
            }))] })
    };
    let single: Vec<_> = JOINS.into_iter().filter(|join| *join != "collect").collect();
    let on_error =
        json!({ "enum": ["stop", "skip"], "default": "stop", "description": "What happens when it fails on an item." });
    let payloads: Vec<_> = registry.payload_types().map(|ty| ty.name).collect();
    let any_inputs = json!({ "type": "object", "additionalProperties": { "anyOf": [
        { "$ref": "#/definitions/input" }, { "$ref": "#/definitions/input_of_many" },
    ] } });
    let mut out = Map::new();
    out.insert("wire".into(), wire);
    out.insert("input".into(), input(&single));
    out.insert("input_of_many".into(), input(&["collect"]));
    out.insert("on_error".into(), on_error);
    out.insert(
        "process".into(),
        json!({ "type": "boolean", "description": "Whether it fires in a process of its own, which may crash alone." }),
    );
    out.insert(
        "stop_after_s".into(),
        json!({ "type": "number", "exclusiveMinimum": 0, "maximum": 86400,
            "description": "The time limit of a firing, after which the process of the node is stopped." }),
    );
    out.insert("payload".into(), json!({ "enum": payloads, "description": "The payload type." }));
    out.insert("result".into(), json!({ "anyOf": [{ "$ref": "#/definitions/wire" }, {
        "description": "A wire, or a group of results.",
        "type": "object",
        "properties": {
            "from": { "$ref": "#/definitions/wire" },
            "all": { "type": "boolean", "default": false, "description": "Whether all values of the wire are listed, not only the last." },
            "optional": { "type": "boolean", "default": false, "description": "Whether the run may end without it." },
        },
        "additionalProperties": { "$ref": "#/definitions/result" },
    }] }));
    out.insert(
        "module".into(),
        json!({
            "title": "module",
            "description": "Another graph file, whose nodes take this one's place.",
            "type": "object",
            "properties": {
                "kind": constant("module", "Another graph file, whose nodes take this one's place."),
                "file": { "type": "string", "description": "The module's file, relative to this one." },
                "in": any_inputs,
            },
            "required": ["kind"],
        }),
    );
    out.insert("partial".into(), json!({
        "description": "What a variant changes of a node whose kind the extended graph or a module chose.",
        "type": "object",
        "properties": { "in": any_inputs, "out": { "type": "object" }, "on_error": { "$ref": "#/definitions/on_error" },
            "process": { "$ref": "#/definitions/process" }, "stop_after_s": { "$ref": "#/definitions/stop_after_s" } },
        "not": { "required": ["kind"] },
    }));
    out
}

fn constant(kind: &str, summary: &str) -> Value {
    json!({ "const": kind, "description": summary, "x-taplo": { "docs": { "constValue": summary } } })
}

/// The table of a node of one kind. Required parameters may be set by the extended graph, so none is required here.
fn node(of: &Description) -> Value {
    let mut properties = Map::new();
    properties.insert("kind".into(), constant(of.kind, &of.summary));
    let inputs: Map<_, _> = of.inputs.iter().map(|port| (port.name.to_owned(), input(port))).collect();
    if !inputs.is_empty() {
        properties.insert(
            "in".into(),
            json!({
                "type": "object", "description": "What it takes: port = \"node.port\".",
                "properties": inputs, "additionalProperties": false,
            }),
        );
    }
    if let OutputPorts::Declared { schema } = &of.outputs {
        let mut port = object(plain(schema, schema, 0));
        let own = [("type", json!({ "$ref": "#/definitions/payload" }))].into_iter().chain(
            ["frame", "to", "from"]
                .map(|key| (key, json!({ "type": "string", "description": "A frame of what it gives." }))),
        );
        if let Some(Value::Object(known)) = port.get_mut("properties") {
            known.extend(own.map(|(key, schema)| (key.to_owned(), schema)));
        }
        port.remove("required");
        properties.insert("out".into(), json!({
            "type": "object", "description": "What it gives: a table for each output.", "additionalProperties": port,
        }));
    }
    for key in ["on_error", "process", "stop_after_s"] {
        properties.insert(key.into(), json!({ "$ref": format!("#/definitions/{key}") }));
    }
    let params = object(plain(&of.params, &of.params, 0));
    let open = params.get("additionalProperties").filter(|more| **more != Value::Bool(false)).cloned();
    if let Some(Value::Object(known)) = params.get("properties") {
        properties.extend(known.clone());
    }
    json!({
        "title": of.kind,
        "description": of.summary,
        "type": "object",
        "properties": properties,
        "required": ["kind"],
        "additionalProperties": open.unwrap_or(Value::Bool(false)),
    })
}

fn input(port: &InputPort) -> Value {
    let definition = if matches!(port.join, Join::Collect { .. }) { "input_of_many" } else { "input" };
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
