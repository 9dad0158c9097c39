//! Nodes in Python: they agree with built-in ones, and what is wrong in them is said at its place.

use crate::common::{WHITE, is_slow_run, osteoflow, osteoflow_to_spawn, page::Page, python::Folder, root};
use osteoflow_geometry::nalgebra::{Matrix4, Point3};
use serde_json::{Value, json};
use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::mpsc::sync_channel,
    thread,
    time::{Duration, Instant},
};

struct Left {
    code: Option<i32>,
    stderr: String,
    results: Value,
}

trait RunsGraphs {
    fn run(&self, graph: &str, arguments: &[&str]) -> Left;
}

impl RunsGraphs for Folder {
    fn run(&self, graph: &str, arguments: &[&str]) -> Left {
        let out = tempfile::tempdir_in(self.0.path()).unwrap().path().join("run");
        let mut command = osteoflow();
        command.arg("run").arg(self.path(graph)).arg("--out").arg(&out).args(arguments).arg("--python").arg(&self.1);
        let output = command.output().unwrap();
        let results = fs::read(out.join("results.json")).unwrap_or_default();
        Left {
            code: output.status.code(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
            results: serde_json::from_slice(&results).unwrap_or(Value::Null),
        }
    }
}

const SOURCE: &str = r#"
[graph]
format = 1

[node.recording]
kind = "acquire.simulated"
camera.n_points = 1000
"#;

fn matrix(value: &Value) -> Matrix4<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value["matrix"].clone()).unwrap();
    Matrix4::from_row_slice(&rows.concat())
}

#[test]
fn the_icp_of_the_template_agrees_with_the_built_in_one() {
    let Some(folder) = Folder::new("an ICP in Python", &[]) else { return };
    let new = osteoflow()
        .current_dir(folder.0.path())
        .args(["new", "plugin", "my_fit", "--lang", "python"])
        .output()
        .unwrap();
    let said = String::from_utf8(new.stdout).unwrap();
    assert!(new.status.success() && said.contains("osteoflow run graphs/my_fit.toml"), "{said}");
    let small = "recording.camera.n_points=5000";
    // Outliers let the pairs of the template change in a cycle.
    let stop = ["--set", "icp.stop_step_mm=1e-8", "--set", "results.fit=icp.t_target_source", "--set", small];
    let stop = [&stop[..], &WHITE[..]].concat();
    let here = folder.run("my_fit/graphs/my_fit.toml", &stop);
    assert_eq!(here.code, Some(0), "{}", here.stderr);
    let graph = "extends = \"fibula.toml\"\n[node.icp]\ngate_sigmas = 0.0\none_sided = false\nlevels = []\npairing = \"tree\"\n\
                 stop_step_rad = 1e-10\n";
    folder.write("my_fit/graphs/built_in.toml", graph);
    let built_in = folder.run("my_fit/graphs/built_in.toml", &stop);
    assert_eq!(built_in.code, Some(0), "{}", built_in.stderr);
    let (here_fit, there) = (matrix(&here.results["fit"]), matrix(&built_in.results["fit"]));
    // Where pairs change in a cycle there are several minima; the report tells how far off another one is.
    let report = &built_in.results["icp"];
    let [remaining_mm, lever_arm_mm] =
        [&report["remaining_mm"], &report["observability"]["lever_arm_mm"]].map(|value| value.as_f64().unwrap());
    assert!(remaining_mm < 1e-4, "{remaining_mm} mm");
    let scanned = Point3::from_slice(&there.fixed_view::<3, 1>(0, 3).clone_owned().as_slice()[..3]);
    for offset in [-50.0, 0.0, 50.0] {
        let point = there
            .try_inverse()
            .unwrap()
            .transform_point(&(scanned + osteoflow_geometry::nalgebra::Vector3::repeat(offset)));
        let off_mm = (here_fit.transform_point(&point) - there.transform_point(&point)).norm();
        // The report tells the movement at the lever arm; further out, a rotation moves points further.
        let reach = 1.0 + 3_f64.sqrt() * offset.abs() / lever_arm_mm;
        assert!(off_mm < 1e-6 + reach * remaining_mm, "{off_mm} mm, {remaining_mm} mm by the report");
    }
    let report = &here.results["icp"];
    assert_eq!((&report["n_pairs"], report["rms_mm"].as_f64().unwrap() < 0.1), (&5000.into(), true), "{report}");
    // As a plugin in any language: the recording replays to the same bits, and `process = false` is no way out.
    let refused = folder.run("my_fit/graphs/my_fit.toml", &["--set", "icp.process=false", "--set", small]);
    assert!(refused.code != Some(0) && refused.stderr.contains("take process = false out"), "{}", refused.stderr);
}

/// Points of a scan that is quickly registered.
const SMALL: &str = "recording.camera.n_points=8000";

