"""Recordings: run.mcap is read by the readers of others, each channel by an encoding that they know, and bags of others here."""

import json
import os
import re
import shutil
import subprocess

import numpy as np
from client import INSTALLED, Missing, Row, client, folder, items, osteoflow, recorded, run

# Metres in 32-bit floats: 6e-8 of 1.2 m.
SINGLE_MM = 1e-4
DRAWN_MM = 0.2


def registered_scan():
    """The registered scan in the CT, mm, by the exact recording."""
    x, y, z, qx, qy, qz, qw = items(recorded(), "icp.t_target_source")[0].fields["isometry"]
    return items(recorded(), "to_bone.cloud")[0].columns["points"] @ turned([qx, qy, qz, qw]).T + [x, y, z]


def turned(q):
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def points_of(cloud):
    """The points of a foxglove.PointCloud, mm."""
    offsets = {field.name: field.offset for field in cloud.fields}
    rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)
    xyz = [rows[:, offsets[name] : offsets[name] + 4].copy().view("<f4")[:, 0] for name in "xyz"]
    return np.stack(xyz, axis=1).astype(float) * 1000


@client("mcap (Python)", module="mcap_protobuf", package="mcap")
def mcap_python():
    import mcap.reader
    from mcap_protobuf.decoder import DecoderFactory
    from mcap_ros2.decoder import DecoderFactory as Ros2

    path = recorded() / "run.mcap"
    with open(path, "rb") as file:
        reader = mcap.reader.make_reader(file, decoder_factories=[DecoderFactory(), Ros2()])
        summary = reader.get_summary()
        first = summary.statistics.message_start_time
        assert min(chunk.message_start_time for chunk in summary.chunk_indexes) == first > 1e18, "an empty chunk begins in 1970"
        n, edges, clouds, poses = 0, {}, [], []
        for schema, channel, message in reader.iter_messages():
            n += 1
            if channel.message_encoding == "json":
                json.loads(message.data)
                continue
            factory = DecoderFactory() if channel.message_encoding == "protobuf" else Ros2()
            decoded = factory.decoder_for(channel.message_encoding, schema)(message.data)
            if schema.name == "foxglove.FrameTransform":
                edges.setdefault(decoded.child_frame_id, []).append((message.log_time, channel.topic, decoded))
            elif channel.topic == "/run/registered":
                clouds.append(decoded)
            elif channel.topic == "/exact/icp.t_target_source":
                poses.append(bytes(decoded.view))
    assert n == summary.statistics.message_count
    yield Row(f"{n} messages decoded, none left out", 0.0, "")
    assert poses[0][:8] == b"OSTEOVW1", "an exact item is the bytes of a message of ROS 2"
    found = points_of(clouds[-1])
    yield Row("/run/registered", float(np.abs(found - registered_scan()).max()), tolerance=SINGLE_MM)
    sources = {child: {topic for _, topic, _ in all_of} for child, all_of in edges.items()}
    assert all(len(topics) == 1 for topics in sources.values()), f"one source for each frame: {sources}"
    yield Row(f"{len(sources)} frames, each of one topic", 0.0, "")
    yield from places(path, edges)
    yield from pictures()


def pictures():
    """The images of a run as viewers are shown them, and as they were."""
    import mcap.reader
    from mcap_protobuf.decoder import DecoderFactory

    out = recorded("graphs/variants/fibula_rgb_spot.toml")
    exact = items(out, "recording.image")
    with open(out / "run.mcap", "rb") as file:
        reader = mcap.reader.make_reader(file, decoder_factories=[DecoderFactory()])
        shown = [row.decoded_message for row in reader.iter_decoded_messages(topics=["/view/recording.image"])]
    assert len(shown) == len(exact) > 0, f"{len(shown)} of {len(exact)} images"
    worst = 0
    for picture, item in zip(shown, exact):
        pixels = item.columns["pixels"].reshape(-1)
        assert (picture.encoding, len(picture.data)) == ("rgb8", len(pixels)) and picture.step * picture.height == len(pixels)
        worst = max(worst, int(np.abs(np.frombuffer(picture.data, np.uint8).astype(int) - pixels).max()))
    yield Row(f"foxglove.RawImage of {len(shown)} images of a run", worst, "levels", 0)


