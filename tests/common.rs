//! Helpers of the tests of the command.
#![cfg_attr(not(unix), allow(dead_code, reason = "some serve tests for Unix alone"))]

#[cfg(unix)]
pub(crate) mod apart;
pub(crate) mod browser;
/// Builds plugins.
#[path = "../engine/tests/plugins/build.rs"]
pub(crate) mod build;
pub(crate) mod case;
/// Simulated devices whose errors are known.
#[path = "../nodes/bone/algorithms/tests/common/devices.rs"]
pub(crate) mod devices;
/// Surfaces of several parts.
#[path = "../nodes/bone/algorithms/tests/common/joined.rs"]
pub(crate) mod joined;
/// Recordings in any layout.
#[path = "../nodes/bone/formats/tests/layouts.rs"]
pub(crate) mod layouts;
pub(crate) mod page;
pub(crate) mod python;
pub(crate) mod served;

use assert_cmd::Command;
use osteoflow_geometry::{
    isometry_from_matrix,
    nalgebra::{Isometry3, Matrix4, Point3},
};
use serde_json::Value;
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{LazyLock, Mutex, OnceLock},
};
use tempfile::TempDir;

/// A graph of the kinds of tests/plugins/toy.c, without the plugin's name.
pub(crate) const TOY_GRAPH: &str = r#"
[graph]
format = 1

[node.give]
kind   = "toy.give"
number = 40

[node.add]
kind = "toy.add"
in   = { number = "give.number" }

[record]
wires = ["*"]

[results]
sum = "add.sum"
"#;

/// For `fibula_live*`: no pose is too old, however long it waits on a busy machine.
pub(crate) const OF_ANY_AGE: &str = "planes.in.t_world_bone_marker.max_age_ms=1e9";

/// The command under test, in the workspace's folder, without the user's settings and store: a test never finds answers of
/// another.
pub(crate) fn osteoflow() -> Command {
    Command::from_std(osteoflow_to_spawn())
}

/// The command under test, for tests that do more with the process than wait for its end.
pub(crate) fn osteoflow_to_spawn() -> std::process::Command {
    let mut command = std::process::Command::new(program());
    command.current_dir(root()).env_remove("OSTEOFLOW_LOG").env("NO_COLOR", "1");
    command.env("OSTEOFLOW_CACHE", "off").env_remove("OSTEOFLOW_CACHE_MAX_MB");
    command
}

/// The program under test; [`osteoflow`] calls it with the settings that tests need.
pub(crate) fn program() -> PathBuf {
    assert_cmd::cargo::cargo_bin("osteoflow")
}

/// What the script of the paper's page prints and returns; prints a message and returns `None` without Python 3.9.
pub(crate) fn reproduce(test: &str, args: &[&str]) -> Option<(String, String, i32)> {
    let newer = "import sys; sys.exit(sys.version_info < (3, 9))";
    if !std::process::Command::new("python3").args(["-c", newer]).status().is_ok_and(|status| status.success()) {
        eprintln!("skipped: {test}: no Python 3.9 or newer");
        return None;
    }
    let mut script = std::process::Command::new("python3");
    script.arg("graphs/paper/reproduce.py").arg("--program").arg(program()).args(args);
    script.current_dir(root()).env("NO_COLOR", "1").env("OSTEOFLOW_CACHE", "off").env("PYTHONDONTWRITEBYTECODE", "1");
    let output = script.output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Some((text(output.stdout), text(output.stderr), output.status.code().unwrap()))
}

/// The workspace's folder.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Development data outside of the repository; prints a message and returns `None` if it is absent.
pub(crate) fn data(test: &str, path: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("OSTEOFLOW_DATA").map_or_else(|| root().join("../shared/data"), PathBuf::from);
    let path = folder.join(path);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: {test}: no development data");
    None
}

/// Whether slow tests are requested.
pub(crate) fn is_slow_run() -> bool {
    std::env::var_os("SLOW_TESTS").is_some()
}

