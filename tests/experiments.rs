//! The ports and kinds of the experiments, in whole graphs.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

mod common;

use common::{root, run};
use serde_json::Value;

/// Runs a graph that extends graphs/fibula.toml.
fn run_over_fibula(text: &str) -> Value {
    let dir = tempfile::tempdir().unwrap();
    let name = text.lines().find_map(|line| line.strip_prefix("name = ")).unwrap().trim_matches('"');
    let file = dir.path().join(format!("{name}.toml"));
    let graph = root().join("graphs/fibula.toml");
    std::fs::write(&file, text.replace("GRAPH", graph.to_str().unwrap())).unwrap();
    let ran = run(file.to_str().unwrap(), &[]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    ran.results["metrics"].as_object().unwrap();
    ran.results.clone()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

#[test]
fn a_bench_reports_check_points_laser_spots_and_stylus() {
    let results = run_over_fibula(BENCH);
    let check = results["metrics"]["check"].as_array().unwrap();
    let places: Vec<&str> = check.iter().map(|c| c["place"].as_str().unwrap()).collect();
    assert_eq!(places, ["calibration", "working"]);
    for place in check {
        // Reading and print alone give 0.18 mm, the mean of the norm of 0.11 mm per axis.
        let mean = number(&place["mean_mm"]);
        assert!((0.1..0.6).contains(&mean) && place["error"]["n"] == 12, "{place}");
        assert!(number(&place["pose"]["at_point_mm"]) < 0.5);
    }
    let spot = &results["metrics"]["laser_spot"];
    assert!(number(&spot["to_spot"]["rms"]["norm"]) < 0.6, "{spot}");
    assert!(number(&spot["to_mark"]["rms"]["norm"]) < 3.0, "{spot}");
    assert_eq!(spot["to_spot"]["n"], 3);
    assert!(number(&results["stylus"]["tip_sd_mm"]) < 0.05 && results["stylus"]["n_poses"] == 200);
    assert_eq!(results["metrics"]["tre_measured_mm"]["n"], 5);
}

#[test]
fn in_vivo_assessment_marks_are_measured_by_laser_without_localiser_and_stylus() {
    let results = run_over_fibula(IN_VIVO);
    let metrics = &results["metrics"];
    assert_eq!((&metrics["tre_measured_mm"]["n"], &metrics["laser_spot"]["to_spot"]["n"]), (&5.into(), &3.into()));
    assert!(number(&metrics["tre_measured_mm"]["mean_abs"]["norm"]) < 8.0);
}

const BENCH: &str = r#"extends = "GRAPH"
[graph]
name = "bench"
[node.recording]
stylus = { pivot_poses = 200 }
[node.check]
kind = "metrics.check_points"
in   = { read = "recording.check_camera", known = "recording.check_world", calibration = "calibration.t_camera_camera_marker", t_world_camera_marker = "camera_marker.pose", t_camera_camera_marker_true = "recording.t_camera_camera_marker_true" }
[node.laser_spot]
kind = "metrics.laser_spot"
in   = { located = "laser_points.points", spots = "recording.laser_spots_true", marks = "recording.laser_marks_true", t_ct_world_true = "recording.t_ct_world_true", axes = "plan.axes", bone = "bone.mesh" }
[node.stylus]
kind = "calibrate.stylus_pivot"
in   = { pose = "recording.stylus_pivoting" }
[node.touched]
kind = "transform.stylus_tip"
in   = { touched = "recording.stylus_assessment", t_world_stylus_marker = "recording.stylus_marker", tip = "stylus.tip" }
[node.assessment]
in = { points = "touched.points" }
[results]
"metrics.check" = { from = "check.report", all = true }
"metrics.laser_spot" = "laser_spot.report"
stylus = "stylus.report"
"#;

const IN_VIVO: &str = r#"extends = "GRAPH"
remove = ["node.calibration", "node.verdict.in.calibration", "node.verdict.in.t_camera_camera_marker", "node.verdict.in.t_camera_phantom_marker", "node.phantom", "node.phantom_marker", "node.assessment", "node.fre", "results.calibration", "results.poses.t_camera_camera_marker", "results.metrics.fre_mm", "node.bone_marker", "node.to_bone.in.motion", "node.to_bone_laser.in.motion"]
[graph]
name = "sim_vivo"
[node.recording]
tracker = { none = true }
laser = { assessment = true, disc = "beam" }
ruler = { shared_mm = 3.0, each_mm = 0.5 }
periosteum = { thickness_mm = 0.5 }
camera = { n_pools = 3, specular_dropout = 0.7 }
[node.to_bone.in]
t_world_bone_marker = "recording.bone_marker"
[node.to_bone_laser.in]
t_world_bone_marker = "recording.bone_marker"
[node.to_world.in]
calibration = "recording.t_camera_camera_marker_true"
[node.to_world_laser.in]
calibration = "recording.t_camera_camera_marker_true"
[node.to_world_m]
kind = "transform.to_world"
in   = { cloud = "recording.laser_assessment", t_world_camera_marker = "camera_marker.pose", calibration = "recording.t_camera_camera_marker_true" }
[node.to_bone_m]
kind = "transform.to_bone_marker"
in   = { cloud = "to_world_m.cloud", t_world_bone_marker = "recording.bone_marker", tracked = "recording.bone_tracked" }
[node.hole_m]
kind = "hole.cloud_difference"
in   = { reference = "to_bone.cloud", cloud = "to_bone_m.cloud" }
[node.tre_measured]
in = { measured = "hole_m.point" }
[node.laser_spot]
kind = "metrics.laser_spot"
in   = { located = "laser_points.points", spots = "recording.laser_spots_true", marks = "recording.laser_marks_true", t_ct_world_true = "recording.t_ct_world_true", axes = "plan.axes", bone = "bone.mesh" }
[record]
wires = ["icp.*"]
[results]
"metrics.laser_spot" = "laser_spot.report"
"#;
