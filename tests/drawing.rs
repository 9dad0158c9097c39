//! Drawings of graphs and of runs: well-formed, complete and without overlaps.

use crate::common::{json, osteoflow, run, shipped_graphs};
use roxmltree::{Document, Node};
use std::path::Path;

fn drawn(arguments: &[&str]) -> String {
    let output = osteoflow().arg("graph").args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn number(node: Node<'_, '_>, name: &str) -> f64 {
    node.attribute(name).unwrap().parse().unwrap()
}

/// The boxes of the nodes: name, left, top, right, bottom.
fn boxes(document: &Document<'_>) -> Vec<(String, [f64; 4])> {
    let groups = document.descendants().filter(|n| n.has_tag_name("g"));
    let boxes = groups.filter_map(|group| {
        let of_class = |class: &str| group.children().find(|n| n.attribute("class").is_some_and(|c| c.contains(class)));
        let (rect, name) = (of_class("box")?, of_class("name")?);
        let (x, y) = (number(rect, "x"), number(rect, "y"));
        let name = name.text().unwrap().trim_end_matches(" \u{25c6}").to_owned();
        Some((name, [x, y, x + number(rect, "width"), y + number(rect, "height")]))
    });
    boxes.collect()
}

/// Every node once, without overlaps, all of it inside the drawing.
fn check(svg: &str, names: &[String]) {
    let document = Document::parse(svg).unwrap_or_else(|error| panic!("not XML: {error}"));
    let (root, boxes) = (document.root_element(), boxes(&document));
    let mut found: Vec<_> = boxes.iter().map(|(name, _)| name.clone()).collect();
    let mut names = names.to_vec();
    found.sort();
    names.sort();
    assert_eq!(found, names);
    for (i, (name, a)) in boxes.iter().enumerate() {
        for (other, b) in &boxes[..i] {
            let apart = a[2] <= b[0] || b[2] <= a[0] || a[3] <= b[1] || b[3] <= a[1];
            assert!(apart, "{name} {a:?} overlaps {other} {b:?}");
        }
        assert!(a[0] >= 0.0 && a[2] <= number(root, "width") && a[3] <= number(root, "height"), "{name} {a:?}");
    }
}

fn nodes_of(dir: &Path) -> Vec<String> {
    let manifest = json(&dir.join("manifest.json"));
    manifest["nodes"].as_array().unwrap().iter().map(|n| n["name"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn every_shipped_graph_is_drawn_without_overlaps() {
    for graph in shipped_graphs() {
        let svg = drawn(&[&graph, "--as", "svg"]);
        let text = drawn(&[&graph, "--as", "mermaid"]);
        let names: Vec<_> =
            text.lines().filter_map(|l| l.split("<b>").nth(1)?.split("</b>").next()).map(str::to_owned).collect();
        assert!(!names.is_empty(), "{graph}");
        check(&svg, &names);
    }
}

#[test]
fn a_run_is_drawn_with_its_figures_and_the_reason_of_the_node_that_failed() {
    let ran = run("graphs/fibula.toml", &["--no-record", "--inject", "cuts"]);
    let dir = ran.dir.path();
    let folder = drawn(&["--run", dir.to_str().unwrap(), "--as", "svg"]);
    let file = drawn(&["--run", dir.join("manifest.json").to_str().unwrap(), "--as", "svg"]);
    assert_eq!(folder, file);
    check(&folder, &nodes_of(dir));
    let document = Document::parse(&folder).unwrap();
    let failed: Vec<_> = document.descendants().filter(|n| n.attribute("class") == Some("box failed")).collect();
    assert_eq!(failed.len(), 1);
    let tip = failed[0].parent().unwrap().children().find(|n| n.has_tag_name("title")).unwrap().text().unwrap();
    assert!(tip.contains("cuts (metrics.cuts)") && tip.contains("a panic was injected into cuts at item 0"), "{tip}");
    assert_eq!(folder.matches(" \u{25c6}</text>").count(), 1, "one node is the slowest");
    assert!(folder.contains(">pose 602</text>"), "wires are labelled with their items");
    for language in ["mermaid", "dot"] {
        let text = drawn(&["--run", dir.to_str().unwrap(), "--as", language]);
        assert!(text.contains("pose 602") && text.contains("#c62828"), "{text}");
    }
}

#[test]
fn a_folder_without_a_run_and_a_graph_together_with_a_run_are_refused() {
    let refusal = |arguments: &[&str], code: i32| {
        let output = osteoflow().arg("graph").args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(refusal(&["--run", "graphs"], 1).contains("--run takes the folder of a run that has ended"));
    assert!(refusal(&["--run", "Cargo.toml"], 1).contains("is not the manifest of a run"));
    refusal(&["graphs/fibula.toml", "--run", "x"], 2);
    refusal(&[], 2);
    refusal(&["--set", "a.b=1"], 2);
}
