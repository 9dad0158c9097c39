//! Markdown documentation of a kind, for `inspect` and `docs/nodes`.

use osteoflow_node::{CachePolicy, Description, FrameExpr, InputPort, Join, OutputPorts, Registry, Role};
use serde_json::{Map, Value};
use std::{collections::BTreeMap, fmt::Write as _};

/// The stages in the order of the procedure; others follow by name.
const STAGES: [&str; 15] = [
    "acquire",
    "plan",
    "surface",
    "calibrate",
    "transform",
    "crop",
    "cloud",
    "hole",
    "landmarks",
    "coarse",
    "icp",
    "plane",
    "stylus",
    "metrics",
    "output",
];

/// Every page of `docs/nodes`: file name and text, the index first.
pub(crate) fn pages(registry: &Registry) -> Vec<(String, String)> {
    let stages = by_stage(registry);
    let mut index = String::from(
        "# Nodes\n\nWhat a graph may name, by stage. These pages are written by `osteoflow inspect --write-docs docs/nodes` \
         from what the nodes say of themselves; edit the doc comment, not the page.\n",
    );
    let mut pages = Vec::new();
    for (stage, kinds) in &stages {
        let _ = write!(index, "\n## [{stage}]({stage}.md)\n\n| Kind | Gives |\n|---|---|\n");
        let mut page = format!("# {stage}\n");
        for description in kinds {
            let anchor = description.kind.replace('.', "");
            let _ =
                writeln!(index, "| [`{0}`]({stage}.md#{anchor}) | {1} |", description.kind, cell(&description.summary));
            page.push('\n');
            page.push_str(&markdown(description));
        }
        pages.push((format!("{stage}.md"), page));
    }
    pages.insert(0, ("README.md".into(), index));
    pages
}

/// The kinds of each stage, in the order of the procedure.
pub(crate) fn by_stage(registry: &Registry) -> Vec<(&str, Vec<&Description>)> {
    let mut stages: BTreeMap<(usize, &str), Vec<&Description>> = BTreeMap::new();
    for kind in registry.kinds() {
        let name = kind.description.kind;
        let stage = name.split('.').next().unwrap_or(name);
        let place = STAGES.iter().position(|s| *s == stage).unwrap_or(STAGES.len());
        stages.entry((place, stage)).or_default().push(&kind.description);
    }
    stages.into_iter().map(|((_, stage), kinds)| (stage, kinds)).collect()
}

/// Documentation of one kind.
pub(crate) fn markdown(of: &Description) -> String {
    let mut out = format!("## {}\n\n{}\n", of.kind, of.summary);
    if !of.details.is_empty() {
        let _ = write!(out, "\n{}\n", of.details);
    }
    match of.cache {
        CachePolicy::Never => {}
        CachePolicy::ByInputs => {
            out.push_str("\nIts answers are kept in the store: parameters and inputs decide them.\n")
        }
        CachePolicy::ByInputsAndSeed => {
            out.push_str("\nIts answers are kept in the store: parameters, inputs and the run's seed decide them.\n");
        }
    }
    match of.role {
        Role::Node => inputs(&mut out, &of.inputs),
        Role::Source if of.constant => out.push_str(
            "\nA source of constants: one item on each output, without a time (stamp 0). It has no inputs.\n",
        ),
        Role::Source => out.push_str("\nA source: it has no inputs.\n"),
        Role::LiveSource => {
            out.push_str("\nA live source: it follows the world's clock, so lossy wires may hang on it.\n")
        }
    }
    outputs(&mut out, &of.outputs);
    parameters(&mut out, "Parameters", &of.params);
    if !of.example.is_empty() {
        let _ = write!(out, "\n**Example**\n\n```toml\n{}\n```\n", of.example.trim());
    }
    if !of.literature.is_empty() {
        out.push_str("\n**Literature**\n\n");
        for source in of.literature {
            let _ = writeln!(out, "- {source}");
        }
    }
    out
}

fn inputs(out: &mut String, ports: &[InputPort]) {
    out.push_str("\n**Inputs**\n\n| Port | Takes | Join | Frame | |\n|---|---|---|---|---|\n");
    for port in ports {
        let doc = match (port.unused, port.optional) {
            (true, _) => format!("Not needed by this kind; there so that the kinds of the stage swap. {}", port.doc),
            (false, true) => format!("Optional. {}", port.doc),
            (false, false) => port.doc.to_owned(),
        };
        let (takes, join, frames) = (port.payload.name(), join(&port.join), frames(&port.frames));
        let _ = writeln!(out, "| `{}` | `{takes}` | {join} | {frames} | {} |", port.name, cell(&doc));
    }
}

