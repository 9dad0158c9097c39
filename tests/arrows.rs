//! Allowed dependencies between crates, and between the modules of the engine: the arrows of docs/project/architecture.md, checked
//! against the manifests and the sources.

mod floors;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

/// Every crate of the workspace, its folder, and the crates of the workspace that it may depend on.
pub(crate) const ARROWS: [(&str, &str, &[&str]); 20] = [
    ("osteoflow-node-macros", "engine/node/macros", &[]),
    ("osteoflow-libm", "engine/libm", &[]),
    ("osteoflow-node", "engine/node", &["osteoflow-libm", "osteoflow-node-macros"]),
    ("osteoflow-container", "engine/container", &[]),
    ("osteoflow-runtime", "engine/runtime", &["osteoflow-container", "osteoflow-node"]),
    ("osteoflow-verdict", "engine/verdict", &[]),
    (
        "osteoflow-engine",
        "engine",
        &["osteoflow-container", "osteoflow-node", "osteoflow-runtime", "osteoflow-verdict"],
    ),
    ("osteoflow-draw", "engine/draw", &[]),
    ("osteoflow-toy", "engine/tests/toy", &["osteoflow-node"]),
    ("osteoflow-geometry", "nodes/bone/geometry", &["osteoflow-libm"]),
    (
        "osteoflow-algorithms",
        "nodes/bone/algorithms",
        &["osteoflow-geometry", "osteoflow-node-macros", "osteoflow-verdict"],
    ),
    ("osteoflow-formats", "nodes/bone/formats", &["osteoflow-container", "osteoflow-geometry"]),
    (
        "osteoflow-simulation",
        "nodes/bone/simulation",
        &["osteoflow-algorithms", "osteoflow-geometry", "osteoflow-node-macros"],
    ),
    ("osteoflow-statistics", "nodes/bone/statistics", &["osteoflow-libm"]),
    (
        "osteoflow-report",
        "nodes/pages/report",
        &[
            "osteoflow-engine",
            "osteoflow-draw",
            "osteoflow-node",
            "osteoflow-algorithms",
            "osteoflow-geometry",
            "osteoflow-statistics",
            "osteoflow-viewer",
        ],
    ),
    ("osteoflow-viewer", "nodes/pages/viewer", &["osteoflow-container", "osteoflow-engine"]),
    ("osteoflow-payloads", "nodes/kinds/payloads", &["osteoflow-node", "osteoflow-geometry", "osteoflow-algorithms"]),
    (
        "osteoflow-standard",
        "nodes/kinds/standard",
        &[
            "osteoflow-node",
            "osteoflow-payloads",
            "osteoflow-algorithms",
            "osteoflow-formats",
            "osteoflow-simulation",
            "osteoflow-geometry",
        ],
    ),
    (
        "osteoflow-python",
        "nodes/python",
        &["osteoflow", "osteoflow-engine", "osteoflow-geometry", "osteoflow-node", "osteoflow-payloads"],
    ),
    // The template may depend on what every plugin may depend on.
    ("my_plugin", "nodes/template/rust", &["osteoflow-node", "osteoflow-payloads"]),
];

/// Dependencies that read or write files, or run graphs: not allowed in crates of plain functions.
const NOT_FOR_ALGORITHMS: [&str; 9] =
    ["mcap", "foxglove", "stl_io", "ply-rs-bw", "csv", "toml", "serde_json", "crossbeam-channel", "tracing"];

fn manifest(folder: &str) -> toml::Table {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder).join("Cargo.toml");
    let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    text.parse().unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn dependencies(manifest: &toml::Table, table: &str) -> Vec<String> {
    manifest.get(table).and_then(|t| t.as_table()).map(|t| t.keys().cloned().collect()).unwrap_or_default()
}

#[test]
fn every_crate_of_the_workspace_has_its_arrows_written_down() {
    let root = manifest(".");
    let mut members: Vec<_> =
        root["workspace"]["members"].as_array().unwrap().iter().map(|m| m.as_str().unwrap()).collect();
    let mut known: Vec<_> = ARROWS.iter().map(|(_, folder, _)| *folder).collect();
    members.sort_unstable();
    known.sort_unstable();
    assert_eq!(members, known, "a new crate gets a line in ARROWS and in docs/project/architecture.md");
    for (name, folder, _) in ARROWS {
        assert_eq!(manifest(folder)["package"]["name"].as_str(), Some(name), "{folder}");
    }
}

#[test]
fn dependencies_point_one_way_only() {
    let mut wrong = BTreeMap::new();
    for (name, folder, allowed) in ARROWS {
        let manifest = manifest(folder);
        for table in ["dependencies", "build-dependencies"] {
            let found = dependencies(&manifest, table);
            let ours = found.into_iter().filter(|d| d == "osteoflow" || d.starts_with("osteoflow-"));
            let beyond: Vec<_> = ours.filter(|d| !allowed.contains(&d.as_str())).collect();
            if !beyond.is_empty() {
                wrong.insert(name, beyond);
            }
        }
    }
    assert!(wrong.is_empty(), "arrows that docs/project/architecture.md does not have: {wrong:?}");
}

#[test]
fn algorithms_know_no_engine_no_node_and_no_file() {
    for folder in ["nodes/bone/algorithms", "nodes/bone/geometry", "nodes/bone/statistics"] {
        let found = dependencies(&manifest(folder), "dependencies");
        let beyond: Vec<_> = found.iter().filter(|d| NOT_FOR_ALGORITHMS.contains(&d.as_str())).collect();
        assert!(beyond.is_empty(), "{folder} depends on {beyond:?}");
    }
}

#[test]
fn the_engine_names_no_bone_point_or_frame() {
    let found = dependencies(&manifest("engine"), "dependencies");
    let geometric = ["nalgebra", "kiddo", "wide", "foxglove"];
    let beyond: Vec<_> = found.iter().filter(|d| geometric.contains(&d.as_str())).collect();
    assert!(beyond.is_empty(), "engine depends on {beyond:?}");
}

/// Cargo finds no tests by itself where a crate has one program for all.
#[test]
fn every_file_of_tests_is_part_of_a_program_of_tests() {
    for folder in ARROWS.map(|(_, folder, _)| folder).into_iter().chain(["."]) {
        let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder).join("tests");
        let manifest = manifest(folder);
        let Some(programs) = manifest.get("test").and_then(|tests| tests.as_array()) else { continue };
        let programs = programs.iter().map(|program| program["name"].as_str().unwrap().to_owned());
        let suite = fs::read_to_string(tests.join("suite.rs")).unwrap();
        let modules = suite.lines().filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';').map(str::to_owned));
        let known: BTreeSet<String> = programs.chain(modules).collect();
        for file in fs::read_dir(&tests).unwrap().map(|entry| entry.unwrap().path()) {
            let name = file.file_stem().unwrap().to_str().unwrap();
            let is_known = file.extension().is_none_or(|extension| extension != "rs") || known.contains(name);
            assert!(is_known, "{} never runs: {folder}/tests/suite.rs has no \"mod {name};\"", file.display());
        }
    }
}
