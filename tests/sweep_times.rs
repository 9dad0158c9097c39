//! How long nodes take in a sweep: in `times.csv`, as columns, in the report, and in no number that has to be repeated.

use crate::common::python::Folder;
use serde_json::Value;
use std::{collections::BTreeMap, fs, path::Path};

/// A source, and nodes that compute, wait and lie for 60 ms.
const NODE: &str = r#"
import os
import time
import numpy as np
from osteoflow_node import Cloud, node, payload, source


@payload("t/R")
class R:
    """A number."""

    number: float
    processors: int


@source("t.src", output="cloud")
def src() -> Cloud:
    """One cloud."""
    yield 0, Cloud("camera", np.arange(30.0).reshape(10, 3))


def answer(cloud):
    return R(float(cloud.points.sum()), len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0)


@node("t.computes", output="r")
def computes(cloud: Cloud) -> R:
    """Uses the processor for 60 ms of its time."""
    began = time.process_time()
    while time.process_time() - began < 0.06:
        pass
    return answer(cloud)


@node("t.waits", output="r")
def waits(cloud: Cloud) -> R:
    """Sleeps for 60 ms."""
    time.sleep(0.06)
    return answer(cloud)


@node("t.lies", output="r")
def lies(cloud: Cloud) -> R:
    """Says that it has used a thousand years."""
    clock = time.process_time_ns
    time.process_time_ns = lambda: clock() + 10**19
    return answer(cloud)
"#;

fn graph(sweep: &str) -> String {
    format!(
        "plugins = [\"t.py\"]\n[graph]\nformat = 1\nname = \"times\"\n[node.src]\nkind = \"t.src\"\n[node.f]\nkind = \"t.computes\"\n\
         in = {{ cloud = \"src.cloud\" }}\n[results]\nr = \"f.r\"\n[sweep]\nrepeat = 2\ntwice = 0\nsame_seed = true\n\
         [sweep.factor]\nmethod = {{ key = \"f.kind\", values = [\"t.computes\", \"t.waits\", \"t.lies\"] }}\n\
         [sweep.columns]\nnumber = \"r.number\"\n{sweep}"
    )
}

fn folder(test: &str, sweep: &str) -> Option<Folder> {
    Folder::new(test, &[("t.py", NODE), ("g.toml", &graph(sweep))])
}

/// The rows of a table, each by its heads.
fn rows(file: &Path) -> Vec<BTreeMap<String, String>> {
    let text = fs::read_to_string(file).unwrap();
    let (heads, rows) = text.split_once('\n').unwrap();
    let row = |row: &str| heads.split(',').zip(row.split(',')).map(|(head, cell)| (head.into(), cell.into())).collect();
    rows.lines().map(row).collect()
}

#[test]
fn a_sweep_says_what_each_node_took_on_the_clock_and_of_the_processor() {
    let columns = "f_cpu_ms = \"nodes.f.cpu_ms\"\nall_wall_ms = \"run.wall_ms\"\nseen = \"r.processors\"\n";
    let Some(folder) = folder("times of nodes", columns) else { return };
    let (code, text) = folder.says(&["sweep", "g.toml", "--out", "s", "--workers", "1"]);
    assert_eq!(code, Some(0), "{text}");
    let times = rows(&folder.path("s/times.csv"));
    let number = |row: &BTreeMap<String, String>, key: &str| row[key].parse::<f64>().unwrap();
    let of = |kind: &str| -> Vec<_> { times.iter().filter(|row| row["kind"] == kind).collect() };
    for row in of("t.computes") {
        assert!(number(row, "cpu_ms") >= 60.0 && number(row, "wall_ms") >= number(row, "busy_ms"), "{row:?}");
    }
    for row in of("t.waits") {
        assert!(number(row, "busy_ms") >= 60.0 && number(row, "cpu_ms") < 60.0, "{row:?}");
    }
    // No more than all processors for as long as it was waited for.
    let n = std::thread::available_parallelism().unwrap().get() as f64;
    for row in of("t.lies") {
        assert!(number(row, "cpu_ms") <= (n + 1.0) * number(row, "busy_ms"), "{row:?}");
    }
    assert_eq!([of("t.computes").len(), of("t.waits").len(), of("t.lies").len()], [2, 2, 2]);
    let from: Vec<_> = of("t.src").iter().map(|row| row["from"].as_str()).collect();
    assert_eq!(from, ["computed", "shared", "shared", "shared", "shared", "shared"]);
    // The row without a node is the run's: what others have computed is none of it.
    let runs: Vec<_> = times.iter().filter(|row| row["node"].is_empty()).collect();
    for row in &runs {
        let own = times.iter().filter(|other| other["run"] == row["run"] && other["from"] == "computed");
        let sum: f64 = own.map(|other| number(other, "cpu_ms")).fold(0.0, |sum, time| sum + time);
        assert_eq!(number(row, "cpu_ms"), sum, "{row:?}");
    }
    // The columns are the same numbers.
    for (run, row) in rows(&folder.path("s/runs.csv")).iter().enumerate() {
        let of_node = times.iter().find(|other| other["run"] == run.to_string() && other["node"] == "f").unwrap();
        assert_eq!(row["f_cpu_ms"], of_node["cpu_ms"]);
        assert_eq!(row["all_wall_ms"], runs[run]["wall_ms"]);
    }
    // A library that counts processors when it is first used has one, as many rows run as there are.
    if cfg!(target_os = "linux") {
        // With seeds of their own nothing is shared: the process of the first row fires again for the second.
        let arguments = ["sweep", "g.toml", "--out", "s2", "--workers", "1", "--set", "sweep.same_seed=false"];
        assert_eq!(folder.says(&arguments).0, Some(0));
        let seen: Vec<_> = rows(&folder.path("s2/runs.csv")).iter().map(|row| row["seen"].clone()).collect();
        assert_eq!((&*seen[0], &*seen[1]), ("1", &*n.to_string()), "{seen:?}");
    }
    let (code, text) = folder.says(&["report", "s"]);
    assert_eq!(code, Some(0), "{text}");
    let page = fs::read_to_string(folder.path("s/report.html")).unwrap().replace("<wbr>", "");
    assert!(page.contains("number against f cpu (ms)"), "the error is drawn against the time");
}

