use super::golden::compare;
use osteoflow_engine::{
    Checked, check, check_recorded, check_text,
    plan::{Plan, Require},
};
use osteoflow_node::Registry;
use osteoflow_toy::stages;
use std::path::Path;

const GRAPH: &str = "tests/graphs/everything.toml";

fn checked(path: &str, sets: &[&str]) -> Checked {
    let sets: Vec<_> = sets.iter().map(|set| set.to_string()).collect();
    check(Path::new(path), &sets, &stages::registry()).unwrap_or_else(|faults| panic!("{faults}"))
}

/// The plan as text, without locations.
fn bare(mut plan: Plan) -> String {
    plan.path = "".into();
    let nowhere = || osteoflow_engine::plan::Location { file: "".into(), line: 0, column: 0 };
    for node in &mut plan.nodes {
        node.location = nowhere();
        node.param_places.clear();
    }
    plan.results.iter_mut().for_each(|result| result.location = nowhere());
    format!("{plan:#?}")
}

#[test]
fn the_resolved_graph_is_checked_again_and_gives_an_equal_plan() {
    for sets in [
        &[][..],
        &["icp.kind=icp.point_to_plane", "remove=[\"node.icp.max_pair_distance_mm\"]", "graph.seed=9"][..],
        &["results.verdict=icp.report", "results.require=trusted"][..],
    ] {
        let plan = checked(GRAPH, sets).plan;
        let again = check_text(&plan.resolved, Path::new("elsewhere.toml"), &[], &stages::registry());
        let again = again.unwrap_or_else(|faults| panic!("{faults}\n{}", plan.resolved));
        assert_eq!(again.plan.resolved, plan.resolved);
        assert_eq!(bare(again.plan), bare(plan));
        assert!(again.warnings.is_empty());
    }
}

#[test]
fn the_resolved_graph_matches_the_golden_text() {
    let plan = checked(GRAPH, &[]).plan;
    compare(&plan.resolved, Path::new("tests/graphs/everything.resolved.txt")).unwrap();
}

#[test]
fn every_setting_is_in_the_resolved_graph_and_is_read_again() {
    let plan = checked("tests/graphs/settings.toml", &[]).plan;
    compare(&plan.resolved, Path::new("tests/graphs/settings.resolved.txt")).unwrap();
    let again = check_text(&plan.resolved, Path::new("elsewhere.toml"), &[], &stages::registry());
    let again = again.unwrap_or_else(|faults| panic!("{faults}")).plan;
    assert_eq!(again.resolved, plan.resolved);
    assert_eq!(bare(again), bare(plan));
}

#[test]
fn nodes_are_in_topological_order_with_ties_in_file_order() {
    let plan = checked(GRAPH, &[]).plan;
    for link in &plan.links {
        assert!(link.from.node < link.to_node, "{} comes after its consumer", plan.wire_name(link.from));
    }
    let names: Vec<_> = plan.nodes.iter().map(|node| &*node.name).collect();
    let expected = ["recording", "camera", "transform", "crop", "ct_surface", "icp", "merge", "follow", "write"];
    assert_eq!(names, expected, "the file names icp and crop before what they need");
}

#[test]
fn a_setting_reaches_any_key() {
    let plan = checked(
        GRAPH,
        &[
            "icp.max_iterations=7",
            "graph.seed=123",
            "node.crop.keep=outside",
            "crop.label=2024",
            "results.extra.fit=icp.report",
            "results.report.optional=true",
            "icp.in.source.capacity=9",
            "icp.in.source=transform.cloud",
            "record.wires=[\"crop.*\"]",
        ],
    );
    let plan = plan.plan;
    let node = |name: &str| plan.nodes.iter().find(|node| &*node.name == name).unwrap();
    assert_eq!(plan.seed, 123);
    assert_eq!(node("icp").params["max_iterations"], 7);
    assert_eq!(node("crop").params["keep"], "outside");
    assert_eq!(node("crop").params["label"], "2024", "a text needs no quotes on the command line");
    let extra = plan.results.iter().find(|result| result.key == "extra.fit").unwrap();
    assert_eq!(plan.wire_name(extra.from), "icp.report");
    assert!(plan.results.iter().find(|result| result.key == "report").unwrap().optional);
    let source = &node("icp").inputs[0];
    let link = &plan.links[source.links[0]];
    assert_eq!((link.capacity, plan.wire_name(link.from).as_str()), (9, "transform.cloud"));
    assert!(plan.record.iter().any(|id| plan.wire_name(*id) == "crop.report"));
    assert!(!plan.record.iter().any(|id| plan.wire_name(*id) == "icp.report"));
}