fn outputs(out: &mut String, ports: &OutputPorts) {
    match ports {
        OutputPorts::Fixed(ports) => {
            out.push_str("\n**Outputs**\n\n| Port | Gives | Frame | |\n|---|---|---|---|\n");
            for port in ports {
                let (gives, frames) = (port.payload.name(), frames(&port.frames));
                let _ = writeln!(out, "| `{}` | `{gives}` | {frames} | {} |", port.name, cell(port.doc));
            }
        }
        OutputPorts::Declared { schema } => {
            out.push_str(
                "\n**Outputs**\n\nDeclared in the graph by `out`: each entry is a port, a table with its `type`, where \
                 known its `frame` (of a pose `to` and `from`), and the parameters below.\n",
            );
            parameters(out, "Parameters of a port", schema);
        }
    }
}

/// Formats a join rule and its numbers as in a graph file.
fn join(join: &Join) -> String {
    match join {
        Join::Stamp { tolerance_ns } => format!("`stamp`, within {} ms", ms(*tolerance_ns)),
        Join::Collect { n: Some(n) } => format!("`collect`, {n} at a time"),
        Join::Collect { n: None } => "`collect`, all".into(),
        Join::Interpolate { max_gap_ns: Some(gap) } => format!("`interpolate`, gaps up to {} ms", ms(*gap)),
        other => format!("`{}`", other.name()),
    }
}

fn ms(ns: i64) -> f64 {
    ns as f64 / 1e6
}

/// Formats the declared frames of a port.
fn frames(of: &FrameExpr) -> String {
    let word = |text: &str| match text.as_bytes().first() {
        Some(b'@') => format!("`{}`", &text[1..]),
        Some(b'$') => format!("parameter `{}`", &text[1..]),
        _ => format!("of `{text}`"),
    };
    match (of.frame, of.to, of.from) {
        (Some(frame), ..) => word(frame),
        (None, None, None) => String::new(),
        (None, to, from) => format!("{} to {}", from.map_or("any".into(), word), to.map_or("any".into(), word)),
    }
}

fn parameters(out: &mut String, title: &str, schema: &Value) {
    let mut rows = String::new();
    parameter_rows(&mut rows, "", schema, schema, None);
    if rows.is_empty() {
        let _ = write!(out, "\n**{title}**: none.\n");
        return;
    }
    let header = "| Name | Type | Unit | Default | Range | Meaning, and why this default |\n|---|---|---|---|---|---|";
    let _ = write!(out, "\n**{title}**\n\n{header}\n{rows}");
}

/// A row for each parameter; nested parameters are named `table.parameter`.
fn parameter_rows(out: &mut String, prefix: &str, table: &Value, root: &Value, defaults: Option<&Value>) {
    let required = table["required"].as_array().map(Vec::as_slice).unwrap_or_default();
    for (name, property) in table["properties"].as_object().into_iter().flatten() {
        let given = defaults.and_then(|d| d.get(name)).or_else(|| property.get("default"));
        let target = resolved(property, root);
        if target["properties"].is_object() {
            parameter_rows(out, &format!("{prefix}{name}."), target, root, given);
            continue;
        }
        let default = match given {
            Some(Value::Null) => "none".into(),
            Some(value) => format!("`{value}`"),
            None if required.iter().any(|r| r == name) => "required".into(),
            None => String::new(),
        };
        let doc = property["description"].as_str().or_else(|| target["description"].as_str());
        let (kind, unit, range, doc) =
            (type_of(property, root), unit(name), range(property), cell(doc.unwrap_or_default()));
        let _ = writeln!(out, "| `{prefix}{name}` | {kind} | {unit} | {default} | {range} | {doc} |");
    }
}

/// The unit in a parameter's suffix.
fn unit(name: &str) -> &'static str {
    const UNITS: [(&str, &str); 11] = [
        ("_per_mm", "1/mm"),
        ("_mm2", "mm²"),
        ("_mm", "mm"),
        ("_deg", "°"),
        ("_rad", "rad"),
        ("_ms", "ms"),
        ("_ns", "ns"),
        ("_hz", "Hz"),
        ("_hu", "HU"),
        ("_px", "px"),
        ("_s", "s"),
    ];
    UNITS.iter().find(|(suffix, _)| name.ends_with(suffix)).map_or("", |(_, unit)| unit)
}

