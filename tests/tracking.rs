//! Wires in a cycle: the shipped graph that tracks a bone, cycles through modules and Python nodes, lists of wires.

use crate::common::{is_slow_run, json, osteoflow, point, root, run, run_whole};
use serde_json::{Value, json};
use std::{fs, path::Path};

const GRAPH: &str = "graphs/fibula_tracking.toml";
/// A quarter of the points and half of the motion, for time.
const SMALL: [&str; 6] = [
    "--set",
    "stream.camera.n_points=5000",
    "--set",
    "stream.stream={n_scans=22,motion_s=3}",
    "--set",
    "stream.motion.bone_mm=30",
];

fn printed(arguments: &[&str]) -> String {
    let output = osteoflow().args(arguments).output().unwrap();
    let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    assert!(output.status.success(), "{arguments:?}: {text}");
    text
}

/// The largest error of each scan at the assessment points, mm; none where the scan was lost.
fn errors(results: &Value) -> Vec<Option<f64>> {
    let reports = results["tracking"]["tre_true_mm"].as_array().unwrap();
    reports.iter().map(|report| report["max"]["norm"].as_f64()).collect()
}

#[test]
fn every_scan_of_the_moving_bone_is_registered_from_the_one_before() {
    let alone = run_whole(GRAPH, &[&SMALL[..], &["--workers", "1"]].concat());
    let (tracking, errors) = (&alone.results["tracking"], errors(&alone.results));
    let starts: Vec<_> = tracking["starts"].as_array().unwrap().iter().map(|start| &start["starts_from"]).collect();
    assert_eq!((starts.len(), starts[0].as_str()), (22, Some("start")));
    assert!(starts[1..].iter().all(|start| *start == "previous"), "{starts:?}");
    let at = |k: usize| {
        let rows: Vec<Vec<f64>> = serde_json::from_value(tracking["t_ct_world"][k]["matrix"].clone()).unwrap();
        point(&json!([rows[0][3], rows[1][3], rows[2][3]]))
    };
    assert!((at(21) - at(0)).norm() > 5.0, "the bone is moved by 30 mm, and its frame by {}", (at(21) - at(0)).norm());
    // Calibration, tracker and 5,000 points with noise: the landmark fit alone leaves more.
    let worst = errors.iter().map(|error| error.expect("no scan is lost")).fold(0.0, f64::max);
    assert!(worst < 1.5, "{worst} mm at an assessment point; {errors:?}");

    let eight = run_whole(GRAPH, &[&SMALL[..], &["--workers", "8"]].concat());
    assert_eq!(eight.results, alone.results, "one worker and eight");
    let (a, b) = (alone.path("run.mcap"), eight.path("run.mcap"));
    assert!(printed(&["diff", a.to_str().unwrap(), b.to_str().unwrap()]).contains("equal"));
    let replayed =
        printed(&["replay", b.to_str().unwrap(), "--from", "icp", "--out", eight.path("r").to_str().unwrap()]);
    assert!(replayed.contains("6 computed anew, 0 differ"), "{replayed}");
}

#[test]
fn a_scan_after_one_that_is_lost_starts_from_the_last_good_pose_and_says_so() {
    let limit = ["--set", "start.limits.min_pair_share=0.999", "--set", "stream.stream.n_scans=4"];
    let lost = run_whole(GRAPH, &[&SMALL[..2], &limit].concat());
    let starts = lost.results["tracking"]["starts"].as_array().unwrap();
    let from: Vec<_> = starts.iter().map(|start| (&start["starts_from"], &start["n_lost"])).collect();
    let start = json!("start");
    assert_eq!(from, [(&start, &json!(0)), (&start, &json!(1)), (&start, &json!(2)), (&start, &json!(3))]);
    assert!(starts[1]["lost"].as_str().unwrap().ends_with("100 % needed"), "{starts:?}");
    let said = "the pose of the scan before is lost";
    assert_eq!(lost.stderr.matches(said).count(), 1, "once, when it is lost: {}", lost.stderr);

    // One scan is not registered at all.
    let failing = ["--inject", "icp@2=error", "--set", "stream.stream.n_scans=5"];
    let failed = run(GRAPH, &[&SMALL[..2], &failing].concat());
    let starts = failed.results["tracking"]["starts"].as_array().unwrap();
    let from: Vec<_> = starts.iter().map(|start| start["starts_from"].as_str().unwrap()).collect();
    assert_eq!(from, ["start", "previous", "previous", "last_good", "previous"]);
    let found = errors(&failed.results);
    assert_eq!(found.iter().map(Option::is_some).collect::<Vec<_>>(), [true, true, false, true, true], "{found:?}");
}