#[test]
fn what_is_required_of_the_verdict_is_set_like_any_key_and_is_no_result() {
    let require = |sets: &[&str]| {
        let plan = checked(GRAPH, &[&["results.verdict=icp.report"], sets].concat()).plan;
        assert!(plan.results.iter().any(|result| result.key == "verdict"));
        assert!(plan.results.iter().all(|result| result.key != "require"));
        (plan.require, plan.resolved.contains("require = \"trusted\""))
    };
    assert_eq!(require(&[]), (Require::Doubtful, false));
    assert_eq!(require(&["results.require=trusted"]), (Require::Trusted, true));
    assert_eq!(require(&["results.require=trusted", "results.require=doubtful"]), (Require::Doubtful, false));
    assert_eq!(
        require(&["results={ require = \"trusted\", verdict = { from = \"icp.report\" } }"]),
        (Require::Trusted, true)
    );
    assert_eq!(require(&["results.require=trusted", "remove=[\"results.require\"]"]), (Require::Doubtful, false));
}

#[test]
fn a_variant_changes_a_few_lines_of_its_base() {
    let base = checked(GRAPH, &[]).plan;
    let variant = checked("tests/graphs/variants/plane.toml", &[]).plan;
    let icp = |plan: &Plan| plan.nodes.iter().position(|node| &*node.name == "icp").unwrap();
    assert_eq!(variant.nodes[icp(&variant)].kind, "icp.point_to_plane");
    assert_eq!(
        variant.nodes[icp(&variant)].location.file,
        Path::new("tests/graphs/variants/plane.toml"),
        "it chose the kind"
    );
    assert_eq!(variant.nodes.len() + 1, base.nodes.len(), "the camera is removed");
    assert_eq!(variant.name, "plane");
    assert_eq!(variant.seed, base.seed);
    let input = &variant.nodes[icp(&variant)].inputs[0];
    assert_eq!(variant.links[input.links[0]].capacity, 8, "the variant keeps the producer and changes the capacity");
    assert_eq!(variant.input_files, base.input_files, "paths are relative to the file that wrote them");
}

#[test]
fn frames_propagate_along_wires() {
    let plan = checked(GRAPH, &[]).plan;
    let of = |wire: &str| {
        let found = plan.nodes.iter().flat_map(|node| node.outputs.iter().map(move |output| (node, output)));
        let (_, output) = found.into_iter().find(|(n, o)| format!("{}.{}", n.name, o.name) == wire).unwrap();
        output.frames.clone()
    };
    assert_eq!(of("recording.scan").frame.as_deref(), Some("camera"));
    assert_eq!(of("transform.cloud").frame.as_deref(), Some("world"));
    assert_eq!(of("crop.cloud").frame.as_deref(), Some("world"));
    let fit = of("icp.t_target_source");
    assert_eq!((fit.to.as_deref(), fit.from.as_deref()), (Some("ct"), Some("world")));
}

#[test]
fn sources_and_matching_wires_are_recorded() {
    let plan = checked(GRAPH, &[]).plan;
    let names: Vec<_> = plan.record.iter().map(|id| plan.wire_name(*id)).collect();
    for wire in ["recording.scan", "camera.cloud", "ct_surface.target", "icp.report", "icp.t_target_source"] {
        assert!(names.iter().any(|name| name == wire), "{wire} is not in {names:?}");
    }
    assert!(!names.iter().any(|name| name == "crop.cloud"));
}