def places(path, edges):
    """Where a viewer draws the scan and the bone at each second: each frame by the newest transform before it."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    def top(frame, time):
        rotation, shift = np.eye(3), np.zeros(3)
        while frame in edges:
            known = [edge for edge in edges[frame] if edge[0] <= time] or edges[frame][:1]
            edge = max(known, key=lambda edge: edge[0])[2]
            turn = turned([edge.rotation.x, edge.rotation.y, edge.rotation.z, edge.rotation.w])
            rotation, shift = turn @ rotation, turn @ shift + 1000 * np.array([edge.translation.x, edge.translation.y, edge.translation.z])
            frame = edge.parent_frame_id
        return rotation, shift

    with open(path, "rb") as file:
        of_scan = list(make_reader(file).iter_messages(topics=["/view/to_bone.cloud"]))
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    schema, _, message = of_scan[-1]
    cloud = DecoderFactory().decoder_for("protobuf", schema)(message.data)
    points, place = points_of(cloud), registered_scan()
    rotation, shift = top(cloud.frame_id, message.log_time)
    drawn = points @ rotation.T + shift
    worst, times = 0.0, range(message.log_time, summary.statistics.message_end_time + 1, 1_000_000_000)
    for time in times:
        rotation, shift = top("ct", time)
        worst = max(worst, float(np.linalg.norm((drawn - shift) @ rotation - place, axis=1).max()))
    yield Row(f"the registered scan on the bone as viewers place both, {len(times)} seconds", worst, tolerance=DRAWN_MM)


@client("mcap (JavaScript), with the decoders of Lichtblick", version=lambda: _npm("@mcap/core"))
def mcap_javascript():
    done = run("node", _script("mcap.mjs"), recorded() / "run.mcap")
    said = json.loads(done.stdout)
    assert not said["errors"], said["errors"][:3]
    assert said["start"] > 1e18, "an empty chunk begins in 1970"
    yield Row(f"{said['messages']} messages of {said['channels']} channels decoded, none refused", 0.0, "")
    found = np.array(said["registered"]).reshape(-1, 3) * 1000
    yield Row("/run/registered", float(np.abs(found - registered_scan()).max()), tolerance=SINGLE_MM)


def _npm(package):
    manifest = INSTALLED / "node_modules" / package / "package.json"
    if not shutil.which("node"):
        raise Missing("no node")
    if not manifest.exists():
        raise Missing(f"no npm package {package}; tests/clients/install has it")
    return json.loads(manifest.read_text())["version"]


def _script(name):
    """A script beside the packages of npm, where it finds them."""
    copy = INSTALLED / name
    shutil.copy(os.path.join(os.path.dirname(__file__), name), copy)
    return copy


@client("Rerun", module="rerun", package="rerun-sdk")
def rerun():
    import sys

    command = os.path.join(os.path.dirname(sys.executable), "rerun")
    if not os.path.exists(command):
        raise Missing("no program rerun")
    done = run(command, "mcap", "convert", recorded() / "run.mcap", "-o", folder() / "run.rrd")
    said = re.sub(r"\x1b\[[0-9;]*m", "", done.stdout + done.stderr)
    wrong = [line for line in said.splitlines() if "ERROR" in line]
    assert not wrong, wrong[:3]
    assert "/view/to_bone.cloud" in said and "/exact/" in said, said[-500:]
    yield Row("run.mcap imported without a line of error", 0.0, "")
    if not shutil.which("xvfb-run"):
        return
    picture = folder() / "rerun.png"
    quiet = {**os.environ, "XDG_RUNTIME_DIR": str(folder()), "HOME": str(folder())}
    arguments = ["-s", "-screen 0 800x600x24", command, recorded() / "run.mcap", "--screenshot-to", picture, "--port", "0"]
    done = subprocess.run(["xvfb-run", "-a", *map(str, arguments)], capture_output=True, text=True, encoding="utf-8", errors="replace", timeout=280, env=quiet)
    said = re.sub(r"\x1b\[[0-9;]*m", "", done.stdout + done.stderr)
    if not picture.exists():
        return
    wrong = [line for line in said.splitlines() if "ERROR" in line or "same child frame" in line]
    assert not wrong, wrong[:3]
    yield Row("run.mcap shown in its viewer, no frame refused", 0.0, "")


ROS_GRAPH = """
[graph]
format = 1