#[test]
fn the_page_leads_from_a_node_to_a_report_and_to_somebody_else() {
    let Some(folder) = Folder::new("the commands of the page", &[]) else { return };
    let mut page = Page::open("docs/extend/python-nodes.md", folder.0.path(), Some(&folder.1)).adding(|command| {
        let is_sweep = command.starts_with("osteoflow sweep graphs/");
        match command.split(' ').nth(1) {
            Some("run") => &["--set", SMALL],
            Some("sweep") if is_sweep => &["--set", SMALL, "--set", "sweep.repeat=1", "--set", "sweep.twice=0"],
            _ => &[],
        }
    });
    let done = page.follow(|command| if command.starts_with("osteoflow replay ") { 4 } else { 0 }, |_, _, _| {});
    assert_eq!(done.len(), 12, "the template, its packages, its run, and eight commands on the way to somebody else");
    let replay = done.iter().find(|done| done.command.contains(" replay ")).unwrap();
    assert!(replay.printed.contains("not comparable"), "{}", replay.printed);
    let at = folder.path("my_icp");
    // Where it is unknown which parameters go with their kind, the rows of a rerun would not be those of the sweep.
    let mut about: Value = serde_json::from_slice(&fs::read(at.join("S/sweep.json")).unwrap()).unwrap();
    assert!(about.as_object_mut().unwrap().remove("written").is_some());
    fs::write(at.join("S/sweep.json"), about.to_string()).unwrap();
    let mut export = osteoflow();
    let output = export.current_dir(&at).args(["export", "S", "unknown.zip"]).output().unwrap();
    let (code, said) = (output.status.code(), String::from_utf8_lossy(&output.stderr));
    assert!(
        code != Some(0) && said.contains("which parameters were written") && !at.join("unknown.zip").exists(),
        "{said}"
    );
    let rows = fs::read_to_string(at.join("S/runs.csv")).unwrap();
    let of = |kind: &str| -> Vec<Vec<f64>> {
        let of_kind = rows.lines().filter(|row| row.contains(kind));
        of_kind.map(|row| row.split(',').skip(7).take(2).map(|cell| cell.parse().unwrap()).collect()).collect()
    };
    let (ours, theirs) = (of(",my_icp.point_to_plane"), of(",icp.point_to_plane"));
    assert_eq!((ours.len(), theirs.len()), (2, 2), "{rows}");
    for (ours, theirs) in ours.iter().zip(&theirs) {
        assert!((ours[0] - theirs[0]).abs() < 0.05, "the same surface, TRE {} and {} mm", ours[0], theirs[0]);
        assert!(ours[1] > 0.0 && theirs[1] > 0.0);
    }
    assert!(at.join("row3/run.mcap").is_file() && at.join("S/report.html").is_file());
    let page = fs::read_to_string(at.join("S/report.html")).unwrap().replace("<wbr>", "");
    assert!(
        page.contains("chen1992")
            && page.contains("Registers a scan onto")
            && !page.contains(folder.0.path().to_str().unwrap())
    );
}

