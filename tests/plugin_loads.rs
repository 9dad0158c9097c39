//! What a plugin loads beside its own file decides numbers, so it is named, hashed and held: modules, packages, libraries.

use crate::common::{
    build, osteoflow, osteoflow_to_spawn,
    python::{Folder, HELPED},
};
use serde_json::Value;
use std::{
    fs,
    path::Path,
    process::Stdio,
    thread,
    time::{Duration, Instant},
};

const GRAPH: &str = r#"
plugins = ["st.py"]
[graph]
format = 1
name = "imports"
[node.src]
kind = "st.src"
[node.f]
kind = "st.f"
in = { cloud = "src.cloud" }
[results]
f = "f.r"
[sweep]
repeat = 4
[sweep.columns]
number = "f.number"
"#;

/// What the program leaves in the folder.
struct Results<'a>(&'a Folder);

impl Results<'_> {
    /// The column `number` of a sweep.
    fn numbers(&self, sweep: &str) -> Vec<String> {
        let table = fs::read_to_string(self.0.path(&format!("{sweep}/runs.csv"))).unwrap();
        let mut rows = table.lines().map(|row| row.split(',').map(str::to_owned).collect::<Vec<_>>());
        let at = rows.next().unwrap().iter().position(|name| name == "number").unwrap();
        rows.map(|row| row[at].clone()).collect()
    }

    fn json(&self, file: &str) -> Value {
        serde_json::from_slice(&fs::read(self.0.path(file)).unwrap()).unwrap()
    }
}

#[test]
fn a_sweep_is_not_continued_nor_merged_with_another_module_beside_the_plugin() {
    let files = [("st.py", HELPED), ("g.toml", GRAPH), ("helper.py", "SCALE = 1.0\n")];
    let Some(folder) = Folder::new("a module beside a plugin", &files) else { return };
    let results = Results(&folder);
    folder.ends_well(&["sweep", "g.toml", "--out", "s"]);
    folder.ends_well(&["sweep", "g.toml", "--shard", "1/2", "--out", "p1"]);
    fs::remove_file(folder.path("s/runs/000003.json")).unwrap();
    folder.write("helper.py", "SCALE = 2.0\n");
    let (code, text) = folder.says(&["sweep", "g.toml", "--out", "s", "--resume"]);
    assert!(code == Some(2) && text.contains("helper (") && text.contains("helper.py) differs"), "{code:?} {text}");
    folder.ends_well(&["sweep", "g.toml", "--shard", "2/2", "--out", "p2"]);
    let (code, text) = folder.says(&["sweep", "--merge", "p1", "p2", "--out", "m"]);
    assert!(code == Some(2) && text.contains("helper.py) differs"), "{code:?} {text}");
    // As it was, it goes on; the number of a run is that of the module as it is.
    folder.ends_well(&["run", "g.toml", "--out", "r"]);
    assert_eq!(results.json("r/results.json")["f"]["number"], 2.0);
    folder.write("helper.py", "SCALE = 1.0\n");
    folder.ends_well(&["sweep", "g.toml", "--out", "s", "--resume"]);
    assert_eq!(results.numbers("s"), ["1.0"; 4]);
    // A changed line of the graph is named, too.
    folder.write("g.toml", &GRAPH.replace("name = \"imports\"", "name = \"imports\"\nseed = 7"));
    let (code, text) = folder.says(&["sweep", "g.toml", "--out", "s", "--resume"]);
    assert!(code == Some(2) && text.contains("[graph] seed: it 0, the other 7"), "{code:?} {text}");
}

