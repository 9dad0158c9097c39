//! Pictures in the languages of other programs.

use super::{Picture, SHARES, class_of, escaped};
use std::fmt::Write;

/// The graph as a Mermaid flowchart, as Markdown viewers draw it.
pub fn mermaid(picture: &Picture) -> String {
    let mut out = String::from("flowchart LR\n");
    for (index, node) in picture.nodes.iter().enumerate() {
        let (open, close) = if node.is_source { ("([", "])") } else { ("[", "]") };
        let mut text = format!("<b>{}</b><br/>{}", escaped(&node.name), escaped(&node.kind));
        let failed = node.failed.as_ref().map(|reason| format!("failed: {reason}"));
        for line in node.figures.iter().chain(&failed) {
            let _ = write!(text, "<br/>{}", escaped(line).replace('\n', " "));
        }
        let _ = writeln!(out, "    n{index}{open}\"{text}\"{close}");
    }
    for wire in &picture.wires {
        let label = wire.label.iter().map(|line| escaped(line)).collect::<Vec<_>>().join("<br/>");
        let _ = writeln!(out, "    n{} -- \"{label}\" --> n{}", wire.from, wire.to);
    }
    for (index, node) in picture.nodes.iter().enumerate() {
        let fill = node.share.map(|share| format!("fill:{},color:#1b1f24", SHARES[class_of(share)].1));
        let edge = node.failed.as_ref().map(|_| "stroke:#c62828,stroke-width:3px".to_owned());
        let style: Vec<_> = fill.into_iter().chain(edge).collect();
        if !style.is_empty() {
            let _ = writeln!(out, "    style n{index} {}", style.join(","));
        }
    }
    for (index, _) in picture.wires.iter().enumerate().filter(|(_, wire)| wire.dropped > 0) {
        let _ = writeln!(out, "    linkStyle {index} stroke:#c62828,color:#c62828");
    }
    out
}

/// The graph as a Graphviz graph.
pub fn dot(picture: &Picture) -> String {
    let mut out = format!("digraph {} {{\n    rankdir = LR;\n    node [shape = box];\n", quote(&picture.name));
    for (index, node) in picture.nodes.iter().enumerate() {
        let lines: Vec<_> = [&node.name, &node.kind].into_iter().chain(&node.figures).map(String::as_str).collect();
        let text = quote(&lines.join("\n"));
        let mut style = Vec::new();
        style.extend(node.is_source.then_some("rounded"));
        style.extend(node.share.map(|_| "filled"));
        let mut attributes = String::new();
        match style[..] {
            [] => {}
            [one] => attributes = format!(", style = {one}"),
            _ => attributes = format!(", style = \"{}\"", style.join(",")),
        }
        if let Some(share) = node.share {
            let _ = write!(attributes, ", fillcolor = \"{}\"", SHARES[class_of(share)].1);
        }
        if let Some(reason) = &node.failed {
            let _ = write!(attributes, ", color = \"#c62828\", penwidth = 3, tooltip = {}", quote(reason));
        }
        let _ = writeln!(out, "    n{index} [label = {text}{attributes}];");
    }
    for wire in &picture.wires {
        let text = quote(&wire.label.join("\n"));
        let red = if wire.dropped > 0 { ", color = \"#c62828\", fontcolor = \"#c62828\"" } else { "" };
        let _ = writeln!(out, "    n{} -> n{} [label = {text}{red}];", wire.from, wire.to);
    }
    out.push_str("}\n");
    out
}

fn quote(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}
