//! Every shipped graph checks, and its plan (order, types, joins, frames) equals the golden text.

use crate::common::{assert_golden, osteoflow, root, shipped_graphs};
use osteoflow_engine::plan::{Plan, PlanOutput};
use serde_json::{Value, json};
use std::{fmt::Write, fs, path::Path};

fn plan(graph: &str) -> Plan {
    let registry = osteoflow_standard::registry();
    let checked = osteoflow_engine::check(&root().join(graph), &[], &registry);
    let checked = checked.unwrap_or_else(|faults| panic!("{graph}:\n{faults}"));
    assert!(checked.warnings.is_empty(), "{graph} has warnings: {:#?}", checked.warnings);
    checked.plan
}

/// The parts of a plan that a reviewer wants to see change when a graph changes.
fn text(plan: &Plan) -> String {
    let mut out = format!("graph {} (seed {})\n", plan.name, plan.seed);
    for node in &plan.nodes {
        let _ = writeln!(out, "\n{} = {}", node.name, node.kind);
        for input in &node.inputs {
            let from = plan.wires_of(input).unwrap_or_else(|| "nothing".into());
            let join = if input.port.unused { "unused".into() } else { format!("{:?}", input.port.join) };
            let _ = writeln!(out, "  {} <- {from} ({join})", input.port.name);
        }
        for output in node.outputs.iter().filter(|output| !output.links.is_empty()) {
            let _ = writeln!(out, "  -> {}: {}{}", output.name, output.payload.name(), frames(output));
        }
    }
    out.push_str("\nresults\n");
    for entry in &plan.results {
        let all = if entry.all { ", all" } else { "" };
        let optional = if entry.optional { ", optional" } else { "" };
        let _ = writeln!(out, "  {} = {}{all}{optional}", entry.key, plan.wire_name(entry.from));
    }
    out
}

fn frames(output: &PlanOutput) -> String {
    let known = |frame: &Option<String>| frame.clone().unwrap_or_else(|| "?".into());
    match &output.frames {
        f if f.frame.is_some() => format!(" in {}", known(&f.frame)),
        f if f.to.is_some() || f.from.is_some() => format!(" {} -> {}", known(&f.from), known(&f.to)),
        _ => String::new(),
    }
}

/// The graph that a graph extends.
fn extended(graph: &str) -> Option<String> {
    let path = root().join(graph);
    let table: toml::Table = fs::read_to_string(&path).unwrap().parse().unwrap();
    let base = path.parent().unwrap().join(table.get("extends")?.as_str()?).canonicalize().unwrap();
    Some(base.strip_prefix(root().canonicalize().unwrap()).unwrap().to_str().unwrap().into())
}

/// The nodes of a plan that are not as in the plan of the graph that it extends, and the names of those that are only there.
fn beside(whole: &str, base: &str) -> String {
    let blocks = |text: &str| text.trim_end().split("\n\n").map(str::to_owned).collect::<Vec<_>>();
    let (whole, base) = (blocks(whole), blocks(base));
    let name = |block: &String| block.split(" = ").next().unwrap().to_owned();
    let names: Vec<_> = whole.iter().map(name).collect();
    let gone = base[1..].iter().map(name).filter(|name| !names.contains(name) && !name.starts_with("results"));
    let others = whole.iter().filter(|block| !base.contains(block)).cloned();
    others.chain(gone.map(|name| format!("without {name}"))).collect::<Vec<_>>().join("\n\n") + "\n"
}

#[test]
fn every_shipped_graph_has_the_plan_of_its_golden_text() {
    let graphs = shipped_graphs();
    assert!(graphs.len() >= 9, "{graphs:?}");
    let folder = root().join("tests/golden/plans");
    let mut kept: Vec<String> = Vec::new();
    for graph in &graphs {
        let name = format!("{}.txt", graph.trim_start_matches("graphs/").trim_end_matches(".toml").replace('/', "_"));
        let whole = text(&plan(graph));
        let base = extended(graph).map(|base| text(&plan(&base)));
        assert_golden(&folder.join(&name), &base.map_or(whole.clone(), |base| beside(&whole, &base)));
        kept.push(name);
    }
    for entry in fs::read_dir(&folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(kept.contains(&name), "tests/golden/plans/{name} belongs to no graph any more");
    }
}

#[test]
fn a_graph_is_named_after_its_file() {
    for graph in shipped_graphs() {
        let stem = Path::new(&graph).file_stem().unwrap().to_str().unwrap().to_owned();
        assert_eq!(plan(&graph).name, stem, "{graph}");
    }
}

