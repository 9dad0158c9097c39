//! The store of cached answers: cold and warm runs are the same to the last bit.

use crate::common::{is_slow_run, json, osteoflow, osteoflow_to_spawn, program, root};
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

const GRAPH: &str = "graphs/fibula.toml";
/// Runs it with a smaller scan of an exact surface, whose nodes take less time; the surface that is kept is as large.
const RUN: [&str; 6] = ["run", GRAPH, "--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];

/// The output of a run without times and places.
#[derive(Debug, PartialEq)]
struct Left {
    results: String,
    digest: String,
}

/// A run with its store in `cache`.
struct Ran {
    left: Left,
    /// The nodes whose answers came from the store.
    recalled: Vec<String>,
    store: Value,
    stderr: String,
}

fn run(cache: &Path, arguments: &[&str]) -> Ran {
    let dir = tempfile::tempdir().unwrap();
    let mut command = osteoflow();
    command.env("OSTEOFLOW_CACHE", cache).args(RUN).args(["--quiet", "--out"]).arg(dir.path()).args(arguments);
    let output = command.output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    let store = json(&dir.path().join("manifest.json"))["store"].clone();
    let recalled = store["recalled"].as_array().cloned().unwrap_or_default();
    let recalled = recalled.iter().map(|r| format!("{}@{}", r["node"].as_str().unwrap(), r["item"])).collect();
    Ran { left: left(dir.path()), recalled, store, stderr }
}

fn left(dir: &Path) -> Left {
    let output = osteoflow().args(["digest", "--format", "json"]).arg(dir.join("run.mcap")).output().unwrap();
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    Left {
        results: fs::read_to_string(dir.join("results.json")).unwrap(),
        digest: answer["files"][0]["digest"].as_str().unwrap().to_owned(),
    }
}

/// The entries of cached answers, largest last.
fn answers(cache: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(cache).unwrap().map(|file| file.unwrap().path());
    let is_answer = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().starts_with("answer-");
    let mut answers: Vec<_> = files.filter(is_answer).collect();
    answers.sort_by_key(|path| path.metadata().unwrap().len());
    answers
}

const SURFACE: &str = "ct_surface@0";

#[test]
fn cold_and_warm_runs_are_equal_and_the_manifest_lists_answers_from_the_store() {
    let cache = tempfile::tempdir().unwrap();
    let computed = run(cache.path(), &["--no-cache"]);
    assert!(computed.store.is_null());
    assert_eq!(fs::read_dir(cache.path()).unwrap().count(), 0, "--no-cache wrote to the store");
    let cold = run(cache.path(), &[]);
    assert_eq!(cold.recalled, [""; 0]);
    for workers in if is_slow_run() { &["1", "2", "8"][..] } else { &["1", "8"] } {
        let warm = run(cache.path(), &["--workers", workers]);
        assert!(warm.recalled.contains(&SURFACE.to_owned()), "{:?}", warm.recalled);
        assert_eq!(warm.store["dir"], cache.path().file_name().unwrap().to_str().unwrap());
        assert_eq!(warm.left, computed.left, "{workers} workers");
        assert_eq!(warm.stderr, cold.stderr);
    }
    assert_eq!(cold.left, computed.left);
    assert_eq!(run(cache.path(), &["--no-cache"]).recalled, [""; 0]);
}

#[test]
fn another_parameter_or_seed_is_another_answer() {
    let cache = tempfile::tempdir().unwrap();
    run(cache.path(), &[]);
    for set in ["ct_surface.n_points=140000", "graph.seed=7"] {
        let other = run(cache.path(), &["--set", set]);
        assert!(!other.recalled.contains(&SURFACE.to_owned()), "{set} changed nothing: {:?}", other.recalled);
        assert_eq!(other.left, run(cache.path(), &["--no-cache", "--set", set]).left, "{set}");
    }
    let elsewhere = run(cache.path(), &["--set", "icp.max_iterations=30"]);
    assert!(elsewhere.recalled.contains(&SURFACE.to_owned()), "{:?}", elsewhere.recalled);
}

#[test]
fn a_damaged_entry_is_computed_again_and_replaced() {
    let cache = tempfile::tempdir().unwrap();
    let cold = run(cache.path(), &[]);
    let entry = answers(cache.path()).pop().unwrap();
    let whole = fs::read(&entry).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 4;
    for damaged in [&flipped[..], &whole[..whole.len() / 3], b"", b"OSTEOST2 of another version"] {
        fs::write(&entry, damaged).unwrap();
        let again = run(cache.path(), &[]);
        assert!(!again.recalled.contains(&SURFACE.to_owned()), "{} bytes were taken for it", damaged.len());
        assert_eq!((&again.left, again.stderr), (&cold.left, cold.stderr.clone()));
        assert!(fs::read(&entry).unwrap() == whole, "the damaged entry was not replaced");
    }
}

#[test]
fn runs_side_by_side_share_a_store() {
    let cache = tempfile::tempdir().unwrap();
    let dirs: Vec<_> = (0..4).map(|_| tempfile::tempdir().unwrap()).collect();
    let begin = |dir: &tempfile::TempDir| {
        let mut command = osteoflow_to_spawn();
        command.env("OSTEOFLOW_CACHE", cache.path()).args(RUN).args(["--quiet", "--out"]).arg(dir.path());
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let runs: Vec<_> = dirs.iter().map(begin).collect();
    for run in runs {
        let output = run.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        // What the nodes say, and nothing of the store.
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.lines().all(|line| line.starts_with("warning: node ")), "{said}");
    }
    let warm = run(cache.path(), &[]);
    assert!(warm.recalled.contains(&SURFACE.to_owned()));
    for dir in &dirs {
        assert_eq!(left(dir.path()), warm.left);
    }
    let names = fs::read_dir(cache.path()).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap());
    let strange: Vec<_> = names.filter(|name| !name.ends_with(".entry")).collect();
    assert_eq!(strange, [""; 0], "files that were written aside are left");
}