/// Whether a test of many seconds is left out, which is printed: it runs with `SLOW_TESTS`.
pub(crate) fn skips_slow(test: &str) -> bool {
    if !is_slow_run() {
        println!("skipped: {test}: it takes long, and runs with SLOW_TESTS");
    }
    !is_slow_run()
}

/// Asserts that generated text equals a file of the repository; `UPDATE=1` rewrites the file.
pub(crate) fn assert_golden(path: &Path, text: &str) {
    if std::env::var_os("UPDATE").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
        return;
    }
    let golden = fs::read_to_string(path).unwrap_or_default();
    let line = golden.lines().zip(text.lines()).position(|(a, b)| a != b).map_or(0, |at| at + 1);
    assert!(
        golden == text,
        "{} differs first at line {line} (0: only in length); `UPDATE=1 cargo test --release` rewrites it, then read the \
         diff\n--- now\n{text}",
        path.display()
    );
}

/// Every shipped graph, by its path from the workspace's folder.
pub(crate) fn shipped_graphs() -> Vec<String> {
    shipped_files().into_iter().filter(|path| !path.starts_with("graphs/modules/")).collect()
}

/// Every shipped module.
pub(crate) fn shipped_modules() -> Vec<String> {
    shipped_files().into_iter().filter(|path| path.starts_with("graphs/modules/")).collect()
}

/// Every shipped graph file.
fn shipped_files() -> Vec<String> {
    let mut folders = vec![root().join("graphs")];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "toml") {
                found.push(path.strip_prefix(root()).unwrap().to_str().unwrap().to_owned());
            }
        }
    }
    found.sort();
    found
}

/// A finished run: its exit code, stderr, results and folder.
pub(crate) struct Ran {
    pub(crate) code: i32,
    pub(crate) stderr: String,
    pub(crate) results: Value,
    pub(crate) dir: TempDir,
}

impl Ran {
    /// A file in its folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }
}

/// Settings that leave the simulated camera white noise without outliers, for tests of what one part does with a plain scan.
pub(crate) const WHITE: [&str; 4] =
    ["--set", "recording.camera.surface_error_mm=0.0", "--set", "recording.camera.edge_outliers=0.0"];

/// Runs a graph into a new folder.
pub(crate) fn run(graph: &str, arguments: &[&str]) -> Ran {
    run_into(tempfile::tempdir().unwrap(), graph, arguments)
}

fn run_into(dir: TempDir, graph: &str, arguments: &[&str]) -> Ran {
    let output = osteoflow().args(["run", graph, "--out"]).arg(dir.path()).args(arguments).output().unwrap();
    let results = fs::read(dir.path().join("results.json")).unwrap_or_default();
    Ran {
        code: output.status.code().unwrap(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        results: serde_json::from_slice(&results).unwrap_or(Value::Null),
        dir,
    }
}

/// Runs a graph into a new folder; the run must succeed.
pub(crate) fn run_whole(graph: &str, arguments: &[&str]) -> Ran {
    whole(run(graph, arguments), graph, arguments)
}

fn whole(ran: Ran, graph: &str, arguments: &[&str]) -> Ran {
    assert_eq!(ran.code, 0, "{graph} {arguments:?}: {}", ran.stderr);
    ran
}

/// A run that must succeed, made once for all tests of this program that only read its folder.
pub(crate) fn shared_run(graph: &str, arguments: &[&str]) -> &'static Ran {
    static RUNS: Mutex<BTreeMap<String, &OnceLock<Ran>>> = Mutex::new(BTreeMap::new());
    let key = format!("{graph} {arguments:?}");
    let ran: &'static OnceLock<Ran> = RUNS.lock().unwrap().entry(key).or_insert_with(|| Box::leak(Box::default()));
    ran.get_or_init(|| {
        let dir = tempfile::tempdir_in(shared_folder()).unwrap();
        whole(run_into(dir, graph, arguments), graph, arguments)
    })
}

