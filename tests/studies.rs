//! Sweeps whose values are files, of which single runs are repeated, that get more repeats, and whose kinds differ in parameters.

use crate::common::{osteoflow, python::Folder, root};
use serde_json::Value;
use std::{fs, path::Path};

/// Plans on small bones: runs that take a few milliseconds.
const PLANS: &str = r#"
[graph]
format = 1
name   = "plans"
seed   = 3

[node.plan]
kind         = "plan.simulated"
bone.edge_mm = 5.0

[results]
landmarks = "plan.landmarks"
"#;

const COLUMNS: &str = "\n[sweep.columns]\nx_mm = \"landmarks.P1.position_mm.0\"\n";

struct Desk(tempfile::TempDir);

impl Desk {
    fn new(files: &[(&str, &str)]) -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        for (name, text) in files {
            let path = desk.0.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        desk
    }

    /// The stdout, stderr and exit code of `sweep` in the folder.
    fn sweep(&self, arguments: &[&str]) -> (String, String, i32) {
        let mut command = osteoflow();
        let output = command.current_dir(self.0.path()).arg("sweep").args(arguments).output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
        (text(&output.stdout), text(&output.stderr), output.status.code().unwrap())
    }

    fn swept(&self, arguments: &[&str]) -> String {
        let (out, err, code) = self.sweep(arguments);
        assert_eq!(code, 0, "{arguments:?}: {out}{err}");
        out
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.0.path().join(name)).unwrap()
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_str(&self.read(name)).unwrap()
    }

    /// Compares the files that a sweep promises to be the same.
    fn assert_same(&self, a: &str, b: &str) {
        let of = |dir: &str| {
            let runs = fs::read_dir(self.0.path().join(dir).join("runs")).unwrap();
            let mut runs: Vec<_> = runs.filter(|entry| entry.as_ref().unwrap().path().is_file()).collect();
            runs.sort_by_key(|entry| entry.as_ref().unwrap().file_name());
            let runs = runs.into_iter().map(|entry| format!("runs/{}", entry.unwrap().file_name().to_str().unwrap()));
            let tables = ["runs.csv", "points.csv", "summary.json", "sweep.toml"].map(str::to_owned);
            runs.chain(tables).map(|name| (name.clone(), self.read(&format!("{dir}/{name}")))).collect::<Vec<_>>()
        };
        let (ours, theirs) = (of(a), of(b));
        assert_eq!(
            ours.iter().map(|file| &file.0).collect::<Vec<_>>(),
            theirs.iter().map(|file| &file.0).collect::<Vec<_>>()
        );
        for ((name, ours), (_, theirs)) in ours.iter().zip(&theirs) {
            assert!(ours == theirs, "{name} differs:\n{ours}\n{theirs}");
        }
    }
}

#[test]
fn files_and_variants_are_values_of_factors_whose_tables_do_not_depend_on_workers_shards_and_interruptions() {
    let sweep = format!(
        "{PLANS}\n[sweep]\nrepeat = 2\n[sweep.factor]\nbone = {{ variants = \"bones/*.toml\" }}\n\
         note = {{ key = \"graph.name\", files = \"notes/*.txt\" }}\n{COLUMNS}"
    );
    let desk = Desk::new(&[
        ("g.toml", &sweep),
        ("bones/bone_10.toml", "extends = \"../g.toml\"\n[node.plan]\nbone.shape_seed = 10\n"),
        ("bones/bone_9.toml", "[node.plan]\nbone.shape_seed = 9\n"),
        ("notes/a.txt", ""),
        ("notes/b.txt", ""),
    ]);
    desk.swept(&["g.toml", "--out", "whole"]);
    let table = desk.read("whole/runs.csv");
    let cells: Vec<_> = table.lines().map(|row| row.split(',').take(4).collect::<Vec<_>>().join(",")).collect();
    assert_eq!(cells[..4], ["run,bone,note,repeat", "0,bone_9,a,0", "1,bone_9,a,1", "2,bone_9,b,0"]);
    let listed = desk.swept(&["g.toml", "--dry-run"]);
    let first = "run 0: extends=\"bones/bone_9.toml\" graph.name=\"notes/a.txt\" graph.seed=3\n";
    assert!(listed.starts_with(first), "{listed}");
    desk.swept(&["g.toml", "--out", "alone", "--workers", "1", "--no-share", "--no-cache"]);
    for part in ["1/3", "2/3", "3/3"] {
        desk.swept(&["g.toml", "--shard", part, "--out", &part[..1]]);
    }
    desk.swept(&["--merge", "3", "1", "2", "--out", "merged"]);
    desk.swept(&["g.toml", "--out", "cut"]);
    fs::remove_file(desk.0.path().join("cut/runs/000005.json")).unwrap();
    desk.swept(&["g.toml", "--out", "cut", "--resume"]);
    for other in ["alone", "merged", "cut"] {
        desk.assert_same("whole", other);
    }
    // A run of the folder needs no files of changes any more.
    fs::remove_dir_all(desk.0.path().join("bones")).unwrap();
    let (_, err, code) = desk.sweep(&["whole", "--only", "6", "--record", "one"]);
    assert!(code == 0 && !err.contains("other results"), "{err}");
    assert_eq!(desk.json("one/results.json"), desk.json("whole/runs/000006.json")["results"]);
    let (_, err, code) = desk.sweep(&["g.toml", "--out", "cut", "--resume"]);
    assert!(
        code == 2 && err.contains("no file matches bones/*.toml") && err.contains("there is no folder bones"),
        "{err}"
    );
    for (name, text) in [("bone_9", "[node.plan]\nbone.shape_seed = 11\n"), ("bone_8", "")] {
        fs::create_dir_all(desk.0.path().join("bones")).unwrap();
        fs::write(desk.0.path().join(format!("bones/{name}.toml")), text).unwrap();
    }
    let (_, err, code) = desk.sweep(&["g.toml", "--out", "cut", "--resume"]);
    assert_eq!(code, 2);
    for expected in [
        "its factor bone has another value \"bone_9\"",
        "its factor bone has no value \"bone_8\"",
        "its factor bone has the value \"bone_10\"",
    ] {
        assert!(err.contains(expected), "{expected}\n---\n{err}");
    }
}

