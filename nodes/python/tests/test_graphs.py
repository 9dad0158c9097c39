"""Graphs, recordings, simulations and sweeps."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading

import numpy as np
import osteoflow
import pytest
from conftest import ROOT, TWO_FILES, graph_with_sweep

FIBULA = ROOT / "graphs/fibula.toml"

def without_paths(results):
    return json.loads(json.dumps({k: v for k, v in results.items() if k != "exported"}))


def test_a_run_gives_the_results_and_wires_of_the_command(command, tmp_path):
    out = tmp_path / "run"
    ended = command("run", FIBULA, "--out", out, "--set", "graph.seed=7", "--set", 'record.wires=["*.*"]')
    assert ended.returncode == 0, ended.stderr
    run = osteoflow.Graph(FIBULA).run(set={"graph.seed": 7})
    assert run.results == json.loads((out / "results.json").read_text())
    recording = osteoflow.Recording(out / "run.mcap")
    assert recording.results == run.results and recording.seed == 7
    assert len(recording) > 20
    for name in recording:
        ours, theirs = run[name], recording[name]
        assert len(ours) == len(theirs), name
        for a, b in zip(ours, theirs):
            assert (a.number, a.stamp_ns, a.payload, a.empty) == (b.number, b.stamp_ns, b.payload, b.empty)
            assert list(a) == list(b)
            for key in a:
                assert np.asarray(a[key]).tobytes() == np.asarray(b[key]).tobytes(), (name, key)
    cloud = recording["to_bone.cloud"].array
    assert cloud.dtype == np.float64 and cloud.shape[1] == 3
    poses = recording["bone_marker.pose"] if "bone_marker.pose" in recording else recording["icp.t_target_source"]
    assert poses.array.shape[-2:] == (4, 4)
    with pytest.raises(KeyError, match="there is no wire 'to_bone.clouds'; there are"):
        recording["to_bone.clouds"]


def test_a_wire_is_replaced_by_an_array_and_gives_the_bits_of_its_file(files):
    graph = osteoflow.Graph(TWO_FILES)
    by_file = graph.run()
    scan = osteoflow.read(files / "scan.ply")
    for given in [{"scan": scan.points}, {"scan.cloud": osteoflow.Cloud(scan.points, scan.normals, frame="camera")}]:
        by_array = graph.run(inputs=given, wires="icp.t_target_source")
        assert by_array["icp.t_target_source"].array.tobytes() == by_file["icp.t_target_source"].array.tobytes()
        assert list(by_array) == ["icp.t_target_source"]
    # Another scan gives another pose: the file is not read.
    other = graph.run(inputs={"scan": scan.points + [1.0, 0.0, 0.0]})
    assert other["icp.t_target_source"].array.tobytes() != by_file["icp.t_target_source"].array.tobytes()
    # A node with inputs can be replaced, too: here the start.
    start = by_file["coarse.t_target_source"].array
    report = by_file["coarse.report"][0]
    assert start.shape == (4, 4) and report.payload
    # A report that nobody needs may be left out; then the results lack it.
    by_item = graph.run(inputs={"coarse.t_target_source": by_file["coarse.t_target_source"][0]})
    assert by_item["icp.t_target_source"].array.tobytes() == by_file["icp.t_target_source"].array.tobytes()
    by_start = graph.run(inputs={"coarse.t_target_source": start})
    # The start passes a matrix, whose rounding may change the last bits of what follows.
    difference = by_start["icp.t_target_source"].array - by_file["icp.t_target_source"].array
    assert np.abs(difference).max() < 1e-9
    assert "start" in by_file.results and "start" not in by_start.results
    with pytest.raises(osteoflow.UsageError, match='wire "icp.t_target_source" is in use by node "verdict"'):
        graph.run(inputs={"icp.report": by_file.results["icp"]})
    with pytest.raises(osteoflow.UsageError, match='carries geometry/Cloud, but geometry/Mesh was given'):
        graph.run(inputs={"scan": osteoflow.read(files / "bone.stl")})
    with pytest.raises(osteoflow.UsageError, match='there is no wire "scam"'):
        graph.run(inputs={"scam": scan.points})


def test_a_pose_is_tried_with_the_verdict_on(files):
    graph = osteoflow.Graph(TWO_FILES)
    found = graph.run()
    pose = found["icp.t_target_source"].array
    given = graph.run(inputs={"icp.t_target_source": pose, "icp.report": found.results["icp"]})
    # The pose passes a matrix, whose rounding is below a femtometre.
    reasons = [reason["rule"] for reason in found.results["verdict"]["reasons"]]
    assert given.results["verdict"]["answer"] == found.results["verdict"]["answer"] and given.results["icp"] == found.results["icp"]
    assert [reason["rule"] for reason in given.results["verdict"]["reasons"]] == reasons
    # An item of another run is a dict, too.
    again = graph.run(inputs={"icp.t_target_source": pose, "icp.report": found["icp.report"][0]})
    assert again.results["verdict"] == given.results["verdict"]
    # Without its report the verdict says so; with another, that is the one in the results.
    alone = graph.run(inputs={"icp.t_target_source": pose})
    no_report = "the registration converged; no report says whether it did"
    assert no_report in alone.results["verdict"]["assumptions"] and "icp" not in alone.results
    assert no_report not in given.results["verdict"]["assumptions"]
    report = {**found.results["icp"], "converged": False, "remaining_mm": 5.0, "stop_reason": "iterations"}
    assert graph.run(inputs={"icp.t_target_source": pose, "icp.report": report}).results["icp"] == report
    with pytest.raises(ValueError, match="report/Icp.*missing field"):
        graph.run(inputs={"icp.t_target_source": pose, "icp.report": {"converged": True}})
    # A pose that is off is refused for what it is.
    off = pose.copy()
    off[:3, 3] += [40.0, 0.0, 0.0]
    with pytest.raises(osteoflow.Refused):
        graph.run(inputs={"icp.t_target_source": off})


@pytest.mark.skipif(sys.version_info < (3, 10), reason="nodes in Python need 3.10")
def test_a_function_is_a_node_of_a_run_and_the_run_says_that_it_cannot_be_repeated(files, command, tmp_path):
    from osteoflow.nodes import Cloud, Context, NodeError, Pose, Surface, node

    graph = osteoflow.Graph(TWO_FILES)
    found = graph.run()
    seen = []

    def keep(cloud: Cloud, ctx: Context) -> Cloud:
        seen.append((ctx.node, ctx.item, len(cloud), ctx.rng().random()))
        # Backwards and back: no array in the order of its rows.
        return cloud.chosen(slice(None, None, -1)).chosen(slice(None, None, -1))

    with pytest.warns(osteoflow.OsteoflowWarning, match="crop was computed by a function"):
        run = graph.run(nodes={"crop": keep}, out=tmp_path / "r")
    assert seen[0][:3] == ("crop", 0, len(found["crop.cloud"].array))
    assert run["icp.t_target_source"].array.tobytes() == found["icp.t_target_source"].array.tobytes()
    assert "crop was computed by a function" in run.results["not_reproducible"]
    manifest = json.loads((tmp_path / "r/manifest.json").read_text())
    assert manifest["command"]["given_nodes"] == ["crop"] and "cannot be repeated" in manifest["warnings"][0]["message"]
    assert manifest["store"] is None, "an answer of the function is none of the kind"
    replayed = command("replay", tmp_path / "r")
    assert replayed.returncode != 0 and "crop were functions of the program" in replayed.stderr, replayed.stderr
    packed = command("export", tmp_path / "r", tmp_path / "r.zip")
    assert packed.returncode == 2 and "functions of a notebook" in packed.stderr, packed.stderr

    # A fit of one's own: its report is not given, and the verdict judges the pose.
    @node("mine.identity", output="t_target_source")
    class Start:
        """The start as it is."""

        def process(self, source: Cloud, target: Surface, init: Pose) -> Pose:
            assert len(target.points) > 1000 and source.frame == init.from_
            return Pose(target.frame, source.frame, init.matrix)

    with pytest.warns(osteoflow.OsteoflowWarning):
        try:
            fit = graph.run(nodes={"icp": Start})
            assert "icp" not in fit.results and "verdict" in fit.results
        except osteoflow.Refused as refused:
            assert "icp" not in refused.report and refused.report["verdict"]["reasons"]

    def fails(cloud: Cloud) -> Cloud:
        raise ZeroDivisionError("by hand")

    def refuses(cloud: Cloud) -> Cloud:
        raise NodeError("nothing to see")

    def gives_another(cloud: Cloud) -> Cloud:
        return Pose("a", "b", np.eye(4))

    for function, why in [(fails, r'"crop", item 0: test_graphs.py:\d+: ZeroDivisionError: by hand'), (refuses, "nothing to see"),
                          (gives_another, 'output "cloud" must be a Cloud, found a Pose')]:
        with pytest.raises(osteoflow.Refused, match=why):
            graph.run(nodes={"crop": function})

    def of_no_port(clouds: Cloud) -> Cloud:
        return clouds

    def of_no_output(cloud: Cloud) -> Pose:
        return None

    for name, function, why in [("crop", of_no_port, 'has no input clouds; it has cloud'), ("crip", keep, 'no node "crip"'),
                                ("crop", of_no_output, 'has no output "pose" of geometry/Pose'), ("scan", keep, "is a source; give")]:
        with pytest.raises(osteoflow.UsageError, match=why):
            graph.run(nodes={name: function})
    with pytest.raises(TypeError, match='port "cloud" has no type'):
        graph.run(nodes={"crop": lambda cloud: cloud})


def test_a_surface_is_given_in_memory(files):
    graph = osteoflow.Graph(TWO_FILES)
    by_file = graph.run(wires="icp.t_target_source")
    bone = osteoflow.read(files / "bone.stl")
    by_array = graph.run(inputs={"bone": bone}, wires=["icp.t_target_source"])
    assert by_array["icp.t_target_source"].array.tobytes() == by_file["icp.t_target_source"].array.tobytes()


def test_a_run_writes_files_only_if_asked_and_says_what_was_given(files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scan = osteoflow.read(files / "scan.ply").points
    run = osteoflow.Graph(TWO_FILES).run(wires=None)
    assert run.out_dir is None and list(tmp_path.iterdir()) == [] and len(run) == 0
    run = osteoflow.Graph(TWO_FILES).run(inputs={"scan": scan}, out=tmp_path / "run")
    manifest = json.loads((tmp_path / "run/manifest.json").read_text())
    assert "scan.cloud" in json.dumps(manifest["command"]["given_wires"])
    assert not (tmp_path / "run/run.mcap").exists(), "a replay would not have the given items"
    osteoflow.Graph(TWO_FILES).run(out=tmp_path / "whole")
    assert "icp.t_target_source" in osteoflow.Recording(tmp_path / "whole/run.mcap")


def test_faults_of_a_graph_are_raised_with_the_words_of_the_command(command, tmp_path):
    graph = tmp_path / "broken.toml"
    graph.write_text('[graph]\nformat = 1\nname = "broken"\n\n[node.scan]\nkind = "acquire.clouds"\n')
    told = command("check", graph).stderr.strip()
    for call in [lambda: osteoflow.Graph(graph).check(), lambda: osteoflow.Graph(graph).run(), lambda: osteoflow.sweep(graph)]:
        with pytest.raises(osteoflow.UsageError) as raised:
            call()
        assert "acquire.clouds" in str(raised.value)
    with pytest.raises(osteoflow.UsageError) as raised:
        osteoflow.Graph(graph).check()
    assert str(raised.value).strip() == told


def test_a_refused_run_is_raised_with_its_reason_and_report(command, tmp_path):
    settings = {"icp.max_pair_distance_mm": 0.001}
    ended = command("run", TWO_FILES, "--out", tmp_path / "run", "--set", "icp.max_pair_distance_mm=0.001")
    assert ended.returncode == 3, ended.stderr
    with pytest.raises(osteoflow.Refused) as raised:
        osteoflow.Graph(TWO_FILES).run(set=settings)
    assert f"refused: {raised.value}" in ended.stderr
    assert isinstance(raised.value.report, dict)


def test_ctrl_c_stops_a_run(tmp_path):
    # A background process of a shell is started with Ctrl-C ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    press = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT))
    press.start()
    with pytest.raises(KeyboardInterrupt):
        osteoflow.sweep(graph_with_sweep(tmp_path), set={"sweep.repeat": 1000}, progress=False)


def test_a_simulation_is_that_of_the_command(command, tmp_path):
    out = osteoflow.simulate(tmp_path / "ours", seed=3, points=1000, shape="folder", set={"tissue.share": 0.1})
    ended = command(
        "simulate", "--seed", 3, "--points", 1000, "--as", "folder", "--out", tmp_path / "theirs", "--set", "tissue.share=0.1"
    )
    assert ended.returncode == 0, ended.stderr
    assert out == tmp_path / "ours"
    names = sorted(file.name for file in out.iterdir())
    assert names == sorted(file.name for file in (tmp_path / "theirs").iterdir()) and "truth.json" in names
    for name in names:
        if name != "README.md":
            assert (out / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes(), name
    with pytest.raises(osteoflow.UsageError, match="not empty"):
        osteoflow.simulate(out)


def test_a_sweep_gives_the_table_of_the_command(command, tmp_path):
    graph = graph_with_sweep(tmp_path)
    ended = command("sweep", graph, "--out", tmp_path / "theirs")
    assert ended.returncode == 0, ended.stderr
    rows = osteoflow.sweep(graph, out=tmp_path / "ours", table="dicts")
    for name in ["runs.csv", "points.csv"]:
        assert (tmp_path / "ours" / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes(), name
    assert len(rows) == 4 and {row["icp"] for row in rows} == {"icp.point_to_plane", "icp.point_to_point"}
    pandas = pytest.importorskip("pandas")
    frame = osteoflow.sweep(graph)
    assert isinstance(frame, pandas.DataFrame) and list(frame["run"]) == [row["run"] for row in rows]


def test_the_command_is_there_as_a_module():
    told = subprocess.run([sys.executable, "-m", "osteoflow", "--version"], capture_output=True, text=True, check=True)
    assert told.stdout.startswith("osteoflow 0.2.0")


CROP = """
[graph]
format = 1
name   = "crop"