#[test]
fn a_recorded_graph_needs_no_files() {
    let text = checked(GRAPH, &[]).plan.resolved.replace("surface.txt", "gone.txt");
    assert!(check_text(&text, Path::new("run.toml"), &[], &stages::registry()).is_err());
    check_recorded(&text, Path::new("run.toml"), &[], &stages::registry()).unwrap_or_else(|faults| panic!("{faults}"));
}

#[test]
fn joins_that_may_be_fed_in_time_are_not_warned_of() {
    let warnings = |text: &str, registry: Registry| {
        let checked =
            check_text(&format!("[graph]\nformat = 1\n{text}"), Path::new("tests/broken/x.toml"), &[], &registry);
        let checked = checked.unwrap_or_else(|faults| panic!("{faults}"));
        checked.warnings.iter().map(|warning| warning.to_string()).collect::<Vec<_>>()
    };
    // Each of several outputs of a live source may give a single item.
    let live = "[node.live]\nkind = \"toy.live\"\n\
        out = { p0 = { type = \"toy/Number\", calls = [] }, p1 = { type = \"toy/Number\", calls = [] } }\ncalls = []\n\
        [node.add]\nkind = \"toy.add\"\nin = { a = \"live.p0\", b = { from = \"live.p1\", join = \"once\" } }\n";
    assert_eq!(warnings(live, osteoflow_toy::registry()), [""; 0]);
    let one_of_one = "[node.ct]\nkind = \"acquire.recording\"\npath = \"../data/recording.txt\"\n\
        out = { scan = { type = \"toy/Cloud\", topic = \"/scan\" } }\n\
        [node.first]\nkind = \"crop.box\"\nin = { cloud = { from = \"ct.scan\", join = \"once\" } }\n\
        [node.all]\nkind = \"cloud.merge\"\nin = { clouds = { from = \"first.cloud\", n = 1 } }\n";
    assert_eq!(warnings(one_of_one, stages::registry()), [""; 0]);
}

#[test]
fn the_largest_whole_number_is_read_as_written() {
    let plan = |us: &str| {
        let text = format!(
            "[graph]\nformat = 1\n[node.one]\nkind = \"toy.script\"\n\
             out = {{ p0 = {{ type = \"toy/Number\", calls = [] }} }}\ncalls = []\n\
             [node.add]\nkind = \"toy.add\"\nin = {{ a = \"one.p0\", b = \"one.p0\" }}\nsleep_us = {us}\n"
        );
        check_text(&text, Path::new("x.toml"), &[], &osteoflow_toy::registry()).map(|checked| checked.plan)
    };
    for us in [u64::MAX, i64::MAX as u64, 0] {
        let plan = plan(&us.to_string()).unwrap_or_else(|faults| panic!("{faults}"));
        let add = plan.nodes.iter().find(|node| &*node.name == "add").unwrap();
        assert_eq!(add.params["sleep_us"].as_u64(), Some(us));
    }
    for us in ["-1", "18446744073709551616"] {
        assert!(plan(us).is_err(), "{us}");
    }
}

#[test]
fn json_faults_have_file_line_and_column() {
    let faults = check_text(
        "[graph]\nformat = 1\n[node.a]\nkind = \"icp.point_to_plan\"\n",
        Path::new("graph.toml"),
        &[],
        &stages::registry(),
    );
    let json = faults.unwrap_err().to_json();
    let expected = serde_json::json!([{
        "severity": "error",
        "message": "node \"a\": there is no kind \"icp.point_to_plan\"",
        "file": "graph.toml", "line": 4, "column": 8, "end_line": 4, "end_column": 27,
        "label": "unknown",
        "also": [],
        "notes": ["kinds of icp: icp.point_to_plane, icp.point_to_point"],
        "help": ["did you mean \"icp.point_to_plane\"?"],
    }]);
    assert_eq!(json, expected);
}