#[test]
fn a_shipped_variant_is_a_value_of_a_factor_and_two_are_extended_at_once() {
    let graphs = root().join("graphs");
    let [fibula, point, ruled] = ["fibula.toml", "variants/fibula_point_to_point.toml", "variants/fibula_ruled.toml"]
        .map(|file| graphs.join(file));
    let sweep = format!(
        "extends = {fibula:?}\n[sweep.factor]\nmethod = {{ variants = [{point:?}, {ruled:?}] }}\n[sweep.columns]\n\
         tre_mm = \"metrics.tre_true_mm.mean_abs.norm\"\n"
    );
    let both = format!("extends = [{point:?}, {ruled:?}]\n[graph]\nname = \"both\"\n");
    let desk = Desk::new(&[("g.toml", &sweep), ("both.toml", &both)]);
    let listed = desk.swept(&["g.toml", "--dry-run"]);
    assert_eq!(listed.lines().count(), 2, "{listed}");
    assert!(
        listed.contains("fibula_point_to_point.toml\" graph.seed=") && listed.contains("fibula_ruled.toml\""),
        "{listed}"
    );
    let expand = osteoflow().arg("expand").arg(desk.0.path().join("both.toml")).output().unwrap();
    let text = String::from_utf8(expand.stdout).unwrap();
    assert!(expand.status.success() && text.contains("name = \"both\""), "{text}");
    let alone = |file: &Path| String::from_utf8(osteoflow().arg("expand").arg(file).output().unwrap().stdout).unwrap();
    let (of_point, of_ruled) = (alone(&point), alone(&ruled));
    let kinds =
        |text: &str| text.lines().filter(|line| line.starts_with("kind = ")).map(str::to_owned).collect::<Vec<_>>();
    let icp = "kind = \"icp.point_to_point\"".to_owned();
    assert!(
        kinds(&text).contains(&icp) && kinds(&of_point).contains(&icp) && !kinds(&of_ruled).contains(&icp),
        "{text}"
    );
    assert!(kinds(&of_ruled).iter().all(|kind| kinds(&text).contains(kind) || kind.contains("icp.")), "{text}");
}

