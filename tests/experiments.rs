//! The ports and kinds of the experiments, in whole graphs.

use crate::common::{Ran, osteoflow, root, run};
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
seed = 46
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

#[test]
fn a_scan_without_a_hole_loses_no_placement_that_is_ruled() {
    let dir = tempfile::tempdir().unwrap();
    for (graph, sets, n_done, n_refused) in [
        (
            "sensitivity",
            vec![
                r#"sweep.factor.registration.values=[{icp.kind="icp.point_to_plane"}]"#,
                r#"sweep.factor.registration.labels=["point_to_plane"]"#,
                r#"remove=["sweep.compare"]"#,
            ],
            1,
            0,
        ),
        // Of two starts, one needs the laser.
        ("point_count", vec!["sweep.factor.n_points.values=[1000]"], 4, 4),
    ] {
        let out = dir.path().join(graph);
        let mut sweep = osteoflow();
        sweep.arg("sweep").arg(root().join(format!("graphs/paper/{graph}.toml"))).arg("--out").arg(&out);
        // The camera sees no spot of this radius, so scans with the laser are refused.
        for set in ["sweep.repeat=1", "recording.laser.hole_radius_mm=0.2", "recording.camera.n_points=4000"] {
            sweep.args(["--set", set]);
        }
        for set in sets {
            sweep.args(["--set", set]);
        }
        let ran = sweep.output().unwrap();
        let runs = std::fs::read_to_string(out.join("runs.csv"));
        let runs = runs.unwrap_or_else(|_| panic!("{graph}: {}", String::from_utf8_lossy(&ran.stderr)));
        let with = |word: &str| runs.lines().filter(|line| line.split(',').any(|cell| cell == word)).count();
        assert_eq!((with("complete"), with("refused")), (n_done, n_refused), "{graph}\n{runs}");
    }
}

/// A run of the graph with the check piece, its camera's marker knocked by `knock_mm`.
fn knocked(knock_mm: f64, more: &[&str]) -> Ran {
    let set = format!("recording.motion.knock_mm={knock_mm}");
    let small = ["--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];
    run(CHECK_PIECE, &[&["--no-record", "--set", &set], &small[..], more].concat())
}

const CHECK_PIECE: &str = "graphs/trust/check_piece.toml";

/// Whether the verdict takes for granted that no marker has moved.
fn assumes_camera_marker(ran: &Ran) -> bool {
    let assumptions = ran.results["verdict"]["assumptions"].as_array().unwrap();
    assumptions.iter().any(|text| text.as_str().unwrap().contains("a marker's shift"))
}

#[test]
fn a_knocked_camera_marker_is_shown_by_a_check_piece_at_the_bone() {
    let mut before = Vec::new();
    for (knock_mm, answer) in [(0.0, "trusted"), (1.0, "doubtful"), (2.0, "doubtful"), (5.0, "refused")] {
        let ran = knocked(knock_mm, &[]);
        let check = ran.results["metrics"]["check"].as_array().unwrap();
        let [calibration, working] = [0, 1].map(|k| number(&check[k]["mean_mm"]));
        let tre_mm = number(&ran.results["metrics"]["tre_true_mm"]["mean_abs"]["norm"]);
        let verdict = &ran.results["verdict"];
        println!("{knock_mm} mm: {}, {working:.2} mm at the piece, {tre_mm:.2} mm at the bone", verdict["answer"]);
        assert_eq!(verdict["answer"], answer, "knocked by {knock_mm} mm: {verdict}");
        assert_eq!(ran.code, if answer == "refused" { 3 } else { 0 }, "{}", ran.stderr);
        let reasons = verdict["reasons"].as_array().unwrap();
        let is_raised = reasons.iter().any(|reason| reason["rule"] == "check_piece" && reason["answer"] == answer);
        assert_eq!(is_raised, knock_mm > 0.0, "{verdict}");
        assert_eq!(assumes_camera_marker(&ran), knock_mm > 0.0, "{verdict}");
        let off_mm = (working - knock_mm).abs().max((tre_mm - knock_mm).abs());
        assert!(off_mm < 0.5, "knocked by {knock_mm} mm: {working} mm at the piece, {tre_mm} mm at the bone");
        before.push(calibration);
    }
    assert!(before.iter().all(|mm| *mm == before[0]), "the piece is read where the phantom stood before the knock");
}

/// A recorded procedure in which no check piece was read.
const NO_PIECE: &str = r#"
extends = "GRAPH"
[graph]
name = "no_piece"
[node.recording]
out.check_camera = { type = "geometry/Points", topic = "/camera/check", labels = ["H1"], frame = "camera", optional = true }
out.check_world = { type = "geometry/Points", topic = "/tracker/check", labels = ["H1"], frame = "world", optional = true }
[node.check]
kind = "metrics.check_points"
in   = { read = "recording.check_camera", known = "recording.check_world", calibration = "calibration.t_camera_camera_marker", t_world_camera_marker = "camera_marker.pose" }
[node.verdict]
in = { check = "check.report" }
"#;

#[test]
fn without_a_reading_of_the_piece_the_verdict_is_given_and_keeps_its_assumption() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("no_piece.toml");
    let graph = root().join("graphs/fibula_recorded.toml");
    std::fs::write(&file, NO_PIECE.replace("GRAPH", graph.to_str().unwrap())).unwrap();
    let ran = run(file.to_str().unwrap(), &["--no-record"]);
    assert_eq!((ran.code, assumes_camera_marker(&ran)), (0, true), "{}", ran.stderr);
}

