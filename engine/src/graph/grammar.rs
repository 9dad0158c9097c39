//! The keys of a graph file, table by table, each with its JSON Schema: what it takes, its range, its default and its doc.
//! The reader takes these, [`crate::schema`] hands them to editors, and misspelt keys are compared with them.

use osteoflow_container::Compression;
use serde_json::{Map, Value, json};
use std::sync::LazyLock;

/// The keys of a table.
pub(crate) type Keys = LazyLock<Map<String, Value>>;

/// Whether one of the keys has this name.
pub(crate) fn has(keys: &Keys, name: &str) -> bool {
    keys.contains_key(name)
}

pub(crate) fn names(keys: &'static Map<String, Value>) -> impl Iterator<Item = &'static str> + Clone {
    keys.keys().map(String::as_str)
}

fn keys(keys: Value) -> Map<String, Value> {
    match keys {
        Value::Object(keys) => keys,
        other => unreachable!("{other} is no table of keys"),
    }
}

/// A table that takes these keys only.
pub(crate) fn table(keys: &Keys) -> Value {
    json!({ "type": "object", "properties": **keys, "additionalProperties": false })
}

/// A described table.
fn described(keys: &Keys, description: &str) -> Value {
    let mut table = table(keys);
    table["description"] = description.into();
    table
}

/// A table that needs this key.
fn with(keys: &Keys, required: &str) -> Value {
    let mut table = table(keys);
    table["required"] = json!([required]);
    table
}

fn texts(description: &str) -> Value {
    json!({ "type": "array", "items": { "type": "string" }, "description": description })
}

/// The top level.
pub(crate) static TOP: Keys = LazyLock::new(|| {
    keys(json!({
        "graph": described(&GRAPH, "The graph as a whole."),
        "node": {
            "description": "The nodes by name.",
            "type": "object",
            "patternProperties": { "^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$": { "$ref": "#/definitions/node" } },
            "additionalProperties": false,
        },
        "record": described(&RECORD, "What is recorded of a run."),
        "results": {
            "description": "What results.json holds: a key with dots, and the wire whose last value it takes.",
            "type": "object", "properties": *RESULTS, "additionalProperties": { "$ref": "#/definitions/result" },
        },
        "extends": {
            "description": "The graph file that this one changes, relative to this file, or a list of them, of which each changes those before it.",
            "anyOf": [{ "type": "string" }, { "type": "array", "items": { "type": "string" } }],
        },
        "remove": texts("What is taken away from the extended graph: \"node.x\", \"node.x.key\", \"results.y\"."),
        "module": described(&MODULE, "What this file takes, gives and lets be set, when another graph uses it as a node."),
        "plugins": {
            "description": "Libraries with kinds of nodes, relative to this file: \"libmy_nodes.so\", or \"my_nodes\" for short.",
            "type": "array", "items": { "anyOf": [{ "type": "string" }, with(&PLUGIN, "file")] },
        },
        "sweep": described(&SWEEP, "Which values `osteoflow sweep` runs the graph with, and which numbers it takes out of each run."),
    }))
});

/// A plugin, in `plugins`.
pub(crate) static PLUGIN: Keys = LazyLock::new(|| {
    keys(json!({
        "file": { "type": "string", "description": "The file, relative to this one." },
        "interpreter": { "type": "string", "description": "What runs it: a path relative to this file, or a name that the system finds." },
    }))
});

/// `[graph]`.
pub(crate) static GRAPH: Keys = LazyLock::new(|| {
    keys(json!({
        "format": { "const": super::header::FORMAT, "description": "The version of the graph format." },
        "name": { "type": "string", "description": "The graph's name, which a run's folder begins with. Default: the file's name." },
        "seed": { "type": "integer", "minimum": 0, "default": 0, "description": "Of everything random in a run." },
        "frames": texts("The frames that the graph may name; any if not given."),
        "lossy": { "type": "boolean", "default": false, "description": "Whether wires may lose items anywhere, not only directly after a live source, or as a sample of a source." },
    }))
});

/// The keys of a node's table that are no parameters.
pub(crate) static NODE: Keys = LazyLock::new(|| {
    keys(json!({
        "kind": { "type": "string" },
        "in": inputs(),
        "out": { "type": "object" },
        "env": texts("For a kind of a plugin: the environment variables that decide what it computes. Their values are recorded and compared."),
        "on_error": { "enum": ["stop", "skip"], "default": "stop", "description": "What happens when it fails on an item." },
        "process": { "type": "boolean", "description": "Whether it fires in a process of its own, which may crash alone." },
        "pool": {
            "type": "boolean", "default": true,
            "description": "Whether its process, in a sweep, builds the node of the next run anew when a run has ended; false: a process for each run.",
        },
        "stop_after_s": {
            "type": "number", "exclusiveMinimum": 0, "maximum": 86400,
            "description": "The time limit of a firing, after which the process of the node is stopped.",
        },
        "deadline_ms": { "type": "number", "exclusiveMinimum": 0, "description": "How long a firing may take; what takes longer is unknown." },
        "otherwise": otherwise("With deadline_ms"),
    }))
});

/// What happens where a contract of time is broken.
fn otherwise(with: &str) -> Value {
    let doc = "what happens otherwise: the value is unknown, the firing is left out, or the run is refused as well.";
    json!({ "enum": OTHERWISE, "default": "unknown", "description": format!("{with}: {doc}") })
}
const OTHERWISE: [&str; 3] = ["unknown", "drop", "refuse"];

/// The inputs of a node of any kind.
fn inputs() -> Value {
    json!({ "type": "object", "additionalProperties": { "anyOf": [
        { "$ref": "#/definitions/input" }, { "$ref": "#/definitions/input_of_many" },
    ] } })
}

/// A node that is a module.
pub(crate) static MODULE_NODE: Keys = LazyLock::new(|| {
    keys(json!({
        "kind": { "type": "string" },
        "file": { "type": "string", "description": "The module's file, relative to this one." },
        "in": inputs(),
    }))
});

/// The table of an input.
pub(crate) static INPUT: Keys = LazyLock::new(|| {
    keys(json!({
        "from": { "$ref": "#/definitions/wire" },
        "capacity": { "type": "integer", "minimum": 1, "description": "How many items wait on the wire." },
        "max_bytes": { "type": ["integer", "string"], "minimum": 1, "description": "How many bytes wait on the wire at most: a number, or a text such as \"64 MiB\"." },
        "policy": { "enum": ["block", "drop_old", "drop_new", "sample", "fail"], "description": "What happens to an item that finds the wire full." },
        "every": { "type": "integer", "minimum": 1, "description": "With sample: one item in this many is kept." },
        "join": { "enum": JOINS, "description": "How items are chosen for a firing. Default: as the kind declares it." },
        "tolerance_ms": { "type": "number", "minimum": 0, "description": "With stamp: the largest difference of stamps." },
        "after_ms": { "type": "number", "minimum": 0, "description": "With latest: how long after the firing stamp an item may be. Default: 0." },
        "max_gap_ms": { "type": "number", "minimum": 0, "description": "With interpolate: the longest gap between the neighbours." },
        "n": { "type": "integer", "minimum": 1, "description": "With collect: how many items; all until the end if not given." },
        "step": { "type": "integer", "minimum": 1, "description": "With n: how many items from one window to the next. Default: n." },
        "span_ms": { "type": "number", "exclusiveMinimum": 0, "description": "With collect: the length of a window in time." },
        "step_ms": { "type": "number", "exclusiveMinimum": 0, "description": "With span_ms: the time from one window to the next. Default: span_ms." },
        "max_age_ms": { "type": "number", "exclusiveMinimum": 0, "description": "How old a value may be at the firing, by its stamp, and by its arrival where its source is live." },
        "rate_hz": { "type": "number", "exclusiveMinimum": 0, "maximum": 1e6, "description": "How often an item of a source is expected; two periods without one are a silence." },
        "otherwise": otherwise("With max_age_ms or rate_hz"),
    }))
});
/// The joins that a graph may choose.
pub(crate) const JOINS: [&str; 7] = ["each", "stamp", "collect", "latest", "interpolate", "once", "previous"];

/// The keys of a declared output that are no parameters.
pub(crate) static OUTPUT: Keys = LazyLock::new(|| {
    let frame = json!({ "type": "string", "description": "A frame of what it gives." });
    keys(json!({ "type": { "$ref": "#/definitions/payload" }, "frame": frame, "to": frame, "from": frame }))
});

/// `[record]`.
pub(crate) static RECORD: Keys = LazyLock::new(|| {
    keys(json!({
        "wires": {
            "description": "The wires to record, by patterns: \"icp.*\", \"*.report\"; an output of a module by its name there.",
            "anyOf": [{ "type": "array", "items": { "type": "string" } }, { "type": "string" }],
        },
        "sources": { "enum": [true, false, "hash"], "default": true, "description": "Whether all outputs of sources are recorded as well; \"hash\" names their files instead." },
        "compression": { "enum": Compression::ALL.map(Compression::name), "description": "How the recording is packed." },
        "plugins": { "type": "boolean", "default": true, "description": "Whether the text of plugins in Python is recorded, with that of their modules." },
        "views": { "type": "boolean", "default": true, "description": "Whether pictures for viewers are recorded beside the exact values." },
    }))
});

/// The entries of `[results]` that are not the graph's choice.
static RESULTS: Keys = LazyLock::new(|| {
    let mut from = json!({ "type": "object", "properties": { "from": { "$ref": "#/definitions/wire" } } });
    (from["additionalProperties"], from["required"]) = (false.into(), json!(["from"]));
    keys(json!({
        VERDICT: {
            "description": "The wire whose last value is the verdict on all results: trusted, doubtful or refused, with the reasons.",
            "anyOf": [{ "$ref": "#/definitions/wire" }, from],
        },
        REQUIRE: {
            "enum": ["doubtful", "trusted"], "default": "doubtful",
            "description": "The answer that the verdict must give at least: with \"trusted\", doubtful results are refused.",
        },
    }))
});
/// The entry of `[results]` that is the verdict on the results.
pub(crate) const VERDICT: &str = "verdict";
/// The key of `results.json` with the signs that inputs are wrong; no entry of `[results]`.
pub(crate) const REASONS: &str = "reasons";
/// The key of `[results]` that is no wire: the answer that the verdict must give at least.
pub(crate) const REQUIRE: &str = "require";

/// An entry of `[results]`.
pub(crate) static RESULT: Keys = LazyLock::new(|| {
    keys(json!({
        "from": { "$ref": "#/definitions/wire" },
        "all": { "type": "boolean", "default": false, "description": "Whether all values of the wire are listed, not only the last." },
        "optional": { "type": "boolean", "default": false, "description": "Whether the run may end without it." },
    }))
});

/// `[module]`.
pub(crate) static MODULE: Keys = LazyLock::new(|| {
    // A text or a list of texts is short for a table with this key.
    let declarations = |keys: &Keys, short: &str, description: &str| {
        let list = json!({ "type": "array", "items": { "type": "string" } });
        let forms = json!([{ "type": "string" }, list, with(keys, short)]);
        json!({ "type": "object", "description": description, "additionalProperties": { "anyOf": forms } })
    };
    keys(json!({
        "doc": doc(),
        "inputs": declarations(&MODULE_INPUT, "to", "Inputs, and the ports within that each feeds."),
        "outputs": declarations(&MODULE_OUTPUT, "from", "Outputs, and the wire within that each is."),
        "params": declarations(&MODULE_PARAM, "to", "Parameters, and the keys of nodes within that each sets."),
    }))
});

fn doc() -> Value {
    json!({ "type": "string", "description": "What it is, for `osteoflow inspect`." })
}

/// What an input or a parameter of a module leads to.
fn targets() -> Value {
    json!({ "anyOf": [{ "type": "string" }, { "type": "array", "items": { "type": "string" } }] })
}

fn off() -> Value {
    json!({ "type": "boolean", "default": false })
}

/// An input of a module.
pub(crate) static MODULE_INPUT: Keys =
    LazyLock::new(|| keys(json!({ "to": targets(), "doc": doc(), "optional": off() })));
/// An output of a module.
pub(crate) static MODULE_OUTPUT: Keys = LazyLock::new(|| keys(json!({ "from": { "type": "string" }, "doc": doc() })));
/// A parameter of a module.
pub(crate) static MODULE_PARAM: Keys =
    LazyLock::new(|| keys(json!({ "to": targets(), "doc": doc(), "default": {}, "required": off() })));

/// `[sweep]`.
pub(crate) static SWEEP: Keys = LazyLock::new(|| {
    let by_name = |table: Value, description: &str| json!({ "description": description, "type": "object", "additionalProperties": table });
    let compare = with(&COMPARE, "factor");
    keys(json!({
        "repeat": { "type": "integer", "minimum": 1, "default": 1, "description": "How often each setting is run: with the seeds graph.seed, +1, +2 and so on." },
        "same_seed": { "type": "boolean", "default": false, "description": "Whether all repeats have the graph's seed, so that only what is drawn tells them apart." },
        "twice": {
            "type": "number", "minimum": 0, "maximum": 1, "default": 0.02,
            "description": "Share of the runs that are computed twice, and beside them the first of each kind, to find kinds that answer otherwise the second time; 0: none.",
        },
        "units": texts("What is resampled and counted, the highest first: names of factors, and one name for the repeats."),
        "pair": { "type": "array", "items": targets(), "description": "Factors that go together, value by value; all others are crossed." },
        "factor": by_name(table(&FACTOR), "What is varied by a list of values; the first varies slowest."),
        "draw": by_name(table(&DRAW), "What is drawn anew for each repeat, the same under all factors."),
        "columns": by_name(json!({ "type": "string" }), "Columns of runs.csv, named with their unit, and where each stands in results.json."),
        "points": by_name(with(&POINTS, "from"), "Lists of points for points.csv, named with their unit."),
        "limit": by_name(json!({ "type": "number" }), "For columns: the share of runs below it is reported."),
        "compare": {
            "description": "What is compared, paired by all that is not the factor; or a list of comparisons, each of another factor.",
            "anyOf": [compare, { "type": "array", "items": compare }],
        },
    }))
});

/// The keys that a factor or a draw sets.
fn set() -> Map<String, Value> {
    keys(json!({
        "key": { "type": "string", "description": "What it sets, as --set takes it: \"icp.kind\"." },
        "keys": texts("Several keys that take the same value."),
    }))
}

/// `[sweep.factor]`: a factor.
pub(crate) static FACTOR: Keys = LazyLock::new(|| {
    let own = keys(json!({
        "values": { "type": "array", "description": "The values; a table sets keys of its own." },
        "labels": texts("What stands in the tables for each value."),
        "files": { "type": "string", "description": "The values are the files of this pattern, such as \"scans/*.ply\", in the order of names and numbers." },
        "variants": {
            "description": "The values are files of changes, merged over the graph as by extends: a pattern, or a list of files.",
            "anyOf": [{ "type": "string" }, { "type": "array", "items": { "type": "string" } }],
        },
        "from": { "type": "number", "description": "The first of n values." },
        "to": { "type": "number", "description": "The last of n values." },
        "n": { "type": "integer", "minimum": 2, "description": "How many values, evenly spaced." },
        "log": { "type": "boolean", "default": false, "description": "Whether they are evenly spaced in the logarithm." },
    }));
    set().into_iter().chain(own).collect()
});

/// `[sweep.draw]`: a draw.
pub(crate) static DRAW: Keys = LazyLock::new(|| set().into_iter().chain(DISTRIBUTIONS.clone()).collect());

/// The distributions of a draw.
pub(crate) static DISTRIBUTIONS: Keys = LazyLock::new(|| {
    let two = |description: &str| json!({ "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2, "description": description });
    keys(json!({
        "uniform": two("Evenly from the first number to the second."),
        "normal": two("Mean and standard deviation."),
        "log_uniform": two("Evenly in the logarithm, from the first number to the second."),
        "integers": two("A whole number from the first to the second, both included."),
        "choice": { "type": "array", "minItems": 1, "description": "One of these." },
    }))
});

/// `[sweep.points]`: a list of points.
pub(crate) static POINTS: Keys = LazyLock::new(|| {
    keys(json!({
        "from": { "type": "string", "description": "Where the list stands in results.json." },
        "name": { "type": "string", "default": "name", "description": "The key of a point's name." },
        "axes": texts("The keys of its values. Default: x, y, z."),
    }))
});

/// `[sweep.compare]`.
pub(crate) static COMPARE: Keys = LazyLock::new(|| {
    keys(json!({
        "factor": { "type": "string", "description": "The factor whose values are compared." },
        "to": { "description": "The value that the others are compared with. Default: the first." },
        "margin": { "type": "object", "additionalProperties": { "type": "number" }, "description": "For columns: the largest difference that does not matter, for the test of equivalence." },
    }))
});
