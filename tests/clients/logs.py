"""Logs of poses: trajectories, tracked sequences and bags that others write, and their numbers by others."""

import json
import re
import shlex
import sys
from pathlib import Path

import numpy as np
from client import Missing, Row, client, folder, items, osteoflow, run

# A float of seconds since 1970 has steps of 2.4e-7 s; what moves here moves 1 m/s at most.
STAMP_MM = 1e-3
START = 1_403_636_579_763_555_584
N = 60


def motion(n=N):
    """Positions in m and rotations as w, x, y, z."""
    k = np.arange(n)
    turn = np.c_[0.3 * np.sin(k / 9), 0.2 * np.cos(k / 5), 0.02 * k]
    angle = np.linalg.norm(turn, axis=1)[:, None]
    return np.c_[np.sin(k / 10), np.cos(k / 7), 0.01 * k], np.c_[np.cos(angle / 2), turn / angle * np.sin(angle / 2)]


def stamps_ns(n=N):
    return START + 50_000_000 * np.arange(n, dtype=np.int64)


def matrices(positions, w_first):
    """Homogeneous matrices of positions and quaternions."""
    w, x, y, z = np.asarray(w_first).T
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    out = np.tile(np.eye(4), (len(w), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = np.moveaxis(turn, -1, 0), positions
    return out


def difference(found, expected):
    """The largest distance in mm between where two lists of motions take points within 100 mm of the tool."""
    corners = np.array([[x, y, z, 1] for x in (-100, 100) for y in (-100, 100) for z in (-100, 100)]).T
    assert len(found) == len(expected), f"{len(found)} poses, {len(expected)} expected"
    return float(np.abs((np.asarray(found) - np.asarray(expected)) @ corners).max())


def read(path, *options):
    """Stamps and matrices in mm of a log by `convert`, and its lost stamps."""
    out = folder() / f"{path.name}.csv"
    out.unlink(missing_ok=True)
    osteoflow("convert", path, out, *options)
    rows = [line.split(",") for line in out.read_text().splitlines()[1:]]
    seen = [row for row in rows if row[3]]
    numbers = np.array([[float(cell) for cell in row[3:]] for row in seen]).reshape(len(seen), 7)
    lost = [int(row[0]) for row in rows if not row[3]]
    return np.array([int(row[0]) for row in seen]), matrices(numbers[:, :3], numbers[:, [6, 3, 4, 5]]), lost


def in_mm(found):
    found = np.array(found)
    found[:, :3, 3] *= 1000
    return found


FRAMES = ("--parent", "world", "--child", "camera")


@client("evo", module="evo")
def of_evo():
    from evo.core.trajectory import PoseTrajectory3D
    from evo.tools import file_interface

    positions, w_first = motion()
    trajectory = PoseTrajectory3D(positions, w_first, stamps_ns() * 1e-9)
    expected = in_mm(matrices(positions, w_first))
    tum, kitti, euroc = (folder() / name for name in ("evo.tum", "evo.kitti", "euroc.csv"))
    file_interface.write_tum_trajectory_file(tum, trajectory)
    file_interface.write_kitti_poses_file(kitti, trajectory)
    stamps, found, _ = read(tum, *FRAMES)
    assert np.abs(stamps - stamps_ns()).max() < 600, "seconds in a float have steps of 240 ns, nanoseconds in one of 256"
    yield Row("its TUM trajectory read here", difference(found, expected))
    stamps, found, _ = read(kitti, *FRAMES, "--rate", "20")
    assert stamps[1:].tolist() == (50_000_000 * np.arange(1, N)).tolist()
    yield Row("its KITTI trajectory read here", difference(found, expected))
    back = folder() / "back.tum"
    osteoflow("convert", tum, back, *FRAMES)
    other = file_interface.read_tum_trajectory_file(back)
    assert np.abs(other.timestamps - trajectory.timestamps).max() < 6e-7
    yield Row("a TUM trajectory of ours read by it", difference(in_mm(other.poses_se3), expected))
    # As the data set has it; evo only reads it.
    names = "p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],v_RS_R_x [m s^-1]"
    rows = np.c_[positions, w_first, np.zeros(N)]
    lines = [f"{ns}," + ",".join(f"{value:.9f}" for value in row) for ns, row in zip(stamps_ns(), rows)]
    euroc.write_text("\r\n".join([f"#timestamp [ns],{names}", *lines]) + "\r\n", newline="")
    other = file_interface.read_euroc_csv_trajectory(euroc)
    stamps, found, _ = read(euroc, *FRAMES)
    assert (stamps == stamps_ns()).all()
    yield Row("a EuRoC trajectory read by it and here", difference(found, in_mm(other.poses_se3)), tolerance=STAMP_MM)


@client("SimpleITK", module="SimpleITK")
def of_simple_itk():
    import SimpleITK as sitk

    positions, w_first = motion(20)
    expected = matrices(100 * positions, w_first)
    for name, size in (("with pixels", (8, 8, 20)), ("compressed", (8, 8, 20))):
        image = sitk.Image(*size, sitk.sitkUInt8)
        for k, matrix in enumerate(expected):
            field = f"Seq_Frame{k:04}_"
            image[field + "StylusToTrackerTransform"] = " ".join(repr(float(value)) for value in matrix.ravel())
            image[field + "StylusToTrackerTransformStatus"] = "MISSING" if k == 7 else "OK"
            image[field + "Timestamp"] = f"{10 + 0.05 * k:.6f}"
        for ending in ("mha", "nrrd"):
            path = folder() / f"{name.replace(' ', '-')}.igs.{ending}"
            sitk.WriteImage(image, str(path), name == "compressed")
            stamps, found, lost = read(path)
            assert lost == [10_350_000_000] and stamps[0] == 10_000_000_000, (lost, stamps)
            yield Row(f".igs.{ending} {name}, its poses read here, one of them lost", difference(found, np.delete(expected, 7, axis=0)))
    euler = sitk.Euler3DTransform((1, 2, 3), 0.3, -0.2, 0.9, (12.5, -3, 900))
    versor = sitk.VersorRigid3DTransform()
    versor.SetRotation((0, 0, 1), 0.4)
    versor.SetTranslation((1, 2, 3))
    versor.SetCenter((9, 8, 7))
    shift = sitk.TranslationTransform(3, (5, 6, 7))
    for name, parts in (("one", [euler]), ("three", [euler, versor, shift]), ("identity", [sitk.Transform(3, sitk.sitkIdentity)])):
        transform = sitk.CompositeTransform(parts) if name != "identity" else parts[0]
        path = folder() / f"{name}.tfm"
        sitk.WriteTransform(transform, str(path))
        found = np.array(json.loads(osteoflow("info", path, "--format", "json").stdout)["matrix"])
        points = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 0], [0, 0, 100]], float)
        through = np.array([transform.TransformPoint(point.tolist()) for point in points])
        back = np.c_[through, np.ones(4)] @ found.T
        yield Row(f".tfm, {'the identity' if name == 'identity' else f'a composite of {name}'}, read here", float(np.abs(back[:, :3] - points).max()))


