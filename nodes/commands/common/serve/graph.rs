//! The graph as the page lists it: nodes with ports, parameters and what they are for.

use osteoflow_engine::plan::{Plan, PlanNode};
use osteoflow_node::Registry;
use serde_json::{Map, Value, json};

/// The nodes of a plan in the order of the graph.
pub(crate) fn as_json(plan: &Plan, registry: &Registry) -> Value {
    let rows: Vec<Value> = plan.nodes.iter().map(|node| node_json(plan, registry, node)).collect();
    json!({ "name": plan.name, "nodes": rows })
}

fn node_json(plan: &Plan, registry: &Registry, node: &PlanNode) -> Value {
    let description = registry.kind(&node.kind).map(|kind| &kind.description);
    let inputs = node.inputs.iter().map(|input| {
        let from = plan.wires_of(input);
        let max_age_ms = input.contract.max_age_ns.map(|ns| ns as f64 / 1e6);
        json!({ "name": input.port.name, "from": from, "doc": input.port.doc, "max_age_ms": max_age_ms })
    });
    let outputs = node.outputs.iter().map(|output| json!({ "name": output.name, "payload": output.payload.name() }));
    let mut params = Vec::new();
    if let (Some(description), Value::Object(values)) = (description, &node.params) {
        let schema = Schema { root: &description.params, at: &description.params };
        add_params(node, "", values, schema, &mut params);
    }
    let stage = stage(&node.kind);
    let alternatives = registry.kinds().map(|kind| kind.description.kind).filter(|kind| self::stage(kind) == stage);
    json!({
        "name": *node.name,
        "kind": node.kind,
        "role": node.role,
        "summary": description.map(|description| &description.summary),
        "inputs": inputs.collect::<Vec<_>>(),
        "outputs": outputs.collect::<Vec<_>>(),
        "params": params,
        "kinds": alternatives.collect::<Vec<_>>(),
    })
}

/// The part of a kind before the dot: kinds of one stage can often replace each other.
pub(crate) fn stage(kind: &str) -> &str {
    kind.split('.').next().unwrap_or(kind)
}

/// A part of the JSON Schema of a kind's parameters.
#[derive(Clone, Copy)]
struct Schema<'a> {
    root: &'a Value,
    at: &'a Value,
}

impl<'a> Schema<'a> {
    /// The schema of a property, and the one that it refers to.
    fn property(self, name: &str) -> (&'a Value, Self) {
        let property = &self.at["properties"][name];
        let of_reference = |schema: &Value| schema["$ref"].as_str()?.strip_prefix("#/$defs/").map(str::to_owned);
        // An optional table is any of the table and null.
        let any = property["anyOf"].as_array().into_iter().flatten();
        let reference = of_reference(property).or_else(|| any.filter_map(of_reference).next());
        let at = reference.map_or(property, |name| &self.root["$defs"][&name]);
        (property, Self { at, ..self })
    }
}

/// Adds the parameters, those of tables by their dotted names.
fn add_params(node: &PlanNode, prefix: &str, values: &Map<String, Value>, schema: Schema<'_>, out: &mut Vec<Value>) {
    for (name, value) in values {
        let (property, inner) = schema.property(name);
        let name = format!("{prefix}{name}");
        match value {
            Value::Object(values) if inner.at["properties"].is_object() => {
                add_params(node, &format!("{name}."), values, inner, out);
            }
            _ => {
                let mut row =
                    json!({ "name": name, "value": without_folders(node, value), "doc": property["description"] });
                for key in ["default", "minimum", "maximum"] {
                    row[key] = if property[key].is_null() { inner.at[key].clone() } else { property[key].clone() };
                }
                row["words"] = json!(words(inner.at));
                out.push(row);
            }
        }
    }
}

/// The words that a parameter may be; empty if it is no choice of words.
fn words(schema: &Value) -> Vec<&Value> {
    let one_of = schema["oneOf"].as_array().into_iter().flatten().map(|choice| &choice["const"]);
    let listed = schema["enum"].as_array().into_iter().flatten();
    listed.chain(one_of).filter(|word| word.is_string()).collect()
}

/// A value in which files have their names alone: folders are named after people.
fn without_folders(node: &PlanNode, value: &Value) -> Value {
    match value {
        Value::String(text) => {
            let file = node.files.iter().find(|file| file.as_os_str() == text.as_str());
            let name = file.and_then(|file| file.file_name()).map(|name| name.to_string_lossy().into_owned());
            name.unwrap_or_else(|| text.clone()).into()
        }
        Value::Array(values) => values.iter().map(|value| without_folders(node, value)).collect(),
        Value::Object(values) => {
            let values = values.iter().map(|(key, value)| (key.clone(), without_folders(node, value)));
            Value::Object(values.collect::<Map<_, _>>())
        }
        other => other.clone(),
    }
}
