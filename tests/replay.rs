//! Recordings: a run is repeated from its recording alone, in part or with changes, and a kill leaves it readable.

use crate::common::{
    build, copied_run, is_slow_run, json, osteoflow, osteoflow_to_spawn, program, root, run, run_whole, shared_run,
};
use osteoflow_engine::{Recording, hash::Digest};
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::Duration,
};

const RECORDED: &str = "graphs/fibula_recorded.toml";
/// The fastest graph that writes all files.
const QUICK: &str = "graphs/calibration.toml";

/// The exit code, stdout as JSON and stderr of a replay.
fn replay(recording: &Path, arguments: &[&str]) -> (i32, Value, String) {
    let output = osteoflow().args(["replay", "--format", "json"]).arg(recording).args(arguments).output().unwrap();
    let answer = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code().unwrap(), answer, String::from_utf8_lossy(&output.stderr).into_owned())
}

fn digest(recording: &Path) -> Digest {
    let report = osteoflow_engine::recording::digest::digest(recording, &mut |_, _| {}).unwrap();
    assert_eq!(report.incomplete, None, "{}", recording.display());
    report.digest.unwrap()
}

fn part_of(answer: &Value, wire: &str) -> (String, Value) {
    let wires = answer["wires"].as_array().unwrap();
    let found = wires.iter().find(|w| w["wire"] == wire).unwrap_or_else(|| panic!("no {wire} in {answer:#}"));
    (found["part"].as_str().unwrap().to_owned(), found["first_difference"].clone())
}

/// The recording of a run of the recorded procedure, and an empty folder.
fn recorded() -> (tempfile::TempDir, PathBuf) {
    (tempfile::tempdir().unwrap(), shared_run(RECORDED, &[]).path("run.mcap"))
}