#[test]
fn a_module_that_only_a_firing_imports_is_named_and_held_to() {
    let node = HELPED.replace("import helper\n", "").replace("    return R", "    import helper\n    return R");
    let files = [("st.py", node.as_str()), ("g.toml", GRAPH), ("helper.py", "SCALE = 1.0\n")];
    let Some(folder) = Folder::new("a module that a firing imports", &files) else { return };
    let results = Results(&folder);
    folder.ends_well(&["run", "g.toml", "--out", "r"]);
    assert_eq!(results.json("r/manifest.json")["plugins"][0]["loads"]["files"][0]["name"], "helper");
    folder.ends_well(&["sweep", "g.toml", "--out", "s"]);
    assert_eq!(results.json("s/sweep.json")["plugins"][0]["loads"]["files"][0]["name"], "helper");
    fs::remove_file(folder.path("s/runs/000003.json")).unwrap();
    folder.write("helper.py", "SCALE = 2.0\n");
    let (code, text) = folder.says(&["sweep", "g.toml", "--out", "s", "--resume"]);
    assert!(code != Some(0) && text.contains("helper.py) differs"), "{code:?} {text}");
    assert!(!folder.path("s/runs/000003.json").exists());
}

/// Runs both parts of a sweep and a run, with a change before the second part; what merging, replaying and comparing say.
fn said_of_a_change(folder: &Folder, change: impl Fn()) -> [String; 3] {
    folder.ends_well(&["sweep", "g.toml", "--shard", "1/2", "--out", "p1"]);
    folder.ends_well(&["run", "g.toml", "--out", "r1"]);
    change();
    folder.ends_well(&["sweep", "g.toml", "--shard", "2/2", "--out", "p2"]);
    folder.ends_well(&["run", "g.toml", "--out", "r2"]);
    let says = |arguments: &[&str]| folder.says(arguments).1;
    [says(&["sweep", "--merge", "p1", "p2", "--out", "m"]), says(&["replay", "r1"]), says(&["compare", "r1", "r2"])]
}

#[test]
fn what_a_plugin_loads_or_opens_in_addition_is_named_by_merge_replay_and_compare() {
    let here = "import os, sys\nHERE = os.path.dirname(os.path.abspath(__file__))\n";
    let at_import = |code: &str| format!("{here}{}", HELPED.replace("import helper\n", code));
    let firing = |code: &str| {
        let node = HELPED.replace("import helper\n", "").replace("    return R", &format!("    {code}\n    return R"));
        format!("{here}{}", node.replace("helper.SCALE", "scale"))
    };
    let backend = "class helper:\n    SCALE = 1.0\ntry:\n    import fast as helper\nexcept ImportError:\n    pass\n";
    let run_text = "exec(open(HERE + '/text.txt').read())\n";
    let scale = "scale = float(open(HERE + '/scale.txt').read())";
    let late = "scale = 1.0\n    try:\n        from fast import SCALE as scale\n    except ImportError:\n        pass";
    let text = |number: &str| format!("class helper:\n    SCALE = {number}\n");
    let cases = [
        ("a backend", at_import(backend), "fast.py", None, "SCALE = 2.0\n".into(), "alone loads fast ("),
        ("a text that is run", at_import(run_text), "text.txt", Some(text("1.0")), text("2.0"), "text.txt) differs"),
        ("data", firing(scale), "scale.txt", Some("1.0".into()), "2.0".into(), "scale.txt), which it opens, differs"),
        ("a backend of a firing", firing(late), "fast.py", None, "SCALE = 2.0\n".into(), "alone loads fast ("),
    ];
    for (name, plugin, file, before, after, expected) in cases {
        let Some(folder) = Folder::new(name, &[("st.py", &plugin), ("g.toml", GRAPH)]) else { return };
        before.iter().for_each(|text| folder.write(file, text));
        let [merge, replay, compare] = said_of_a_change(&folder, || folder.write(file, &after));
        assert!(merge.contains(expected) && compare.contains(expected), "{name}: {merge}\n{compare}");
        // Changed and new code is not run, and changed data named.
        let refused = format!("{file}, which it loads, is not as in the recorded run");
        let (passed_over, changed) = (format!("{file} is passed over"), format!("{file} has changed since"));
        let is_named = [refused, passed_over, changed].iter().any(|said| replay.contains(said));
        assert!(is_named, "{name}: {replay}");
    }
}

