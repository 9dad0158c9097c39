//! Two runs into one folder, a full and a failing disk, and what a power cut may leave.

use crate::common::osteoflow_to_spawn;
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    sync::OnceLock,
};

/// The library that makes the disk fail; `None` if there is no compiler.
fn failing_disk() -> Option<&'static Path> {
    static LIBRARY: OnceLock<Option<PathBuf>> = OnceLock::new();
    let build = || {
        let library = Path::new(env!("CARGO_TARGET_TMPDIR")).join("libfailing_disk.so");
        let compiler = Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-o"])
            .arg(&library)
            .arg(crate::common::root().join("tests/disk/failing.c"))
            .arg("-ldl")
            .output();
        match compiler {
            Ok(output) => {
                assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
                Some(library)
            }
            Err(error) => {
                println!("skipped: there is no C compiler here: {error}");
                None
            }
        }
    };
    LIBRARY.get_or_init(build).as_deref()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Settings of a procedure that takes less time.
const SMALL: [&str; 4] = ["--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];

fn run_into(dir: &Path) -> Command {
    let mut command = osteoflow_to_spawn();
    command.args(["run", "graphs/fibula.toml"]).args(SMALL).args(["--quiet", "--out"]).arg(dir);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn validate(recording: &Path) -> Output {
    osteoflow_to_spawn().arg("validate").arg(recording).output().unwrap()
}

/// Checks that each file of a run is absent or whole, and that a recording that is not sound can be recovered.
fn is_whole_as_far_as_it_goes(dir: &Path, said: &str) {
    for name in ["results.json", "manifest.json", "layout.json"] {
        if let Ok(bytes) = fs::read(dir.join(name)) {
            assert!(serde_json::from_slice::<serde_json::Value>(&bytes).is_ok(), "{name} is cut: {said}");
        }
    }
    for entry in fs::read_dir(dir).unwrap() {
        let name = entry.unwrap().file_name().to_string_lossy().into_owned();
        assert!(!name.ends_with(".part") && !name.starts_with('.'), "{name} was left: {said}");
    }
    let recording = dir.join("run.mcap");
    if validate(&recording).status.code() != Some(0) && fs::metadata(&recording).is_ok_and(|found| found.len() > 50_000)
    {
        let saved = dir.join("saved.mcap");
        let output = osteoflow_to_spawn().arg("recover").arg(&recording).arg(&saved).output().unwrap();
        assert!(output.status.success(), "{}; {said}", text(&output.stderr));
        let _ = fs::remove_file(saved);
    }
}

#[test]
fn of_two_runs_into_one_folder_one_is_refused_by_the_name_of_the_other() {
    let n_pairs = if crate::common::is_slow_run() { 80 } else { 3 };
    for _ in 0..n_pairs {
        let parent = tempfile::tempdir().unwrap();
        let dir = parent.path().join("run");
        let children: Vec<_> = (0..2).map(|_| run_into(&dir).spawn().unwrap()).collect();
        let ids: Vec<_> = children.iter().map(|child| child.id()).collect();
        let outputs: Vec<_> = children.into_iter().map(|child| child.wait_with_output().unwrap()).collect();
        let loser = outputs.iter().position(|output| output.status.code() == Some(2)).expect("one is refused");
        let (err, winner) = (text(&outputs[loser].stderr), 1 - loser);
        assert_eq!(outputs[winner].status.code(), Some(0), "{}", text(&outputs[winner].stderr));
        // Or it came when the other had ended, or had written already.
        let names_it = err.contains(&format!("in use by process {}", ids[winner]));
        assert!(names_it || err.contains("is not empty"), "{err}");
        assert_eq!(validate(&dir.join("run.mcap")).status.code(), Some(0));
        is_whole_as_far_as_it_goes(&dir, &err);
    }
}

#[test]
fn force_does_not_replace_a_run_that_is_under_way_and_a_killed_one_holds_no_folder() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("run");
    let mut first = osteoflow_to_spawn();
    first.args(["run", "graphs/variants/fibula_live.toml", "--quiet", "--out"]).arg(&dir);
    let mut first = first.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !dir.join("run.mcap").exists() {
        assert!(first.try_wait().unwrap().is_none(), "it ended before it recorded");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let output = run_into(&dir).arg("--force").output().unwrap();
    assert!(output.status.code() == Some(2) && text(&output.stderr).contains("in use by process"));
    first.kill().unwrap();
    first.wait().unwrap();
    let output = run_into(&dir).arg("--force").output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    is_whole_as_far_as_it_goes(&dir, "");
}

#[test]
fn the_recording_is_synced_before_results_and_manifest_which_are_renamed_from_synced_files() {
    let Some(library) = failing_disk() else { return };
    let parent = tempfile::tempdir().unwrap();
    let (dir, log) = (parent.path().join("run"), parent.path().join("log"));
    let output = run_into(&dir).env("LD_PRELOAD", library).env("OSTEOFLOW_TEST_DISK_LOG", &log).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let log = fs::read_to_string(log).unwrap();
    let lines: Vec<&str> = log.lines().collect();
    let at = |what: &str| {
        let found = lines.iter().position(|line| line.contains(what));
        found.unwrap_or_else(|| panic!("no {what} in {log}"))
    };
    let folder = format!("fsync {}", dir.display());
    for name in ["results.json", "manifest.json"] {
        let (synced, renamed) = (at(&format!("{name}.")), at(&format!("rename {}/{name}", dir.display())));
        assert!(at("fsync") <= at("run.mcap") && at("run.mcap") < synced && synced < renamed, "{log}");
        assert!(lines[renamed..].contains(&folder.as_str()), "the folder after {name}: {log}");
    }
    assert_eq!(lines.iter().filter(|line| line.starts_with("fsync") && line.ends_with("run.mcap")).count(), 1);
}

#[test]
fn a_disk_that_is_full_anywhere_leaves_whole_files_and_the_message_says_what_is_missing() {
    let Some(library) = failing_disk() else { return };
    let parent = tempfile::tempdir().unwrap();
    let whole = crate::common::shared_run("graphs/fibula.toml", &SMALL);
    let size = |name: &str| fs::metadata(whole.path(name)).unwrap().len();
    let recording = size("run.mcap");
    let mut n_named = 0;
    for limit in [0, 300, 20_000, recording / 2, recording - 100_000, recording + size("layout.json") + 10_000] {
        let dir = parent.path().join(limit.to_string());
        let mut command = run_into(&dir);
        let output =
            command.env("LD_PRELOAD", library).env("OSTEOFLOW_TEST_DISK_BYTES", limit.to_string()).output().unwrap();
        let err = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{limit} bytes: {err}");
        assert!(err.contains("No space left on device") && err.contains(&*dir.to_string_lossy()), "{limit}: {err}");
        n_named += usize::from(err.contains("the files of this run lack"));
        is_whole_as_far_as_it_goes(&dir, &format!("{limit} bytes: {err}"));
        assert!(!dir.join("manifest.json").exists() || !err.contains("manifest.json"), "{err}");
    }
    assert!(n_named >= 2, "{n_named}");
    // A disk that fails when it is synced.
    let dir = parent.path().join("failing");
    let output = run_into(&dir).env("LD_PRELOAD", library).env("OSTEOFLOW_TEST_SYNC_FAILS", "1").output().unwrap();
    let err = text(&output.stderr);
    assert!(output.status.code() == Some(1) && err.contains("Input/output error"), "{err}");
    assert!(!dir.join("results.json").exists() && !dir.join("manifest.json").exists(), "{err}");
}

#[test]
fn a_sweep_on_a_full_disk_goes_on_where_it_stopped() {
    let Some(library) = failing_disk() else { return };
    let parent = tempfile::tempdir().unwrap();
    let graph = parent.path().join("small.toml");
    let base = crate::common::root().join("graphs/fibula.toml");
    let n_runs = if crate::common::is_slow_run() { 3 } else { 2 };
    let small = "[node.recording]\ncamera.n_points = 5000\n[node.bone]\nexact = true\n";
    let sweep = format!("{small}[sweep]\nrepeat = {n_runs}\n[sweep.columns]\nrms = \"icp.rms_mm\"\n");
    fs::write(&graph, format!("extends = {base:?}\n[graph]\nname = \"small\"\n{sweep}")).unwrap();
    let command = |dir: &str, resume: bool| {
        let mut command = osteoflow_to_spawn();
        command.arg("sweep").arg(&graph).args(["--quiet", "--workers", "1", "--out"]).arg(parent.path().join(dir));
        command.args(resume.then_some("--resume")).stdout(Stdio::null());
        command
    };
    assert!(command("whole", false).status().unwrap().success());
    let mut failing = command("cut", false);
    let output = failing.env("LD_PRELOAD", library).env("OSTEOFLOW_TEST_DISK_BYTES", "30000").output().unwrap();
    let err = text(&output.stderr);
    assert!(output.status.code() == Some(1) && err.contains("No space left on device"), "{err}");
    assert!(command("cut", true).status().unwrap().success());
    let table = |dir: &str| fs::read_to_string(parent.path().join(dir).join("runs.csv")).unwrap();
    assert_eq!(table("whole"), table("cut"));
}

#[test]
fn a_small_file_system_is_full_as_a_full_disk_is() {
    let parent = tempfile::tempdir().unwrap();
    let program = crate::common::program();
    let script = format!(
        "mount -t tmpfs -o size=2m tmpfs {0} || exit 77; cd {1}; OSTEOFLOW_CACHE=off {2} run graphs/fibula.toml --quiet --out {0}/run > /dev/null; \
         code=$?; ls {0}/run; test -f {0}/run/results.json && cat {0}/run/results.json > /dev/null; exit $code",
        parent.path().display(),
        crate::common::root().display(),
        program.display()
    );
    let output = Command::new("unshare").args(["--user", "--map-root-user", "--mount", "sh", "-c", &script]).output();
    let output = match output {
        Ok(output) if output.status.code() != Some(77) && !text(&output.stderr).starts_with("unshare:") => output,
        _ => {
            println!("skipped: a_small_file_system_is_full_as_a_full_disk_is: no file system can be mounted here");
            return;
        }
    };
    let err = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{err}");
    assert!(err.contains("No space left on device") && err.contains("run.mcap"), "{err}");
    let listed = text(&output.stdout);
    assert!(listed.contains("run.mcap") && !listed.contains(".part"), "{listed}");
}

/// The names in a folder.
fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn convert(from: &str, to: &Path) -> Command {
    let mut command = osteoflow_to_spawn();
    command.arg("convert").arg(crate::common::root().join("tests/data/folder").join(from)).arg(to);
    command
}

#[test]
fn a_converted_file_is_whole_or_not_there_on_a_full_disk_and_after_a_kill() {
    let Some(library) = failing_disk() else { return };
    let dir = tempfile::tempdir().unwrap();
    let cases = [
        ("scan.ply", "out.csv"),
        ("scan.ply", "out.pcd"),
        ("scan.ply", "out.vtk"),
        ("bone.stl", "out.ply"),
        ("bone.stl", "out.obj"),
        ("poses.csv", "out.mcap"),
    ];
    for (from, to) in cases {
        let out = dir.path().join(to);
        let mut full = convert(from, &out);
        let output = full.env("LD_PRELOAD", library).env("OSTEOFLOW_TEST_DISK_BYTES", "200").output().unwrap();
        let err = text(&output.stderr);
        assert!(output.status.code() == Some(1) && err.contains("No space left on device"), "{to}: {err}");
        assert_eq!(names(dir.path()), [""; 0], "{to}");
    }
    let out = dir.path().join("out.csv");
    let mut waits = convert("scan.ply", &out);
    let mut waits = waits.env("LD_PRELOAD", library).env("OSTEOFLOW_TEST_SYNC_WAITS", "1").spawn().unwrap();
    while names(dir.path()).is_empty() {
        assert!(waits.try_wait().unwrap().is_none(), "it ended before it wrote");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    waits.kill().unwrap();
    waits.wait().unwrap();
    let left = names(dir.path());
    assert!(left.len() == 1 && left[0].ends_with(".part"), "{left:?}");
    assert!(convert("scan.ply", &dir.path().join("other.csv")).status().unwrap().success());
    assert_eq!(names(dir.path()), ["other.csv"], "the next call removes what a killed one left");
}

#[test]
fn a_registration_that_cannot_be_written_is_refused_before_it_is_computed_or_printed_all_the_same() {
    let Some(library) = failing_disk() else { return };
    let dir = tempfile::tempdir().unwrap();
    let folder = crate::common::root().join("tests/data/folder");
    let register = |out: &Path| {
        let mut command = osteoflow_to_spawn();
        command
            .arg("register")
            .args([folder.join("bone.stl"), folder.join("scan.ply")])
            .arg("--no-verdict")
            .arg("--out");
        command.arg(out);
        command
    };
    fs::write(dir.path().join("file"), "").unwrap();
    for nowhere in ["no/such/pose.txt", "file/pose", "file/pose.json"] {
        let output = register(&dir.path().join(nowhere)).output().unwrap();
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        assert!(output.status.code() != Some(0) && out.is_empty() && err.contains("cannot be written"), "{out}{err}");
    }
    let out = dir.path().join("pose.json");
    let mut full = register(&out);
    let output = full
        .env("LD_PRELOAD", library)
        .env("OSTEOFLOW_TEST_DISK_BYTES", "0")
        .env("OSTEOFLOW_CACHE", "off")
        .output()
        .unwrap();
    let (said, err) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.code() == Some(1) && err.contains("the pose is printed, and not written"), "{err}");
    assert!(said.lines().count() > 4 && !out.exists(), "{said}");
    assert_eq!(names(dir.path()), ["file"]);
}

#[test]
fn a_sweep_that_is_interrupted_before_its_first_run_says_so() {
    let Some(library) = failing_disk() else { return };
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("swept");
    let mut sweep = osteoflow_to_spawn();
    sweep.args(["sweep", "graphs/paper/sensitivity.toml", "--out"]).arg(&out);
    sweep.env("LD_PRELOAD", library).env("OSTEOFLOW_TEST_SYNC_WAITS", "1").stdout(Stdio::null()).stderr(Stdio::piped());
    let mut sweep = sweep.spawn().unwrap();
    while !out.is_dir() || names(&out).is_empty() {
        assert!(sweep.try_wait().unwrap().is_none(), "it ended before it wrote");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &sweep.id().to_string()]).status().unwrap().success());
    let output = sweep.wait_with_output().unwrap();
    let err = text(&output.stderr);
    assert!(output.status.code() == Some(130) && err.contains("interrupted: before the first run"), "{err}");
}
