//! Topological order of a recorded graph, from its text alone: its kinds need not be known.

use std::collections::{BTreeMap, BTreeSet};
use toml::{Table, Value};

/// Rank of each node in the topological order of the graph, ties in file order; empty if the text is not a graph.
pub(super) fn ranks(graph: &str) -> BTreeMap<String, usize> {
    let graph: Table = graph.parse().unwrap_or_default();
    let nodes: Vec<_> = graph.get("node").and_then(Value::as_table).into_iter().flatten().collect();
    let producers = |node: &Value| -> Vec<usize> {
        let inputs = node.get("in").and_then(Value::as_table).into_iter().flatten();
        let wires = inputs.filter_map(|(_, input)| input.get("from").unwrap_or(input).as_str());
        wires.filter_map(|wire| nodes.iter().position(|(name, _)| *name == node_of(wire))).collect()
    };
    let producers: Vec<_> = nodes.iter().map(|(_, node)| producers(node)).collect();
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
            in.a = "part/first.out"
            [node."part/first"]
            kind = "x"
            [node.second]
            kind = "x"
        "#;
        let ranks = ranks(graph);
        let mut names: Vec<_> = ranks.iter().map(|(name, rank)| (*rank, name.as_str())).collect();
        names.sort();
        assert_eq!(names.iter().map(|(_, name)| *name).collect::<Vec<_>>(), ["part/first", "middle", "second", "last"]);
        assert_eq!(super::ranks("no = graph"), BTreeMap::new());
    }

    #[test]
    fn a_cycle_does_not_hang() {
        let graph = "[node.a]\nkind = \"x\"\nin.x = \"b.out\"\n[node.b]\nkind = \"x\"\nin.x = \"a.out\"\n";
        assert_eq!(ranks(graph).len(), 2);
    }
}