#[test]
fn above_the_cap_the_oldest_entries_go() {
    let cache = tempfile::tempdir().unwrap();
    let with = |seed: &str| {
        let mut command = osteoflow();
        command.env("OSTEOFLOW_CACHE", cache.path()).env("OSTEOFLOW_CACHE_MAX_MB", "24");
        let dir = tempfile::tempdir().unwrap();
        let set = format!("graph.seed={seed}");
        command.args(RUN).args(["--no-record", "--set", &set, "--out"]).arg(dir.path()).assert().success();
        let bytes: u64 = answers(cache.path()).iter().map(|path| path.metadata().unwrap().len()).sum();
        assert!(bytes <= 24_000_000, "{bytes} bytes after seed {seed}");
        json(&dir.path().join("manifest.json"))["store"]["recalled"].to_string().contains("ct_surface")
    };
    // A prepared surface has 11.1 MB: there is room for two.
    let recalled: Vec<bool> = ["1", "2", "1", "3", "1", "2"].into_iter().map(with).collect();
    assert_eq!(recalled, [false, false, true, false, true, false]);
}

#[test]
#[cfg(unix)]
fn a_store_that_cannot_be_written_is_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("file");
    fs::write(&file, "").unwrap();
    let ran = run(&file.join("store"), &[]);
    let expected = format!("nothing can be kept in the store {}", file.join("store").display());
    assert_eq!(ran.stderr.matches(&expected).count(), 1, "{}", ran.stderr);
    assert_eq!(ran.left, run(&file.join("store"), &["--no-cache"]).left);

    // The largest file that this shell's children may write has 1 MiB: a prepared surface is larger.
    let (cache, out) = (dir.path().join("cache"), dir.path().join("out"));
    let graph = dir.path().join("graph.toml");
    let text = format!(
        "extends = {:?}\nremove = [\"node.export\"]\n[graph]\nname = \"no_export\"\n[node.recording]\ncamera.n_points = 5000\n\
         [node.bone]\nexact = true\n",
        root().join(GRAPH)
    );
    fs::write(&graph, text).unwrap();
    let script = format!(
        "trap '' XFSZ; ulimit -f 1024; OSTEOFLOW_CACHE={} exec {} run {} --no-record --out {}",
        cache.display(),
        program().display(),
        graph.display(),
        out.display()
    );
    let output = Command::new("bash").current_dir(root()).args(["-c", &script]).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{printed}");
    assert!(
        printed.contains("nothing can be kept in the store") && printed.contains("OSTEOFLOW_CACHE names another"),
        "{printed}"
    );
    assert_eq!(fs::read_to_string(out.join("results.json")).unwrap(), ran.left.results);
    let left: Vec<_> = fs::read_dir(&cache).unwrap().map(|file| file.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| name.to_str().unwrap().starts_with("file_hash-")), "{left:?}");
}