#[test]
fn shuffled_runs_on_any_number_of_workers_give_one_digest_and_replay_exactly() {
    // Settings of a procedure that takes less time.
    let small = ["--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];
    for (graph, n_runs) in [("graphs/fibula.toml", 2), (RECORDED, 2)] {
        let small = if graph == RECORDED || is_slow_run() { &[][..] } else { &small };
        let n_runs = if is_slow_run() { 1000 } else { n_runs };
        let mut first = None;
        for seed in 0..n_runs {
            let (seed, workers) = (seed.to_string(), ["8", "1", "2"][seed % 3]);
            let ran = run_whole(graph, &[&["--workers", workers, "--shuffle", &seed], small].concat());
            let recording = ran.dir.path().join("run.mcap");
            let found = digest(&recording);
            let first = *first.get_or_insert(found);
            assert_eq!(found, first, "{graph}, {workers} workers, shuffled with {seed}");
            // Every tenth is replayed.
            if !seed.ends_with('0') {
                continue;
            }
            let again = ran.dir.path().join("again");
            let (code, answer, printed) = replay(&recording, &["--out", again.to_str().unwrap()]);
            assert_eq!((code, answer["equal"].as_bool()), (0, Some(true)), "{printed}{answer:#}");
            assert_eq!(digest(&again.join("run.mcap")), first, "the replay's recording is the run's");
            assert_eq!(json(&again.join("results.json")), ran.results);
        }
    }
}

#[test]
fn one_changed_parameter_diverges_first_at_its_node_and_nowhere_upstream() {
    let (_, recording) = recorded();
    let (code, answer, printed) = replay(&recording, &["--set", "icp.max_pair_distance_mm=1"]);
    assert_eq!(code, 4, "{printed}");
    let first = &answer["first_divergence"];
    assert!(first["wire"].as_str().unwrap().starts_with("icp.") && first["item"] == 0, "{first}");
    let what = &first["what"];
    assert!(
        what["field"].as_str().unwrap().starts_with("isometry") && what["distance"].as_f64().unwrap() > 0.0,
        "{what}"
    );
    for wire in ["to_bone.cloud", "hole.point", "coarse.t_target_source", "calibration.t_camera_camera_marker"] {
        assert_eq!(part_of(&answer, wire), ("computed".into(), Value::Null), "{wire} is upstream");
    }
    assert!(part_of(&answer, "planes_at_scan.planes").1.is_object(), "what follows differs too");
    assert_eq!(part_of(&answer, "recording.scan").0, "played");

    // Another method instead of the first.
    let (code, answer, printed) = replay(&recording, &["--set", "icp.kind=icp.point_to_point"]);
    assert_eq!(code, 4, "{printed}");
    assert!(answer["first_divergence"]["wire"].as_str().unwrap().starts_with("icp."), "{}", answer["first_divergence"]);
}

#[test]
fn a_kind_of_ones_own_takes_the_place_of_a_recorded_one_and_what_has_another_payload_is_not_comparable() {
    let (dir, recording) = recorded();
    let library = build::example("template_icp").display().to_string();
    let own = ["--plugin", library.as_str(), "--set", "icp.kind=my_plugin.point_to_point"];
    let (code, answer, printed) = replay(&recording, &own);
    assert_eq!((code, &answer["equal"]), (4, &Value::Bool(false)), "{printed}");
    let wires = answer["wires"].as_array().unwrap();
    let not_comparable: Vec<_> = wires.iter().filter(|wire| wire["not_comparable"].is_string()).collect();
    assert_eq!(not_comparable.len(), 1, "{not_comparable:?}");
    let (wire, why) = (&not_comparable[0]["wire"], not_comparable[0]["not_comparable"].as_str().unwrap());
    assert!(wire == "icp.report" && why == "report/Icp was recorded, report/Json is given now", "{wire}: {why}");
    assert_eq!(part_of(&answer, "icp.report"), ("computed".into(), Value::Null));
    assert_eq!(answer["first_divergence"]["wire"], "icp.t_target_source", "{}", answer["first_divergence"]);
    assert_eq!(part_of(&answer, "to_bone.cloud"), ("computed".into(), Value::Null), "what is upstream is as it was");
    assert!(answer["results"]["verdict"]["answer"].is_string(), "what follows reads the report of any kind");

    // Defaults of the old kind are gone; what was written for it is a fault of the new one.
    let written = run_whole(RECORDED, &["--set", "icp.trim_fraction=0.1"]);
    let (code, _, printed) = replay(&written.dir.path().join("run.mcap"), &own);
    assert!(code == 2 && printed.contains("\"trim_fraction\"") && printed.contains("1 error"), "{printed}");

    // From the node on, and by a graph.
    let (code, answer, printed) = replay(&recording, &[&own[..], &["--from", "icp"]].concat());
    assert_eq!((code, part_of(&answer, "to_bone.cloud").0), (4, "played".into()), "{printed}");
    let graph = dir.path().join("own.toml");
    let base = root().join(RECORDED);
    let text =
        format!("extends = {base:?}\nplugins = [{library:?}]\n[node.icp]\nkind = \"my_plugin.point_to_point\"\n");
    fs::write(&graph, text).unwrap();
    let (code, answer, printed) = replay(&recording, &["--graph", graph.to_str().unwrap(), "--from", "icp"]);
    assert_eq!((code, part_of(&answer, "icp.report").0), (4, "computed".into()), "{printed}");
}

#[test]
fn from_a_node_on_only_what_follows_is_computed_and_the_rest_is_played() {
    let (dir, recording) = recorded();
    let again = dir.path().join("again");
    let (code, answer, printed) = replay(&recording, &["--from", "icp", "--out", again.to_str().unwrap()]);
    assert_eq!((code, answer["equal"].as_bool()), (0, Some(true)), "{printed}{answer:#}");
    for (wire, part) in [
        ("to_bone.cloud", "played"),
        ("hole.point", "played"),
        ("icp.t_target_source", "computed"),
        ("planes.planes", "computed"),
    ] {
        assert_eq!(part_of(&answer, wire).0, part, "{wire}");
    }
    // The outputs of these are not recorded: they are computed from recorded inputs, and reported.
    assert_eq!(answer["computed_too"], serde_json::json!(["bone_marker", "ct_surface", "assessment"]));
    assert_eq!(digest(&again.join("run.mcap")), digest(&recording), "its recording holds all that was recorded");
    let (code, ..) = replay(&again.join("run.mcap"), &[]);
    assert_eq!(code, 0, "and can itself be replayed whole");

    let (code, answer, _) = replay(&recording, &["--from", "icp", "--set", "icp.max_pair_distance_mm=1"]);
    assert_eq!((code, answer["first_divergence"]["item"].as_u64()), (4, Some(0)));
    for (arguments, words) in [
        (["--from", "icq"].as_slice(), "no node \"icq\""),
        (&["--from", "icp", "--set", "hole.min_confidence=0.3"], "changes nothing"),
        (&["--set", "recording.path=x"], "changes nothing"),
        (&["--set", "icp.no_such=3"], "no_such"),
        (&["--rate", "0"], "above 0"),
        (&["--start", "soon"], "seconds after the first stamp"),
    ] {
        let (code, _, printed) = replay(&recording, arguments);
        assert!(code == 2 && printed.contains(words), "{arguments:?}: {code}: {printed}");
    }
}

#[test]
fn recorded_streams_play_into_another_graph_that_has_their_wires() {
    let (dir, recording) = recorded();
    let other = "graphs/variants/fibula_recorded_point_to_point.toml";
    let (code, answer, printed) = replay(&recording, &["--graph", other]);
    assert_eq!(code, 4, "{printed}");
    assert!(answer["first_divergence"]["wire"].as_str().unwrap().starts_with("icp."), "{}", answer["first_divergence"]);
    let straight = run_whole(other, &["--no-record"]);
    assert_eq!(answer["results"]["poses"], straight.results["poses"], "as if it had run on the file itself");

    let foreign = dir.path().join("foreign.toml");
    fs::write(
        &foreign,
        "[graph]\nformat = 1\n[node.other]\nkind = \"surface.simulated\"\n[results]\nmesh = \"other.mesh\"\n",
    )
    .unwrap();
    let (code, _, printed) = replay(&recording, &["--graph", foreign.to_str().unwrap()]);
    assert!(code == 2 && printed.contains("no recorded wire") && printed.contains("recording.scan"), "{printed}");
}

#[test]
fn the_rate_changes_no_result_and_a_part_of_a_recording_is_played_and_not_compared() {
    let (_, recording) = recorded();
    // Fifty seconds in a quarter of a second.
    let (code, answer, printed) = replay(&recording, &["--rate", "200", "--workers", "1"]);
    assert_eq!((code, answer["equal"].as_bool()), (0, Some(true)), "{printed}");

    let first = Recording::open(&recording).unwrap().wires["recording.bone_marker"].messages.len() as u64;
    let (_, answer, printed) = replay(&recording, &["--end", "20"]);
    assert!(answer["not_compared"].as_str().unwrap().contains("part"), "{answer:#}");
    let played = |answer: &Value| {
        let wires = answer["wires"].as_array().unwrap();
        wires.iter().find(|w| w["wire"] == "recording.bone_marker").unwrap()["replayed"].as_u64().unwrap()
    };
    assert!(played(&answer) > 0 && played(&answer) < first, "{} of {first}: {printed}", played(&answer));
    let (_, later, _) = replay(&recording, &["--start", "20.000000001"]);
    assert_eq!(played(&answer) + played(&later), first, "every item is before or after");
    let mesh = later["wires"].as_array().unwrap().iter().find(|w| w["wire"] == "bone.mesh").unwrap();
    assert_eq!(mesh["replayed"], 1, "a constant is always played");
}

#[test]
fn a_range_plays_the_calibration_and_the_registration_that_do_not_change_and_computes_what_moves() {
    let (_, recording) = recorded();
    // The range of docs/use/recording.md ends before the third laser scan, and the later one begins after all of them.
    for range in [&["--start", "10", "--end", "20.5"][..], &["--start", "15"]] {
        let (code, answer, printed) = replay(&recording, range);
        assert_eq!(code, 0, "{range:?}: {printed}");
        for (wire, part) in [
            ("calibration.t_camera_camera_marker", "played"),
            ("icp.t_target_source", "played"),
            ("planes.planes", "computed"),
        ] {
            assert_eq!(part_of(&answer, wire).0, part, "{range:?}: {wire}");
        }
        assert_eq!(answer["results"]["planes_at_scan"].as_array().unwrap().len(), 2, "{range:?}: the planes are known");
    }
    // What is not compared is not called equal.
    let output = osteoflow().arg("replay").arg(&recording).args(["--start", "15"]).output().unwrap();
    let printed = String::from_utf8(output.stdout).unwrap();
    let line = printed.lines().find(|line| line.contains("planes.planes")).unwrap();
    assert!(line.ends_with("not compared") && !printed.contains("equal"), "{printed}");
    // What a setting changes is computed, and what follows it.
    let (code, answer, printed) = replay(&recording, &["--start", "15", "--set", "icp.max_pair_distance_mm=3"]);
    assert_eq!(code, 0, "{printed}");
    assert_eq!(part_of(&answer, "coarse.t_target_source").0, "played");
    for wire in ["icp.t_target_source", "planes_at_scan.planes", "verdict.verdict"] {
        assert_eq!(part_of(&answer, wire).0, "computed", "{wire}");
    }
}

#[test]
fn files_that_a_procedure_names_outside_of_its_folder_are_in_the_manifest_and_may_not_change() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("folder");
    fs::create_dir(&folder).unwrap();
    let shipped = root().join("tests/data/folder");
    for entry in fs::read_dir(&shipped).unwrap() {
        let name = entry.unwrap().file_name();
        fs::copy(shipped.join(&name), folder.join(&name)).unwrap();
    }
    let scan = dir.path().join("scan.ply");
    fs::rename(folder.join("scan.ply"), &scan).unwrap();
    let procedure = fs::read_to_string(folder.join("procedure.toml")).unwrap();
    fs::write(folder.join("procedure.toml"), procedure.replace("\"scan.ply\"", "\"../scan.ply\"")).unwrap();
    let set = format!("recording.path={}", folder.display());
    let ran = run_whole("graphs/fibula_folder.toml", &["--set", &set, "--set", "record.sources=hash"]);
    let manifest = json(&ran.dir.path().join("manifest.json"));
    let paths: Vec<_> = manifest["inputs"].as_array().unwrap().iter().map(|input| input["path"].clone()).collect();
    assert!(paths.contains(&scan.display().to_string().into()), "{paths:#?}");
    assert!(paths.iter().all(|path| paths.iter().filter(|other| *other == path).count() == 1), "{paths:#?}");

    let recording = ran.dir.path().join("run.mcap");
    assert_eq!(replay(&recording, &[]).0, 0);
    let mut bytes = fs::read(&scan).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(&scan, bytes).unwrap();
    let (code, _, printed) = replay(&recording, &[]);
    assert!(code == 1 && printed.contains("scan.ply is not the file that the run had read"), "{printed}");
}

