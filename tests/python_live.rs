//! Live sources in Python: recorded and replayed, too fast for their graph, at fault, and interrupted.

use crate::common::{json, osteoflow_to_spawn, python::Folder};
use std::{
    fs,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

const PLUGIN: &str = r#"
import time
from dataclasses import dataclass
from typing import NamedTuple, Optional

import numpy as np
from osteoflow_node import Cloud, Context, Pose, node, param, payload, source


@payload("my/Count")
class Count:
    """How many."""

    n: int


@dataclass
class Params:
    n: int = param(40, doc="Number of frames; 0: without end.")
    every_ms: float = param(1.0, doc="Time between frames.")
    raises_at: int = param(-1, doc="The frame at which the device is lost.")


@source("my_scanner.live", output="cloud", live=True)
def frames(params: Params, ctx: Context) -> Cloud:
    """Frames as the device gives them."""
    k = 0
    while ctx.wait(params.every_ms / 1e3) and (params.n == 0 or k < params.n):
        if k == params.raises_at:
            raise ConnectionError("the device is gone")
        yield ctx.clock_ns(), Cloud("camera", np.full((4, 3), float(k)))
        k += 1


class Both(NamedTuple):
    cloud: Optional[Cloud]
    pose: Optional[Pose]


@source("my_scanner.tracked", live=True, max_delay_ms=5.0)
def tracked(ctx: Context) -> Both:
    """A cloud and a pose on outputs of their own; the last pose comes later than it may."""
    at = 1_000_000_000
    for k, (before_ms, is_cloud) in enumerate([(0, True), (4, False), (-20, True), (11, False)]):
        given = Cloud("camera", np.full((4, 3), float(k))), None
        if not is_cloud:
            given = None, Pose("world", "camera", np.eye(4))
        yield at - before_ms * 1_000_000, Both(*given)


@node("my_scanner.slow", output="count")
def slow(cloud: Cloud, ctx: Context) -> Count:
    """Takes longer than a frame."""
    time.sleep(0.02)
    return Count(int(cloud.points[0, 0]))
"#;

const GRAPH: &str = r#"
plugins = ["my.py"]
[graph]
format = 1
name = "live"
[node.camera]
kind = "my_scanner.live"
[node.slow]
kind = "my_scanner.slow"
in.cloud = { from = "camera.cloud", capacity = 2, policy = "drop_old" }
[record]
wires = ["*"]
[results]
counts = { from = "slow.count", all = true }
"#;

const TRACKED: &str = r#"
plugins = ["my.py"]
[graph]
format = 1
name = "tracked"
[node.both]
kind = "my_scanner.tracked"
[node.slow]
kind = "my_scanner.slow"
in = { cloud = "both.cloud" }
[record]
wires = ["*"]
[results]
counts = { from = "slow.count", all = true }
"#;

fn folder(test: &str) -> Option<Folder> {
    Folder::new(test, &[("my.py", PLUGIN), ("g.toml", GRAPH), ("t.toml", TRACKED)])
}

fn command(folder: &Folder, arguments: &[&str]) -> Command {
    let mut command = osteoflow_to_spawn();
    command.current_dir(folder.0.path()).env("OSTEOFLOW_PYTHON", &folder.1).args(arguments);
    command
}

fn says(folder: &Folder, arguments: &[&str]) -> (Option<i32>, String) {
    let output = command(folder, arguments).output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
}

#[test]
fn a_live_source_in_python_drops_what_its_graph_cannot_take_and_replays_the_same() {
    let Some(folder) = folder("a live source in Python") else { return };
    let (code, text) = says(&folder, &["run", "g.toml", "--out", "r"]);
    assert_eq!(code, Some(0), "{text}");
    let manifest = json(&folder.path("r/manifest.json"));
    let link = &manifest["links"][0];
    let of = |key: &str| link[key].as_u64().unwrap();
    assert_eq!((of("sent"), of("sent")), (40, of("received") + of("dropped")), "{link}");
    assert!(of("dropped") >= 10, "a frame each millisecond, 20 ms for each: {link}");
    let counts = json(&folder.path("r/results.json"))["counts"].as_array().unwrap().clone();
    assert_eq!(counts.last().unwrap()["n"], 39, "the last frame is the newest: {counts:?}");
    let (code, text) = says(&folder, &["replay", "r"]);
    assert!(code == Some(0) && text.contains(", 0 differ"), "{code:?} {text}");
    // A sweep is refused, since a device gives what it gives once.
    let swept = fs::read_to_string(folder.path("g.toml")).unwrap() + "[sweep]\nrepeat = 2\n";
    folder.write("s.toml", &swept);
    let (code, text) = says(&folder, &["sweep", "s.toml", "--out", "s"]);
    assert!(code == Some(2) && text.contains("is a live source"), "{code:?} {text}");
}

#[test]
fn an_output_stays_silent_and_what_comes_later_than_the_delay_is_late() {
    let Some(folder) = folder("a live source in Python with two outputs") else { return };
    let (code, text) = says(&folder, &["run", "t.toml", "--out", "r"]);
    assert_eq!(code, Some(0), "{text}");
    // The pose 4 ms before the first cloud is in time, that 31 ms before the second is not.
    assert!(text.contains("both.pose: 1 item came late, by up to 26 ms"), "{text}");
    let wires = json(&folder.path("r/manifest.json"))["recording"]["wires"].as_array().unwrap().clone();
    let of =
        |wire: &str| wires.iter().find(|of| of["wire"] == wire).map(|of| (of["items"].clone(), of["values"].clone()));
    assert_eq!(of("both.cloud"), Some((2.into(), 2.into())), "{wires:?}");
    assert_eq!(of("both.pose"), Some((2.into(), 1.into())), "{wires:?}");
    let (code, text) = says(&folder, &["replay", "r"]);
    assert!(code == Some(0) && text.contains(", 0 differ"), "{code:?} {text}");
}

#[test]
fn a_live_source_in_python_that_raises_is_named_with_its_line_and_what_came_before_stays() {
    let Some(folder) = folder("a live source in Python that raises") else { return };
    let (code, text) = says(&folder, &["run", "g.toml", "--out", "r", "--set", "camera.raises_at=3"]);
    assert_eq!(code, Some(3), "{text}");
    let line = PLUGIN.lines().position(|line| line.contains("raise ConnectionError")).unwrap() + 1;
    let said = format!("node \"camera\", item 3: my.py:{line}: ConnectionError: the device is gone");
    assert!(text.contains(&said), "{text}");
    let manifest = json(&folder.path("r/manifest.json"));
    // The fourth item is the empty that names the failure.
    let wire = &manifest["recording"]["wires"][0];
    assert_eq!((&wire["items"], &wire["values"]), (&4.into(), &3.into()), "{wire}");
    let (code, text) = says(&folder, &["validate", "r/run.mcap"]);
    assert_eq!(code, Some(0), "{text}");
    // Times of a live source are of a live source.
    folder.write("my.py", &PLUGIN.replace("live=True, max_delay_ms=5.0", "max_delay_ms=5.0"));
    let (code, text) = says(&folder, &["check", "t.toml"]);
    assert!(code == Some(2) && text.contains("add live=True"), "{code:?} {text}");
}

#[test]
fn ctrl_c_ends_a_live_source_in_python_in_order() {
    let Some(folder) = folder("a live source in Python, interrupted") else { return };
    let mut run =
        command(&folder, &["run", "g.toml", "--out", "r", "--set", "camera.n=0", "--set", "camera.every_ms=50"]);
    let child = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let began = Instant::now();
    while fs::metadata(folder.path("r/run.mcap")).map_or(0, |about| about.len()) < 500
        && began.elapsed() < Duration::from_secs(60)
    {
        std::thread::sleep(Duration::from_millis(50));
    }
    std::thread::sleep(Duration::from_millis(500));
    let asked = Instant::now();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    assert_eq!(output.status.code(), Some(130), "{text}");
    assert!(asked.elapsed() < Duration::from_secs(20) && !text.contains("Traceback"), "{:?} {text}", asked.elapsed());
    let (code, text) = says(&folder, &["validate", "r/run.mcap"]);
    assert_eq!(code, Some(0), "{text}");
}
