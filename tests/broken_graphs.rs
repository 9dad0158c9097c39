//! Every broken graph under tests/broken gives its exact text; every shipped graph has no fault. `UPDATE=1` rewrites the
//! texts; read the diff.

use osteoflow_engine::{Faults, RunOptions, check, check_text, run};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// The settings after `# --set ` in the first lines of a graph.
fn sets(text: &str) -> Vec<String> {
    let comments = text.lines().map_while(|line| line.strip_prefix("# "));
    comments.filter_map(|line| line.strip_prefix("--set ")).map(str::to_owned).collect()
}

fn graphs(folder: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap_or_else(|error| panic!("{folder}: {error}"));
    let mut files: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|ext| ext == "toml"));
    files.sort();
    files
}

#[test]
fn every_broken_graph_gives_its_exact_text() {
    let registry = osteoflow_standard::registry();
    let files = graphs("tests/broken");
    assert!(files.len() >= 30, "{} broken graphs, 30 wanted", files.len());
    let mut wrong = String::new();
    for path in &files {
        let text = fs::read_to_string(path).unwrap();
        let found = match check(path, &sets(&text), &registry) {
            Ok(checked) => format!("accepted\n{}\n", Faults(checked.warnings)),
            Err(faults) => format!("{faults}\n"),
        };
        let found = found.replace(env!("CARGO_MANIFEST_DIR"), "$ROOT");
        let golden = path.with_extension("txt");
        if std::env::var_os("UPDATE").is_some() {
            fs::write(&golden, &found).unwrap();
        }
        let expected = fs::read_to_string(&golden).unwrap_or_default();
        if expected != found {
            wrong += &format!("{} holds\n{expected}\nbut found\n{found}\n", golden.display());
        }
        assert!(!found.starts_with("accepted"), "{} is not broken", path.display());
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn every_shipped_graph_and_its_resolved_graph_check_and_build() {
    let registry = osteoflow_standard::registry();
    for path in graphs("graphs").into_iter().chain(graphs("graphs/variants")) {
        let checked = check(&path, &[], &registry).unwrap_or_else(|faults| panic!("{faults}"));
        assert!(checked.warnings.is_empty(), "{}", Faults(checked.warnings));
        // What passes the schema can be deserialized by the node, which is built without opening a file.
        for node in &checked.plan.nodes {
            let kind = registry.kind(&node.kind).unwrap();
            let built = kind.build(&node.params, &osteoflow_node::BuildContext::detached(&node.name));
            assert!(built.is_ok(), "{}: node \"{}\": {:?}", path.display(), node.name, built.err());
        }
        let resolved = checked.plan.resolved;
        let again = check_text(&resolved, Path::new("resolved.toml"), &[], &registry);
        let again = again.unwrap_or_else(|faults| panic!("{}: {faults}", path.display()));
        assert_eq!(again.plan.resolved, resolved, "{} resolves to itself", path.display());
    }
}

#[test]
fn the_columns_of_a_table_are_written_in_a_graph_as_the_page_of_formats_has_them() {
    let page = fs::read_to_string("docs/use/formats.md").unwrap();
    let (_, block) = page.split_once("`columns` of the node").unwrap();
    let (_, block) = block.split_once("```toml\n").unwrap();
    let block = block.split_once("```").unwrap().0.replace("[[tools]]", "[[node.tracker.columns.tools]]");
    let dir = tempfile::tempdir().unwrap();
    let line = |k: u32| format!("{};stylus;{k},5;0;0;1;0;0;0;{}\n", 1000 * (k + 1), if k == 2 { "LOST" } else { "OK" });
    let heading = "timestamp_us;marker;Tx;Ty;Tz;Q0;Qx;Qy;Qz;status\n";
    fs::write(dir.path().join("log.csv"), heading.to_owned() + &(0..4).map(line).collect::<String>()).unwrap();
    let graph = format!(
        "[graph]\nformat = 1\n[node.tracker]\nkind = \"acquire.poses\"\npath = \"log.csv\"\n\
         frames = {{ tracker = \"world\" }}\n[node.tracker.out.stylus]\ntype = \"geometry/Pose\"\nto = \"world\"\nfrom = \"stylus\"\n\
         [node.tracker.columns]\n{block}\n[results]\nposes = {{ from = \"tracker.stylus\", all = true }}\n"
    );
    let registry = osteoflow_standard::registry();
    let checked = check_text(&graph, &dir.path().join("graph.toml"), &[], &registry);
    let plan = checked.unwrap_or_else(|faults| panic!("{faults}")).plan;
    let report = run(&plan, &registry, &RunOptions::default(), &()).unwrap();
    let text = report.results["poses"].to_string();
    assert!(["0.5", "1.5", "3.5"].iter().all(|x| text.contains(x)) && !text.contains("2.5"), "{}", report.results);
}
