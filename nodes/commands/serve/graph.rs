//! The graph as the page lists it: nodes with ports, parameters and what they are for.

use osteoflow_engine::plan::{Plan, PlanNode};
use osteoflow_node::Registry;
use serde_json::{Map, Value, json};

/// The nodes of a plan in the order of the graph.
pub(super) fn as_json(plan: &Plan, registry: &Registry) -> Value {
    let rows: Vec<Value> = plan.nodes.iter().map(|node| node_json(plan, registry, node)).collect();
    json!({ "name": plan.name, "nodes": rows })
}

fn node_json(plan: &Plan, registry: &Registry, node: &PlanNode) -> Value {
    let description = registry.kind(&node.kind).map(|kind| &kind.description);
    let inputs = node.inputs.iter().map(|input| {
        let from = input.link.map(|link| plan.wire_name(plan.links[link].from));
        json!({ "name": input.port.name, "from": from, "doc": input.port.doc })
    });
    let outputs = node.outputs.iter().map(|output| json!({ "name": output.name, "payload": output.payload.name() }));
    let schema = description.map(|description| &description.params["properties"]);
    let docs = |name: &str, key: &str| schema.map_or(Value::Null, |schema| schema[name][key].clone());
    let values = node.params.as_object().into_iter().flatten();
    let params = values.map(|(name, value)| {
        json!({ "name": name, "value": without_folders(node, value), "default": docs(name, "default"), "doc": docs(name, "description") })
    });
    json!({
        "name": *node.name,
        "kind": node.kind,
        "role": node.role,
        "summary": description.map(|description| &description.summary),
        "inputs": inputs.collect::<Vec<_>>(),
        "outputs": outputs.collect::<Vec<_>>(),
        "params": params.collect::<Vec<_>>(),
    })
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