#[test]
fn a_run_is_named_by_its_folder_or_by_its_recording() {
    let (_dir, folder) = copied_run(RECORDED, &[]);
    let (folder, recording) = (folder.as_path(), folder.join("run.mcap"));
    assert_eq!(replay(folder, &[]).0, 0);
    let output = |arguments: &[&Path], command: &str| {
        let output = osteoflow().arg(command).args(arguments).output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.code().unwrap(), String::from_utf8(text).unwrap())
    };
    for command in ["digest", "validate"] {
        assert_eq!(output(&[folder], command).1, output(&[&recording], command).1);
    }
    assert_eq!(output(&[folder, &recording], "diff").0, 0);
    let (code, text) = output(&[&recording], "report");
    assert!(code == 0 && folder.join("report.html").is_file(), "{text}");
    fs::remove_file(&recording).unwrap();
    let (code, text) = output(&[folder], "digest");
    assert!(code == 2 && text.contains("this run was not recorded (--no-record)"), "{code}: {text}");
    let (code, text) = output(&[&root().join("docs")], "replay");
    assert!(code == 2 && text.contains("name the folder of a run, or a recording"), "{code}: {text}");
}

#[test]
fn sources_named_by_hash_are_read_again_and_only_if_they_are_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let copy = dir.path().join("bone.stl");
    fs::copy(root().join("tests/data/procedure/bone.stl"), &copy).unwrap();
    let set = format!("bone.path={}", copy.display());
    let ran = run_whole(RECORDED, &["--set", "record.sources=hash", "--set", &set]);
    let recording = ran.dir.path().join("run.mcap");
    let whole = recorded();
    let size = |path: &Path| fs::metadata(path).unwrap().len();
    assert!(size(&recording) < size(&whole.1) / 2, "{} bytes where the scans are not in it", size(&recording));
    let (code, answer, printed) = replay(&recording, &[]);
    assert_eq!((code, answer["equal"].as_bool()), (0, Some(true)), "{printed}{answer:#}");

    let mut bytes = fs::read(&copy).unwrap();
    bytes[200] ^= 1;
    fs::write(&copy, &bytes).unwrap();
    let (code, _, printed) = replay(&recording, &[]);
    assert!(
        code == 1 && printed.contains("bone.stl") && printed.contains("expected") && printed.contains("found"),
        "{printed}"
    );
    fs::remove_file(&copy).unwrap();
    let (code, _, printed) = replay(&recording, &[]);
    assert!(code == 1 && printed.contains("bone.stl"), "{printed}");
    let moved = format!("bone.path={}", root().join("tests/data/procedure/bone.stl").display());
    let (code, _, printed) = replay(&recording, &["--set", &moved]);
    assert_eq!(code, 0, "a file that has moved is known by its hash: {printed}");

    // Simulated inputs are simulated again.
    let ran = run_whole(QUICK, &["--set", "record.sources=hash"]);
    let (code, answer, printed) = replay(&ran.dir.path().join("run.mcap"), &[]);
    assert_eq!((code, answer["equal"].as_bool()), (0, Some(true)), "{printed}");
}

