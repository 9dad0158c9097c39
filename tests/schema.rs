//! The schema for editors matches the nodes, every shipped graph fits it, and faulty graphs do not.

use crate::common::{assert_golden, osteoflow, root, shipped_graphs, shipped_modules};
use jsonschema::Validator;
use serde_json::Value;
use std::fs;

fn schema() -> Value {
    osteoflow_engine::schema::schema(&osteoflow_standard::registry())
}

fn validator() -> Validator {
    jsonschema::draft7::new(&schema()).unwrap()
}

fn graph(text: &str) -> Value {
    serde_json::to_value(text.parse::<toml::Table>().unwrap_or_else(|error| panic!("{error}\n{text}"))).unwrap()
}

#[test]
fn the_schema_beside_the_graphs_is_that_of_the_nodes() {
    let text = serde_json::to_string_pretty(&schema()).unwrap() + "\n";
    assert_golden(&root().join("graphs/osteoflow.schema.json"), &text);
    let printed = osteoflow().arg("schema").assert().success();
    assert_eq!(String::from_utf8(printed.get_output().stdout.clone()).unwrap(), text);
    jsonschema::draft7::meta::validate(&schema()).unwrap();
}

#[test]
fn every_plan_fits_its_schema_and_what_the_reader_refuses_does_not() {
    let text = fs::read_to_string(root().join("graphs/plan.schema.json")).unwrap();
    let printed = osteoflow().args(["schema", "--plan"]).assert().success();
    assert_eq!(String::from_utf8(printed.get_output().stdout.clone()).unwrap(), text);
    let validator = jsonschema::draft7::new(&serde_json::from_str(&text).unwrap()).unwrap();
    let read = |plan: &Value| osteoflow_formats::plan_file::parse_plan("plan.json".as_ref(), &plan.to_string());
    let plans = [
        "tests/data/procedure/plan.json",
        "tests/data/folder/plan.json",
        "../shared/data/recordings/procedure_dev.plan.json",
    ];
    for path in plans.map(|path| root().join(path)).iter().filter(|path| path.is_file()) {
        let plan: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
        let wrong: Vec<_> = validator.iter_errors(&plan).map(|error| error.to_string()).collect();
        assert!(wrong.is_empty() && read(&plan).is_ok(), "{}: {wrong:#?}", path.display());
        // Every key of the schema is one that the reader knows.
        let known = read(&plan).unwrap().notes;
        assert!(known.iter().all(|note| !note.contains("no such keys")), "{known:?}");
    }
    let whole = "tests/data/procedure/plan.json";
    let sound: Value = serde_json::from_str(&fs::read_to_string(root().join(whole)).unwrap()).unwrap();
    let with = |key: &str, value: Value| {
        let mut plan = sound.clone();
        plan[key] = value;
        plan
    };
    let matrix = serde_json::json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]);
    for (key, value) in [
        ("units", "m".into()),
        ("landmarks", serde_json::json!({ "P1": [1, 2] })),
        ("assessment", serde_json::json!([[1, 2, 3]])),
        ("planes", serde_json::json!([matrix])),
        ("proximal", "up".into()),
        ("phantom_marker_in_phantom", matrix),
        ("surface", "bone.stl".into()),
        ("surface", serde_json::json!({ "sha256": "abc" })),
        ("surface", serde_json::json!({ "frame_of_reference_uid": "my CT" })),
        ("surface", serde_json::json!({ "points": [[1, 2, 3]] })),
        ("surface", serde_json::json!({ "hash": "abc" })),
    ] {
        let plan = with(key, value);
        assert!(!validator.is_valid(&plan) && read(&plan).is_err(), "{key}: {}", plan[key]);
    }
    assert!(!validator.is_valid(&serde_json::json!({ "markups": [] })));
}