/// A copy of a [`shared_run`] in the folder `run`, for tests that change it.
pub(crate) fn copied_run(graph: &str, arguments: &[&str]) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    copy_folder(shared_run(graph, arguments).dir.path(), &run);
    (dir, run)
}

/// Copies a folder with all that is in it.
pub(crate) fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &to);
        } else {
            fs::copy(entry.path(), to).unwrap();
        }
    }
}

/// The folder of what the tests of this process share; where the system lists its processes, those of ended ones are removed.
pub(crate) fn shared_folder() -> &'static Path {
    static SHARED: LazyLock<PathBuf> = LazyLock::new(|| {
        let all = Path::new(env!("CARGO_TARGET_TMPDIR")).join("shared");
        let own = all.join(std::process::id().to_string());
        fs::create_dir_all(&own).unwrap();
        let processes = Path::new("/proc");
        for entry in fs::read_dir(&all).unwrap().map_while(Result::ok) {
            if processes.join("self").exists() && !processes.join(entry.file_name()).exists() {
                let _ = fs::remove_dir_all(entry.path());
            }
        }
        own
    });
    &SHARED
}

/// A pose as in results and truths: rows of a 4 x 4 matrix, mm.
pub(crate) fn isometry(rows: &Value) -> Isometry3<f64> {
    let m = Matrix4::from_fn(|r, c| rows[r][c].as_f64().unwrap_or_else(|| panic!("no matrix: {rows}")));
    isometry_from_matrix(&m).unwrap()
}

/// A point as in results and truths, mm.
pub(crate) fn point(xyz: &Value) -> Point3<f64> {
    Point3::from(std::array::from_fn(|k| xyz[k].as_f64().unwrap_or_else(|| panic!("no point: {xyz}"))))
}

/// A JSON file.
pub(crate) fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))).unwrap()
}

/// The names of all commands, and how many files or folders each takes by place.
pub(crate) fn commands() -> Vec<(String, usize)> {
    let help = |arguments: &[&str]| {
        let output = osteoflow_to_spawn().args(arguments).arg("--help").output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    let all = help(&[]);
    let listed = all.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let names =
        listed.filter_map(|line| line.strip_prefix("  ")?.split_whitespace().next().filter(|_| &line[2..3] != " "));
    let names: Vec<&str> = names.filter(|name| *name != "help").collect();
    assert!(names.len() > 20, "{names:?}");
    let places = |name: &str| {
        let help = help(&[name]);
        let usage = help.lines().find_map(|line| line.strip_prefix("Usage: ")).unwrap().replace("[OPTIONS]", "");
        let words = usage.split_whitespace().filter(|word| word.starts_with(['<', '[']));
        words
            .filter(|word| !["GLOB", "OUT", "KIND", "SHELL", "COMMAND", ".mcap"].iter().any(|no| word.contains(no)))
            .count()
    };
    names.into_iter().map(|name| (name.to_owned(), places(name))).collect()
}

/// Refuses a schema of JSON messages that Foxglove's parser of the time when Lichtblick came from it refuses, which shows an alert: each
/// object lists its properties, each property has a type, and a list is one of objects or of plain values.
///
/// # Source
/// `packages/mcap-support/src/parseJsonSchema.ts` of foxglove/studio, 9abf66535509.
pub(crate) fn read_by_viewers(schema: &serde_json::Value) -> Result<(), String> {
    let (kind, properties) = (&schema["type"], schema["properties"].as_object());
    let Some(properties) = properties.filter(|_| kind == "object") else {
        return Err(format!("an object with properties is expected: {schema}"));
    };
    properties.iter().try_for_each(|(name, property)| {
        let (is_list, value) = (property["type"] == "array", &property["items"]);
        let value = if is_list { value } else { property };
        match value["type"].as_str() {
            Some("boolean" | "string" | "number" | "integer") => Ok(()),
            Some("object") => read_by_viewers(value),
            other => Err(format!("{name}: {other:?} in {schema}")),
        }
    })
}