#[test]
fn a_refused_run_replays_to_the_same_refusal() {
    // No hole reaches this confidence.
    let ran = run(RECORDED, &["--set", "hole.min_confidence=1", "--set", "hole.min_confidence_agreeing=1"]);
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    let recording = ran.dir.path().join("run.mcap");
    let (code, answer, printed) = replay(&recording, &[]);
    assert_eq!(
        (code, answer["equal"].as_bool(), answer["results_equal"].as_bool()),
        (3, Some(true), Some(true)),
        "{printed}"
    );
    assert_eq!(answer["results"]["refused"], ran.results["refused"]);
    let (code, answer, _) = replay(&recording, &["--set", "hole.min_confidence=0.4"]);
    assert_eq!(code, 4, "it is not refused any more: {answer:#}");
    assert!(answer["first_divergence"]["wire"].as_str().unwrap().starts_with("hole."));
}

#[test]
fn a_recording_contains_its_provenance() {
    let ran = run_whole(QUICK, &["--set", "record.compression=none", "--set", "record.views=false"]);
    let bytes = fs::read(ran.dir.path().join("run.mcap")).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    for words in ["git_revision", "rustc ", "target_features", "cpu_features", "osteoflow.plugins", "osteoflow.inputs"]
    {
        assert!(text.contains(words), "{words}");
    }
    assert!(text.contains("/run/timing") && !text.contains("/view/"), "pictures were switched off");
    let manifest = json(&ran.dir.path().join("manifest.json"));
    assert_eq!(manifest["recording"]["compression"], "none");
    assert!(manifest["command"]["compiler"].as_str().unwrap().starts_with("rustc"));
    assert!(manifest["command"].get("git_revision").is_some());
    let level = manifest["command"]["opt_level"].as_str().unwrap();
    assert_eq!(level, if cfg!(debug_assertions) { level } else { "3" }, "that of the crates that compute");
}