@client("mcap (Python)", module="mcap_protobuf", package="mcap")
def of_mcap():
    import mcap.reader
    from mcap_protobuf.decoder import DecoderFactory

    positions, w_first = motion(20)
    expected = matrices(100 * positions, w_first)
    text = "ObjectType = Image\nNDims = 3\nDimSize = 0 0 20\n"
    for k, matrix in enumerate(expected):
        numbers = " ".join(repr(float(value)) for value in matrix.ravel())
        name = f"Seq_Frame{k:04}_ProbeToTrackerTransform"
        text += f"{name} = {numbers}\n{name}Status = {'MISSING' if k == 7 else 'OK'}\nSeq_Frame{k:04}_Timestamp = {10 + 0.05 * k:.6f}\n"
    log, made = folder() / "log.igs.mha", folder() / "log.mcap"
    log.write_text(text + "ElementDataFile = LOCAL\n")
    osteoflow("convert", log, made)
    with open(made, "rb") as file:
        rows = [row.decoded_message for row in mcap.reader.make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()]
    assert {(row.parent_frame_id, row.child_frame_id) for row in rows} == {("Tracker", "Probe")} and len(rows) == 20
    assert [row.timestamp.ToNanoseconds() for row in rows] == [10_000_000_000 + 50_000_000 * k for k in range(20)]
    lost = [k for k, row in enumerate(rows) if row.translation.x != row.translation.x]
    seen = [row for row in rows if row.translation.x == row.translation.x]
    assert lost == [7], f"NaN where the tool was not seen: {lost}"
    found = matrices([[row.translation.x, row.translation.y, row.translation.z] for row in seen], [[row.rotation.w, row.rotation.x, row.rotation.y, row.rotation.z] for row in seen])
    yield Row("a log of poses as .mcap, its transforms read", difference(in_mm(found), np.delete(expected, 7, axis=0)))


def edges():
    """Transforms map -> base at 20 Hz, base -> arm between its stamps, arm -> camera once, and phantom beside them."""

    def at(t, k):
        turn = np.array([[0.1 * k + 0.05 * np.sin(t), -0.2 * k, 0.3 + 0.1 * k * np.cos(t)]])
        angle = np.linalg.norm(turn)
        w_first = np.c_[np.cos(angle / 2), turn / angle * np.sin(angle / 2)]
        return np.array([[0.1 * k + 0.02 * np.sin(t), 0.2 - 0.01 * t, 0.5 + 0.1 * k]]), w_first

    out = [("/tf_static", 0, "arm", "camera", *at(0.0, 3))]
    for k in range(N):
        ns = 50_000_000 * k
        out.append(("/tf", ns, "map", "base", *at(ns * 1e-9, 1)))
        ns += 20_000_000
        out.append(("/tf", ns, "base", "arm", *at(ns * 1e-9, 2)))
        out.append(("/tf", ns, "map", "phantom", *at(ns * 1e-9, 1.5)))
    return out


