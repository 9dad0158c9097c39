"""OpenCV: images that it compressed, lenses that it undistorts, and hand-eye calibrations that it solves, by both."""

import sys

import numpy as np
from client import ROOT, Missing, Row, client, folder, items, osteoflow, run

# Decoders of JPEG round in their own ways.
JPEG_LEVELS = 4
# Floats of metres at 300 mm.
SINGLE_MM = 1e-4
N_POSES = 15

BAG = """[graph]
format = 1
name = "images"
frames = ["camera"]
[node.bag]
kind = "acquire.mcap"
path = "{path}"
{ports}

[record]
wires = ["*"]
"""
PICTURE = 'out.{name} = {{ type = "geometry/Image", topic = "/{name}", calibration = "/pinhole/info", frame = "camera" }}'
CLOUD = 'out.{name} = {{ type = "geometry/Cloud", topic = "{topic}", {more}frame = "camera" }}'

CALIBRATION = """[graph]
format = 1
name = "hand_eye"
frames = ["world", "camera", "camera_marker", "board"]
[node.log]
kind = "acquire.poses"
path = "{path}"
out.marker = {{ type = "geometry/Pose", parent = "world", child = "camera_marker", to = "world", from = "camera_marker" }}
out.target = {{ type = "geometry/Pose", parent = "camera", child = "board", to = "camera", from = "board" }}
[node.calibration]
kind = "calibrate.hand_eye"
in = {{ marker = "log.marker", target = "log.target" }}
method = "{method}"

[record]
wires = ["*"]
"""


def ran(name, text):
    """The folder of a run of a graph, and what it said."""
    graph, out = folder() / f"{name}.toml", folder() / f"{name}-run"
    graph.write_text(text)
    done = osteoflow("run", graph, "--out", out, check=False)
    return out, done


def images():
    bag = folder() / "opencv-bag"
    run(sys.executable, ROOT / "tests" / "python" / "ros2_images.py", bag)
    lenses = ("pinhole", "brown", "rational", "fisheye")
    pictures = ("rgb8", "png", "jpeg", "jpeg_by_opencv")
    ports = [PICTURE.format(name=name) for name in pictures]
    for lens in lenses:
        for depth in ("depth16", "depth32"):
            ports.append(CLOUD.format(name=f"{lens}_{depth}", topic=f"/{depth}", more=f'calibration = "/{lens}/info", '))
        ports.append(CLOUD.format(name=f"{lens}_points", topic=f"/{lens}/points", more=""))
    out, done = ran("opencv-images", BAG.format(path=bag, ports="\n".join(ports)))
    assert done.returncode == 0, done.stderr

    def column(wire, name):
        return items(out, f"bag.{wire}")[0].columns[name].astype(float)

    def levels(a, b):
        return float(np.abs(column(a, "pixels") - column(b, "pixels")).max())

    yield Row("PNG that it compressed, decoded here", levels("png", "rgb8"), "levels", 0)
    yield Row("JPEG that it compressed, decoded by both", levels("jpeg", "jpeg_by_opencv"), "levels", JPEG_LEVELS)
    for lens in lenses:
        for depth, what, tolerance in (("depth16", "whole mm", 1e-6), ("depth32", "floats", SINGLE_MM)):
            off = column(f"{lens}_{depth}", "points") - column(f"{lens}_points", "points")
            yield Row(f"a depth image of {what} under the lens {lens}, its points by both", float(np.abs(off).max()), tolerance=tolerance)


def pose(vector, position):
    from scipy.spatial.transform import Rotation

    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), position
    return out


def seen(axes=(1, 1, 1)):
    """Poses of the marker in the tracker and of a target in the camera, with noise; turned about `axes`."""
    random = np.random.default_rng(3)
    truth, world = pose([0.4, -0.7, 1.1], [35, -60, 82]), pose([-0.3, 0.2, 0.9], [500, -800, 1200])
    markers, targets = [], []
    for _ in range(N_POSES):
        target = pose(random.uniform(-0.7, 0.7, 3) * axes, [0, 0, 250] + random.uniform(-30, 30, 3))
        marker = world @ np.linalg.inv(target) @ np.linalg.inv(truth)
        noise = [pose(2e-4 * random.normal(size=3), 0.1 * random.normal(size=3)) for _ in range(2)]
        markers.append(marker @ noise[0])
        targets.append(target @ noise[1])
    return markers, targets