/// A run that is killed after this time; its recording, if it exists by then.
#[cfg(unix)]
fn killed(dir: &Path, after: Duration) -> Option<PathBuf> {
    let mut child = osteoflow_to_spawn()
        .args(["run", RECORDED, "--force", "--set", "record.wires=[\"*\"]", "--out"])
        .arg(dir)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(after);
    child.kill().unwrap();
    child.wait().unwrap();
    Some(dir.join("run.mcap")).filter(|path| path.exists())
}

/// Checks that `recover` writes a file that `validate` accepts.
#[cfg(unix)]
fn assert_recovered(killed: &Path, recovered: &Path) {
    for (command, files) in [("recover", &[killed, recovered][..]), ("validate", &[recovered])] {
        let ran = osteoflow_to_spawn().arg(command).args(files).output().unwrap();
        assert!(ran.status.success(), "{command}: {}", String::from_utf8_lossy(&ran.stderr));
    }
    fs::remove_file(recovered).unwrap();
}

#[test]
#[cfg(unix)]
fn a_kill_at_any_instant_leaves_a_recording_that_is_read_and_replayed_up_to_its_last_chunk() {
    let n_kills: u64 = if is_slow_run() { 1000 } else { 6 };
    let dir = tempfile::tempdir().unwrap();
    let (mut n_read, mut n_items) = (0, 0);
    for kill in 0..n_kills {
        // Spread over a run's second and a half, in steps that do not repeat.
        let after = Duration::from_micros(kill * 1_618_033 % 1_500_000);
        let Some(path) = killed(dir.path(), after) else { continue };
        match Recording::open(&path) {
            Ok(recording) => {
                n_read += 1;
                n_items += recording.wires.values().map(|wire| wire.messages.len()).sum::<usize>();
                assert!(!recording.run.graph.is_empty(), "the graph stands at the front");
                if kill % 4 == 3 {
                    assert_recovered(&path, &dir.path().join("recovered.mcap"));
                }
                if recording.wires.is_empty() || kill % 4 != 1 {
                    continue;
                }
                let (code, answer, printed) = replay(&path, &[]);
                assert!(
                    answer["wires"]
                        .as_array()
                        .is_some_and(|wires| wires.iter().all(|w| w["first_difference"].is_null())),
                    "killed after {after:?}: {code}: {printed}{answer:#}"
                );
            }
            Err(error) => {
                let printed = error.to_string();
                assert!(printed.contains("is no recording of a run"), "killed after {after:?}: {printed}");
            }
        }
    }
    let counted = format!("{n_kills} runs killed: {n_read} recordings read, with {n_items} items");
    println!("{counted}");
    assert!(n_read > 0 && n_items > 0, "{counted}");
}

#[test]
#[cfg(unix)]
fn a_disk_that_is_full_ends_the_run_with_the_file_named_and_leaves_the_rest_whole() {
    let dir = tempfile::tempdir().unwrap();
    // The largest file that this shell's children may write has 200 blocks of 1 KiB; the recording needs more.
    let script = format!(
        "trap '' XFSZ; ulimit -f 200; OSTEOFLOW_CACHE=off exec {} run {RECORDED} --set record.compression=none --out {}",
        program().display(),
        dir.path().display()
    );
    let output = Command::new("bash").current_dir(root()).args(["-c", &script]).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert!(printed.contains("run.mcap") && printed.contains("cannot write"), "{printed}");
    let results = json(&dir.path().join("results.json"));
    let manifest = json(&dir.path().join("manifest.json"));
    assert!(manifest["recording"]["error"].as_str().unwrap().contains("run.mcap"), "{}", manifest["recording"]);
    assert!(results["refused"]["reason"].as_str().is_none_or(|reason| reason.contains("run.mcap")), "{results}");
    let recording = Recording::open(&dir.path().join("run.mcap")).unwrap();
    assert!(recording.truncated.is_some() && !recording.wires.is_empty());
}
