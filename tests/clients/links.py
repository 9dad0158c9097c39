"""OpenIGTLink: the C++ library and pyigtl receive what is sent, and what they send is read, with equal values."""

import json
import math
import os
import shutil
import socket
import subprocess
import time

import numpy as np
from client import Missing, PROGRAM, ROOT, Row, client, compiled, debian, folder, items

# Single precision of 1 m, and the rounding of a rotation.
SINGLE_MM = 1e-4


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def igtl_111():
    if not shutil.which("pkg-config") and not os.path.exists("/usr/include/openigtlink"):
        raise Missing("no libopenigtlink-dev of Debian")
    return compiled("igtl.cpp", "-I/usr/include/openigtlink", "/usr/lib/libOpenIGTLink.so", "-lpthread")


def igtl_3():
    built = os.environ.get("OSTEOFLOW_IGTL3")
    if not built:
        raise Missing("OSTEOFLOW_IGTL3 names no build of the library's source, which no registry has")
    flags = ["-DIGTL_3", f"-I{built}", f"-I{built}/../Source", f"-I{built}/../Source/igtlutil", f"-I{built}/Source"]
    library = next((str(path) for path in __import__("pathlib").Path(built).rglob("libOpenIGTLink*.a")), None)
    if not library:
        raise Missing(f"{built} has no libOpenIGTLink")
    return compiled("igtl.cpp", *flags, library, "-lpthread", name="igtl3")


def program(*arguments, **options):
    quiet = {**os.environ, "NO_COLOR": "1", "OSTEOFLOW_CACHE": "off"}
    return subprocess.Popen([PROGRAM, *map(str, arguments)], cwd=ROOT, env=quiet, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **options)


def ended(process, what):
    _, said = process.communicate(timeout=120)
    if process.returncode != 0:
        raise AssertionError(f"{what} ended with {process.returncode}: {said[-1500:]}")
    return said


_SENT = {}


def run_that_sends(receive):
    """Runs the live graph on a simulated rig while `receive` listens to what it sends; its results and what `receive` returns."""
    out = folder() / f"igtl-{len(_SENT)}"
    _SENT[out] = True
    port, rig_port = free_port(), free_port()
    rig = program("simulate", "--points", "5000", "--openigtlink", rig_port, "--rate", "40")
    try:
        rig.stderr.readline()
        run = program(
            "run", "graphs/variants/fibula_live_openigtlink.toml", "--out", out, "--set", f"recording.address=127.0.0.1:{rig_port}",
            "--set", f"navigation.address=127.0.0.1:{port}", "--set", "record.wires=['*']",
        )
        received = receive(port)
        ended(run, "the run")
    finally:
        rig.kill()
        rig.wait()
    return out, received


def registration(out):
    """The rotation and translation that WorldToRas has: t_ct_world, with ct turned from LPS to RAS."""
    results = json.loads((out / "results.json").read_text())
    return np.diag([-1.0, -1.0, 1.0, 1.0]) @ np.array(results["poses"]["t_ct_world"]["matrix"])


