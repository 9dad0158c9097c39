use super::{context::Check, inputs::Input, parsed_nodes::ParsedNode, wires};
use crate::fault::{Fault, Span};
use petgraph::{algo::tarjan_scc, graph::DiGraph};
use std::collections::{BTreeSet, VecDeque};

impl Check<'_> {
    /// The parsed nodes in topological order, ties broken by the order of the file; faults for cycles.
    pub(super) fn order(&mut self, parsed_nodes: &[ParsedNode<'_>], inputs: &[Vec<Input>]) -> Option<Vec<usize>> {
        let mut graph = DiGraph::<(), ()>::new();
        let nodes: Vec<_> = parsed_nodes.iter().map(|_| graph.add_node(())).collect();
        for (to, inputs) in inputs.iter().enumerate() {
            for (from, _) in inputs.iter().filter_map(|input| input.from) {
                graph.add_edge(nodes[from], nodes[to], ());
            }
        }
        let mut circles: Vec<BTreeSet<usize>> = Vec::new();
        for component in tarjan_scc(&graph) {
            let members: BTreeSet<_> = component.iter().map(|node| node.index()).collect();
            if members.len() > 1 || component.iter().any(|&node| graph.contains_edge(node, node)) {
                circles.push(members);
            }
        }
        circles.sort();
        self.faults.extend(circles.iter().filter_map(|members| cycle(members, parsed_nodes, inputs)));
        circles.is_empty().then(|| sort(inputs))
    }
}

fn sort(inputs: &[Vec<Input>]) -> Vec<usize> {
    let producers = |node: usize| inputs[node].iter().filter_map(|input| input.from).map(|(from, _)| from);
    let mut waits: Vec<usize> = (0..inputs.len()).map(|node| producers(node).count()).collect();
    let mut ready: BTreeSet<_> = (0..inputs.len()).filter(|&node| waits[node] == 0).collect();
    let mut order = Vec::new();
    while let Some(node) = ready.pop_first() {
        order.push(node);
        for (other, waits) in waits.iter_mut().enumerate() {
            let fed = producers(other).filter(|&from| from == node).count();
            *waits -= fed;
            if fed > 0 && *waits == 0 {
                ready.insert(other);
            }
        }
    }
    order
}

/// The fault of the shortest cycle through the first of `members`; it names all nodes of the cycle.
fn cycle(members: &BTreeSet<usize>, parsed_nodes: &[ParsedNode<'_>], inputs: &[Vec<Input>]) -> Option<Fault> {
    let &start = members.first()?;
    let wire = |from: usize, to: usize| -> Option<(&Span, String)> {
        let input = inputs[to].iter().find(|input| input.from.is_some_and(|(node, _)| node == from))?;
        Some((input.at.as_ref()?, wires::name(input.from?, parsed_nodes)))
    };
    let mut before: Vec<Option<usize>> = vec![None; parsed_nodes.len()];
    let mut open = VecDeque::from([start]);
    let last = 'search: loop {
        let node = open.pop_front()?;
        for &next in members.iter().filter(|&&next| wire(node, next).is_some()) {
            if next == start {
                break 'search node;
            }
            if before[next].is_none() {
                before[next] = Some(node);
                open.push_back(next);
            }
        }
    };
    let mut path = vec![last];
    while path[path.len() - 1] != start {
        path.push(before[path[path.len() - 1]]?);
    }
    path.reverse();
    let names: Vec<_> = path.iter().chain([&start]).map(|&node| parsed_nodes[node].name).collect();
    let (at, from) = wire(last, start)?;
    let mut fault = Fault::new(format!("wires go in a cycle: {}", names.join(" -> ")));
    fault = fault.at(at, format!("\"{from}\" closes the cycle"));
    for pair in path.windows(2) {
        let (at, from) = wire(pair[0], pair[1])?;
        fault = fault.also(at, format!("\"{from}\""));
    }
    Some(fault.help("a node can only take what was made before it; take one of these wires away"))
}
