//! Pictures of a plan: nodes with their kinds, and on each arrow the ports, the payload and, where known, its frames.

use crate::plan::{Link, Plan, PlanOutput, PortFrames};
use osteoflow_node::Role;
use std::fmt::Write;

/// The plan as a Mermaid flowchart, as Markdown viewers draw it.
pub fn mermaid(plan: &Plan) -> String {
    let mut out = String::from("flowchart LR\n");
    for (index, node) in plan.nodes.iter().enumerate() {
        let (open, close) = if node.role == Role::Node { ("[", "]") } else { ("([", "])") };
        let text = format!("<b>{}</b><br/>{}", html(&node.name), html(&node.kind));
        let _ = writeln!(out, "    n{index}{open}\"{text}\"{close}");
    }
    for link in &plan.links {
        let label = label(plan, link).iter().map(|line| html(line)).collect::<Vec<_>>().join("<br/>");
        let _ = writeln!(out, "    n{} -- \"{label}\" --> n{}", link.from.node, link.to_node);
    }
    out
}

/// The plan as a Graphviz graph.
pub fn dot(plan: &Plan) -> String {
    let mut out = format!("digraph {} {{\n    rankdir = LR;\n    node [shape = box];\n", quote(&plan.name));
    for (index, node) in plan.nodes.iter().enumerate() {
        let style = if node.role == Role::Node { "" } else { ", style = rounded" };
        let text = quote(&format!("{}\n{}", node.name, node.kind));
        let _ = writeln!(out, "    n{index} [label = {text}{style}];");
    }
    for link in &plan.links {
        let text = quote(&label(plan, link).join("\n"));
        let _ = writeln!(out, "    n{} -> n{} [label = {text}];", link.from.node, link.to_node);
    }
    out.push_str("}\n");
    out
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

fn html(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn quote(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}
