//! Mermaid and Graphviz output.

use crate::{Diagram, share_colour, xml::escape};
use std::fmt::Write;

/// Draws the diagram as a Mermaid flowchart, which Markdown viewers render.
pub fn mermaid(diagram: &Diagram) -> String {
    let mut out = String::from("flowchart LR\n");
    for (index, node) in diagram.nodes.iter().enumerate() {
        let (open, close) = if node.is_source { ("([", "])") } else { ("[", "]") };
        let mut text = format!("<b>{}</b><br/>{}", escape(&node.name), escape(&node.kind));
        let failed = node.failure.as_ref().map(|reason| format!("failed: {reason}"));
        for line in node.lines.iter().chain(&failed) {
            let _ = write!(text, "<br/>{}", escape(line).replace('\n', " "));
        }
        let _ = writeln!(out, "    n{index}{open}\"{text}\"{close}");
    }
    for link in &diagram.links {
        let label = link.label.iter().map(|line| escape(line)).collect::<Vec<_>>().join("<br/>");
        let (open, close) = if link.leads_back() { ("-.", ".->") } else { ("--", "-->") };
        let _ = writeln!(out, "    n{} {open} \"{label}\" {close} n{}", link.from, link.to);
    }
    for (index, node) in diagram.nodes.iter().enumerate() {
        let fill = node.busy_share.map(|share| format!("fill:{},color:#1b1f24", share_colour(Some(share))));
        let edge = node.failure.as_ref().map(|_| "stroke:#c62828,stroke-width:3px".to_owned());
        let style: Vec<_> = fill.into_iter().chain(edge).collect();
        if !style.is_empty() {
            let _ = writeln!(out, "    style n{index} {}", style.join(","));
        }
    }
    for (index, _) in diagram.links.iter().enumerate().filter(|(_, link)| link.dropped > 0) {
        let _ = writeln!(out, "    linkStyle {index} stroke:#c62828,color:#c62828");
    }
    out
}

/// Draws the diagram as a Graphviz graph.
pub fn dot(diagram: &Diagram) -> String {
    let mut out = format!("digraph {} {{\n    rankdir = LR;\n    node [shape = box];\n", quote(&diagram.title));
    for (index, node) in diagram.nodes.iter().enumerate() {
        let lines: Vec<_> = [&node.name, &node.kind].into_iter().chain(&node.lines).map(String::as_str).collect();
        let text = quote(&lines.join("\n"));
        let mut style = Vec::new();
        style.extend(node.is_source.then_some("rounded"));
        style.extend(node.busy_share.map(|_| "filled"));
        let mut attributes = String::new();
        match style[..] {
            [] => {}
            [one] => attributes = format!(", style = {one}"),
            _ => attributes = format!(", style = \"{}\"", style.join(",")),
        }
        if let Some(share) = node.busy_share {
            let _ = write!(attributes, ", fillcolor = \"{}\"", share_colour(Some(share)));
        }
        if let Some(reason) = &node.failure {
            let _ = write!(attributes, ", color = \"#c62828\", penwidth = 3, tooltip = {}", quote(reason));
        }
        let _ = writeln!(out, "    n{index} [label = {text}{attributes}];");
    }
    for link in &diagram.links {
        let text = quote(&link.label.join("\n"));
        let red = if link.dropped > 0 { ", color = \"#c62828\", fontcolor = \"#c62828\"" } else { "" };
        let back = if link.leads_back() { ", style = dashed, constraint = false" } else { "" };
        let _ = writeln!(out, "    n{} -> n{} [label = {text}{red}{back}];", link.from, link.to);
    }
    out.push_str("}\n");
    out
}

fn quote(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Link, Node};

    /// A source and a failed node that was busy for all of the time; one item was dropped between them.
    fn diagram() -> Diagram {
        let source = Node { name: "scan".into(), kind: "acquire.mcap".into(), is_source: true, ..Node::default() };
        let failed = Node {
            name: "crop".into(),
            kind: "crop.box".into(),
            lines: vec!["2 items".into()],
            busy_share: Some(1.0),
            failure: Some("no \"box\"\nat all".into()),
            ..Node::default()
        };
        let label = vec!["cloud <3>".into(), "1 dropped".into()];
        let link = Link { from: 0, to: 1, label, dropped: 1, tooltip: String::new() };
        Diagram { title: "two nodes".into(), notes: Vec::new(), nodes: vec![source, failed], links: vec![link] }
    }

    #[test]
    fn mermaid_has_colours_counts_and_escaped_text() {
        let expected = "\
flowchart LR
    n0([\"<b>scan</b><br/>acquire.mcap\"])
    n1[\"<b>crop</b><br/>crop.box<br/>2 items<br/>failed: no &quot;box&quot; at all\"]
    n0 -- \"cloud &lt;3&gt;<br/>1 dropped\" --> n1
    style n1 fill:#ec7f5b,color:#1b1f24,stroke:#c62828,stroke-width:3px
    linkStyle 0 stroke:#c62828,color:#c62828
";
        assert_eq!(mermaid(&diagram()), expected);
    }

    #[test]
    fn dot_has_colours_counts_and_quoted_text() {
        let expected = r##"digraph "two nodes" {
    rankdir = LR;
    node [shape = box];
    n0 [label = "scan\nacquire.mcap", style = rounded];
    n1 [label = "crop\ncrop.box\n2 items", style = filled, fillcolor = "#ec7f5b", color = "#c62828", penwidth = 3, tooltip = "no \"box\"\nat all"];
    n0 -> n1 [label = "cloud <3>\n1 dropped", color = "#c62828", fontcolor = "#c62828"];
}
"##;
        assert_eq!(dot(&diagram()), expected);
    }
}