[node.scan]
kind = "acquire.cloud"
path = "{scan}"

[node.crop]
kind   = "{kind}"
in     = {{ cloud = "scan.cloud" }}
min_mm = [-1000.0, -5.0, -1000.0]
max_mm = [1000.0, 5.0, 1000.0]
"""


def test_a_plugin_in_c_is_looked_at_and_run_from_python(files, tmp_path):
    compiler = shutil.which("cc") or pytest.skip("there is no C compiler")
    library = tmp_path / "libcrop_box.so"
    headers = ["-I", ROOT / "engine/node/include", "-I", ROOT / "nodes/kinds/payloads/include"]
    source = ROOT / "nodes/kinds/payloads/examples/c/crop_box.c"
    subprocess.run([compiler, "-std=c11", "-O2", "-shared", "-fPIC", *headers, source, "-o", library], check=True)

    def graph(kind, plugins=()):
        file = tmp_path / f"{kind}.toml"
        file.write_text(CROP.format(scan=(files / "scan.ply").as_posix(), kind=kind))
        return osteoflow.Graph(file, plugins=plugins)

    ours = graph("crop_c.box", [library])
    with pytest.raises(osteoflow.UsageError, match="crop_c.box"):
        graph("crop_c.box").check()
    assert ours.check() == [] and ours.wires()["crop.cloud"] == "geometry/Cloud"
    built_in, by_plugin = graph("crop.box").run(), ours.run()
    assert 10 < len(by_plugin["crop.cloud"].array) < len(built_in["scan.cloud"].array)
    assert by_plugin["crop.cloud"].array.tobytes() == built_in["crop.cloud"].array.tobytes()
    with pytest.raises(osteoflow.UsageError, match="min_mm"):
        ours.check(set={"crop.min_mm": "everywhere"})
    with pytest.raises(osteoflow.OsteoflowError, match="libnone.so"):
        graph("crop_c.box", [tmp_path / "libnone.so"]).check()


def test_a_process_that_was_forked_after_a_run_refuses_to_run_and_one_forked_before_runs():
    if not hasattr(os, "fork"):
        pytest.skip("there is no fork")
    code = f"""
import os, sys, osteoflow
graph = osteoflow.Graph({str(TWO_FILES)!r})

def child():
    sys.stdout.flush()
    if os.fork():
        return os.wait()[1]
    try:
        graph.run(wires=None)
        print("it ran")
    except osteoflow.OsteoflowError as error:
        print("refused:", error)
    try:
        osteoflow.sweep({str(TWO_FILES)!r}, {{"sweep.repeat": 1}})
        print("it swept")
    except osteoflow.OsteoflowError as error:
        print("refused:", error)
    sys.stdout.flush()
    os._exit(0)

assert child() == 0
graph.run(wires=None)
assert child() == 0
graph.run(wires=None)
print("the parent runs on")
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    lines = told.stdout.splitlines()
    refused = 'refused: this process was forked from one that had run a graph, and a fork loses its threads; start processes with multiprocessing.get_context("spawn")'
    assert lines == ["it ran", "it swept", refused, refused, "the parent runs on"], told.stdout + told.stderr