/// The type of a property for readers; choices are listed.
fn type_of(property: &Value, root: &Value) -> String {
    let property = resolved(property, root);
    if property["format"] == osteoflow_node::FilePath::SCHEMA_FORMAT {
        return "path".into();
    }
    let listed = |key: &str| property.get(key).and_then(Value::as_array);
    if let Some(choices) = listed("enum") {
        return choices.iter().filter(|c| !c.is_null()).map(|c| format!("`{c}`")).collect::<Vec<_>>().join(" or ");
    }
    if let Some(value) = property.get("const") {
        return format!("`{value}`");
    }
    if let Some(ways) = listed("oneOf").or_else(|| listed("anyOf")) {
        let ways = ways.iter().filter(|way| way["type"] != "null").map(|way| type_of(way, root));
        return ways.collect::<Vec<_>>().join(" or ");
    }
    let kind = match &property["type"] {
        Value::Array(kinds) => kinds.iter().find(|k| *k != "null").and_then(Value::as_str),
        kind => kind.as_str(),
    };
    match kind {
        Some("array") => {
            let of = property.get("items").map(|items| type_of(items, root)).unwrap_or_default();
            let n = property["minItems"].as_u64().filter(|n| property["maxItems"].as_u64() == Some(*n));
            format!(
                "list of {}{}",
                n.map(|n| format!("{n} ")).unwrap_or_default(),
                if of.is_empty() { "values".into() } else { of }
            )
        }
        Some("object") => match property["properties"].as_object() {
            Some(fields) => {
                format!("table of {}", fields.keys().map(|k| format!("`{k}`")).collect::<Vec<_>>().join(", "))
            }
            None => "table".into(),
        },
        Some(kind) => kind.into(),
        None => "any".into(),
    }
}

/// The schema that a `$ref` points to, or the schema itself.
fn resolved<'a>(property: &'a Value, root: &'a Value) -> &'a Value {
    let pointer = property["$ref"].as_str().and_then(|r| r.strip_prefix('#'));
    pointer.and_then(|p| root.pointer(p)).unwrap_or(property)
}

fn range(property: &Value) -> String {
    let empty = Map::new();
    let of = property.as_object().unwrap_or(&empty);
    let from = of.get("minimum").map(|v| format!("≥ {v}")).or(of.get("exclusiveMinimum").map(|v| format!("> {v}")));
    let to = of.get("maximum").map(|v| format!("≤ {v}")).or(of.get("exclusiveMaximum").map(|v| format!("< {v}")));
    [from, to].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// Escapes text for a table cell: one line, no bars.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_parameter_is_told_with_type_unit_default_range_and_reason() {
        let schema = json!({
            "properties": {
                "gate_mm": { "type": "number", "default": 5.0, "minimum": 0.1, "maximum": 50.0, "description": "5: twice\nthe | error." },
                "weight": { "$ref": "#/$defs/Weight", "default": "none" },
                "limit": { "type": ["integer", "null"], "default": null, "exclusiveMinimum": 0 },
                "path": { "type": "string", "format": "input-path" },
                "camera": { "$ref": "#/$defs/Camera", "default": { "n_points": 20000 } },
            },
            "required": ["path"],
            "$defs": { "Weight": { "oneOf": [{ "const": "none" }, { "const": "incidence" }], "description": "How pairs weigh." },
                "Camera": { "type": "object", "properties": { "n_points": { "type": "integer", "minimum": 1 } } },
            },
        });
        let mut out = String::new();
        parameters(&mut out, "Parameters", &schema);
        for row in [
            "| `gate_mm` | number | mm | `5.0` | ≥ 0.1, ≤ 50.0 | 5: twice the \\| error. |",
            "| `weight` | `\"none\"` or `\"incidence\"` |  | `\"none\"` |  | How pairs weigh. |",
            "| `limit` | integer |  | none | > 0 |  |",
            "| `camera.n_points` | integer |  | `20000` | ≥ 1 |  |",
            "| `path` | path |  | required |  |  |",
        ] {
            assert!(out.contains(row), "{out}\nlacks\n{row}");
        }
    }
}