#[test]
fn a_variant_is_a_few_lines_over_the_graph_it_extends() {
    for graph in shipped_graphs().iter().filter(|g| g.starts_with("graphs/variants/")) {
        let text = fs::read_to_string(root().join(graph)).unwrap();
        assert!(text.contains("extends"), "{graph} extends nothing");
        let n_lines = text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#')).count();
        // The longest, the stylus baseline, removes the camera's half of the graph and rewires all that took its cloud.
        assert!(n_lines <= 32, "{graph} has {n_lines} lines");
    }
}

#[test]
fn both_drawings_show_every_node_and_wire() {
    let plan = plan("graphs/fibula.toml");
    for (language, arrow) in [("mermaid", "-->"), ("dot", "->")] {
        let assert = osteoflow().args(["graph", "graphs/fibula.toml", "--as", language]).assert().success();
        let drawn = String::from_utf8(assert.get_output().stdout.clone()).unwrap();
        for node in &plan.nodes {
            assert!(drawn.contains(&*node.name), "{language} lacks {}", node.name);
        }
        let n_arrows = drawn.lines().filter(|line| line.contains(arrow)).count();
        assert_eq!(n_arrows, plan.links.len(), "{language}");
    }
}

#[test]
fn check_prints_the_numbers_of_nodes_and_wires_as_json() {
    let plan = plan("graphs/fibula.toml");
    let assert = osteoflow().args(["check", "graphs/fibula.toml", "--format", "json"]).assert().success();
    let answer: serde_json::Value = serde_json::from_slice(&assert.get_output().stdout).unwrap();
    assert_eq!(answer["outcome"]["status"], "done");
    assert_eq!(
        (answer["nodes"].as_u64(), answer["wires"].as_u64()),
        (Some(plan.nodes.len() as u64), Some(plan.links.len() as u64))
    );
}

/// The parameters of a node's table that equal the default of its kind.
fn defaults_written(table: &toml::Table, schema: &Value, root: &Value) -> Vec<String> {
    let mut written = Vec::new();
    for (key, value) in table {
        let property = &schema["properties"][key];
        let followed = property["$ref"].as_str().and_then(|path| root.pointer(path.trim_start_matches('#')));
        let followed = followed.unwrap_or(property);
        let default = property.get("default").or(followed.get("default"));
        match value {
            toml::Value::Table(inner) if followed["properties"].is_object() => {
                written.extend(defaults_written(inner, followed, root).iter().map(|inner| format!("{key}.{inner}")));
            }
            value => written.extend((default == Some(&json!(value))).then(|| key.clone())),
        }
    }
    written
}

/// The tables of the nodes of a graph file: its own, and those of the graphs that it extends.
fn tables(graph: &Path) -> Vec<toml::Table> {
    let table: toml::Table = fs::read_to_string(graph).unwrap().parse().unwrap();
    let base = table.get("extends").and_then(|base| base.as_str()).map(|base| graph.parent().unwrap().join(base));
    let nodes = table.get("node").and_then(|nodes| nodes.as_table()).cloned().unwrap_or_default();
    [nodes].into_iter().chain(base.iter().flat_map(|base| tables(base))).collect()
}

#[test]
fn a_shipped_graph_writes_no_parameter_that_equals_the_default_of_its_kind() {
    let registry = osteoflow_standard::registry();
    let mut all = Vec::new();
    for graph in shipped_graphs() {
        let [nodes, bases @ ..] = &tables(&root().join(&graph))[..] else { unreachable!("{graph}") };
        for (name, node) in nodes {
            let node = node.as_table().unwrap();
            let in_bases = |key: &str| {
                let value = |base: &toml::Table| base.get(name)?.get(key).cloned();
                bases.iter().find_map(value)
            };
            let kind = node.get("kind").cloned().or_else(|| in_bases("kind"));
            let Some(kind) = kind.as_ref().and_then(|kind| registry.kind(kind.as_str()?)) else { continue };
            let params = &kind.description.params;
            for key in defaults_written(node, params, params) {
                // Another value of a graph that is extended is set back.
                if in_bases(key.split('.').next().unwrap()).is_none() {
                    all.push(format!("{graph}: node \"{name}\": {key}"));
                }
            }
        }
    }
    assert!(all.is_empty(), "a kind in the place of theirs would be given them:\n{}", all.join("\n"));
}