#[test]
fn single_runs_are_repeated_with_a_recording_and_their_results_are_those_of_the_rows() {
    let sweep = format!(
        "{PLANS}\n[sweep]\nrepeat = 2\n[sweep.factor]\nshape = {{ key = \"plan.bone.shape_seed\", values = [1, 2, 3] }}\n\
         [sweep.draw]\nedge_mm = {{ key = \"plan.bone.edge_mm\", uniform = [3.0, 5.0] }}\n{COLUMNS}"
    );
    let desk = Desk::new(&[("g.toml", &sweep)]);
    desk.swept(&["g.toml", "--only", "3", "--record", "before"]);
    desk.swept(&["g.toml", "--out", "S"]);
    assert_eq!(desk.json("before/results.json"), desk.json("S/runs/000003.json")["results"]);
    let (_, err, code) = desk.sweep(&["S", "--only", "5,2-3", "--record", "after"]);
    assert!(code == 0 && !err.contains("other results"), "{err}");
    for run in ["000002", "000003", "000005"] {
        assert_eq!(
            desk.json(&format!("after/{run}/results.json")),
            desk.json(&format!("S/runs/{run}.json"))["results"]
        );
    }
    assert_eq!(desk.json("after/000005/manifest.json")["command"]["sweep_run"], 5);
    let replay = osteoflow().arg("replay").arg(desk.0.path().join("after/000005/run.mcap")).output().unwrap();
    assert!(replay.status.success(), "{}", String::from_utf8_lossy(&replay.stdout));
    let listed = desk.swept(&["g.toml", "--only", "3,5", "--dry-run"]);
    let numbers: Vec<_> = listed.lines().map(|line| line.split(':').next().unwrap()).collect();
    assert_eq!(numbers, ["run 3", "run 5"], "{listed}");
    // Without a folder, a new one of its own.
    desk.swept(&["g.toml", "--only", "0"]);
    let made: Vec<_> =
        fs::read_dir(desk.0.path().join("runs")).unwrap().map(|e| e.unwrap().path().join("run.mcap")).collect();
    assert!(made.len() == 1 && made[0].is_file(), "{made:?}");
    // A row that is another now is named.
    let mut row = desk.json("S/runs/000001.json");
    row["results"]["landmarks"] = Value::Null;
    fs::write(desk.0.path().join("S/runs/000001.json"), row.to_string()).unwrap();
    let (_, err, code) = desk.sweep(&["S", "--only", "1", "--record", "other"]);
    assert!(code == 0 && err.contains("run 1 has other results in S"), "{err}");
    for (arguments, expected) in [
        (&["g.toml", "--only", "6"][..], "g.toml has no run 6"),
        (&["S", "--only", "7"], "S has no run 7; it has 6 runs up to 5"),
        (&["S", "--only", "1", "--record", "S"], "S is not empty"),
        (&["S", "--only", "2-1"], "numbers or ranges, such as 3 or 7-9"),
        (&["S", "--only", "1", "--out", "T"], "cannot be used with"),
        (&["g.toml", "--record", "T"], "--only"),
    ] {
        let (_, err, code) = desk.sweep(arguments);
        assert!(code == 2 && err.contains(expected), "{arguments:?}: {err}");
    }
}

#[test]
fn a_sweep_that_gets_more_repeats_has_the_files_of_one_that_had_them_at_once() {
    let sweep = format!(
        "{PLANS}\n[sweep]\nrepeat = 2\ntwice = 0.3\nunits = [\"plan\"]\n[sweep.factor]\nshape = {{ key = \
         \"plan.bone.shape_seed\", values = [1, 2, 3] }}\n[sweep.draw]\nedge_mm = {{ key = \"plan.bone.edge_mm\", uniform = \
         [3.0, 5.0] }}\n{COLUMNS}"
    );
    let desk = Desk::new(&[("g.toml", &sweep)]);
    let five = ["--set", "sweep.repeat=5"];
    desk.swept(&[&["g.toml", "--out", "whole"], &five[..]].concat());
    desk.swept(&["g.toml", "--out", "grown"]);
    let out = desk
        .swept(&[&["g.toml", "--out", "grown", "--resume", "--format", "json", "--workers", "1"], &five[..]].concat());
    let runs = serde_json::from_str::<Value>(&out).unwrap()["runs"].clone();
    assert_eq!((&runs["there_before"], &runs["run"]), (&6.into(), &9.into()), "{runs}");
    desk.assert_same("whole", "grown");
    for (name, part) in [("p1", "1/2"), ("p2", "2/2")] {
        desk.swept(&["g.toml", "--out", name, "--shard", part]);
    }
    desk.swept(&["--merge", "p1", "p2", "--out", "merged"]);
    desk.swept(&[&["g.toml", "--out", "merged", "--resume"], &five[..]].concat());
    desk.assert_same("whole", "merged");
    let other = ["g.toml", "--out", "grown", "--resume", "--set", "sweep.repeat=9", "--set", "graph.seed=4"];
    let (_, err, code) = desk.sweep(&other);
    assert!(code == 2 && err.contains("seed: it 3, the other 4") && !err.contains("its repeat"), "{err}");
    let (_, err, code) = desk.sweep(&["g.toml", "--out", "grown", "--resume"]);
    assert!(code == 2 && err.contains("its repeat is 5, not 2"), "{err}");
}

/// Ways to thin a cloud, each with a parameter of its own.
const THIN: &str = r#"
from dataclasses import dataclass

import numpy as np
from osteoflow_node import Cloud, Text, node, param, source


@dataclass
class Line:
    n: int = param(100, ge=1, le=1000, doc="Number of points.")


@source("thin.line", output="cloud")
def line(params: Line) -> Cloud:
    """Points on a line."""
    yield 0, Cloud("camera", np.arange(3.0 * params.n).reshape(-1, 3))