#[test]
fn a_changed_module_beside_a_plugin_is_not_run_by_a_replay_unless_the_user_names_the_plugin() {
    let files = [("st.py", HELPED), ("g.toml", GRAPH), ("helper.py", "SCALE = 1.0\n")];
    let Some(folder) = Folder::new("a changed module in a replay", &files) else { return };
    folder.ends_well(&["run", "g.toml", "--out", "r"]);
    folder.write("helper.py", "SCALE = 1.0\nopen('MARK', 'w').write('run')\n");
    for run in ["r", "r/run.mcap"] {
        let (code, text) = folder.says(&["replay", run]);
        assert!(
            code == Some(2) && text.contains("helper.py, which it loads, is not as in the recorded run"),
            "{code:?} {text}"
        );
        assert!(text.contains("--plugin ") && text.contains("--allow-plugins"), "{text}");
    }
    assert!(!folder.path("MARK").exists(), "the changed module was run");
    folder.ends_well(&["replay", "r", "--allow-plugins"]);
    assert!(!folder.path("MARK").exists(), "the text that the recording carries is run instead");
    folder.ends_well(&["replay", "r", "--plugin", "st.py"]);
    assert!(folder.path("MARK").exists());
}

#[test]
fn a_replay_runs_nothing_beside_a_plugin_that_the_recorded_run_had_not_loaded() {
    let by_source = "class helper:\n    SCALE = 1.0\ntry:\n    import fast as helper\nexcept ImportError:\n    pass\nimport parts.a, colorsys\n";
    let node = HELPED.replace("import helper\n", by_source);
    let node =
        node.replace("    return R(float(helper.SCALE))", "    import late\n    return R(helper.SCALE * late.L)");
    let files = [
        ("st.py", node.as_str()),
        ("g.toml", GRAPH),
        ("late.py", "L = 1.5\n"),
        ("parts/__init__.py", ""),
        ("parts/a.py", "A = 1\n"),
    ];
    let Some(folder) = Folder::new("what came beside a plugin", &files) else { return };
    folder.ends_well(&["run", "g.toml", "--out", "r", "--set", "record.wires=[\"*\"]"]);
    let mark = "open('MARK', 'w')\n";
    // A backend, a module that shadows one of Python's, one within a package, and a compiled file that is not of its source.
    for (file, passed_over) in [("fast.py", true), ("colorsys.py", true), ("parts/fast.py", false)] {
        folder.write(file, &format!("{mark}SCALE = 2.0\n"));
        let text = folder.ends_well(&["replay", "r"]);
        assert_eq!(text.contains(&format!("{file} is passed over")), passed_over, "{text}");
        assert!(text.contains("0 differ, results equal") && !folder.path("MARK").exists(), "{file}: {text}");
        if passed_over {
            let (code, text) = folder.says(&["replay", "r", "--plugin", "st.py"]);
            assert!(code.is_some() && folder.path("MARK").exists(), "the user names the plugin: {text}");
            fs::remove_file(folder.path("MARK")).unwrap();
        }
        fs::remove_file(folder.path(file)).unwrap();
    }
    let compile = "import importlib.util as u, marshal, os\nstat = os.stat('late.py')\nfile = u.cache_from_source('late.py')\n\
                   os.makedirs(os.path.dirname(file), exist_ok=True)\ncode = compile(\"open('MARK', 'w'); L = 1.5\", 'late.py', 'exec')\n\
                   head = [0, int(stat.st_mtime), stat.st_size]\n\
                   open(file, 'wb').write(u.MAGIC_NUMBER + b''.join(n.to_bytes(4, 'little') for n in head) + marshal.dumps(code))";
    let compiled = std::process::Command::new(&folder.1).current_dir(folder.0.path()).args(["-c", compile]).status();
    assert!(compiled.unwrap().success());
    folder.ends_well(&["replay", "r"]);
    assert!(!folder.path("MARK").exists(), "the compiled file was run");
    folder.ends_well(&["run", "g.toml", "--out", "compiled"]);
    assert!(folder.path("MARK").exists(), "Python itself takes it for that of its source");
    // A bundle knows what the failed firing had loaded.
    folder.write("st.py", &node.replace("    import late\n", "    import late\n    raise ValueError(late.L)\n"));
    let (code, text) = folder.says(&["run", "g.toml", "--out", "failed"]);
    assert_eq!(code, Some(3), "{text}");
    let text = folder.ends_well(&["repro", "failed/repro/f-0"]);
    assert!(text.contains("failed now:  the same"), "{text}");
}