#[test]
fn every_shipped_graph_names_the_schema_in_its_first_line_and_fits_it() {
    let validator = validator();
    for path in shipped_graphs().into_iter().chain(shipped_modules()) {
        let text = fs::read_to_string(root().join(&path)).unwrap();
        let named =
            text.lines().next().unwrap().strip_prefix("#:schema ").unwrap_or_else(|| panic!("{path} names none"));
        let named = root().join(&path).parent().unwrap().join(named);
        let expected = fs::canonicalize(root().join("graphs/osteoflow.schema.json")).unwrap();
        assert_eq!(fs::canonicalize(&named).unwrap(), expected, "{path}");
        let wrong: Vec<_> = validator.iter_errors(&graph(&text)).map(|error| error.to_string()).collect();
        assert!(wrong.is_empty(), "{path}: {wrong:#?}");
    }
}

#[test]
fn every_expanded_graph_fits_the_schema() {
    let validator = validator();
    let registry = osteoflow_standard::registry();
    for path in shipped_graphs() {
        let plan = osteoflow_engine::check(&root().join(&path), &[], &registry).unwrap().plan;
        let wrong: Vec<_> = validator.iter_errors(&graph(&plan.resolved)).map(|error| error.to_string()).collect();
        assert!(wrong.is_empty(), "{path}: {wrong:#?}");
    }
}

/// A schema sees one file: the kinds that a variant inherits from the extended graph are written into its tables here.
#[test]
fn broken_graphs_whose_kinds_and_parameters_are_wrong_do_not_fit() {
    let validator = validator();
    let registry = osteoflow_standard::registry();
    let base = osteoflow_engine::check(&root().join("graphs/fibula.toml"), &[], &registry).unwrap().plan;
    // Keys of the extended graph, misspelt kinds and parameters that exclude each other cannot be seen.
    let elsewhere = ["parameter_of_the_other_kind", "parameters_missing", "parameters_that_exclude_each_other"];
    let (mut n_seen, mut unseen) = (0, Vec::new());
    for entry in fs::read_dir(root().join("tests/broken")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let meant =
            ["kind_", "parameter", "nested_", "list_", "input_misspelt"].iter().any(|word| name.starts_with(word));
        if path.extension().is_none_or(|ext| ext != "toml") || !meant || elsewhere.contains(&name.as_str()) {
            continue;
        }
        let mut value = graph(&fs::read_to_string(&path).unwrap());
        for (node, table) in value["node"].as_object_mut().unwrap() {
            let known = base.nodes.iter().find(|known| *known.name == **node);
            let table = table.as_object_mut().unwrap();
            table.entry("kind").or_insert_with(|| known.map_or(Value::Null, |known| known.kind.clone().into()));
        }
        n_seen += 1;
        if validator.is_valid(&value) {
            unseen.push(name);
        }
    }
    assert!(n_seen >= 10, "only {n_seen} broken graphs looked at");
    assert!(unseen.is_empty(), "{unseen:?} fit the schema");
}

#[test]
fn a_verdict_is_one_wire_and_require_one_of_two_words() {
    let validator = validator();
    for (results, fits) in [
        ("verdict = \"a.b\"\nrequire = \"trusted\"", true),
        ("verdict = { from = \"a.b\" }\nrequire = \"doubtful\"", true),
        ("require = \"a.b\"", false),
        ("verdict = { from = \"a.b\", all = true }", false),
        ("verdict = { from = \"a.b\", optional = true }", false),
        ("other = { from = \"a.b\", optional = true }", true),
    ] {
        let text = format!("[graph]\nformat = 1\n[results]\n{results}\n");
        assert_eq!(validator.is_valid(&graph(&text)), fits, "{results}");
    }
}

#[test]
fn the_example_of_every_kind_fits_its_own_schema() {
    let registry = osteoflow_standard::registry();
    for kind in registry.kinds() {
        let description = &kind.description;
        let schema = osteoflow_engine::schema::kind_schema(&registry, description.kind).unwrap();
        let validator = jsonschema::draft7::new(&schema).unwrap();
        let wrong: Vec<_> = validator.iter_errors(&graph(description.example)).map(|e| e.to_string()).collect();
        assert!(wrong.is_empty(), "{}: {wrong:#?}", description.kind);
    }
}

#[test]
fn an_unknown_kind_is_refused_with_the_nearest_name() {
    let output = osteoflow().args(["schema", "--kind", "icp.point_to_plan"]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(text.contains("did you mean \"icp.point_to_plane\"?"), "{text}");
}
