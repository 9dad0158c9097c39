"""The stream of `view` and `run --serve`: a client of the protocol that is not ours plays, seeks, sets parameters and calls services,
and a server of the protocol that is not ours is read."""

import asyncio
import json
import os

import subprocess
import threading
import time

import numpy as np
from client import PROGRAM, ROOT, Row, client, folder, items, recorded, run
from links import ended, free_port, program
from recordings import SINGLE_MM, _npm, _script, registered_scan


class Served:
    """A command that serves, until it is left."""

    def __init__(self, *arguments):
        quiet = {**os.environ, "NO_COLOR": "1", "OSTEOFLOW_CACHE": "off"}
        self.process = subprocess.Popen([PROGRAM, *map(str, arguments)], cwd=ROOT, env=quiet, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        said = ""
        for line in self.process.stderr:
            said += line
            if line.startswith("page: "):
                self.page = line.split()[1]
            if line.startswith("stream: "):
                self.stream = line.split()[1]
                break
        else:
            raise AssertionError(f"no stream: {said}")
        threading.Thread(target=self.process.stderr.read, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait(timeout=20)


def hands(stream, what):
    done = run("node", _script("ws.mjs"), stream, what)
    said = json.loads(done.stdout.splitlines()[-1])
    assert not said["errors"], said["errors"][:3]
    return said


@client("@foxglove/ws-protocol", version=lambda: _npm("@foxglove/ws-protocol"))
def ws_protocol():
    with Served("view", recorded()) as served:
        said = hands(served.stream, "play")
    assert "playbackControl" in said["capabilities"], said
    assert said["paused"] == 0, f"{said['paused']} messages came while it was paused"
    yield Row("view RUN: sought to 35 s, the first pose played from there", abs(said["seek_s"] - 35.0), "s", 0.2)
    # 2.5 s at four times the speed, on a machine that may be busy.
    assert 2.0 < said["last_s"] - 35.0 < 14.0, said
    yield Row("view RUN: sought to 40 s while paused, the pose shown", abs(said["sought_s"] - 40.0), "s", 0.2)
    with Served("view", "graphs/fibula.toml", "--out", folder() / "steered") as served:
        said = hands(served.stream, "steer")
    assert (said["before"], said["after"]) == (500, 77), said
    assert said["again"] == said["before"], f"reverted: {said}"
    yield Row("view GRAPH: parameter read and set, service revert called", 0.0, "")
    out = folder() / "live"
    with Served("run", "graphs/fibula.toml", "--serve", "--out", out) as served:
        said = hands(served.stream, "live")
    found = np.array(said["registered"]).reshape(-1, 3) * 1000
    yield Row("run --serve: /run/registered received", float(np.abs(found - registered_scan()).max()), tolerance=SINGLE_MM)


GRAPH = """
[graph]
format = 1

[node.peer]
kind      = "acquire.foxglove_ws"
address   = "ws://127.0.0.1:{port}"
reconnect = false
out.marker = {{ type = "geometry/Pose", topic = "/marker", to = "world", from = "marker" }}

[record]
wires = ["*"]
"""


@client("foxglove-websocket (Python), a server", module="foxglove_websocket", package="foxglove-websocket")
def foxglove_websocket():
    from foxglove_websocket.server import FoxgloveServer

    port, n = free_port(), 40
    positions = np.array([[0.1 + 0.001 * k, -0.2, 0.3] for k in range(n)])

    async def serve():
        async with FoxgloveServer("127.0.0.1", port, "of another") as server:
            channel = await server.add_channel(
                {"topic": "/marker", "encoding": "json", "schemaName": "foxglove.FrameTransform", "schema": "{}", "schemaEncoding": "jsonschema"}
            )
            await asyncio.sleep(4)
            for k, (x, y, z) in enumerate(positions):
                stamp = {"sec": 1_750_000_000 + k // 20, "nsec": (k % 20) * 50_000_000}
                message = {
                    "timestamp": stamp,
                    "parent_frame_id": "world",
                    "child_frame_id": "marker",
                    "translation": {"x": x, "y": y, "z": z},
                    "rotation": {"x": 0, "y": 0, "z": float(np.sin(k / 100)), "w": float(np.cos(k / 100))},
                }
                await server.send_message(channel, stamp["sec"] * 10**9 + stamp["nsec"], json.dumps(message).encode())
                await asyncio.sleep(0.02)
            await asyncio.sleep(0.5)

    serving = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    serving.start()
    time.sleep(1)
    graph = folder() / "foxglove.toml"
    graph.write_text(GRAPH.format(port=port))
    out = folder() / "from-foxglove"
    ended(program("run", graph, "--out", out), "the run")
    serving.join()
    rows = [row for row in items(out, "peer.marker") if not row.empty]
    found = np.array([row.fields["isometry"][:3] for row in rows])
    assert len(found) == n, f"{len(found)} of {n}"
    yield Row(f"{n} transforms sent, read here", float(np.abs(found - 1000 * positions).max()))
