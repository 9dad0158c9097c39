//! Another kind for a node of a recorded graph.
//!
//! A recorded graph states every parameter. Those that the user did not write go with their kind. In a recording that does not
//! tell which were written, a value that equals the default of the kind that the node had counts as not written.

use crate::{
    graph::{
        self, keys_set,
        written::{remove_unwritten, sets_kind},
    },
    plan::Plan,
    plugin::Kinds,
    recording::format::RunRecord,
};
use serde_json::Value as Json;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};
use toml::{Table, Value};

/// A graph that states every parameter, of the file `path`, without the defaults of kinds that `sets` exchange; `None` if they
/// exchange none. `written` has the parameters of each node that the user wrote.
pub(crate) fn without_old_defaults(
    text: &str,
    path: &Path,
    written: Option<&BTreeMap<String, BTreeSet<String>>>,
    sets: &[String],
    kinds: &Kinds,
) -> Option<String> {
    let mut graph: Table = text.parse().ok()?;
    let nodes = graph.get_mut("node")?.as_table_mut()?;
    let mut exchanged: Vec<_> =
        nodes.iter_mut().filter(|(name, _)| sets.iter().any(|set| sets_kind(set, name))).collect();
    if exchanged.is_empty() {
        return None;
    }
    let plugins = graph::load_text(text.into(), path, &[], &mut Vec::new()).plugins;
    let registry = kinds.with(&plugins).registry;
    for (name, node) in &mut exchanged {
        if let (Some(written), Some(node)) = (written.and_then(|nodes| nodes.get(name.as_str())), node.as_table_mut()) {
            remove_unwritten(node, written);
            continue;
        }
        let schema = node.get("kind").and_then(Value::as_str).and_then(|kind| registry.kind(kind));
        if let (Some(kind), Some(node)) = (schema, node.as_table_mut()) {
            remove_defaults(node, &kind.description.params, &kind.description.params);
        }
    }
    Some(graph.to_string())
}

/// In the plan of a recorded graph, which states all: only what the recorded user wrote, or a setting does, was written.
pub(super) fn keep_written(plan: &mut Plan, run: &RunRecord, sets: &[String]) {
    let set: Vec<String> = keys_set(sets).into_iter().map(|(key, _)| key.to_string()).collect();
    for node in &mut plan.nodes {
        let Some(written) = run.written.as_ref().and_then(|nodes| nodes.get(&*node.name)) else { continue };
        let is_set = |key: &str| set.contains(&format!("{}.{key}", node.name));
        node.param_places.retain(|key, _| written.contains(key) || is_set(key));
    }
}

/// Removes the parameters that equal the defaults of their schema, and tables that become empty.
fn remove_defaults(table: &mut Table, schema: &Json, root: &Json) {
    table.retain(|key, value| {
        let property = &schema["properties"][key];
        let reference = property["$ref"].as_str().and_then(|path| root.pointer(path.trim_start_matches('#')));
        let default = property.get("default");
        let property = reference.unwrap_or(property);
        match value {
            Value::Table(inner) if property["properties"].is_object() => {
                remove_defaults(inner, property, root);
                !inner.is_empty()
            }
            _ => default.or(property.get("default")) != serde_json::to_value(&*value).ok().as_ref(),
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_what_equals_a_default_goes() {
        let schema = json!({
            "properties": {
                "mm": { "type": "number", "default": 5.0 },
                "levels": { "default": [32, 8] },
                "n": { "type": "integer", "default": 3 },
                "rules": { "$ref": "#/$defs/Rules" },
                "other": { "$ref": "#/$defs/Rules" },
            },
            "$defs": { "Rules": { "properties": { "most": { "default": 1.5 }, "least": { "default": 0.0 } } } },
        });
        let mut node: Table =
            "kind = \"a.b\"\nin = { a = \"c.d\" }\nmm = 5.0\nlevels = [32, 8]\nn = 4\nrules = { most = 1.5, \
                               least = 0.1 }\nother = { most = 1.5, least = 0.0 }\n"
                .parse()
                .unwrap();
        remove_defaults(&mut node, &schema, &schema);
        let expected: Table = "kind = \"a.b\"\nin = { a = \"c.d\" }\nn = 4\nrules = { least = 0.1 }\n".parse().unwrap();
        assert_eq!(node, expected);
    }
}
