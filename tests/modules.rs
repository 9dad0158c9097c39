//! Modules from the command line: checked alone, described by `inspect`, used by a shipped graph, and expanded.

use crate::common::{osteoflow, root, run_whole, shared_run, shipped_graphs, shipped_modules};
use std::fs;

const GRAPH: &str = "graphs/variants/fibula_modules.toml";

fn printed(arguments: &[&str]) -> String {
    let assert = osteoflow().args(arguments).assert().success();
    String::from_utf8(assert.get_output().stdout.clone()).unwrap()
}

#[test]
fn a_graph_with_a_module_gives_the_results_of_the_flat_one() {
    // No node inside uses random numbers, so its longer name changes nothing.
    let (flat, modules) = (shared_run("graphs/fibula.toml", &[]), run_whole(GRAPH, &[]));
    assert!(flat.results["metrics"].is_object(), "{}", flat.results);
    assert_eq!(modules.results, flat.results);
}

#[test]
fn every_shipped_module_is_checked_alone_and_described_by_inspect() {
    let modules = shipped_modules();
    assert!(!modules.is_empty());
    for module in &modules {
        assert!(printed(&["check", module]).contains("a module of"), "{module}");
        let answer: serde_json::Value =
            serde_json::from_str(&printed(&["inspect", module, "--format", "json"])).unwrap();
        let page = printed(&["inspect", module]);
        for part in ["inputs", "outputs", "params"] {
            for entry in answer[part].as_array().unwrap() {
                let name = entry["name"].as_str().unwrap();
                assert!(!entry["doc"].as_str().unwrap().is_empty(), "{module}: {part} {name} has no doc");
                assert!(page.contains(&format!("- `{name}` (")), "{page}");
            }
        }
        let text = fs::read_to_string(root().join(module)).unwrap();
        let stem = module.rsplit('/').next().unwrap().trim_end_matches(".toml");
        assert!(text.contains(&format!("\"{stem}\"")), "{module} is not named after its file");
    }
}

#[test]
fn a_module_is_not_run_by_itself() {
    let module = &shipped_modules()[0];
    let output = osteoflow().args(["run", module]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("this is a module: other graphs use it"), "{text}");
}

#[test]
fn an_expanded_graph_is_one_flat_file_that_expands_to_itself() {
    let dir = tempfile::tempdir().unwrap();
    for graph in shipped_graphs() {
        let flat = printed(&["expand", &graph]);
        assert!(!flat.contains("extends") && !flat.contains("kind = \"module\""), "{graph}");
        let path = dir.path().join("flat.toml");
        fs::write(&path, &flat).unwrap();
        let again = printed(&["expand", path.to_str().unwrap()]);
        let bare =
            |text: &str| text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(bare(&again), bare(&flat), "{graph}");
    }
}

#[test]
fn an_expanded_graph_says_where_each_node_was_written() {
    let flat = printed(&["expand", GRAPH]);
    let line = flat.lines().position(|line| line == "[node.\"laser/hole\"]").unwrap();
    let place = flat.lines().nth(line - 1).unwrap();
    assert!(place.starts_with("# graphs/modules/laser_point.toml:"), "{place}");
}

#[test]
fn settings_reach_a_module_by_its_parameters_and_its_nodes() {
    for set in ["laser.method=hole.range_image", "laser/hole.kind=hole.range_image"] {
        let flat = printed(&["expand", GRAPH, "--set", set]);
        let (_, hole) = flat.split_once("[node.\"laser/hole\"]\n").unwrap();
        assert!(hole.starts_with("kind = \"hole.range_image\""), "{set}");
    }
}