#[test]
fn times_are_no_part_of_what_has_to_be_repeated() {
    let Some(folder) = folder("times and repeated tables", "") else { return };
    for (out, workers) in [("one", "1"), ("two", "2")] {
        let (code, text) = folder.says(&["sweep", "g.toml", "--out", out, "--workers", workers]);
        assert_eq!(code, Some(0), "{text}");
    }
    for name in ["runs.csv", "points.csv", "summary.json", "runs/000002.json"] {
        let read = |out: &str| fs::read_to_string(folder.path(&format!("{out}/{name}"))).unwrap();
        assert_eq!(read("one"), read("two"), "{name}");
    }
    for part in ["1", "2"] {
        let (shard, out) = (format!("{part}/2"), format!("part{part}"));
        let (code, text) = folder.says(&["sweep", "g.toml", "--out", &out, "--shard", &shard]);
        assert_eq!(code, Some(0), "{text}");
    }
    let (code, text) = folder.says(&["sweep", "--merge", "part1", "part2", "--out", "whole"]);
    assert_eq!(code, Some(0), "{text}");
    let n = |out: &str| rows(&folder.path(&format!("{out}/times.csv"))).len();
    assert_eq!((n("whole"), n("part1") + n("part2")), (18, 18), "three rows for each of six runs");
    // A sweep of a version that measured nothing is still one.
    fs::remove_dir_all(folder.path("one/runs/times")).unwrap();
    fs::remove_file(folder.path("one/runs/000005.json")).unwrap();
    let (code, text) = folder.says(&["sweep", "g.toml", "--out", "one", "--resume"]);
    assert_eq!(code, Some(0), "{text}");
    assert_eq!(n("one"), 3);
}

#[test]
fn a_time_that_there_is_not_is_a_fault_of_the_graph() {
    let wrong = [
        ("nodes.g.cpu_ms", "asks for the time of \"g\", which is no node"),
        ("nodes.f.seconds", "asks for nodes.f.seconds, which no node has"),
        ("run.seconds", "asks for run.seconds, which no run has"),
    ];
    let columns: String = wrong.iter().enumerate().map(|(k, (path, _))| format!("c{k} = \"{path}\"\n")).collect();
    let Some(folder) = folder("faults of times", &columns) else { return };
    let (code, text) = folder.says(&["check", "g.toml"]);
    assert_eq!(code, Some(2), "{text}");
    for (_, message) in wrong {
        assert!(text.contains(message), "{message}: {text}");
    }
    assert!(text.contains("write \"nodes.f.cpu_ms\"") && text.contains("busy_ms, cpu_ms, wall_ms"), "{text}");
    let faults = folder.says(&["check", "g.toml", "--format", "json"]).1;
    let faults: Value = serde_json::from_str(faults.trim()).unwrap();
    let lines: Vec<_> =
        faults["faults"].as_array().unwrap().iter().map(|fault| fault["line"].as_u64().unwrap()).collect();
    assert_eq!(lines, [20, 21, 22]);
}