[node.bag]
kind = "acquire.mcap"
path = "{path}"
frames = {{ map = "world" }}
out.scan      = {{ type = "geometry/Cloud", topic = "/camera/points", frame = "camera" }}
out.marker    = {{ type = "geometry/Pose", topic = "/tf", parent = "map", child = "marker", to = "world", from = "marker" }}
out.simulated = {{ type = "report/Flag", default = true }}

[record]
wires = ["*"]
"""


def bag(path):
    """A bag of ROS 2 in MCAP with a cloud and a moving transform, by rosbags; the points in m and the positions in m."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    Time, Header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    points = np.random.default_rng(5).uniform(-0.3, 0.3, (500, 3)).astype(np.float32)
    positions = [np.array([0.1 + 0.001 * k, -0.2, 0.3]) for k in range(40)]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        scans = writer.add_connection("/camera/points", "sensor_msgs/msg/PointCloud2", typestore=store)
        transforms = writer.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store)
        marker = writer.add_connection("/marker", "geometry_msgs/msg/TransformStamped", typestore=store)
        start = 1_750_000_000
        for k, p in enumerate(positions):
            stamp = Time(sec=start + k // 20, nanosec=(k % 20) * 50_000_000)
            edge = types["geometry_msgs/msg/TransformStamped"](
                header=Header(stamp=stamp, frame_id="map"),
                child_frame_id="marker",
                transform=types["geometry_msgs/msg/Transform"](
                    translation=types["geometry_msgs/msg/Vector3"](x=p[0], y=p[1], z=p[2]),
                    rotation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=float(np.sin(k / 100)), w=float(np.cos(k / 100))),
                ),
            )
            message = types["tf2_msgs/msg/TFMessage"](transforms=[edge])
            ns = stamp.sec * 10**9 + stamp.nanosec
            writer.write(transforms, ns, store.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))
            writer.write(marker, ns, store.serialize_cdr(edge, "geometry_msgs/msg/TransformStamped"))
        field = types["sensor_msgs/msg/PointField"]
        cloud = types["sensor_msgs/msg/PointCloud2"](
            header=Header(stamp=Time(sec=start + 1, nanosec=0), frame_id="camera"),
            height=1,
            width=len(points),
            fields=[field(name=name, offset=4 * k, datatype=7, count=1) for k, name in enumerate("xyz")],
            is_bigendian=False,
            point_step=12,
            row_step=12 * len(points),
            data=np.frombuffer(points.tobytes(), np.uint8),
            is_dense=True,
        )
        writer.write(scans, (start + 1) * 10**9, store.serialize_cdr(cloud, "sensor_msgs/msg/PointCloud2"))
    return points.astype(float), np.array(positions)


def read_bag(path):
    graph = folder() / f"{path.name}.toml"
    graph.write_text(ROS_GRAPH.format(path=path))
    out = folder() / f"run-{path.name}"
    osteoflow("run", graph, "--out", out)
    return out


@client("rosbags", module="rosbags")
def of_rosbags():
    path = folder() / "rosbag"
    points, positions = bag(path)
    out = read_bag(path)
    found = items(out, "bag.scan")[0].columns["points"]
    yield Row("PointCloud2 of a bag of ROS 2 (MCAP) read here", float(np.abs(found - 1000 * points).max()))
    poses = np.array([row.fields["isometry"][:3] for row in items(out, "bag.marker")])
    yield Row(f"{len(poses)} transforms of /tf read here", float(np.abs(poses - 1000 * positions).max()))
    flags = [row.fields for row in items(out, "bag.simulated")]
    assert len(flags) == 1 and True in flags[0].values(), f"the flag that no bag can state: {flags}"
    yield Row("a flag that the bag cannot state, from default", 0.0, "")


@client("evo", module="evo")
def of_evo():
    from evo.tools import file_interface
    from rosbags.rosbag2 import Reader

    path = folder() / "evo-bag"
    bag(path)
    poses = items(read_bag(path), "bag.marker")
    with Reader(path) as reader:
        trajectory = file_interface.read_bag_trajectory(reader, "/marker")
    found = 1000 * np.asarray(trajectory.positions_xyz)
    expected = np.array([row.fields["isometry"][:3] for row in poses])
    n = min(len(found), len(expected))
    assert n > 30, f"{len(found)} of {len(expected)} poses"
    yield Row(f"{n} positions of a bag, by it and by us", float(np.abs(found[:n] - expected[:n]).max()))
