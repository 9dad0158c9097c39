use super::{context::Check, inputs::Input, parsed_nodes::ParsedNode, wires};
use crate::fault::{Fault, Span};
use osteoflow_node::Join;
use petgraph::{algo::tarjan_scc, graph::DiGraph};
use std::collections::{BTreeSet, VecDeque};

/// The nodes in an order in which they can be run, and the cycles that inputs joined by `previous` close.
pub(super) struct Order {
    /// The parsed nodes in topological order, ties broken by the order of the file; wires that close a cycle do not count.
    pub(super) nodes: Vec<usize>,
    /// The nodes of each cycle.
    pub(super) cycles: Vec<BTreeSet<usize>>,
}

impl Check<'_> {
    /// The order of the parsed nodes; faults for cycles without an input joined by `previous`.
    pub(super) fn order(&mut self, parsed_nodes: &[ParsedNode<'_>], inputs: &[Vec<Input>]) -> Option<Order> {
        let circles = cycles(inputs, |input| input.port.join != Join::Previous);
        self.faults.extend(circles.iter().filter_map(|members| cycle(members, parsed_nodes, inputs)));
        let cycles = cycles(inputs, |_| true);
        circles.is_empty().then(|| Order { nodes: sort(inputs, &cycles), cycles })
    }
}

/// The strongly connected nodes over the inputs that count.
fn cycles(inputs: &[Vec<Input>], counts: impl Fn(&Input) -> bool) -> Vec<BTreeSet<usize>> {
    let mut graph = DiGraph::<(), ()>::new();
    let nodes: Vec<_> = inputs.iter().map(|_| graph.add_node(())).collect();
    for (to, inputs) in inputs.iter().enumerate() {
        for from in inputs.iter().filter(|input| counts(input)).flat_map(Input::producers) {
            graph.add_edge(nodes[from], nodes[to], ());
        }
    }
    let mut cycles: Vec<BTreeSet<usize>> = Vec::new();
    for component in tarjan_scc(&graph) {
        let members: BTreeSet<_> = component.iter().map(|node| node.index()).collect();
        if members.len() > 1 || component.iter().any(|&node| graph.contains_edge(node, node)) {
            cycles.push(members);
        }
    }
    cycles.sort();
    cycles
}

fn sort(inputs: &[Vec<Input>], cycles: &[BTreeSet<usize>]) -> Vec<usize> {
    let closes = |input: &Input, from: usize, to: usize| {
        input.port.join == Join::Previous && cycles.iter().any(|cycle| cycle.contains(&from) && cycle.contains(&to))
    };
    let producers = |node: usize| {
        inputs[node].iter().flat_map(move |input| input.producers().filter(move |from| !closes(input, *from, node)))
    };
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
        let mut wires =
            inputs[to].iter().filter(|input| input.port.join != Join::Previous).flat_map(Input::known_wires);
        let (wire, at) = wires.find(|((node, _), _)| *node == from)?;
        Some((at, wires::name(wire, parsed_nodes)))
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
    let help = "a node can only take what was made before it; take one of these wires away, or join an optional input by \
                \"previous\", which brings the item of the firing before";
    Some(fault.help(help))
}