#[test]
fn nothing_is_named_of_two_parts_that_load_the_same() {
    let files = [("st.py", HELPED), ("g.toml", GRAPH), ("helper.py", "SCALE = 1.0\n")];
    let Some(folder) = Folder::new("two equal parts", &files) else { return };
    let [merge, replay, compare] = said_of_a_change(&folder, || folder.write("other.txt", "nobody reads this"));
    for said in [merge, replay, compare] {
        assert!(!said.contains("plugin st") && !said.contains("otherwise:") && !said.contains("differs"), "{said}");
    }
}

#[test]
fn a_sweep_runs_from_plugin_and_modules_as_they_were_at_its_start() {
    let slow = HELPED.replace("    return R", "    import time\n    time.sleep(0.1)\n    return R");
    let graph = GRAPH.replace("repeat = 4", "repeat = 12");
    let files = [("st.py", slow.as_str()), ("g.toml", &graph), ("helper.py", "SCALE = 1.0\n")];
    let Some(folder) = Folder::new("a plugin saved during a sweep", &files) else { return };
    let results = Results(&folder);
    let mut sweep = osteoflow_to_spawn();
    sweep.current_dir(folder.0.path()).env("OSTEOFLOW_PYTHON", &folder.1);
    sweep.args(["sweep", "g.toml", "--out", "s", "--workers", "1", "-q"]).stderr(Stdio::piped());
    let sweep = sweep.stdout(Stdio::null()).spawn().unwrap();
    let is_run = |entry: &std::io::Result<fs::DirEntry>| entry.as_ref().is_ok_and(|entry| entry.path().is_file());
    let n_there = || fs::read_dir(folder.path("s/runs")).map_or(0, |runs| runs.filter(is_run).count());
    let began = Instant::now();
    while n_there() < 2 && began.elapsed() < Duration::from_secs(120) {
        thread::sleep(Duration::from_millis(5));
    }
    assert!((2..12).contains(&n_there()), "the files are saved while the sweep runs");
    folder.write("st.py", "raise ImportError(\"half saved\")\n");
    fs::remove_file(folder.path("helper.py")).unwrap();
    let output = sweep.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(results.numbers("s"), ["1.0"; 12]);
}

#[test]
fn a_changed_default_in_an_imported_module_is_seen() {
    let common = |k: &str| {
        format!(
            "from dataclasses import dataclass\nfrom osteoflow_node import param\n\n\n@dataclass\nclass Params:\n    \
             k: float = param({k}, ge=0, le=10, doc=\"A number.\")\n"
        )
    };
    let plugin = "from common import Params\nfrom osteoflow_node import Text, source\n\n\n@source(\"c.x\", \
                  output=\"t\")\ndef x(params: Params) -> Text:\n    \"\"\"A text.\"\"\"\n    yield 0, Text(f\"k={params.k}\")\n";
    let graph = "plugins = [\"c.py\"]\n[graph]\nformat = 1\n[node.c]\nkind = \"c.x\"\n[results]\nt = \"c.t\"\n";
    let files = [("c.py", plugin), ("c.toml", graph), ("common.py", &common("1.0"))];
    let Some(folder) = Folder::new("a default in an imported module", &files) else { return };
    let results = Results(&folder);
    for k in ["1.0", "2.0"] {
        folder.write("common.py", &common(k));
        folder.ends_well(&["run", "c.toml", "--out", k]);
        assert_eq!(results.json(&format!("{k}/results.json"))["t"], format!("k={k}"));
    }
}

