//! Pictures of a graph: nodes with their kinds, wires with their ports, and, of a run, its figures on them.

mod layout;
mod of_run;
mod svg;
mod text;

pub use of_run::{percent, time};
pub use svg::svg;
pub use text::{dot, mermaid};

use crate::plan::{Link, Plan, PlanOutput, PortFrames};
use osteoflow_node::Role;

/// A graph to be drawn.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Picture {
    /// The graph's name.
    pub name: String,
    /// What a run was and how it ended; empty for a graph.
    pub about: Vec<String>,
    /// The nodes in topological order.
    pub nodes: Vec<Node>,
    /// The wires, each from one node to another.
    pub wires: Vec<Wire>,
}

/// A node of a picture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Node {
    /// Its full name.
    pub name: String,
    /// Its kind.
    pub kind: String,
    /// Whether it has no inputs by its kind.
    pub is_source: bool,
    /// Figures of a run, a line each.
    pub figures: Vec<String>,
    /// Its share of the time that all nodes were busy, of a run.
    pub share: Option<f64>,
    /// Why it failed, if it did.
    pub failed: Option<String>,
}

/// A wire of a picture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Wire {
    /// Index of the producing node.
    pub from: usize,
    /// Index of the consuming node.
    pub to: usize,
    /// What stands on it.
    pub label: Vec<String>,
    /// Items dropped, of a run.
    pub dropped: u64,
    /// All that is known of it.
    pub about: String,
}

impl Picture {
    /// The picture of a checked graph.
    pub fn of_plan(plan: &Plan) -> Self {
        let nodes = plan.nodes.iter().map(|node| Node {
            name: node.name.to_string(),
            kind: node.kind.clone(),
            is_source: node.role != Role::Node,
            ..Node::default()
        });
        let wires = plan.links.iter().map(|link| {
            let label = label(plan, link);
            let to = &plan.nodes[link.to_node];
            let ends = format!("{} -> {}.{}", plan.wire_name(link.from), to.name, to.inputs[link.to_port].port.name);
            let join = to.inputs[link.to_port].port.join.name();
            let about = format!("{ends}: {}, joined by {join}", label[1..].join(", "));
            Wire { from: link.from.node, to: link.to_node, label, dropped: 0, about }
        });
        Self { name: plan.name.clone(), about: Vec::new(), nodes: nodes.collect(), wires: wires.collect() }
    }
}

/// Ports, payload, frames.
fn label(plan: &Plan, link: &Link) -> Vec<String> {
    let output = &plan.nodes[link.from.node].outputs[link.from.port];
    let input = &plan.nodes[link.to_node].inputs[link.to_port].port;
    let ports =
        if output.name == input.name { output.name.clone() } else { format!("{} as {}", output.name, input.name) };
    let mut lines = vec![ports, output.payload.name().to_owned()];
    lines.extend(frames(output));
    lines
}

/// `ct`, or `world to ct` of a pose.
fn frames(output: &PlanOutput) -> Option<String> {
    match &output.frames {
        PortFrames { frame: Some(frame), .. } => Some(format!("in {frame}")),
        PortFrames { to: None, from: None, .. } => None,
        PortFrames { to, from, .. } => {
            let name = |frame: &Option<String>| frame.clone().unwrap_or_else(|| "?".into());
            Some(format!("{} to {}", name(from), name(to)))
        }
    }
}

/// Text as markup takes it; characters that XML forbids are left out.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\n' | '\t' => out.push(c),
            c if c < ' ' || matches!(c, '\u{7f}' | '\u{fffe}' | '\u{ffff}') => {}
            c => out.push(c),
        }
    }
    out
}

/// The classes that colour nodes by their share of the busy time: the least share, the colour, what the legend says.
pub(crate) const SHARES: [(f64, &str, &str); 5] = [
    (0.0, "#eef1f4", "below 1 %"),
    (0.01, "#fdf0c4", "1 %"),
    (0.05, "#fbd37a", "5 %"),
    (0.15, "#f5a353", "15 %"),
    (0.30, "#ec7f5b", "30 % and more"),
];

/// The class of a share.
fn class_of(share: f64) -> usize {
    SHARES.iter().rposition(|(least, ..)| share >= *least).unwrap_or(0)
}