def compare_received(out, messages):
    """Rows for what a receiver has unpacked, against the results of the run."""
    results = json.loads((out / "results.json").read_text())
    lost = [message for message in messages if message.get("lost") or not message["ok"]]
    assert not lost, f"{len(lost)} of {len(messages)} messages cannot be unpacked, the first is {lost[0]}"
    of = lambda device, type: [message for message in messages if (message["device"], message["type"]) == (device, type)]  # noqa: E731
    found = np.array(of("WorldToRas", "TRANSFORM")[-1]["numbers"]).reshape(-1, 4)[:3]
    yield Row("WorldToRas received", float(np.abs(found - registration(out)[:3]).max()), tolerance=SINGLE_MM)
    points = np.array(of("Points", "POINT")[-1]["numbers"]).reshape(-1, 3)
    expected = np.array([point["position_mm"] for point in results["laser_points"]])
    yield Row("Points received", float(np.abs(points - expected).max()), tolerance=SINGLE_MM)
    planes = {row.fields["stamp_ns"]: row for row in items(out, "planes.planes")}
    worst, n = 0.0, 0
    for message in messages:
        if message["type"] != "TRANSFORM" or message["device"] == "WorldToRas":
            continue
        stamp = min(planes, key=lambda ns: abs(ns / 1e9 - message["stamp"]))
        row = planes[stamp]
        names = ["".join(word.capitalize() for word in name.replace("-", "_").split("_")) for name in row.fields["names"].split("\n")]
        at = names.index(message["device"].split("To")[0])
        place = row.columns["isometries"][at][:3]
        worst = max(worst, float(np.abs(np.array(message["numbers"]).reshape(-1, 4)[:3, 3] - place).max()))
        n += 1
    assert n > 100, f"{n} planes came"
    yield Row(f"planes received, {n} TRANSFORMs", worst, tolerance=SINGLE_MM)
    squares = of(next(m["device"] for m in messages if m["type"] == "POLYDATA"), "POLYDATA")
    side = np.array(squares[-1]["numbers"]).reshape(4, 3)
    yield Row("the square of a plane received, its side", abs(float(np.linalg.norm(side[1] - side[0])) - 60.0), tolerance=SINGLE_MM)
    assert any(message["type"] == "STATUS" and message.get("name") == "exiting" for message in messages), "the end is said"


GRAPH = """
[graph]
format = 1

[node.peer]
kind      = "acquire.openigtlink"
address   = "127.0.0.1:{port}"
reconnect = false
out.transform = {{ type = "geometry/Pose", device = "StylusToWorld", to = "world", from = "stylus" }}
out.position  = {{ type = "geometry/Pose", device = "PointerToWorld", to = "world", from = "pointer" }}
out.tool      = {{ type = "geometry/Pose", device = "ToolToWorld", to = "world", from = "tool" }}
out.marks     = {{ type = "geometry/Points", device = "Marks", frame = "world" }}
out.scan      = {{ type = "geometry/Mesh", device = "Scan", frame = "world" }}
out.cloud     = {{ type = "geometry/Cloud", device = "Cloud", frame = "world" }}
out.points    = {{ type = "geometry/Cloud", device = "VideoStreamPCL", frame = "camera" }}
out.depth     = {{ type = "geometry/Cloud", device = "VideoStreamDEPTH", frame = "camera", depth_unit_mm = 0.1, intrinsics = {camera} }}
out.grey      = {{ type = "geometry/Image", device = "VideoStreamIR", frame = "camera", intrinsics = {camera} }}
out.note      = {{ type = "report/Text", device = "Note" }}
out.state     = {{ type = "report/Text", device = "State" }}

[record]
wires = ["*"]
"""


def read_here(port, name):
    """What this program reads of a sender at a port, until that closes."""
    graph = folder() / f"{name}.toml"
    lines = GRAPH.format(port=port, camera="[500.0, 400.0, 1.5, 1.0]").splitlines()
    graph.write_text("\n".join(line for line in lines if name != "igtl" or "out.cloud" not in line) + "\n")
    _SENT[graph, port] = True
    out = folder() / f"from-{name}-{len(_SENT)}"
    said = ended(program("run", graph, "--out", out), "the run")
    assert "CRC" not in said, said
    return out