#[test]
fn the_version_of_a_package_is_in_the_manifest_and_a_new_one_makes_another_sweep() {
    let metadata = |version: &str| format!("Metadata-Version: 2.1\nName: helper\nVersion: {version}\n");
    let of = |version: &str| format!("packages/helper-{version}.dist-info/METADATA");
    let path =
        "import sys, os\nsys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), \"packages\"))\n";
    let node = format!("{path}{HELPED}");
    let files = [("st.py", node.as_str()), ("g.toml", GRAPH), ("packages/helper.py", "SCALE = 1.0\n")];
    let Some(folder) = Folder::new("a package of another version", &files) else { return };
    let results = Results(&folder);
    folder.write(&of("1.1"), &metadata("1.1"));
    folder.ends_well(&["sweep", "g.toml", "--out", "s"]);
    fs::remove_file(folder.path("s/runs/000003.json")).unwrap();
    for version in ["1.1", "1.2"] {
        fs::remove_dir_all(folder.path("packages/helper-1.1.dist-info")).unwrap();
        folder.write(&of(version), &metadata(version));
        folder.ends_well(&["run", "g.toml", "--out", version]);
        let loads = &results.json(&format!("{version}/manifest.json"))["plugins"][0]["loads"];
        let packages: Vec<_> = loads["packages"].as_array().unwrap().iter().map(|p| p.as_str().unwrap()).collect();
        assert!(packages.contains(&&*format!("helper {version}")), "{packages:?}");
        assert!(packages.iter().any(|package| package.starts_with("numpy ")), "{packages:?}");
        assert!(loads["environment"][0].as_str().unwrap().starts_with("CPython 3."), "{loads}");
    }
    let (code, text) = folder.says(&["sweep", "g.toml", "--out", "s", "--resume"]);
    assert!(code == Some(2) && text.contains("helper 1.1 against 1.2"), "{code:?} {text}");
}

#[test]
fn a_library_that_a_plugin_links_is_part_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let library = folder.path().join("libalgo.so");
    let algo = |factor: f64| {
        let file = folder.path().join("algo.c");
        fs::write(&file, format!("double algo_factor(void) {{ return {factor:?}; }}\n")).unwrap();
        build::compile(&file, &library, &[])
    };
    if !algo(1.0) {
        return;
    }
    let source = fs::read_to_string("tests/plugins/centre.cpp").unwrap();
    let source =
        source.replace("static int32_t create", "extern \"C\" double algo_factor(void);\nstatic int32_t create");
    let source = source.replace("mean[k];\n    }\n    const", "mean[k] * algo_factor();\n    }\n    const");
    let source = source.replace(" || normals == nullptr", " || (normals != nullptr && normals->n_rows == 0)");
    let source = source.replace("OSTEOFLOW_KEPT_NO", "OSTEOFLOW_KEPT_BY_INPUTS");
    assert!(source.contains("* algo_factor()") && source.contains("KEPT_BY_INPUTS"));
    let file = folder.path().join("centre.cpp");
    fs::write(&file, source).unwrap();
    let dir = folder.path().to_str().unwrap();
    let rpath = format!("-Wl,-rpath,{dir}");
    assert!(build::compile(&file, &folder.path().join("libcentre.so"), &[&format!("-L{dir}"), "-lalgo", &rpath]));
    let graph = "plugins = [\"libcentre.so\"]\n[graph]\nformat = 1\n[node.scan]\nkind = \"acquire.simulated\"\n\
                 camera.n_points = 1000\n[node.centre]\nkind = \"centre.mean\"\nin = { cloud = \"scan.scan\" }\n\
                 [results]\npose = \"centre.pose\"\n";
    fs::write(folder.path().join("g.toml"), graph).unwrap();
    let run = |out: &str, arguments: &[&str]| -> Value {
        let mut command = osteoflow();
        command.current_dir(folder.path()).env("OSTEOFLOW_CACHE", folder.path().join("cache"));
        let output = command.args(["run", "g.toml", "--out", out]).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&fs::read(folder.path().join(out).join("results.json")).unwrap()).unwrap()
    };
    let manifest = |out: &str| -> Value {
        serde_json::from_slice(&fs::read(folder.path().join(out).join("manifest.json")).unwrap()).unwrap()
    };
    for (place, arguments) in [("here", [].as_slice()), ("apart", &["--set", "centre.process=true"])] {
        assert!(algo(1.0));
        let [first, again] = ["first", "again"].map(|name| run(&format!("{place}-{name}"), arguments));
        assert!(algo(0.5));
        let [kept, computed] = [("kept", None), ("computed", Some("--no-cache"))].map(|(name, more)| {
            run(&format!("{place}-{name}"), &arguments.iter().copied().chain(more).collect::<Vec<_>>())
        });
        assert!(first == again && kept == computed && first != kept, "{place}: {first} {again} {kept} {computed}");
        let loads = &manifest(&format!("{place}-kept"))["plugins"][0]["loads"]["files"];
        let names: Vec<_> = loads.as_array().unwrap().iter().map(|file| file["name"].as_str().unwrap()).collect();
        assert!(names.contains(&"libalgo.so"), "{names:?}");
    }
    assert!(Path::new(dir).is_dir());
}