def write_bag(path, sqlite=False):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP) as writer:
        name = "tf2_msgs/msg/TFMessage"
        topics = {topic: writer.add_connection(topic, name, typestore=store) for topic in ("/tf", "/tf_static")}
        for topic, ns, parent, child, position, w_first in edges():
            ns += START
            time = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            (x, y, z), (w, i, j, k) = position[0].tolist(), w_first[0].tolist()
            transform = types["geometry_msgs/msg/TransformStamped"](
                header=types["std_msgs/msg/Header"](stamp=time, frame_id=parent),
                child_frame_id=child,
                transform=types["geometry_msgs/msg/Transform"](
                    translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
                    rotation=types["geometry_msgs/msg/Quaternion"](x=i, y=j, z=k, w=w),
                ),
            )
            writer.write(topics[topic], ns, store.serialize_cdr(types[name](transforms=[transform]), name))


CHAIN = """[graph]
format = 1
name = "chain"
seed = 1
[node.bag]
kind = "acquire.mcap"
path = "{path}"
out.camera = {{ type = "geometry/Pose", topic = "/tf", parent = "{parent}", child = "{child}", to = "{parent}", from = "{child}" }}

[record]
wires = ["*"]
"""


def chained(path, parent, child):
    """Stamps and matrices in mm of a transform that several join, and why it is lost where it is."""
    graph = folder() / f"{Path(path).name}-{parent}-{child}.toml"
    graph.write_text(CHAIN.format(path=path, parent=parent, child=child))
    out = folder() / f"run-{Path(path).name}-{parent}-{child}"
    said = osteoflow("run", graph, "--out", out).stderr
    seen = [row for row in items(out, "bag.camera") if not row.empty]
    numbers = np.array([row.fields["isometry"] for row in seen])
    return [row.stamp_ns - START for row in seen], matrices(numbers[:, :3], numbers[:, [6, 3, 4, 5]]), said


def interpolated(parent, child, at_ns):
    """A transform at a time by scipy: SLERP in the rotation, linear in the position."""
    from scipy.spatial.transform import Rotation, Slerp

    rows = [row for row in edges() if row[2:4] == (parent, child)]
    times = np.array([row[1] for row in rows], float)
    positions, w_first = np.concatenate([row[4] for row in rows]), np.concatenate([row[5] for row in rows])
    turns = Rotation.from_quat(w_first[:, [1, 2, 3, 0]])
    out = np.eye(4)
    out[:3, 3] = [1000 * np.interp(at_ns, times, column) for column in positions.T]
    out[:3, :3] = (turns[0] if len(rows) == 1 else Slerp(times, turns)(at_ns)).as_matrix()
    return out


@client("rosbags", module="rosbags")
def of_rosbags():
    try:
        import scipy  # noqa: F401
    except ImportError as error:
        raise Missing("no Python package scipy") from error
    path = folder() / "tf-bag"
    write_bag(path)
    for parent, child in (("map", "camera"), ("camera", "phantom")):
        stamps, found, said = chained(path, parent, child)
        assert f"t_{parent}_{child} is " in said and len(stamps) > 100, said
        expected = []
        for ns in stamps:
            camera = interpolated("map", "base", ns) @ interpolated("base", "arm", ns) @ interpolated("arm", "camera", ns)
            expected.append(camera if parent == "map" else np.linalg.inv(camera) @ interpolated("map", "phantom", ns))
        yield Row(f"{len(stamps)} transforms {parent} -> {child} over the tree of /tf and /tf_static, by scipy", difference(found, expected))
    database, bare, ros1 = folder() / "sqlite-bag", folder() / "bare.db3", folder() / "ros1.bag"
    write_bag(database, sqlite=True)
    bare.write_bytes(next(database.glob("*.db3")).read_bytes())
    # The program beside this Python, as it is installed.
    converter = str(Path(sys.executable).parent / "rosbags-convert")
    run(converter, "--src", path, "--dst", ros1)
    expected = chained(path, "map", "arm")[1]
    for source in (bare, database, ros1):
        refused = osteoflow("info", source, check=False)
        command = re.search(r"`rosbags-convert (.*?)`", refused.stderr)
        assert refused.returncode == 1 and command, f"{source}: {refused.stderr}"
        words = shlex.split(command[1])
        run(converter, *words)
        made = words[words.index("--dst") + 1]
        what = source.suffix or "folder with .db3"
        yield Row(f"{what} refused with the command that converts it, its transforms read here", difference(chained(made, "map", "arm")[1], expected))