@dataclass
class First:
    share: float = param(0.5, gt=0, le=1, doc="Share of the points that stay.")


@node("thin.first", output="cloud")
def first(cloud: Cloud, params: First) -> Cloud:
    """The first points."""
    return cloud.chosen(slice(0, int(len(cloud) * params.share)))


@dataclass
class Every:
    step: int = param(2, ge=1, le=100, doc="One point in this many stays.")


@node("thin.every", output="cloud")
def every(cloud: Cloud, params: Every) -> Cloud:
    """One point in some."""
    return cloud.chosen(slice(0, None, params.step))


@node("thin.count", output="text")
def count(cloud: Cloud) -> Text:
    """The number of points."""
    return Text(str(len(cloud)))
"#;

#[test]
fn kinds_with_parameters_of_their_own_are_exchanged_within_a_sweep() {
    let graph = |values: &str| {
        format!(
            "plugins = [\"thin.py\"]\n[graph]\nformat = 1\nname = \"thin\"\n[node.line]\nkind = \"thin.line\"\n[node.thin]\n\
             kind = \"thin.first\"\nin.cloud = \"line.cloud\"\nshare = 0.25\n[node.count]\nkind = \"thin.count\"\nin.cloud = \
             \"thin.cloud\"\n[results]\nn = \"count.text\"\n[sweep.factor]\nkind = {{ values = {values} }}\n[sweep.columns]\n\
             n = \"n\"\n"
        )
    };
    let tables = "[{ thin.kind = \"thin.first\" }, { thin.kind = \"thin.every\", thin.step = 5, remove = [\"node.thin.share\"] }, \
                  { thin.kind = \"crop.box\", thin.min_mm = [0.0, 0.0, 0.0], thin.max_mm = [8.5, 8.5, 8.5], \
                  remove = [\"node.thin.share\"] }], labels = [\"first\", \"every\", \"box\"]";
    let more = THIN.replace("\"thin.", "\"more.");
    let method = graph("[]").replace("kind = { values = [] }", "method = { variants = [\"own.toml\", \"half.toml\"] }");
    let own =
        "plugins = [\"more.py\"]\nremove = [\"node.thin.share\"]\n[node.thin]\nkind = \"more.every\"\nstep = 10\n";
    let files = [
        ("thin.py", THIN),
        ("more.py", &*more),
        ("g.toml", &*graph(tables)),
        ("names.toml", &*graph("[\"thin.first\", \"thin.every\"], key = \"thin.kind\"")),
        ("variants.toml", &*method),
        ("own.toml", own),
        ("half.toml", "[node.thin]\nshare = 0.5\n"),
    ];
    let Some(folder) = Folder::new("kinds that are exchanged", &files) else { return };
    let sweep = |arguments: &[&str]| {
        let mut command = osteoflow();
        command.current_dir(folder.0.path()).arg("sweep").args(arguments).arg("--python").arg(&folder.1);
        let output = command.output().unwrap();
        (String::from_utf8(output.stderr).unwrap(), output.status.code().unwrap())
    };
    for (out, workers) in [("a", "1"), ("b", "3")] {
        let (err, code) = sweep(&["g.toml", "--out", out, "--workers", workers, "--no-cache"]);
        assert_eq!(code, 0, "{err}");
    }
    let read = |name: &str| fs::read_to_string(folder.path(name)).unwrap();
    assert_eq!(read("a/runs.csv"), read("b/runs.csv"));
    let counts = |out: &str| {
        let table = read(&format!("{out}/runs.csv"));
        table.lines().skip(1).map(|row| row.split(',').rev().nth(1).unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(counts("a"), ["25", "20", "3"]);
    // A variant may name a plugin of its own.
    let (err, code) = sweep(&["variants.toml", "--out", "v", "--no-cache"]);
    assert_eq!(code, 0, "{err}");
    assert_eq!(counts("v"), ["10", "50"]);
    // Each of them alone, from the frozen graph, which states the parameters of the first.
    let (err, code) = sweep(&["a", "--only", "0-2", "--record", "r"]);
    assert!(code == 0 && !err.contains("other results"), "{err}");
    let (err, code) = sweep(&["v", "--only", "0", "--record", "rv"]);
    assert!(code == 0 && !err.contains("other results"), "{err}");
    let (err, code) = sweep(&["names.toml", "--dry-run"]);
    let remedy = "{ thin.kind = \"thin.every\", remove = [\"node.thin.share\"] }";
    assert!(code == 2 && err.contains("thin.every has no parameter \"share\"") && err.contains(remedy), "{err}");
    assert!(err.contains("names.toml:10:1") && err.contains("in run 1 of the sweep: kind = \"thin.every\""), "{err}");
}