#[test]
fn one_process_serves_the_runs_of_a_sweep_with_a_new_node_each_and_the_same_constants() {
    let plugin = r#"
import os
import numpy as np
from osteoflow_node import Mesh, node, payload, source

MESHES, BUILT = [], []


@payload("p/R")
class R:
    """What was seen."""

    pid: int
    n_built: int
    n_fired: int
    n_meshes: int


@source("p.mesh", output="mesh")
def mesh() -> Mesh:
    """One mesh."""
    yield 0, Mesh("ct", np.eye(3), np.array([[0, 1, 2]]))


@node("p.f", output="r")
class F:
    """Counts."""

    def __init__(self):
        self.n = 0
        BUILT.append(1)

    def process(self, mesh: Mesh) -> R:
        self.n += 1
        if not any(known is mesh for known in MESHES):
            MESHES.append(mesh)
        assert not mesh.vertices.flags.writeable
        return R(os.getpid(), len(BUILT), self.n, len(MESHES))
"#;
    let graph = "plugins = [\"p.py\"]\n[graph]\nformat = 1\n[node.mesh]\nkind = \"p.mesh\"\n[node.f]\nkind = \"p.f\"\n\
                 in = { mesh = \"mesh.mesh\" }\n[results]\nr = \"f.r\"\n[sweep]\nrepeat = 5\n\
                 [sweep.columns]\npid = \"r.pid\"\nn_built = \"r.n_built\"\nn_fired = \"r.n_fired\"\nn_meshes = \"r.n_meshes\"\n";
    let Some(folder) = Folder::new("a process for many runs", &[("p.py", plugin), ("g.toml", graph)]) else { return };
    let columns = |out: &str| -> Vec<Vec<f64>> {
        let table = fs::read_to_string(folder.path(&format!("{out}/runs.csv"))).unwrap();
        let row = |row: &str| row.split(',').skip(5).take(4).map(|cell| cell.parse().unwrap()).collect();
        table.lines().skip(1).map(row).collect()
    };
    // Each run has a seed of its own, and computes the mesh anew: it is the same all the same.
    folder.ends_well(&["sweep", "g.toml", "--out", "pooled", "--workers", "1", "--set", "sweep.twice=0"]);
    let pooled = columns("pooled");
    let pid = pooled[0][0];
    for (run, row) in pooled.iter().enumerate() {
        assert_eq!(row[..], [pid, (run + 1) as f64, 1.0, 1.0], "a node is built anew in the process: {pooled:?}");
    }
    folder.ends_well(&["sweep", "g.toml", "--out", "alone", "--workers", "1", "--set", "f.pool=false"]);
    let alone = columns("alone");
    let mut pids: Vec<_> = alone.iter().map(|row| row[0] as u64).collect();
    pids.sort_unstable();
    pids.dedup();
    assert!(pids.len() == 5 && alone.iter().all(|row| row[1..] == [1.0; 3]), "{alone:?}");
}

