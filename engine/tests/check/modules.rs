use osteoflow_engine::{CheckedFile, Faults, check, check_file, check_text, plan::Plan};
use osteoflow_toy::stages;
use std::{fs, path::Path};

const HEAD: &str = r#"
[graph]
format = 1
seed = 7
[node.rec]
kind = "acquire.recording"
path = "../data/recording.txt"
out  = { scan = { type = "toy/Cloud", topic = "/scan", frame = "camera" }, pose = { type = "toy/Pose", topic = "/pose", to = "ct", from = "camera" } }
[node.ct]
kind  = "surface.read"
path  = "../data/surface.txt"
frame = "ct"
"#;

/// The plan of a graph in tests/broken, the folder of the test modules.
fn plan_with(text: &str, sets: &[&str]) -> Result<Plan, Faults> {
    let sets: Vec<_> = sets.iter().map(|set| set.to_string()).collect();
    let path = Path::new("tests/broken/graph.toml");
    Ok(check_text(&format!("{HEAD}{text}"), path, &sets, &stages::registry())?.plan)
}

fn plan(text: &str, sets: &[&str]) -> Plan {
    plan_with(text, sets).unwrap_or_else(|faults| panic!("{faults}"))
}

/// Wires as `from -> to.port`.
fn wires(plan: &Plan) -> Vec<String> {
    let wire = |link: &osteoflow_engine::plan::Link| {
        let to = &plan.nodes[link.to_node];
        format!("{} -> {}.{}", plan.wire_name(link.from), to.name, to.inputs[link.to_port].port.name)
    };
    let mut wires: Vec<_> = plan.links.iter().map(wire).collect();
    wires.sort();
    wires
}

fn params<'p>(plan: &'p Plan, node: &str) -> &'p serde_json::Value {
    &plan.nodes.iter().find(|n| &*n.name == node).unwrap_or_else(|| panic!("no node {node}")).params
}

const FIT: &str = r#"
[node.fit]
kind = "module"
file = "modules/register.toml"
in   = { cloud = "rec.scan", target = "ct.target" }
"#;

#[test]
fn a_module_equals_its_expanded_nodes() {
    let module = plan(&format!("{FIT}[record]\nwires = [\"fit.report\"]\n[results]\npose = \"fit.pose\"\n"), &[]);
    let flat = plan(
        r#"
[node."fit/crop"]
kind   = "crop.box"
in     = { cloud = "rec.scan" }
rounds = [{ n = 2 }, { n = 3 }]
[node."fit/icp"]
kind = "icp.point_to_point"
in   = { source = "fit/crop.cloud", target = "ct.target" }
max_pair_distance_mm = 4.0
[record]
wires = ["fit/icp.report"]
[results]
pose = "fit/icp.t_target_source"
"#,
        &[],
    );
    assert_eq!(module.resolved, flat.resolved);
}

#[test]
fn parameters_of_a_module_reach_its_nodes_and_those_of_a_node_take_precedence() {
    let distance = |plan: &Plan| params(plan, "fit/icp")["max_pair_distance_mm"].as_f64().unwrap();
    assert_eq!(distance(&plan(FIT, &[])), 4.0, "the module's default");
    assert_eq!(distance(&plan(&format!("{FIT}max_pair_distance_mm = 6"), &[])), 6.0);
    assert_eq!(distance(&plan(FIT, &["fit.max_pair_distance_mm=7"])), 7.0);
    assert_eq!(distance(&plan(FIT, &["fit/icp.max_pair_distance_mm=8"])), 8.0);
    assert_eq!(distance(&plan(FIT, &["fit/icp.max_pair_distance_mm=8", "fit.max_pair_distance_mm=7"])), 8.0);
    assert_eq!(distance(&plan(&format!("{FIT}[node.\"fit/icp\"]\nmax_pair_distance_mm = 9"), &[])), 9.0);
}