#[test]
fn sources_sinks_and_payloads_of_ones_own_travel_as_any() {
    let plugin = r#"
from dataclasses import dataclass
from typing import Annotated, Optional
import numpy as np
from osteoflow_node import Cloud, Context, Points, column, node, param, payload, port, source


@payload("acme/Wave", version=3)
class Wave:
    label: str
    gain: float
    on: bool
    n: int
    taps: list[float]
    note: Optional[str] = None
    samples: np.ndarray = column("f32", 2, unit="mm")


@dataclass
class Params:
    n: int = param(3, ge=0, le=100, doc="How many.")


@source("acme.waves", output="wave")
def waves(params: Params, ctx: Context) -> Wave:
    """Gives waves."""
    for k in range(params.n):
        yield 1_000_000 * k, Wave("w", float(ctx.rng().random()), k % 2 == 0, k, [1.0, 2.0], None, np.full((4, 2), k))


@node("acme.sum", output="points")
def sums(wave: Wave, scale: Optional[Points], ctx: Context) -> Points:
    """Sums a wave."""
    assert scale is None and "nothing is wired" in ctx.absent_reason("scale"), ctx.absent_reason("scale")
    assert isinstance(wave, Wave) and wave.note is None and wave.taps == [1.0, 2.0] and wave.samples.shape == (4, 2)
    if wave.n == 1:
        ctx.warn("one")
    return Points("ct", ["a"], [[wave.samples.sum(), wave.gain, float(wave.on)]], ctx.stamp_ns)


@node("acme.write")
def write(points: Points, ctx: Context) -> None:
    """Writes points."""
    with open(f"{ctx.out_dir}/{ctx.node}-{ctx.item}.txt", "w") as file:
        file.write(f"{points.names} {points.positions.tolist()[0][0]}")


@node("acme.all", output="points")
def all_of(points: list[Points]) -> Points:
    """The first of all."""
    return Points("ct", ["n"], [[len(points), 0, 0]])
"#;
    let graph = r#"
plugins = ["acme.py"]
[graph]
format = 1
[node.waves]
kind = "acme.waves"
n = 4
[node.sum]
kind = "acme.sum"
in = { wave = "waves.wave" }
[node.write]
kind = "acme.write"
in = { points = "sum.points" }
[node.all]
kind = "acme.all"
in = { points = "sum.points" }
[record]
wires = ["*"]
[results]
sums = { from = "sum.points", all = true }
n = "all.points"
wave = "waves.wave"
"#;
    let Some(folder) = Folder::new("sources and sinks in Python", &[("acme.py", plugin), ("acme.toml", graph)]) else {
        return;
    };
    let out = folder.path("out");
    let run = |out: &Path| {
        let mut command = osteoflow();
        command.arg("run").arg(folder.path("acme.toml")).arg("--out").arg(out).arg("--python").arg(&folder.1);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        (fs::read_to_string(out.join("results.json")).unwrap(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (text, said) = run(&out);
    let results: Value = serde_json::from_str(&text).unwrap();
    let x = |k: usize| results["sums"][k][0]["position_mm"].clone();
    assert_eq!((&x(0)[0], &x(3)[0], &x(0)[2], &x(3)[2]), (&json!(0.0), &json!(24.0), &json!(1.0), &json!(0.0)));
    assert_ne!(x(0)[1], x(1)[1], "draws differ by item");
    assert_eq!(results["n"][0]["position_mm"][0], 4.0);
    assert_eq!(results["wave"]["samples"], json!([[3.0, 3.0], [3.0, 3.0], [3.0, 3.0], [3.0, 3.0]]));
    assert!(said.contains("node \"sum\", item 1: one"), "{said}");
    assert_eq!(fs::read_to_string(out.join("write-3.txt")).unwrap(), "['a'] 24.0");
    assert_eq!(run(&folder.path("again")).0, text, "draws are those of seed, node and item");
    let mut replay = osteoflow();
    replay.arg("replay").arg(&out).arg("--out").arg(folder.path("replayed")).arg("--python").arg(&folder.1);
    let output = replay.output().unwrap();
    let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    assert!(output.status.success() && said.contains("equal"), "{said}");
}

/// A plugin with one node whose body is given.
fn relay(body: &str) -> String {
    format!(
        "from osteoflow_node import *\nimport numpy as np, os, sys, time\n\n@node(\"bad.relay\", output=\"cloud\")\n\
         def relay(cloud: Cloud, ctx: Context) -> Cloud:\n    \"\"\"Passes clouds on.\"\"\"\n{body}\n"
    )
}

#[test]
fn what_is_wrong_in_a_plugin_is_said_at_its_line() {
    let graph = format!(
        "plugins = [\"bad.py\"]\n{SOURCE}\n[node.relay]\nkind = \"bad.relay\"\nin = {{ cloud = \"recording.laser\" }}\n\
         [results]\nclouds = {{ from = \"relay.cloud\", all = true }}\n"
    );
    let Some(folder) = Folder::new("faults in Python", &[("graph.toml", &graph)]) else { return };
    for (body, expected) in [
        ("    return cloud.nothing", "bad.py:7: AttributeError: 'Cloud' object has no attribute 'nothing'"),
        ("    raise NodeError(\"no hole\")", "item 0: no hole"),
        ("    cloud.points[0] = 0.0\n    return cloud", "bad.py:7: ValueError: assignment destination is read-only"),
        ("    return 3", "output \"cloud\" must be a Cloud, found a int"),
        ("    return Cloud(cloud.frame, np.zeros((5, 2)))", "points must have shape (n, 3), found (5, 2)"),
        ("    return Cloud(cloud.frame, np.full((5, 3), np.nan))", "output \"cloud\": geometry/Cloud"),
        ("    return Cloud(cloud.frame, np.ones((5, 3)), normals=np.ones((5, 3)))", "output \"cloud\": geometry/Cloud"),
        ("    return Pose(\"a\", \"b\", np.diag([1, 1, -1, 1]))", "it scales, shears or mirrors"),
        ("    os._exit(0)", "its process ended with exit code 0, without an answer"),
        ("    sys.exit(0)", "bad.py:7: SystemExit: 0"),
        ("    os.abort()", "its process ended by signal 6, SIGABRT (abort, or an exception that nothing caught)"),
        ("    return relay(cloud, ctx)", "RecursionError: maximum recursion depth exceeded"),
    ]
    .into_iter()
    .step_by(if is_slow_run() { 1 } else { 2 })
    {
        folder.write("bad.py", &relay(body));
        let failed = folder.run("graph.toml", &[]);
        assert_eq!(failed.code, Some(3), "{body}: {}", failed.stderr);
        assert!(failed.stderr.contains("node \"relay\", item 0: "), "{body}: {}", failed.stderr);
        assert!(failed.stderr.contains(expected), "{body}: {expected}: {}", failed.stderr);
    }
    // What is kept of earlier items stays what it was, though memory is used again.
    let keep = "    relay.kept = getattr(relay, 'kept', []) + [(cloud.points, cloud.points.copy())]\n    assert all((a == b).all() \
                for a, b in relay.kept)\n    assert len({tuple(a[0]) for a, _ in relay.kept}) == len(relay.kept) == ctx.item + 1\n    \
                return cloud";
    folder.write("bad.py", &relay(keep));
    let kept = folder.run("graph.toml", &[]);
    assert_eq!(kept.code, Some(0), "{}", kept.stderr);
    let stale = "    from __main__ import Connection\n    send = Connection.send\n    Connection.send = lambda self, message, \
                 fds=(): send(self, {**message, 'answer': {**message['answer'], 'item': 7}}, fds)\n    return cloud";
    folder.write("bad.py", &relay(stale));
    let failed = folder.run("graph.toml", &[]);
    assert!(failed.stderr.contains("its process answers for item 7, and was stopped"), "{}", failed.stderr);
    folder.write("bad.py", &relay("    import logging\n    while True:\n        logging.error('again')"));
    let loud = folder.run("graph.toml", &["--set", "relay.stop_after_s=0.5", "-q"]);
    assert!(loud.stderr.contains("it did not answer within 0.5 s"), "it logs without end");
    folder.write("bad.py", &relay("    time.sleep(60)"));
    let began = Instant::now();
    let slow = folder.run("graph.toml", &["--set", "relay.stop_after_s=0.5"]);
    assert!(slow.stderr.contains("it did not answer within 0.5 s"), "{}", slow.stderr);
    assert!(began.elapsed() < Duration::from_secs(30));
    for (text, expected) in [
        ("def f(:\n", "bad.py:1: SyntaxError: invalid syntax"),
        ("import no_such_package\n", "bad.py:1: the interpreter "),
        ("import no_such_package.inner\n", "-m pip install no_such_package, or name another interpreter"),
        ("import cv2_not_there, cv2\n", "-m pip install cv2_not_there"),
        ("x = 1\n", "it has no node"),
        (
            "from osteoflow_node import *\n@node(\"bad.relay\")\ndef f(cloud) -> Cloud: ...\n",
            "port \"cloud\" has no type",
        ),
        (
            "from osteoflow_node import *\n@node(\"bad.relay\")\ndef f(cloud: int) -> Cloud: ...\n",
            "but must be a payload",
        ),
        ("import os\nos._exit(0)\n", "it ended the process that looked at it"),
    ] {
        folder.write("bad.py", text);
        let failed = folder.run("graph.toml", &[]);
        assert_eq!(failed.code, Some(2), "{text}: {}", failed.stderr);
        assert!(failed.stderr.contains(expected), "{text}: {expected}: {}", failed.stderr);
    }
    // Several outputs: what is returned is named with its line.
    folder.write(
        "bad.py",
        "from typing import NamedTuple\nfrom osteoflow_node import *\nclass Both(NamedTuple):\n    cloud: Cloud\n    other: Cloud\n\
         @node(\"bad.relay\")\ndef f(cloud: Cloud) -> Both:\n    if cloud is None:\n        raise ValueError\n    return cloud\n",
    );
    let wrong = folder.run("graph.toml", &[]);
    let expected = "bad.py:10: it returns a Cloud, and a Both is expected; write return Both(cloud=.., other=..)";
    assert!(wrong.stderr.contains(expected), "{}", wrong.stderr);
    // The example of the page.
    let page = include_str!("../docs/extend/python-nodes.md");
    let example = page.split("```python\n").nth(1).unwrap().split("```").next().unwrap();
    folder.write("bad.py", &example.replace("half.first", "bad.relay"));
    let halves = folder.run("graph.toml", &[]);
    assert_eq!((halves.code, &halves.results["clouds"][2]["n_points"]), (Some(0), &500.into()), "{}", halves.stderr);
    // Parameters are checked at their character, as for any kind.
    let params = "from dataclasses import dataclass\nfrom osteoflow_node import *\n@dataclass\nclass P:\n    share: float = \
                  param(0.5, gt=0, le=1)\n@node(\"bad.relay\", output=\"cloud\")\ndef f(cloud: Cloud, params: P) -> Cloud:\n    \
                  return cloud\n";
    folder.write("bad.py", params);
    for (set, expected) in [("relay.share=2", "share"), ("relay.shore=0.5", "did you mean \"share\"")] {
        let failed = folder.run("graph.toml", &["--set", set]);
        assert!(failed.code == Some(2) && failed.stderr.contains(expected), "{set}: {}", failed.stderr);
    }
    assert_eq!(folder.run("graph.toml", &["--set", "relay.share=1"]).code, Some(0));
    // The graph names an interpreter.
    let graph = graph.replace("[\"bad.py\"]", &format!("[{{ file = \"bad.py\", interpreter = {:?} }}]", folder.1));
    folder.write("named.toml", &graph);
    let out = folder.path("named");
    let ran = osteoflow()
        .arg("run")
        .arg(folder.path("named.toml"))
        .args(["--python", "/no/python", "--out"])
        .arg(&out)
        .output();
    assert!(ran.as_ref().unwrap().status.success(), "{}", String::from_utf8_lossy(&ran.unwrap().stderr));
    // A replay starts no interpreter that only the recording names.
    let replay = |python: &str| osteoflow().arg("replay").arg(&out).args(["--python", python]).output().unwrap();
    let replayed = replay(folder.1.to_str().unwrap());
    assert!(replayed.status.success(), "{}", String::from_utf8_lossy(&replayed.stderr));
    let refused = String::from_utf8(replay("/no/python").stderr).unwrap();
    assert!(refused.contains("/no/python, cannot be started"), "{refused}");
    assert!(refused.contains(&format!("add --python {}", folder.1.display())), "{refused}");
    // An interpreter that is not there is named.
    let failed =
        osteoflow().arg("check").arg(folder.path("graph.toml")).args(["--python", "/no/python"]).output().unwrap();
    let said = String::from_utf8(failed.stderr).unwrap();
    assert!(said.contains("the program that looks at it, /no/python, cannot be started"), "{said}");
}

#[test]
fn a_saved_plugin_gives_new_numbers_at_once() {
    let relay = |share: f64| relay(&format!("    return cloud.chosen(slice(0, int({share} * len(cloud))))"));
    let graph = format!(
        "plugins = [\"bad.py\"]\n{SOURCE}\n[node.relay]\nkind = \"bad.relay\"\nin = {{ cloud = \"recording.scan\" }}\n\
         [results]\ncloud = \"relay.cloud\"\n"
    );
    let files = [("graph.toml", graph.as_str()), ("bad.py", &relay(0.5))];
    let Some(folder) = Folder::new("a watch of a plugin in Python", &files) else { return };
    let mut command = osteoflow_to_spawn();
    command.arg("run").arg(folder.path("graph.toml")).args(["--watch", "--format", "json", "--python"]).arg(&folder.1);
    command.arg("--out").arg(folder.path("watched")).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut watch = command.spawn().unwrap();
    let (send, lines) = sync_channel(1000);
    let stdout = BufReader::new(watch.stdout.take().unwrap());
    thread::spawn(move || stdout.lines().map_while(Result::ok).try_for_each(|line| send.send(line)));
    let next = || -> Value {
        serde_json::from_str(&lines.recv_timeout(Duration::from_secs(60)).expect("the watch answers")).unwrap()
    };
    assert_eq!(next()["cloud"]["n_points"], 500);
    folder.write("bad.py", &relay(0.25));
    assert_eq!(next()["cloud"]["n_points"], 250);
    watch.kill().unwrap();
    watch.wait().unwrap();
    assert!(root().join("docs/extend/python-nodes.md").is_file());
}

/// A registration that gives `POSE` for each pose it starts from, and says that it converged.
const REGISTRATION: &str = r#"
import os
from dataclasses import dataclass
from typing import Annotated, NamedTuple
import numpy as np
from osteoflow_node import Cloud, NodeError, Pose, Surface, node, payload, port

@payload("claims/Report")
class Report:
    converged: bool

class Fit(NamedTuple):
    t_target_source: Annotated[Pose, port("The pose.", to="target", from_="source")]
    report: Report

@node("claims.fit")
def fit(
    source: Cloud,
    target: Annotated[Surface, port("The surface.", frame="init.to")],
    init: Annotated[Pose, port("The start.", to="target", from_="source")],
) -> Fit:
    """Registers."""
    t = init.matrix.copy()
    to, from_ = target.frame, source.frame
    POSE
    return Fit(Pose(to, from_, t, source.stamp_ns), Report(True))
"#;

/// The small bone and a scan of it.
#[test]
fn a_result_that_names_a_file_replays_equal_and_is_warned_of() {
    let plugin = r#"
from dataclasses import dataclass
from osteoflow_node import Text, node, param, source


@dataclass
class Params:
    path: str = param(path=True, doc="A file.")


@source("names.file", output="text")
def file(params: Params) -> Text:
    """Names a file."""
    yield 0, Text("read " + params.path)


@node("names.relay", output="text")
def relay(text: Text) -> Text:
    """Gives a text on."""
    return Text("from " + text.value)
"#;
    let graph = "plugins = [\"names.py\"]\n[graph]\nformat = 1\n[node.a]\nkind = \"names.file\"\npath = \"d.txt\"\n\
                 [node.b]\nkind = \"names.relay\"\nin = { text = \"a.text\" }\n[record]\nwires = [\"*\"]\n[results]\n\
                 first = \"a.text\"\nsecond = \"b.text\"\n";
    let files = [("g/names.py", plugin), ("g/g.toml", graph), ("g/d.txt", "1")];
    let Some(folder) = Folder::new("a path in a result", &files) else { return };
    let run = folder.path("run");
    let command = |arguments: &[&str]| {
        let mut command = osteoflow();
        let output = command.args(arguments).arg("--python").arg(&folder.1).output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.code(), String::from_utf8_lossy(&text).into_owned())
    };
    let (code, printed) = command(&["run", folder.path("g/g.toml").to_str().unwrap(), "--out", run.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{printed}");
    for (result, wire) in [("first", "a.text"), ("second", "b.text")] {
        let warning =
            format!("the result \"{result}\" holds the whole path of a file, and so does the recorded wire {wire}");
        assert!(printed.contains(&warning), "{printed}");
    }
    let results: Value = serde_json::from_slice(&fs::read(run.join("results.json")).unwrap()).unwrap();
    assert_eq!((&results["first"], &results["second"]), (&json!("read d.txt"), &json!("from read d.txt")));
    let recording = run.join("run.mcap");
    let (code, printed) = command(&["replay", recording.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{printed}");
    // A node that gives another text is found.
    folder.write("g/names.py", &plugin.replace("from \" +", "of \" +"));
    let edited = folder.path("g/names.py");
    let (code, printed) = command(&["replay", recording.to_str().unwrap(), "--plugin", edited.to_str().unwrap()]);
    assert!(code == Some(4) && printed.contains("b.text"), "{code:?} {printed}");
}

#[test]
fn a_sweep_with_runs_that_failed_says_so_until_they_are_run_again() {
    let plugin = r##"
import os
from dataclasses import dataclass
from osteoflow_node import NodeError, Text, param, source


@dataclass
class Params:
    n: int = param(0, ge=0, le=9, doc="A number.")


@source("saved.number", output="text")
class Number:
    """Gives a number, where no flag is beside it."""

    def __init__(self, params: Params):
        self.n = params.n
        if self.n > 1 and os.path.exists(os.path.join(os.path.dirname(os.path.abspath(__file__)), "flag")):
            raise NodeError("the disk is away")

    def items(self) -> Text:
        yield 0, Text(str(self.n))
"##;
    let graph = "plugins = [\"saved.py\"]\n[graph]\nformat = 1\n[node.a]\nkind = \"saved.number\"\n[results]\nx = \"a.text\"\n\
                 [sweep]\nrepeat = 1\n[sweep.factor]\nn = { key = \"a.n\", values = [0, 1, 2, 3] }\n";
    let files = [("saved.py", plugin), ("sweep.toml", graph), ("flag", "")];
    let Some(folder) = Folder::new("runs of a sweep that failed", &files) else { return };
    let (graph, out) = (folder.path("sweep.toml"), folder.path("swept"));
    let sweep = |arguments: &[&str]| {
        let mut command = osteoflow();
        command.arg("sweep").arg(&graph).arg("--out").arg(&out).args(["--workers", "1", "--no-cache"]).args(arguments);
        let output = command.arg("--python").arg(&folder.1).output().unwrap();
        let summary: Value = serde_json::from_slice(&fs::read(out.join("summary.json")).unwrap()).unwrap();
        let rows = fs::read_to_string(out.join("runs.csv")).unwrap();
        (output.status.code(), summary, rows, String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, summary, rows, stderr) = sweep(&[]);
    assert_eq!((code, &summary["incomplete"]["n_failed"]), (Some(5), &json!(2)), "{rows}{stderr}");
    assert_eq!(rows.matches(",failed,").count(), 2, "{rows}");
    assert!(summary["incomplete"]["first"].as_str().unwrap().starts_with("run 2: "), "{summary}");
    assert!(
        stderr.contains("incomplete: 2 runs failed; run 2: ") && stderr.contains("--resume --retry-failed"),
        "{stderr}"
    );
    // They stay until they are to be run again.
    fs::remove_file(folder.path("flag")).unwrap();
    let (code, ..) = sweep(&["--resume"]);
    assert_eq!(code, Some(5));
    let (code, summary, rows, stderr) = sweep(&["--resume", "--retry-failed"]);
    assert_eq!((code, &summary["incomplete"]), (Some(0), &Value::Null), "{rows}{stderr}");
    assert_eq!(rows.matches(",complete,").count(), 4, "{rows}");
}

fn bone_and_scan() -> [PathBuf; 2] {
    ["bone.stl", "scan.ply"].map(|file| root().join("tests/data/folder").join(file))
}

impl Folder {
    /// Exit code, answer and stderr of `register` with a plugin.
    fn register(&self, plugin: &str, arguments: &[&str]) -> (Option<i32>, Value, String) {
        let mut command = osteoflow();
        command.arg("register").args(bone_and_scan()).arg("--plugin").arg(self.path(plugin));
        command.arg("--python").arg(&self.1).args(["--format", "json"]).args(arguments);
        let output = command.output().unwrap();
        let answer = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
        (output.status.code(), answer, String::from_utf8_lossy(&output.stderr).into_owned())
    }
}

#[test]
fn register_with_a_plugin_gives_its_pose_and_judges_it() {
    let Some(folder) = Folder::new("register with a plugin", &[]) else { return };
    let new = osteoflow().current_dir(folder.0.path()).args(["new", "plugin", "my_fit", "--lang", "python"]).output();
    assert!(new.unwrap().status.success());
    let (code, answer, stderr) = folder.register("my_fit/my_fit.py", &["--set", "max_iterations=150"]);
    assert_eq!(code, Some(0), "{stderr}");
    // The template has no gate: both take all pairs.
    let all_pairs = ["--format", "json", "--set", "gate_sigmas=0"];
    let built_in = osteoflow().arg("register").args(bone_and_scan()).args(all_pairs).output().unwrap();
    let built_in: Value = serde_json::from_slice(&built_in.stdout).unwrap();
    let pose = |answer: &Value| -> Matrix4<f64> {
        let numbers: Vec<f64> = serde_json::from_value(answer["T"].clone()).unwrap();
        Matrix4::from_row_slice(&numbers)
    };
    let (ours, theirs) = (pose(&built_in), pose(&answer));
    for corner in [[0.0, 0.0, 0.0], [900.0, 100.0, 100.0], [1000.0, -100.0, 200.0]] {
        let point = Point3::from(corner);
        let off_mm = (ours.transform_point(&point) - theirs.transform_point(&point)).norm();
        assert!(off_mm < 0.001, "{off_mm} mm; both stop within 0.001 mm");
    }
    assert_eq!(answer["verdict"]["answer"], "trusted", "{answer}");
    assert_eq!((&answer["method"], &answer["converged"]), (&json!("my_fit.point_to_plane"), &json!(true)));
    assert_eq!(answer["params"]["max_iterations"], json!(150));
    let hash = "import hashlib, sys; print(hashlib.sha256(open(sys.argv[1], 'rb').read()).hexdigest())";
    let hash = Command::new(&folder.1).args(["-c", hash]).arg(folder.path("my_fit/my_fit.py")).output().unwrap();
    assert_eq!(answer["plugin"]["sha256"], json!(String::from_utf8(hash.stdout).unwrap().trim()));
    for (arguments, fault) in [
        (&["--set", "max_iterations=0"][..], "max_iterations takes a whole number from 1 to 100000, found 0"),
        (&["--pairing", "tree"], "my_fit.point_to_plane has no parameter \"pairing\""),
        (&["--kind", "my_fit.other"], "the plugin has no kind \"my_fit.other\""),
        (&["--method", "symmetric"], "cannot be used with"),
        (&["--stop", "fixed"], "cannot be used with"),
    ] {
        let (code, answer, stderr) = folder.register("my_fit/my_fit.py", arguments);
        let faults = format!("{stderr}{}", answer["faults"]).replace("\\\"", "\"");
        assert!(code == Some(2) && faults.contains(fault), "{arguments:?}: {code:?} {stderr} {answer}");
    }
}

#[test]
fn coherent_point_drift_ends_beside_the_built_in_method_and_refuses_a_start_far_away() {
    let text = std::fs::read_to_string(root().join("graphs/plugins/cpd.py")).unwrap();
    let Some(folder) = Folder::new("coherent point drift", &[("cpd.py", &text)]) else { return };
    // Fewer points than by default, for the time.
    let few = ["--set", "n_source=300", "--set", "n_target=1500"];
    let (code, answer, stderr) = folder.register("cpd.py", &few);
    assert_eq!(code, Some(0), "{stderr}");
    let built_in = osteoflow().arg("register").args(bone_and_scan()).args(["--format", "json"]).output().unwrap();
    let built_in: Value = serde_json::from_slice(&built_in.stdout).unwrap();
    let pose = |answer: &Value| -> Matrix4<f64> {
        let numbers: Vec<f64> = serde_json::from_value(answer["T"].clone()).unwrap();
        Matrix4::from_row_slice(&numbers)
    };
    let off = pose(&answer) * pose(&built_in).try_inverse().unwrap();
    let middle: Vec<f64> = serde_json::from_value(built_in["start"]["report"]["middle_mm"].clone()).unwrap();
    let middle = Point3::from_slice(&middle);
    let off_mm = (off.transform_point(&middle) - middle).norm();
    assert!(
        off_mm < 0.5,
        "{off_mm} mm: a mixture of 1500 points knows the surface to a share of their distance of 2 mm"
    );
    let sigma_mm = answer["report"]["sigma_mm"].as_f64().unwrap();
    assert!(answer["converged"] == json!(true) && (0.05..1.5).contains(&sigma_mm), "{}", answer["report"]);
    // Without an outlier's share and far from the surface nothing is explained, which is said and no pose.
    folder.write("far.txt", "1 0 0 9000\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
    let far = folder.path("far.txt");
    let (code, _, stderr) = folder.register("cpd.py", &["--init", far.to_str().unwrap()]);
    assert!(code == Some(3) && stderr.contains("is init right?"), "{code:?} {stderr}");
}

#[test]
fn register_believes_no_plugin() {
    let cases = [
        // 8 mm along the bone, and a quarter turn about it.
        ("t[:3, 3] += 8.0 * np.array([0.0, 0.0, 1.0])", "verdict", ""),
        ("t[:3, :3] = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ t[:3, :3]", "verdict", ""),
        ("t[:3, :3] = -t[:3, :3]", "pose", "scales, shears or mirrors"),
        ("t[:3, :3] = 1.05 * t[:3, :3]", "pose", "scales, shears or mirrors"),
        ("t[0, 3] = np.nan", "pose", "finite"),
        ("to, from_ = from_, to", "pose", "output t_target_source has to \"camera\", but the graph expects \"ct\""),
        ("raise NodeError('no overlap')", "pose", "no overlap"),
        ("os._exit(0)", "pose", "exit code 0"),
        ("os.abort()", "pose", "SIGABRT"),
    ];
    let files: Vec<_> = (0..cases.len()).map(|k| format!("claims_{k}.py")).collect();
    let texts = cases.map(|(pose, _, _)| REGISTRATION.replace("POSE", pose));
    let pairs: Vec<_> = files.iter().zip(&texts).map(|(file, text)| (file.as_str(), text.as_str())).collect();
    let Some(folder) = Folder::new("register with a plugin that is wrong", &pairs) else { return };
    // One of those that end in the same way; all with `SLOW_TESTS`.
    let every = if is_slow_run() { 1 } else { 2 };
    for ((file, text), (pose, what, said)) in pairs.iter().zip(cases).step_by(every) {
        let (code, answer, stderr) = folder.register(file, &[]);
        assert_ne!(answer["verdict"]["answer"], "trusted", "{pose}: {answer}");
        assert!(!answer.is_null() && !text.contains("POSE"), "{pose}: {stderr}");
        if what == "pose" {
            assert_eq!((code, &answer["T"]), (Some(3), &Value::Null), "{pose}: {answer}");
            assert!(stderr.contains("refused: ") && stderr.contains(said), "{pose}: {stderr}");
        }
    }
    // Nor without a verdict on it.
    let swapped = cases.iter().position(|(pose, ..)| pose.starts_with("to, from_")).unwrap();
    let (code, answer, stderr) = folder.register(&files[swapped], &["--no-verdict"]);
    assert_eq!((code, &answer["T"]), (Some(3), &Value::Null), "{answer}");
    assert!(
        stderr.contains("refused: claims.fit: output t_target_source has to \"camera\", but the graph expects \"ct\""),
        "{stderr}"
    );
    folder.write("two.py", &format!("{}{TWO}", texts[0]));
    let (code, _, stderr) = folder.register("two.py", &[]);
    assert!(code == Some(2) && stderr.contains("claims.fit, claims.other; name one with --kind"), "{stderr}");
    let (_, answer, stderr) = folder.register("two.py", &["--kind", "claims.other"]);
    assert_eq!((&answer["method"], &answer["converged"]), (&json!("claims.other"), &Value::Null), "{stderr}");
    let not_reported = answer["verdict"]["assumptions"].to_string();
    assert!(not_reported.contains("no report says whether it did"), "{not_reported}");
    folder.write("crop.py", "from osteoflow_node import Cloud, node\n@node(\"no.fit\")\ndef crop(cloud: Cloud) -> Cloud:\n    \"\"\"Crops.\"\"\"\n    return cloud\n");
    let (code, _, stderr) = folder.register("crop.py", &[]);
    assert!(code == Some(2) && stderr.contains("no kind of it is a registration"), "{stderr}");
}

/// A second registration, without a report.
const TWO: &str = r#"
class Alone(NamedTuple):
    t_target_source: Annotated[Pose, port("The pose.", to="target", from_="source")]

@node("claims.other")
def other(
    source: Cloud,
    target: Annotated[Surface, port("The surface.", frame="init.to")],
    init: Annotated[Pose, port("The start.", to="target", from_="source")],
) -> Alone:
    """Registers."""
    return Alone(Pose(target.frame, source.frame, init.matrix, source.stamp_ns))
"#;

#[test]
fn arrays_and_texts_that_are_no_payload_are_refused_by_their_cause() {
    let node = "import numpy as np\nfrom osteoflow_node import Cloud, NodeError, node, source\nGOOD = np.arange(30.0).reshape(10, 3)\n\n\n\
                @source(\"p.src\", output=\"cloud\")\ndef src() -> Cloud:\n    \"\"\"One cloud.\"\"\"\n    yield 0, Cloud(\"camera\", GOOD)\n\n\n\
                @node(\"p.f\", output=\"cloud\")\ndef f(cloud: Cloud) -> Cloud:\n    \"\"\"A cloud.\"\"\"\n    return ANSWER\n";
    let graph = "plugins = [\"p.py\"]\n[graph]\nformat = 1\n[node.src]\nkind = \"p.src\"\n[node.f]\nkind = \"p.f\"\n\
                 in = { cloud = \"src.cloud\" }\n[node.crop]\nkind = \"crop.box\"\nin = { cloud = \"f.cloud\" }\n[results]\nc = \"crop.cloud\"\n";
    let Some(folder) = Folder::new("arrays and texts of a plugin", &[("g.toml", graph)]) else { return };
    let raised = |text: &str| format!("(_ for _ in ()).throw(NodeError({text}))");
    for (answer, expected) in [
        ("Cloud(\"camera\", np.ma.masked_less(GOOD, 5))", "points has 5 masked values"),
        ("Cloud(\"camera\", GOOD + 0j)", "points holds complex numbers (complex128)"),
        ("Cloud(\"camera\", GOOD.astype(str))", "points holds texts"),
        ("Cloud(\"camera\", GOOD[:0])", "there are no points to crop"),
        ("Cloud(\"\", GOOD)", "\"frame\" is empty"),
        ("Cloud(5, GOOD)", "a text is expected, found 5"),
        ("Cloud(\"cam\\ud800\", GOOD)", "is no text, as it has half of a character"),
        ("Cloud(\"camera\", GOOD, stamp_ns=2**70)", "\"stamp_ns\" is 1180591620717411303424, which no 64 bits hold"),
        (&raised("\"half \\ud800 of it\""), "half ? of it"),
        (&raised("\"x\" * 100_000_000"), "xxxx"),
    ] {
        folder.write("p.py", &node.replace("ANSWER", answer));
        let (code, text) = folder.says(&["run", "g.toml", "--out", "r", "--force"]);
        assert!(code == Some(3) && text.contains(expected) && text.len() < 100_000, "{answer}: {code:?} {text:.2000}");
    }
}

#[test]
fn a_frame_that_a_plugin_gives_is_one_of_the_graph_and_the_declared_one() {
    let node = "import numpy as np\nfrom typing import Annotated\nfrom osteoflow_node import Cloud, Pose, node, port, source\n\
                GOOD = np.arange(30.0).reshape(10, 3)\n\n\n\
                @source(\"p.src\", output=\"cloud\")\ndef src() -> Cloud:\n    \"\"\"One cloud.\"\"\"\n    yield 0, Cloud(\"SOURCE\", GOOD)\n\n\n\
                @node(\"p.f\", output=\"out\")\ndef f(cloud: Cloud) -> TYPE:\n    \"\"\"An answer.\"\"\"\n    return ANSWER\n";
    let graph = "plugins = [\"p.py\"]\n[graph]\nformat = 1\nFRAMES\n[node.src]\nkind = \"p.src\"\n[node.f]\nkind = \"p.f\"\n\
                 in = { cloud = \"src.cloud\" }\n[results]\nc = \"f.out\"\n";
    let Some(folder) = Folder::new("the frames of a plugin", &[]) else { return };
    let declared = "Annotated[Cloud, port(\"A cloud.\", frame=\"@camera\")]";
    let (cloud, pose) = ("Cloud", "Pose");
    let listed = "frames = [\"camera\", \"ct\"]";
    let of_graph = "but the graph's are camera, ct; give one of them, or add it to frames in [graph]";
    for (frames, source, of_type, answer, said) in [
        (
            listed,
            "camera",
            cloud,
            "Cloud(\"nowhere\", GOOD)",
            Some(("f", format!("output out has frame \"nowhere\", {of_graph}"))),
        ),
        (
            listed,
            "camera",
            pose,
            "Pose(\"ct\", \"nowhere\", np.eye(4))",
            Some(("f", format!("output out has frame \"nowhere\", {of_graph}"))),
        ),
        (listed, "away", cloud, "cloud", Some(("src", format!("output cloud has frame \"away\", {of_graph}")))),
        (
            "",
            "camera",
            declared,
            "Cloud(\"nowhere\", GOOD)",
            Some(("f", "output out has frame \"nowhere\", but the graph expects \"camera\"".into())),
        ),
        (listed, "camera", cloud, "Cloud(\"ct\", GOOD)", None),
        (listed, "camera", pose, "Pose(\"ct\", cloud.frame, np.eye(4))", None),
        ("", "anything", cloud, "Cloud(\"nowhere\", GOOD)", None),
        ("", "anything", declared, "Cloud(\"camera\", GOOD)", None),
    ] {
        folder.write("p.py", &node.replace("SOURCE", source).replace("TYPE", of_type).replace("ANSWER", answer));
        folder.write("g.toml", &graph.replace("FRAMES", frames));
        let (code, text) = folder.says(&["run", "g.toml", "--out", "r", "--force"]);
        match said {
            Some((node, said)) => {
                let is_said = text.contains(&format!("node \"{node}\"")) && text.contains(&said);
                assert!(code == Some(3) && is_said, "{answer}: {code:?} {text:.2000}");
            }
            None => assert_eq!(code, Some(0), "{frames}, {answer}: {text:.2000}"),
        }
    }
}

#[test]
fn a_column_of_a_million_values_is_a_number_and_a_digest_in_results_and_rows() {
    let node = "import numpy as np\nfrom osteoflow_node import column, payload, source\n\n\n@payload(\"mine/Values\")\nclass Values:\n    \
                \"\"\"A column.\"\"\"\n    values: np.ndarray = column(\"f64\", 1, unit=\"mm\")\n\n\n@source(\"p.src\", output=\"values\")\n\
                def src() -> Values:\n    \"\"\"A million values.\"\"\"\n    yield 0, Values(np.random.default_rng(1).normal(size=1_000_000))\n";
    let graph = "plugins = [\"p.py\"]\n[graph]\nformat = 1\n[node.src]\nkind = \"p.src\"\n[results]\nv = \"src.values\"\n[sweep]\nrepeat = 1\n";
    let Some(folder) = Folder::new("a column of a million values", &[("p.py", node), ("g.toml", graph)]) else {
        return;
    };
    for (command, file) in [("run", "results.json"), ("sweep", "runs/000000.json")] {
        let (code, text) = folder.says(&[command, "g.toml", "--out", command]);
        assert_eq!(code, Some(0), "{text}");
        let written = fs::read_to_string(folder.path(command).join(file)).unwrap();
        println!("{file}: {} bytes", written.len());
        assert!(written.len() < 1000 && written.contains("1000000") && written.contains("sha256"), "{written:.2000}");
    }
}