/// Sweeps the detection curves on one bone, one run of each of these mistakes, and gives the table of its script.
fn curves(mistakes: &str) -> String {
    let dir = tempfile::tempdir().unwrap();
    let sets = [
        format!("sweep.factor.mistake={mistakes}"),
        r#"sweep.factor.bone={ values = [{ recording.bone.shape_seed = 1 }], labels = ["built-in 1"] }"#.to_owned(),
        "sweep.repeat=1".to_owned(),
        "recording.camera.n_points=8000".to_owned(),
    ];
    let out = dir.path().join("curves");
    let mut sweep = osteoflow();
    sweep.args(["sweep", "graphs/trust/curves.toml", "-q", "--out"]).arg(&out);
    sweep.args(sets.iter().flat_map(|set| ["--set", set])).assert().success();
    let mut script = std::process::Command::new("python3");
    let printed = script.arg(root().join("graphs/trust/curves.py")).arg(&out).output().unwrap();
    assert!(printed.status.success(), "{}", String::from_utf8_lossy(&printed.stderr));
    String::from_utf8(printed.stdout).unwrap()
}

#[test]
fn detection_curves_say_from_which_size_an_answer_is_wrong_and_from_which_it_is_told() {
    if std::process::Command::new("python3").arg("--version").output().is_err() {
        println!(
            "skipped: detection_curves_say_from_which_size_an_answer_is_wrong_and_from_which_it_is_told: no python3"
        );
        return;
    }
    let table = curves(
        r#"{ values = [{ bone.ct.offset_mm = 0.0 }, { plan.displaced.across_mm = 0.5 }, { plan.displaced.across_mm = 6.0 },
        { plan.bone.step_mm = 0.1, bone.bone.step_mm = 0.1 }, { plan.bone.step_mm = 4.0, bone.bone.step_mm = 4.0 }],
        labels = ["none", "plan across: 0.5 mm", "plan across: 6 mm", "step: 0.1 mm", "step: 4 mm"] }"#,
    );
    let rows: Vec<Vec<&str>> = table.lines().skip(2).map(|line| line.split('|').map(str::trim).collect()).collect();
    assert_eq!(rows.iter().map(|row| row[1]).collect::<Vec<_>>(), ["none", "plan across", "step"], "{table}");
    assert_eq!((rows[0][3], rows[0][5], rows[0][6]), ("never", "0 of 0", "0: 100, 100"), "{table}");
    for (row, largest_mm) in [(&rows[1], "6 mm"), (&rows[2], "4 mm")] {
        // Beyond the limit of 1.5 mm, or 0.5 degrees; the first size is harmless, the second is told.
        let wrong_from: f64 = row[3].split(' ').next().unwrap().parse().unwrap();
        assert!((0.1..2.0).contains(&wrong_from), "{table}");
        assert_eq!((row[4], row[5]), (largest_mm, "0 of 1"), "{table}");
        assert!(row[6].contains(": 100, 100; "), "{table}");
    }
}
