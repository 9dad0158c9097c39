"""Reads the folder export/ of a run with the libraries of other programs and compares it with the recording.

    python3 tests/python/check_export.py RUN

RUN has run.mcap, which holds the wires bone.mesh, to_bone.cloud, icp.t_target_source, plan.landmarks and plan.planes. Needs
mcap, numpy, trimesh, SimpleITK and vtk: the reader of meshes in Python, that of transforms and that of models in 3D Slicer.
Exit code 0: all coordinates agree to 1e-4 mm; 1: they do not; 2: a library is missing, which is named.
"""

import json
import struct
import sys
from pathlib import Path

try:
    import numpy as np
    import SimpleITK as sitk
    import trimesh
    import vtk
    from mcap.reader import make_reader
    from vtk.util.numpy_support import vtk_to_numpy
except ImportError as missing:
    print(f"missing: {missing.name}")
    sys.exit(2)

TOLERANCE_MM = 1e-4
NOTICE = b"research use only"


def read_item(message):
    """Fields and columns of an exact message; see docs/use/recording.md."""
    at = 40
    n_fields, n_columns = struct.unpack_from("<II", message, 28)
    assert message[:8] == b"OSTEOVW1" and message[24] == 0

    def take(form):
        nonlocal at
        values = struct.unpack_from(form, message, at)
        at += struct.calcsize(form)
        return values

    def text():
        (n,) = take("<I")
        return take(f"<{n}s")[0].decode()

    values = {}
    for _ in range(n_fields):
        (kind,) = take("<B")
        name = text()
        if kind == 5:
            values[name] = text()
        elif kind == 4:
            values[name] = np.array(take(f"<{take('<I')[0]}d"))
        else:
            values[name] = take({1: "<?", 2: "<q", 3: "<d"}[kind])[0]
    for _ in range(n_columns):
        name = text()
        kind, width, n_bytes = take("<BIQ")
        at += -at % 8
        dtype = np.dtype({1: "<f8", 2: "<f4", 3: "<i8", 4: "<u4", 5: "u1"}[kind])
        values[name] = np.frombuffer(message, dtype, n_bytes // dtype.itemsize, at).reshape(-1, width)
        at += n_bytes
    return values


def matrix(numbers):
    """Rotation and translation of x, y, z in mm and a quaternion x, y, z, w."""
    x, y, z, w = numbers[3:]
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation, np.array(numbers[:3])


run = Path(sys.argv[1])
export = run / "export"
recorded = {}
with open(run / "run.mcap", "rb") as file:
    for _, channel, message in make_reader(file).iter_messages():
        if channel.topic.startswith("/exact/") and message.data[8 + 24] == 0:
            recorded.setdefault(channel.topic.removeprefix("/exact/"), message.data[8:])
item = {wire: read_item(recorded[wire]) for wire in ("bone.mesh", "plan.landmarks", "plan.planes", "to_bone.cloud")}
turn, shift = matrix(read_item(recorded["icp.t_target_source"])["isometry"])
scan = item["to_bone.cloud"]["points"] @ turn.T + shift
wrong = []


def compare(what, found, expected):
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    if found.shape != expected.shape:
        off_mm = np.inf
    else:
        off_mm = float(np.abs(found - expected).max())
    print(f"{what:40} {len(expected):7} values, largest difference {off_mm:.2e} mm")
    if not off_mm <= TOLERANCE_MM:
        wrong.append(what)


def expect(what, holds):
    if not holds:
        print(f"{what}: not so")
        wrong.append(what)


bone = trimesh.load(export / "bone.stl", process=False)
compare("bone.stl (trimesh)", bone.triangles, item["bone.mesh"]["vertices"][item["bone.mesh"]["faces"]])
reader = vtk.vtkSTLReader()
reader.SetFileName(str(export / "bone.stl"))
reader.Update()
expect("bone.stl says LPS", b"SPACE=LPS" in (export / "bone.stl").read_bytes()[:80])
compare("bone.stl (vtk), extent", reader.GetOutput().GetBounds()[::2], item["bone.mesh"]["vertices"].min(axis=0))

compare("scan.ply (trimesh)", trimesh.load(export / "scan.ply", process=False).vertices, scan)
reader = vtk.vtkPolyDataReader()
reader.SetFileName(str(export / "scan.vtk"))
reader.Update()
compare("scan.vtk (vtk)", vtk_to_numpy(reader.GetOutput().GetPoints().GetData()), scan)
expect("every point of scan.vtk is drawn", reader.GetOutput().GetNumberOfVerts() == len(scan))
expect("scan.vtk is coloured by its distance", reader.GetOutput().GetPointData().GetScalars().GetName() == "distance_mm")
expect("scan.vtk says LPS", "SPACE=LPS" in reader.GetHeader())

moves = sitk.ReadTransform(str(export / "scan_to_ct.tfm")).GetInverse()
some = item["to_bone.cloud"]["points"][:: max(1, len(scan) // 500)]
compare("scan_to_ct.tfm (SimpleITK)", [moves.TransformPoint(p.tolist()) for p in some], some @ turn.T + shift)

markups = json.loads((export / "landmarks.mrk.json").read_text())["markups"]
points = markups[0]["controlPoints"]
compare("landmarks.mrk.json", [p["position"] for p in points], item["plan.landmarks"]["positions"])
expect("landmarks have their names", [p["label"] for p in points] == item["plan.landmarks"]["names"].split("\n"))
planes = json.loads((export / "planes.mrk.json").read_text())["markups"]
poses = [matrix(numbers) for numbers in item["plan.planes"]["isometries"]]
compare("planes.mrk.json, origins", [p["center"] for p in planes], [t for _, t in poses])
compare("planes.mrk.json, normals times 100 mm", [np.multiply(100, p["normal"]) for p in planes], [100 * r[:, 2] for r, _ in poses])
expect("planes have their names", [p["name"] for p in planes] == item["plan.planes"]["names"].split("\n"))
for markup in markups + planes:
    expect("markups are LPS and mm", (markup["coordinateSystem"], markup["coordinateUnits"]) == ("LPS", "mm"))

for file in sorted(export.iterdir()):
    expect(f"{file.name} is marked for research use only", NOTICE in file.read_bytes())
print("wrong: " + ", ".join(wrong) if wrong else "all agree")
sys.exit(bool(wrong))