#[test]
fn a_cycle_is_drawn_dashed_and_leads_back() {
    let mermaid = printed(&["graph", GRAPH, "--as", "mermaid"]);
    assert_eq!(mermaid.matches("-. ").count(), 2, "{mermaid}");
    let dot = printed(&["graph", GRAPH, "--as", "dot"]);
    assert_eq!(dot.matches("style = dashed, constraint = false").count(), 2, "{dot}");
    let svg = printed(&["graph", GRAPH, "--as", "svg"]);
    assert_eq!(svg.matches("class=\"wire back\"").count(), 1, "one curve for both: {svg}");
}

const SOURCES: &str = r#"
[graph]
format = 1
[node.recording]
kind = "acquire.simulated"
camera.n_points = 1000
laser.scans = false
[node.plan]
kind = "plan.simulated"
[node.average]
kind = "transform.still_average"
in   = { pose = "recording.camera_marker" }
"#;

fn write(dir: &Path, name: &str, text: &str) -> String {
    let path = dir.join(name);
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// The cycle of the shipped graph, as a module.
const MODULE: &str = r#"
[graph]
format = 1
name = "track"
[module.inputs]
cloud  = { to = ["start.scan", "icp.source"] }
target = { to = "icp.target" }
first  = { to = "start.start" }
[module.outputs]
t_ct_world = "icp.t_target_source"
icp        = "icp.report"
starts     = "start.report"
[node.start]
kind = "track.last_pose"
in   = { previous = "icp.t_target_source", report = "icp.report" }
[node.icp]
kind = "icp.point_to_plane"
in   = { init = "start.pose" }
on_error = "skip"
"#;

#[test]
fn a_cycle_may_lie_in_a_module_and_is_refused_where_a_setting_breaks_the_step() {
    let dir = tempfile::tempdir().unwrap();
    let module = write(dir.path(), "track.toml", MODULE);
    assert!(printed(&["check", &module]).contains("a module of 2 nodes"));
    let text = format!(
        "extends = {:?}\nremove = [\"node.start\", \"node.icp\"]\n[node.track]\nkind = \"module\"\nfile = \"track.toml\"\n\
         in = {{ cloud = \"to_world_stream.cloud\", target = \"ct_surface.target\", first = \"coarse.t_target_source\" }}\n\
         [node.tre_true]\nin.t_ct_world = \"track.t_ct_world\"\n[record]\nwires = [\"track/*\"]\n[results]\n\
         \"tracking.t_ct_world\" = \"track.t_ct_world\"\n\"tracking.starts\" = \"track.starts\"\n\"tracking.icp\" = \"track.icp\"\n",
        root().join(GRAPH)
    );
    let graph = write(dir.path(), "graph.toml", &text);
    let few = ["--set", "stream.stream.n_scans=3", "--set", "stream.camera.n_points=2000"];
    let (modules, flat) = (run_whole(&graph, &few), run_whole(GRAPH, &few));
    assert_eq!(modules.results["tracking"], flat.results["tracking"]);
    let set = "track/icp.in.init.join=latest";
    let output = osteoflow().args(["check", &graph, "--set", set]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let expected = "node \"track/icp\": input \"init\" is part of a cycle, and joins by latest";
    assert!(output.status.code() == Some(2) && text.contains(expected), "{text}");
}

#[test]
fn several_wires_are_listed_set_expanded_recorded_and_replayed() {
    let dir = tempfile::tempdir().unwrap();
    let text = format!(
        "{SOURCES}[node.all]\nkind = \"cloud.merge\"\nin = {{ clouds = [\"recording.scan\"] }}\n[record]\nwires = [\"all.*\"]\n\
         [results]\ncloud = \"all.cloud\"\n"
    );
    let graph = write(dir.path(), "graph.toml", &text);
    let more = ["--set", "all.in.clouds+=recording.phantom_scan"];
    let expanded = printed(&[&["expand", &graph][..], &more].concat());
    let list = "in.clouds = { from = [\"recording.scan\", \"recording.phantom_scan\"], join = \"collect\"";
    assert!(expanded.contains(list), "{expanded}");
    let out = dir.path().join("run");
    printed(&[&["run", &graph, "--out", out.to_str().unwrap()][..], &more].concat());
    let n_points = |results: &Value| results["cloud"]["n_points"].clone();
    assert_eq!(n_points(&json(&out.join("results.json"))), json!(2000));
    let replayed = printed(&["replay", out.to_str().unwrap(), "--out", dir.path().join("again").to_str().unwrap()]);
    assert!(replayed.contains("0 differ, results equal"), "{replayed}");
    // A variant's list replaces the base's, and keeps its other settings.
    let base = text.replace("[\"recording.scan\"]", "{ from = \"recording.scan\", n = 1 }");
    write(dir.path(), "base.toml", &base);
    let variant = "extends = \"base.toml\"\n[node.all]\nin.clouds = [\"recording.phantom_scan\", \"recording.scan\"]\n";
    let expanded = printed(&["expand", &write(dir.path(), "variant.toml", variant)]);
    let list = "from = [\"recording.phantom_scan\", \"recording.scan\"], join = \"collect\", n = 1";
    assert!(expanded.contains(list), "{expanded}");
    let svg = printed(&["graph", dir.path().join("variant.toml").to_str().unwrap(), "--as", "dot"]);
    assert_eq!(svg.matches(" -> ").count(), 3, "both wires and that of the average: {svg}");
}

#[cfg(unix)]
#[test]
fn a_node_in_python_takes_its_own_last_answer() {
    let plugin = r#"
from typing import Annotated, Optional
from osteoflow_node import *

@node("acme.count", output="out")
def count(pose: Pose, before: Annotated[Optional[Points], port("The last.", join="previous")], ctx: Context) -> Points:
    """Counts."""
    if before is None:
        assert ctx.item == 0 and "nothing before the first firing" in ctx.absent_reason("before"), ctx.absent_reason("before")
        return Points("ct", ["n"], [[1.0, 0, 0]])
    return Points("ct", ["n"], [[before.positions[0][0] + 1, 0, 0]])
"#;
    let graph = format!(
        "plugins = [\"acme.py\"]\n{SOURCES}[node.count]\nkind = \"acme.count\"\nin = {{ pose = \"recording.camera_marker\", \
         before = \"count.out\" }}\n[record]\nwires = [\"count.*\"]\n[results]\nn = \"count.out\"\n"
    );
    let files = [("acme.py", plugin), ("graph.toml", graph.as_str())];
    let Some(folder) = crate::common::python::Folder::new("a Python node in a cycle", &files) else { return };
    let (path, out) = (folder.path("graph.toml"), folder.path("out"));
    let python = ["--python", folder.1.to_str().unwrap()];
    let run = ["run", path.to_str().unwrap(), "--out", out.to_str().unwrap()];
    printed(&[&run[..], &python].concat());
    let results = json(&out.join("results.json"));
    let manifest = json(&out.join("manifest.json"));
    let n_firings =
        manifest["nodes"].as_array().unwrap().iter().find(|node| node["name"] == "count").unwrap()["items"].as_f64();
    assert!(n_firings > Some(20.0), "{manifest}");
    assert_eq!(results["n"][0]["position_mm"][0].as_f64(), n_firings, "{results}");
    let again = folder.path("again");
    let replayed =
        printed(&[&["replay", out.to_str().unwrap(), "--out", again.to_str().unwrap()][..], &python].concat());
    assert!(replayed.contains("results equal"), "{replayed}");
}

#[test]
fn runs_of_a_sweep_share_no_part_of_a_cycle_that_differs() {
    let dir = tempfile::tempdir().unwrap();
    let graph = root().join(GRAPH);
    let sweep = format!(
        "extends = {:?}\n[node.stream]\ncamera.n_points = 1000\nstream = {{ n_scans = 3 }}\n[node.recording]\ncamera.n_points = 5000\n\
         [sweep]\ntwice = 1.0\n[sweep.factor.steps]\nkey = \"icp.max_iterations\"\nvalues = [3, 100]\n[sweep.columns]\n\
         last_mm = \"tracking.tre_true_mm.2.max.norm\"\n",
        graph.to_str().unwrap()
    );
    let path = write(dir.path(), "sweep.toml", &sweep);
    let out = dir.path().join("out");
    let said = printed(&["sweep", &path, "--out", out.to_str().unwrap()]);
    assert!(!said.contains("answered otherwise"), "{said}");
    let table = fs::read_to_string(out.join("runs.csv")).unwrap();
    let at = table.lines().next().unwrap().split(',').position(|name| name == "last_mm").unwrap();
    let values: Vec<_> = table.lines().skip(1).map(|line| line.split(',').nth(at).unwrap().to_owned()).collect();
    assert!(values.len() == 2 && values[0] != values[1], "{table}");
    // The same numbers come out of a run alone.
    let sets = ["--set", "icp.max_iterations=3"];
    let text = sweep.split("[sweep]").next().unwrap();
    let alone = run_whole(&write(dir.path(), "alone.toml", text), &sets);
    assert_eq!(format!("{}", errors(&alone.results)[2].unwrap()), values[0], "{table}");
    if is_slow_run() {
        let eight =
            run_whole(&write(dir.path(), "alone.toml", text), &["--workers", "8", "--set", "icp.max_iterations=3"]);
        assert_eq!(eight.results, alone.results);
    }
}