def camera_images(round_number):
    """Images of 4 x 3 pixels as the drivers of PLUS for depth cameras send them; the last pixel sees nothing."""
    pixel = np.arange(12)
    z = np.where(pixel < 11, 300 + round_number + pixel, 0)
    points = np.stack([(pixel % 4 - 1.5) * z / 500, (pixel // 4 - 1.0) * z / 400, z], axis=1)
    return {
        "PCL": points.astype(np.float32).reshape(1, 3, 4, 3),
        "DEPTH": (10 * z).astype(np.uint16).reshape(1, 3, 4),
        "IR": (round_number + pixel).astype(np.uint8).reshape(1, 3, 4),
    }


def turned(round_number):
    return 0.01 * round_number, np.array([10.0 + round_number, -20.5, 30.25])


def compare_read(out, n, wires):
    """Rows for what is read of the rounds that igtl.cpp and pyigtl send."""
    for wire in wires:
        rows = items(out, f"peer.{wire}")
        numbers = [row.empty for row in rows if row.empty]
        assert not numbers, f"{wire}: {numbers[0]}"
        # The first round is the identity in rotation, and an item of each round is there.
        assert len(rows) >= n - 2, f"{wire}: {len(rows)} of {n} rounds"
        worst = 0.0
        for row in rows:
            k = round((row.stamp_ns / 1e9 - 1_750_000_000) / 0.05)
            turn, at = turned(k)
            if wire in ("transform", "position", "tool"):
                expected = [*at, 0.0, 0.0, math.sin(turn / 2), math.cos(turn / 2)]
                found = np.array(row.fields["isometry"])
                off = float(np.abs(found - expected).max())
            elif wire == "marks":
                off = float(np.abs(row.columns["positions"] - [at + [j, 0, at[2] * j - at[2]] for j in range(3)]).max())
                assert row.fields["names"].split("\n") == ["P1", "P2", "P3"]
            elif wire in ("points", "depth"):
                z = 300.0 + k + np.arange(11)
                pixel = np.arange(11)
                expected = np.stack([(pixel % 4 - 1.5) * z / 500, (pixel // 4 - 1.0) * z / 400, z], axis=1)
                assert len(row.columns["points"]) == 11, "the pixel without a point is left out"
                off = float(np.abs(row.columns["points"] - expected).max())
            elif wire == "grey":
                assert (row.fields["width"], row.fields["height"], row.fields["channels"]) == (4, 3, 1), row.fields
                off = float(np.abs(np.asarray(row.columns["pixels"], float).ravel() - (k + np.arange(12))).max())
            elif wire == "scan":
                corners = [at + [j & 1, j >> 1, j * j] for j in range(4)]
                off = float(np.abs(row.columns["vertices"] - corners).max())
                assert len(row.columns["faces"]) == 4
            else:
                text = row.fields.get("text", "")
                off = 0.0 if text == {"note": "of the bone"}.get(wire, text) and text else math.inf
            worst = max(worst, off)
        what = {"transform": "TRANSFORM", "position": "POSITION", "tool": "TDATA", "marks": "POINT", "scan": "POLYDATA", "points": "IMAGE (points)", "depth": "IMAGE (depth)", "grey": "IMAGE (grey)", "note": "STRING", "state": "STATUS"}[wire]
        yield Row(f"{what} sent, read here {len(rows)} times", worst, tolerance=SINGLE_MM)


def scans_of_simulation(peer, scans):
    """What a receiver unpacks of the scans that `simulate` sends in a type of message."""
    port = free_port()
    rig = program("simulate", "--points", "5000", "--openigtlink", port, "--rate", "1e6", "--scans", scans)
    try:
        rig.stderr.readline()
        done = subprocess.run([peer, "receive", "127.0.0.1", str(port), "20"], capture_output=True, text=True, timeout=200)
    finally:
        rig.kill()
        rig.wait()
    messages = [json.loads(line) for line in done.stdout.splitlines()]
    found = [message for message in messages if message["type"] == {"image": "IMAGE"}.get(scans, scans.upper())]
    assert found and all(message["ok"] for message in found), f"{len(found)} of {len(messages)} messages are {scans}"
    return {message["device"]: np.array(message["numbers"]).reshape(-1, 3) for message in found}


def compare_scans(peer):
    """A row for the point images of a simulation, against the same scans as POLYDATA."""
    images, points = (scans_of_simulation(peer, scans) for scans in ("image", "polydata"))
    assert images.keys() == points.keys() and len(images) == 5, f"{images.keys()} and {points.keys()}"
    worst = 0.0
    for device, found in images.items():
        expected = points[device]
        assert len(found) >= len(expected) and not found[len(expected):].any(), "what is left of the last row is zero"
        worst = max(worst, float(np.abs(found[: len(expected)] - expected).max()))
    yield Row("IMAGE (points) received", worst, tolerance=1e-5)


def both_ways(program_of):
    peer = program_of()

    def receive(port):
        done = subprocess.run([peer, "receive", "127.0.0.1", str(port), "60"], capture_output=True, text=True, timeout=200)
        return [json.loads(line) for line in done.stdout.splitlines()]

    out, messages = run_that_sends(receive)
    yield from compare_received(out, messages)
    yield from compare_scans(peer)
    port, n = free_port(), 40
    sender = subprocess.Popen([peer, "send", str(port), str(n)], stdout=subprocess.PIPE, text=True)
    assert sender.stdout.readline().strip() == "ready"
    try:
        out = read_here(port, "igtl")
    finally:
        sender.kill()
        sender.wait()
    yield from compare_read(out, n, ["transform", "position", "tool", "marks", "scan", "points", "depth", "grey", "note", "state"])


@client("OpenIGTLink (C++)", version=lambda: debian("libopenigtlink-dev"))
def igtl_of_debian():
    yield from both_ways(igtl_111)


@client("OpenIGTLink (C++) 3", version=lambda: "3.1" if igtl_3() else None)
def igtl_of_source():
    yield from both_ways(igtl_3)


@client("pyigtl", module="pyigtl")
def of_pyigtl():
    import logging

    import pyigtl

    logging.disable(logging.CRITICAL)

    def receive(port):
        peer = pyigtl.OpenIGTLinkClient("127.0.0.1", port)
        messages, last = [], time.time()
        heard = False
        while time.time() - last < (8 if heard else 60):
            for message in peer.get_latest_messages():
                heard, last = True, time.time()
                messages.append(message)
            time.sleep(0.002)
        peer.stop()
        return messages

    out, messages = run_that_sends(receive)
    found = [message for message in messages if message.device_name == "WorldToRas"]
    assert found, f"WorldToRas is not among {sorted({m.device_name for m in messages})}"
    yield Row("WorldToRas received", float(np.abs(found[-1].matrix[:3] - registration(out)[:3]).max()), tolerance=SINGLE_MM)
    points = [message for message in messages if message.device_name == "Points"][-1]
    results = json.loads((out / "results.json").read_text())
    expected = np.array([point["position_mm"] for point in results["laser_points"]])
    yield Row("Points received", float(np.abs(np.array(points.positions) - expected).max()), tolerance=SINGLE_MM)

    port, n = free_port(), 40
    server = pyigtl.OpenIGTLinkServer(port=port)
    import threading

    def send():
        until = time.time() + 30
        while not server.is_connected() and time.time() < until:
            time.sleep(0.02)
        for k in range(n):
            turn, at = turned(k)
            matrix = np.eye(4)
            matrix[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
            matrix[:3, 3] = at
            stamp = 1_750_000_000 + 0.05 * k
            points = [at + [j, 0, at[2] * j - at[2]] for j in range(3)]
            for message in [
                pyigtl.TransformMessage(matrix, device_name="StylusToWorld", timestamp=stamp),
                pyigtl.PointMessage(points, names=["P1", "P2", "P3"], device_name="Marks", timestamp=stamp),
                pyigtl.StringMessage("of the bone", device_name="Note", timestamp=stamp),
                *(pyigtl.ImageMessage(image, device_name=f"VideoStream{name}", timestamp=stamp) for name, image in camera_images(k).items()),
            ]:
                server.send_message(message, wait=True)
            time.sleep(0.03)
        server.stop()

    sending = threading.Thread(target=send)
    sending.start()
    try:
        out = read_here(port, "pyigtl")
    finally:
        sending.join()
    yield from compare_read(out, n, ["transform", "marks", "points", "depth", "grey", "note"])
