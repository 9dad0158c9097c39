//! Topological order of a recorded graph, from its text alone: its kinds need not be known.

use std::collections::{BTreeMap, BTreeSet};
use toml::{Table, Value};

/// Rank of each node in the topological order of the graph, ties in file order; empty if the text is not a graph.
pub(super) fn ranks(graph: &str) -> BTreeMap<String, usize> {
    let Ok(table) = graph.parse::<Table>() else { return BTreeMap::new() };
    let mut nodes = Vec::new();
    if let Some(Value::Table(table)) = table.get("node") {
        collect("", table, &mut nodes);
    }
    let index: BTreeMap<&str, usize> = nodes.iter().zip(0..).map(|((name, _), i)| (name.as_str(), i)).collect();
    let producers: Vec<BTreeSet<usize>> = nodes
        .iter()
        .map(|(_, wires)| wires.iter().filter_map(|wire| index.get(node_of(wire)).copied()).collect())
        .collect();
    let mut ranks = BTreeMap::new();
    let mut waiting: BTreeSet<usize> = (0..nodes.len()).collect();
    // A graph that ran has no cycle; nodes of a cycle in a modified file come last, in file order.
    while let Some(next) = waiting
        .iter()
        .copied()
        .find(|&node| producers[node].iter().all(|from| *from == node || !waiting.contains(from)))
        .or_else(|| waiting.first().copied())
    {
        waiting.remove(&next);
        ranks.insert(nodes[next].0.clone(), ranks.len());
    }
    ranks
}

/// The node of a wire, `node.port`.
pub(super) fn node_of(wire: &str) -> &str {
    wire.rsplit_once('.').map_or(wire, |(node, _)| node)
}

/// Collects nodes and the wires they take; a table without a kind groups others.
fn collect(prefix: &str, table: &Table, nodes: &mut Vec<(String, Vec<String>)>) {
    for (name, value) in table {
        let Value::Table(node) = value else { continue };
        let name = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        if node.contains_key("kind") {
            let mut wires = Vec::new();
            if let Some(Value::Table(inputs)) = node.get("in") {
                inputs.values().for_each(|input| sources(input, &mut wires));
            }
            nodes.push((name, wires));
        } else {
            collect(&name, node, nodes);
        }
    }
}

/// Wires that an input names.
fn sources(input: &Value, wires: &mut Vec<String>) {
    match input {
        Value::String(wire) => wires.push(wire.clone()),
        Value::Array(list) => list.iter().for_each(|input| sources(input, wires)),
        Value::Table(table) => table.get("from").into_iter().for_each(|from| sources(from, wires)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_come_after_their_inputs_and_otherwise_in_file_order() {
        let graph = r#"
            [node.last]
            kind = "x"
            in = { a = { from = "middle.out", join = "latest" }, b = "second.out" }
            [node.middle]
            kind = "x"
            in.a = "part.first.out"
            [node.part.first]
            kind = "x"
            [node.second]
            kind = "x"
        "#;
        let ranks = ranks(graph);
        let mut names: Vec<_> = ranks.iter().map(|(name, rank)| (*rank, name.as_str())).collect();
        names.sort();
        assert_eq!(names.iter().map(|(_, name)| *name).collect::<Vec<_>>(), ["part.first", "middle", "second", "last"]);
        assert_eq!(super::ranks("no = graph"), BTreeMap::new());
    }

    #[test]
    fn a_cycle_does_not_hang() {
        let graph = "[node.a]\nkind = \"x\"\nin.x = \"b.out\"\n[node.b]\nkind = \"x\"\nin.x = \"a.out\"\n";
        assert_eq!(ranks(graph).len(), 2);
    }
}