def calibrated(name, markers, targets, method="park_martin"):
    """The camera in its marker by the program, and what it said."""
    from scipy.spatial.transform import Rotation

    path = folder() / f"{name}.csv"
    rows = ["t_ns,parent,child,x,y,z,qx,qy,qz,qw"]
    for k, pair in enumerate(zip(markers, targets)):
        for frames, matrix in zip(("world,camera_marker", "camera,board"), pair):
            numbers = [*matrix[:3, 3], *Rotation.from_matrix(matrix[:3, :3]).as_quat()]
            rows.append(f"{10**9 * (k + 1)},{frames}," + ",".join(repr(float(number)) for number in numbers))
    path.write_text("\n".join(rows) + "\n")
    out, done = ran(name, CALIBRATION.format(path=path, method=method))
    if done.returncode != 0:
        return None, done.stderr
    x, y, z, *quaternion = items(out, "calibration.t_camera_camera_marker")[0].fields["isometry"]
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), [x, y, z]
    return np.linalg.inv(found), done.stderr


def hand_eye(cv2):
    markers, targets = seen()
    for method, name, what, tolerance in (
        ("park_martin", "PARK", "Park and Martin", 1e-6),
        ("daniilidis", "DANIILIDIS", "Daniilidis", 1e-6),
        # It leaves out motions by less than 0.3 radians here.
        ("tsai_lenz", "TSAI", "Tsai and Lenz", 0.02),
    ):
        split = [[matrix[:3, :3] for matrix in poses] for poses in (markers, targets)], [[matrix[:3, 3] / 1000 for matrix in poses] for poses in (markers, targets)]
        # In metres, since its dual quaternions weigh lengths against turns.
        turn, position = cv2.calibrateHandEye(split[0][0], split[1][0], split[0][1], split[1][1], method=getattr(cv2, f"CALIB_HAND_EYE_{name}"))
        found, _ = calibrated(f"hand-eye-{method}", markers, targets, method)
        corners = np.array([[0, 0, 0, 1], [100, 0, 0, 1], [0, 100, 0, 1], [0, 0, 100, 1]], float).T
        other = np.eye(4)
        other[:3, :3], other[:3, 3] = turn, position.ravel() * 1000
        yield Row(f"hand-eye calibration of {what} by both, at points 100 mm away", float(np.abs((found - other) @ corners).max()), tolerance=tolerance)
    inverse = np.linalg.inv
    one_axis, still = seen((0, 0, 1)), seen((0, 0, 0))
    metres = [np.block([[target[:3, :3], target[:3, 3:] / 1000], [np.zeros((1, 3)), np.ones((1, 1))]]) for target in targets]
    for what, marker, target, said in (
        ("about one axis", *one_axis, "about one axis alone"),
        ("without turns", *still, "about no axis that can be told"),
        ("of the camera in the target", markers, [inverse(m) for m in targets], "if the poses of the marker or of the target are inverted"),
        ("of the tracker in the marker", [inverse(m) for m in markers], targets, "if the poses of the marker or of the target are inverted"),
        ("that are exchanged", targets, markers, "hand_eye_arrangement"),
        ("of a target in metres", markers, metres, "multiply the size of the board by"),
        ("of other times", markers, targets[::-1], "are poses of different times paired"),
    ):
        found, text = calibrated("hand-eye-" + what.replace(" ", "-"), marker, target)
        assert said in text, f"{what}: {text}"
        yield Row(f"hand-eye poses {what} {'refused' if found is None else 'warned of'}", 0.0, "")


@client("OpenCV", version=lambda: __import__("cv2").__version__, module="cv2", package="opencv-python-headless")
def of_opencv():
    import cv2

    for module in ("rosbags", "scipy", "mcap"):
        try:
            __import__(module)
        except ImportError as error:
            raise Missing(f"no Python package {module}") from error
    yield from images()
    if not hasattr(cv2, "calibrateHandEye"):
        raise Missing("this OpenCV has no calibrateHandEye; versions before 5 have it")
    yield from hand_eye(cv2)