#[test]
fn lists_of_a_module_are_changed_item_by_item() {
    let rounds = |sets: &[&str]| params(&plan(FIT, sets), "fit/crop")["rounds"].clone();
    let n = |rounds: &serde_json::Value| {
        rounds.as_array().unwrap().iter().map(|round| round["n"].as_u64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(n(&rounds(&[])), [2, 3]);
    assert_eq!(n(&rounds(&["fit/crop.rounds[1].n=5"])), [2, 5]);
    assert_eq!(n(&rounds(&["fit/crop.rounds+={ n = 9 }", "fit/crop.rounds[0]={ n = 1 }"])), [1, 3, 9]);
}

#[test]
fn kinds_are_swapped_and_keys_removed_within_a_module() {
    let swapped = ["fit/icp.kind=icp.point_to_plane", "remove=[\"node.fit/icp.max_pair_distance_mm\"]"];
    // The default of the module's parameter goes to the node, whose new kind does not have it.
    let text = format!("{FIT}\n");
    let faults = plan_with(&text, &swapped).unwrap_err().to_string();
    assert!(faults.contains("icp.point_to_plane has no parameter \"max_pair_distance_mm\""), "{faults}");
    let crop = plan(FIT, &["fit/crop.kind=crop.sphere", "remove=[\"node.fit/crop.rounds\"]"]);
    assert_eq!(params(&crop, "fit/crop")["radius_mm"], 30.0);
}

#[test]
fn modules_nest_and_may_be_used_twice() {
    let plan = plan(
        r#"
[node.one]
kind = "module"
file = "modules/nested.toml"
in   = { cloud = "rec.scan", target = "ct.target" }
gate_mm = 3
[node.two]
kind = "module"
file = "modules/register.toml"
in   = { cloud = { from = "one/fit/crop.cloud", capacity = 9 }, target = "ct.target", init = "one.pose" }
"#,
        &[],
    );
    let expected = [
        "ct.target -> one/fit/icp.target",
        "ct.target -> two/icp.target",
        "one/fit/crop.cloud -> one/fit/icp.source",
        "one/fit/crop.cloud -> two/crop.cloud",
        "one/fit/icp.t_target_source -> two/icp.init",
        "rec.scan -> one/fit/crop.cloud",
        "two/crop.cloud -> two/icp.source",
    ];
    assert_eq!(wires(&plan), expected);
    assert_eq!(params(&plan, "one/fit/icp")["max_pair_distance_mm"], 3.0);
    let node = plan.nodes.iter().find(|node| &*node.name == "one/fit/icp").unwrap();
    assert_eq!(node.location.file, Path::new("tests/broken/modules/register.toml"));
    let into = plan.nodes.iter().find(|node| &*node.name == "two/crop").unwrap().inputs[0].links[0];
    assert_eq!(plan.links[into].capacity, 9, "a setting of a module's input applies to the ports that it feeds");
}

#[test]
fn paths_are_relative_to_the_file_that_contains_them() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("inner")).unwrap();
    let module = "[graph]\nformat = 1\n[module.outputs]\ntarget = \"a.target\"\n[module.params]\nother = \"a.other\"\n\
                  [node.a]\nkind = \"surface.read\"\nframe = \"ct\"\npath = \"here.txt\"\n";
    fs::write(dir.path().join("inner/module.toml"), module).unwrap();
    fs::write(dir.path().join("inner/here.txt"), "").unwrap();
    fs::write(dir.path().join("there.txt"), "").unwrap();
    let graph = dir.path().join("graph.toml");
    let text = "[graph]\nformat = 1\n[node.m]\nkind = \"module\"\nfile = \"inner/module.toml\"\nother = \"there.txt\"\n\
                [results]\na = \"m/a.report\"\n";
    fs::write(&graph, text).unwrap();
    let plan = check(&graph, &[], &stages::registry()).unwrap_or_else(|faults| panic!("{faults}")).plan;
    assert_eq!(plan.input_files, [dir.path().join("inner/here.txt"), dir.path().join("there.txt")]);
}

#[test]
fn a_module_is_checked_alone_and_described() {
    let path = Path::new("tests/broken/modules/nested.toml");
    let CheckedFile::Module(module) = check_file(path, &[], &stages::registry()).unwrap_or_else(|f| panic!("{f}"))
    else {
        panic!("a module")
    };
    let description = serde_json::to_value(&module.description).unwrap();
    let inputs: Vec<_> = module.description.inputs.iter().map(|i| (i.name.as_str(), i.payload, i.joins[0])).collect();
    assert_eq!(inputs, [("cloud", "toy/Cloud", "each"), ("target", "toy/Target", "once")]);
    let output = &module.description.outputs[0];
    assert_eq!((output.name.as_str(), output.payload, output.doc.as_str()), ("pose", "toy/Pose", "The fit."));
    assert!(description["params"][0]["required"].as_bool().unwrap(), "{description}");
    assert!(check(path, &[], &stages::registry()).is_err(), "it is no graph");
}

#[test]
fn a_parameter_of_a_module_has_the_default_of_the_node_that_it_sets() {
    let path = Path::new("tests/broken/modules/register.toml");
    let CheckedFile::Module(module) = check_file(path, &[], &stages::registry()).unwrap_or_else(|f| panic!("{f}"))
    else {
        panic!("a module")
    };
    let defaults: Vec<_> = module.description.params.iter().map(|p| (p.name.as_str(), p.default.clone())).collect();
    let rounds = serde_json::json!([{ "n": 2, "step_mm": 0.5 }, { "n": 3, "step_mm": 0.5 }]);
    assert_eq!(defaults, [("max_pair_distance_mm", Some(4.0.into())), ("rounds", Some(rounds))]);
}

#[test]
fn only_the_graph_may_allow_loss_not_its_modules() {
    let lossy = |source: &str, header: &str| {
        let text = format!(
            "[node.camera]\nkind = \"acquire.camera\"\n[node.fit]\nkind = \"module\"\nfile = \"modules/register.toml\"\n\
             in = {{ cloud = {{ from = \"{source}\", policy = \"drop_old\" }}, target = \"ct.target\" }}\n"
        );
        let text = format!("{HEAD}{text}").replace("seed = 7", header);
        check_text(&text, Path::new("tests/broken/graph.toml"), &[], &stages::registry()).map(|_| ())
    };
    lossy("camera.cloud", "").unwrap_or_else(|faults| panic!("directly after a live source: {faults}"));
    lossy("rec.scan", "lossy = true").unwrap_or_else(|faults| panic!("{faults}"));
    let faults = lossy("rec.scan", "").unwrap_err().to_string();
    assert!(
        faults.contains("node \"fit/crop\": input \"cloud\" may lose items, but \"rec\" is no live source"),
        "{faults}"
    );
}

#[test]
fn the_interface_of_each_module_matches_the_golden_text() {
    let mut all = String::new();
    for name in ["register", "nested", "described"] {
        let path = format!("tests/broken/modules/{name}.toml");
        let CheckedFile::Module(module) =
            check_file(Path::new(&path), &[], &stages::registry()).unwrap_or_else(|faults| panic!("{faults}"))
        else {
            panic!("{name} is a module")
        };
        all += &format!("{}\n", serde_json::to_string_pretty(&module.description).unwrap());
    }
    super::golden::compare(&all, Path::new("tests/check/modules.txt")).unwrap();
}