#[test]
fn a_kind_that_answers_otherwise_the_second_time_is_named_with_how_much() {
    let plugin = |unsteady: &str| {
        format!(
            r#"
import os
from osteoflow_node import Text, node, payload, source


@payload("u/R")
class R:
    """A number."""

    number: float


@source("u.src", output="text")
def src() -> Text:
    """A text."""
    yield 0, Text("a")


@node("u.random", output="r"{unsteady})
def random(text: Text) -> R:
    """Another number each time."""
    return R(1.0 + os.urandom(1)[0] / 256 + os.urandom(1)[0] / 65536)


@node("u.relay", output="r")
def relay(r: R) -> R:
    """The same number."""
    return R(r.number)
"#
        )
    };
    let graph = "plugins = [\"u.py\"]\n[graph]\nformat = 1\n[node.src]\nkind = \"u.src\"\n[node.a]\nkind = \"u.random\"\n\
                 in = { text = \"src.text\" }\n[node.b]\nkind = \"u.relay\"\nin = { r = \"a.r\" }\n[results]\nr = \"b.r\"\n\
                 [sweep]\nrepeat = 3\ntwice = 1.0\n[sweep.columns]\nx = \"r.number\"\n";
    let files = [("u.py", plugin("")), ("declared.py", plugin(", unsteady=True")), ("g.toml", graph.into())];
    let files = files.each_ref().map(|(name, text)| (*name, text.as_str()));
    let Some(folder) = Folder::new("a kind that answers otherwise", &files) else { return };
    let results = Results(&folder);
    let printed = folder.ends_well(&["sweep", "g.toml", "--out", "s"]);
    assert!(printed.contains("u.random answers otherwise the second time, in 3 of 3 runs"), "{printed}");
    assert!(!printed.contains("u.relay answers"), "its input differed: {printed}");
    let twice = &results.json("s/summary.json")["twice"];
    assert_eq!((&twice["n_runs"], &twice["unsteady"][0]["kind"]), (&3.into(), &"u.random".into()), "{twice}");
    assert!(twice["unsteady"][0]["columns"]["x"].as_f64().unwrap() > 0.0, "{twice}");
    folder.ends_well(&["report", "s", "--out", "r.html"]);
    assert!(fs::read_to_string(folder.path("r.html")).unwrap().contains("u.random answers otherwise"));
    // By default the first run is, and none where the share is zero; a kind that says so is not named.
    let none = |arguments: &[&str], n_runs: Option<u64>, out: &str| {
        let printed = folder.ends_well(&[&["sweep", "g.toml", "--out", out], arguments].concat());
        assert_eq!(results.json(&format!("{out}/summary.json"))["twice"]["n_runs"].as_u64(), n_runs, "{printed}");
        printed
    };
    none(&["--set", "sweep.twice=0.02"], Some(1), "default");
    none(&["--set", "sweep.twice=0"], None, "never");
    fs::copy(folder.path("declared.py"), folder.path("u.py")).unwrap();
    assert!(!none(&[], Some(3), "declared").contains("answers otherwise"));
}

/// A plugin that takes its number from a library, which it opens by the foreign functions of the interpreter.
const FOREIGN: &str = "import ctypes, os, time\nSCALE_OF = ctypes.CDLL(os.path.join(os.path.dirname(os.path.abspath(__file__)), \
                       \"libalgo.so\")).algo_factor\nSCALE_OF.restype = ctypes.c_double\n";