#[test]
fn a_replay_computes_what_the_run_recalled() {
    let (cache, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    run(cache.path(), &[]);
    let with_store = || {
        let mut command = osteoflow();
        command.env("OSTEOFLOW_CACHE", cache.path());
        command
    };
    with_store().args(RUN).arg("--out").arg(dir.path()).assert().success();
    let used = |path: &PathBuf| path.metadata().unwrap().modified().unwrap();
    let before: Vec<_> = answers(cache.path()).iter().map(used).collect();
    let again = tempfile::tempdir().unwrap();
    let mut replay = with_store();
    replay.arg("replay").arg(dir.path().join("run.mcap")).arg("--out").arg(again.path()).assert().success();
    assert!(json(&again.path().join("manifest.json"))["store"].is_null());
    assert_eq!(before, answers(cache.path()).iter().map(used).collect::<Vec<_>>(), "the replay read the store");
}

#[test]
fn record_keeps_and_recalls_answers_too() {
    let (cache, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let record = |name: &str, arguments: &[&str]| {
        let file = dir.path().join(name);
        let mut command = osteoflow();
        command.env("OSTEOFLOW_CACHE", cache.path()).args([
            "record",
            GRAPH,
            RUN[2],
            RUN[3],
            RUN[4],
            RUN[5],
            "--wires",
            "ct_surface.*",
            "--out",
        ]);
        command.arg(&file).args(arguments).assert().success();
        let digest = osteoflow().arg("digest").arg(&file).output().unwrap().stdout;
        String::from_utf8(digest).unwrap().replace(name, "")
    };
    let computed = record("computed.mcap", &["--no-cache"]);
    assert_eq!(fs::read_dir(cache.path()).unwrap().count(), 0);
    assert_eq!(record("cold.mcap", &[]), computed);
    assert!(!answers(cache.path()).is_empty());
    assert_eq!(record("warm.mcap", &[]), computed);
}

#[test]
fn a_size_that_is_no_number_is_a_fault_of_the_command_line() {
    let mut command = osteoflow();
    command.env("OSTEOFLOW_CACHE_MAX_MB", "much").args(["run", GRAPH]);
    let assert = command.assert().code(2);
    let printed = String::from_utf8_lossy(&assert.get_output().stderr).into_owned();
    assert!(printed.contains("OSTEOFLOW_CACHE_MAX_MB is \"much\", but a whole number of megabytes"), "{printed}");
}

#[test]
fn no_test_runs_the_command_with_the_store_of_whoever_runs_it() {
    let mut files: Vec<PathBuf> =
        fs::read_dir(root().join("tests")).unwrap().map(|file| file.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|end| end == "rs") && !path.ends_with("tests/common.rs"));
    // In two parts, so that this file does not match itself.
    let words = [concat!("cargo_", "bin"), concat!("CARGO_", "BIN_EXE")];
    let calls = |path: &&PathBuf| {
        let text = fs::read_to_string(path).unwrap();
        words.iter().any(|word| text.contains(word))
    };
    let found: Vec<_> = files.iter().filter(calls).collect();
    assert!(
        found.is_empty(),
        "these call the program past crate::common::osteoflow, which turns the store off: {found:?}"
    );
}