#[test]
fn colours_are_for_terminals_only() {
    let faults = check_text("[graph]\nformat = 2\n", Path::new("g.toml"), &[], &stages::registry()).unwrap_err();
    assert!(!faults.to_string().contains('\u{1b}'));
    assert!(faults.render(true).contains('\u{1b}'));
}

#[test]
fn a_missing_graph_file_is_reported_with_the_nearest_name() {
    let faults = check(Path::new("tests/graphs/everythin.toml"), &[], &stages::registry()).unwrap_err();
    let text = faults.to_string();
    assert!(text.contains("there is no graph file tests/graphs/everythin.toml"), "{text}");
    assert!(text.contains("did you mean \"everything.toml\"?"), "{text}");
    let folder = check(Path::new("tests/graphs"), &[], &stages::registry()).unwrap_err().to_string();
    assert!(folder.contains("tests/graphs is a folder; a graph file is needed"), "{folder}");
}

#[test]
fn the_files_that_a_list_names_are_inputs_of_the_run_too() {
    let files = |parameter: &str| {
        let text = format!("[graph]\nformat = 1\n[node.a]\nkind = \"from.listed\"\n{parameter}\n");
        let checked = check_text(&text, Path::new("tests/data/x.toml"), &[], &super::own_nodes::registry());
        checked.unwrap_or_else(|faults| panic!("{faults}")).plan.input_files
    };
    let data = std::path::absolute("tests/data").unwrap();
    let expected = ["of_the_list.txt", "surface.txt"].map(|name| data.join(name));
    assert_eq!(files("list = \"surface.txt\""), expected, "each once, in order");
    assert_eq!(files(""), [""; 0].map(std::path::PathBuf::from), "a source that reads no file has no list");
}

#[test]
fn every_parameter_has_the_place_where_it_is_set() {
    let plan = checked("tests/graphs/variants/plane.toml", &["crop.half_mm[0]=7"]).plan;
    let crop = plan.nodes.iter().find(|node| &*node.name == "crop").unwrap();
    let place = |key: &str| {
        let location = &crop.param_places[key];
        format!("{}:{}", location.file.file_name().unwrap().to_string_lossy(), location.line)
    };
    let text = std::fs::read_to_string(GRAPH).unwrap();
    let line = |start: &str| text.lines().position(|line| line.starts_with(start)).unwrap() + 1;
    assert_eq!(place("region"), format!("everything.toml:{}", line("region")));
    assert_eq!(place("region.from_mm"), format!("everything.toml:{}", line("region")));
    assert_eq!(place("offsets_mm.left side"), format!("everything.toml:{}", line("offsets_mm")));
    assert!(!crop.param_places.contains_key("threshold"), "a default has no place");
}

#[test]
fn the_command_line_may_swap_a_kind_and_add_a_node_whose_name_is_not_near_another() {
    let swap = ["icp.kind=icp.point_to_plane", "remove=[\"node.icp.max_pair_distance_mm\"]"];
    let plan = checked(GRAPH, &swap).plan;
    let icp = plan.nodes.iter().find(|node| &*node.name == "icp").unwrap();
    assert_eq!((icp.kind.as_str(), icp.location.file.as_path()), ("icp.point_to_plane", Path::new(GRAPH)));
    let add = |name: &str, kind: &str| {
        let sets = [format!("{name}.kind={kind}"), format!("{name}.in.cloud=transform.cloud")];
        check(Path::new(GRAPH), &sets, &stages::registry()).map_err(|faults| faults.to_string())
    };
    let added = add("sphere", "crop.sphere").unwrap().plan;
    assert!(added.nodes.iter().any(|node| &*node.name == "sphere"));
    let near = add("crap", "crop.sphere").unwrap_err();
    assert!(near.contains("there is no node \"crap\"") && near.contains("did you mean \"crop\"?"), "{near}");
    let sets = ["sphere.half_mm=[1, 2, 3]".to_owned()];
    let without = check(Path::new(GRAPH), &sets, &stages::registry()).unwrap_err().to_string();
    assert!(without.contains("there is no node \"sphere\""), "{without}");
}