#[test]
fn a_library_that_changes_during_a_sweep_ends_in_failed_rows_with_its_name() {
    let node = HELPED.replace("import helper\n", FOREIGN).replace("helper.SCALE", "SCALE_OF()");
    let node = node.replace("    return R", "    time.sleep(0.1)\n    return R");
    let graph =
        GRAPH.replace("repeat = 4", "repeat = 8").replace("kind = \"st.f\"\n", "kind = \"st.f\"\npool = false\n");
    let Some(folder) = Folder::new("a library that changes", &[("st.py", &node), ("g.toml", &graph)]) else { return };
    let algo = |factor: f64| {
        folder.write("algo.c", &format!("double algo_factor(void) {{ return {factor:?}; }}\n"));
        // Under another name first: the processes that use the file keep theirs.
        build::compile(&folder.path("algo.c"), &folder.path("new.so"), &[])
            && fs::rename(folder.path("new.so"), folder.path("libalgo.so")).is_ok()
    };
    if !algo(1.0) {
        return;
    }
    let mut sweep = osteoflow_to_spawn();
    sweep.current_dir(folder.0.path()).env("OSTEOFLOW_PYTHON", &folder.1);
    sweep.args(["sweep", "g.toml", "--out", "s", "--workers", "1", "--set", "sweep.twice=0"]);
    let sweep = sweep.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
    let is_run = |entry: &std::io::Result<fs::DirEntry>| entry.as_ref().is_ok_and(|entry| entry.path().is_file());
    let n_there = || fs::read_dir(folder.path("s/runs")).map_or(0, |runs| runs.filter(is_run).count());
    let began = Instant::now();
    while n_there() < 2 && began.elapsed() < Duration::from_secs(120) {
        thread::sleep(Duration::from_millis(5));
    }
    assert!(algo(2.0));
    let output = sweep.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let runs: Vec<Value> = (0..8)
        .filter(|run| folder.path(&format!("s/runs/{run:06}.json")).exists())
        .map(|run| Results(&folder).json(&format!("s/runs/{run:06}.json")))
        .collect();
    let failed: Vec<_> = runs.iter().filter(|run| run["status"] != "complete").collect();
    assert!(!failed.is_empty() && runs.len() - failed.len() >= 2, "{said}: {runs:#?}");
    for run in failed {
        let reason = run["reason"].as_str().unwrap();
        assert!(reason.contains("libalgo.so") && reason.contains("differs"), "{reason}");
    }
    let whole = runs.iter().filter(|run| run["status"] == "complete");
    assert!(
        whole.clone().all(|run| run["results"]["f"]["number"] == 1.0),
        "no row has the number of the other library"
    );
}

#[test]
fn a_process_that_breaks_the_protocol_serves_no_further_run_and_its_warnings_name_node_and_run() {
    let plugin = r#"
import atexit, os, sys
from osteoflow_node import Context, Text, node, payload, source


@payload("p/R")
class R:
    """Which process it was."""

    pid: int


@source("p.src", output="text")
def src() -> Text:
    """A text."""
    yield 0, Text("a")


@node("p.f", output="r")
def f(text: Text, ctx: Context) -> R:
    """Answers once with outputs that it does not have, and leaves with an exit code."""
    if ctx.seed == 3:
        atexit.register(lambda: os._exit(7))
    if ctx.seed == 1:
        from __main__ import Connection
        send = Connection.send
        def wrong(self, message, fds=()):
            Connection.send = send
            send(self, {"answer": {**message["answer"], "outputs": message["answer"]["outputs"] * 2}}, fds)
        Connection.send = wrong
    return R(os.getpid())
"#;
    let graph = "plugins = [\"p.py\"]\n[graph]\nformat = 1\n[node.src]\nkind = \"p.src\"\n[node.f]\nkind = \"p.f\"\n\
                 in = { text = \"src.text\" }\n[results]\nr = \"f.r\"\n[sweep]\nrepeat = 4\ntwice = 0\n[sweep.columns]\npid = \"r.pid\"\n";
    let Some(folder) = Folder::new("a broken protocol", &[("p.py", plugin), ("g.toml", graph)]) else { return };
    let results = Results(&folder);
    let (_, text) = folder.says(&["sweep", "g.toml", "--out", "s", "--workers", "1"]);
    let run = |run: usize| results.json(&format!("s/runs/{run:06}.json"));
    let pid = |n: usize| run(n)["results"]["r"]["pid"].as_u64().unwrap_or_else(|| panic!("{n}: {:#} {text}", run(n)));
    let reason = run(1)["reason"].as_str().unwrap_or_default().to_owned();
    assert!(reason.contains("answers on 2 outputs of 1"), "{reason}");
    assert!(pid(0) != pid(2) && pid(2) == pid(3), "{} {} {}", pid(0), pid(2), pid(3));
    assert!(text.contains("node \"f\": after its end its process ended with exit code 7"), "{text}");
    // A process of its own for each run is named with its run.
    let (_, text) = folder.says(&["sweep", "g.toml", "--out", "alone", "--workers", "1", "--set", "f.pool=false"]);
    let line = text.lines().find(|line| line.contains("exit code 7")).unwrap_or_else(|| panic!("{text}"));
    assert!(line.contains("run{number=3}") && line.contains("node \"f\""), "{line}");
}
