//! Files and folders of a run, refusals to overwrite, switches, Ctrl-C.

use crate::common::{json, osteoflow, osteoflow_to_spawn, root, shared_run};
use serde_json::Value;
use std::{
    fs,
    process::{Command, Stdio},
    thread,
    time::Duration,
};

/// The fastest graph that writes all files.
const GRAPH: &str = "graphs/calibration.toml";

#[test]
fn an_existing_folder_is_refused_and_force_replaces_only_the_files_of_a_run() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("notes.txt"), "mine").unwrap();
    fs::write(dir.path().join("results.json"), "old").unwrap();
    let refused = osteoflow().args(["run", GRAPH, "--out"]).arg(dir.path()).assert().code(2);
    let printed = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(printed.contains("is not empty") && printed.contains("--force"), "{printed}");
    assert_eq!(fs::read_to_string(dir.path().join("results.json")).unwrap(), "old");

    osteoflow().args(["run", GRAPH, "--force", "--no-record", "--out"]).arg(dir.path()).assert().success();
    assert_eq!(fs::read_to_string(dir.path().join("notes.txt")).unwrap(), "mine");
    assert!(json(&dir.path().join("results.json"))["poses"].is_object());
    assert!(!dir.path().join("run.mcap").exists(), "--no-record");
}

#[test]
fn without_out_a_new_folder_is_made_under_runs_in_the_current_folder() {
    let here = tempfile::tempdir().unwrap();
    let graph = root().join(GRAPH);
    for _ in 0..2 {
        osteoflow().current_dir(here.path()).arg("run").arg(&graph).assert().success();
    }
    let runs: Vec<_> = fs::read_dir(here.path().join("runs")).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(runs.len(), 2, "{runs:?}");
    for run in runs {
        assert!(run.file_name().unwrap().to_str().unwrap().starts_with("calibration-2"), "{}", run.display());
        for file in ["results.json", "manifest.json", "run.mcap"] {
            assert!(run.join(file).exists(), "{} in {}", file, run.display());
        }
    }
}

#[test]
fn a_faulty_graph_leaves_no_folder() {
    let here = tempfile::tempdir().unwrap();
    let graph = root().join(GRAPH);
    let assert =
        osteoflow().current_dir(here.path()).arg("run").arg(&graph).args(["--set", "calibration.no_such=1"]).assert();
    assert.code(2);
    assert!(!here.path().join("runs").exists());
}

#[test]
fn json_on_stdout_is_the_results_and_the_outcome_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let output = osteoflow().args(["run", GRAPH, "--format", "json", "--out"]).arg(dir.path()).output().unwrap();
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (answer["outcome"]["status"].as_str(), answer["outcome"]["exit_code"].as_u64()),
        (Some("done"), Some(0))
    );
    let mut results = answer.as_object().unwrap().clone();
    results.remove("outcome");
    assert_eq!(Value::Object(results), json(&dir.path().join("results.json")));

    let faulty =
        osteoflow().args(["run", GRAPH, "--format", "json", "--set", "calibration.no_such=1"]).output().unwrap();
    let answer: Value = serde_json::from_slice(&faulty.stdout).unwrap();
    assert_eq!(answer["outcome"]["status"], "faulty");
    assert_eq!(answer["faults"].as_array().unwrap().len(), 1);
}

#[test]
fn verbose_shows_where_the_time_went_and_what_the_wires_carried_and_quiet_shows_answers_only() {
    let dir = tempfile::tempdir().unwrap();
    let output = osteoflow().args(["run", GRAPH, "-v", "--out"]).arg(dir.path().join("a")).output().unwrap();
    let printed = String::from_utf8(output.stdout).unwrap();
    for words in
        ["share", "p99", "<- slowest", "highest fill", "calibration", "recording.phantom_scan -> calibration.cloud"]
    {
        assert!(printed.contains(words), "{printed}\nlacks {words}");
    }
    let output = osteoflow().args(["run", GRAPH, "--quiet", "--out"]).arg(dir.path().join("b")).output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(printed.contains("SIMULATED") && printed.contains("research use only, not for clinical use"), "{printed}");
}

#[test]
fn a_recorded_run_can_be_replayed_from_its_recording_alone() {
    let recording = shared_run("graphs/fibula_recorded.toml", &[]).path("run.mcap");
    for workers in ["1", "3"] {
        let output =
            osteoflow().args(["replay", "--format", "json", "--workers", workers]).arg(&recording).output().unwrap();
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(output.status.code(), Some(0), "{answer:#}");
        assert_eq!((answer["equal"].as_bool(), answer["results_equal"].as_bool()), (Some(true), Some(true)));
        assert!(answer["wires"].as_array().unwrap().iter().any(|w| w["wire"] == "icp.t_target_source"));
    }
}

#[test]
fn record_writes_the_wires_asked_for_into_one_file() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("wires.mcap");
    let record = |force: &[&str]| {
        osteoflow().args(["record", GRAPH, "--wires", "calibration.*", "--out"]).arg(&file).args(force).assert()
    };
    record(&[]).success();
    let recording = osteoflow_engine::recording::Recording::open(&file).unwrap();
    assert!(recording.wires.contains_key("calibration.t_camera_camera_marker"));
    assert!(recording.wires.contains_key("recording.phantom_scan"), "sources are always recorded");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "nothing else is left beside it");
    record(&[]).code(2);
    record(&["--force"]).success();
    osteoflow().arg("replay").arg(&file).assert().success();
}

#[test]
fn replaying_a_file_that_is_not_a_recording_is_refused() {
    let assert = osteoflow().args(["replay", "graphs/fibula.toml"]).assert().code(1);
    let printed = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    assert!(printed.contains("graphs/fibula.toml"), "{printed}");
}

#[test]
#[cfg(unix)]
fn ctrl_c_stops_in_order_and_leaves_valid_files() {
    let dir = tempfile::tempdir().unwrap();
    let mut child = osteoflow_to_spawn()
        // Half a million points take long enough to be interrupted.
        .args(["run", "graphs/fibula.toml", "--set", "recording.camera.n_points=500000", "--out"])
        .arg(dir.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The recording exists once the run is under way and the handler of Ctrl-C is installed.
    while !dir.path().join("run.mcap").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it could be interrupted");
        thread::sleep(Duration::from_millis(2));
    }
    let signalled = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(signalled.success());
    let output = child.wait_with_output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(130), "{printed}");
    assert!(printed.contains("interrupted"), "{printed}");
    let results = json(&dir.path().join("results.json"));
    assert!(results["refused"]["reason"].as_str().unwrap().contains("interrupted"), "{results}");
    assert!(results.get("poses").is_none());
    assert_eq!(json(&dir.path().join("manifest.json"))["outcome"]["status"], "interrupted");
    let recording = osteoflow_engine::recording::Recording::open(&dir.path().join("run.mcap")).unwrap();
    assert_eq!(recording.truncated, None, "the recording was closed in order");
}
