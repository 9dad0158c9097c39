"""Reads a scene of 3D Slicer (.mrb) by the rules of its source, and puts every node into RAS, mm, under the transforms above it.

    python3 tests/clients/scene.py SCENE.mrb FOLDER

writes FOLDER/scene.json and the points and columns of each model as 64-bit floats. Needs numpy; shares no code with the writer.
What 3D Slicer would read otherwise than it is meant, or not at all, is an error. Rules of 3D Slicer at 583e9b37:

vtkMRMLScene.cxx                       the .mrml nearest to the root of the archive
vtkMRMLStorageNode.cxx                 fileName is URL-encoded, and relative to the scene
vtkMRMLModelStorageNode.cxx            SPACE=RAS or SPACE=LPS in a file's header, else coordinateSystem of the node, else RAS
vtkMRMLLinearTransformNode.cxx         matrixTransformToParent, RAS to RAS; a file replaces it
vtkMRMLTransformStorageNode.cxx        an ITK file is LPS, and leads from the parent
vtkMRMLMarkupsJsonStorageNode.cxx      the first markup, of the node's type; LPS if it states nothing
vtkMRMLMarkupsPlaneJsonStorageNode.cxx baseToNode and objectToBase, of which LPS negates the first two rows
vtkMRMLMarkupsFiducialStorageNode.cxx  .fcsv: CoordinateSystem in a comment, then id, x, y, z, orientation, flags, label
vtkMRMLColorTableStorageNode.cxx       .ctbl: index, name, r, g, b, a up to 255
"""

import csv
import json
import sys
import zipfile
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np

TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
SHAPES = {"Model", "MarkupsFiducial", "MarkupsPlane"}
STORAGE = {
    "Model": "ModelStorage",
    "LinearTransform": "TransformStorage",
    "ColorTable": "ColorTableStorage",
    "MarkupsFiducial": "MarkupsJsonStorage",
    "MarkupsPlane": "MarkupsPlaneJsonStorage",
}


def moved(matrix, points):
    return np.asarray(points, float) @ matrix[:3, :3].T + matrix[:3, 3]


def stl(data):
    """The corners of the faces of a binary STL, three for each, and its header."""
    n = int.from_bytes(data[80:84], "little")
    assert len(data) == 84 + 50 * n, "a binary STL"
    faces = np.frombuffer(data, np.dtype([("corners", "<f4", (4, 3)), ("about", "<u2")]), n, 84)
    return faces["corners"][:, 1:].reshape(-1, 3).astype(float), data[:80].split(b"\0")[0].decode()


def legacy_vtk(data):
    """Points, scalars in their order and the header of binary poly data whose cells are vertices."""
    at = 0

    def line():
        nonlocal at
        end = data.index(b"\n", at)
        text, at = data[at:end].decode(), end + 1
        return text

    def numbers(form, n):
        nonlocal at
        values = np.frombuffer(data, form, n, at)
        at += values.nbytes
        assert line() == "", "numbers end their line"
        return values

    assert line().startswith("# vtk DataFile Version 3")
    header = line()
    assert len(header) < 256 and (line(), line()) == ("BINARY", "DATASET POLYDATA")
    _, n, kind = line().split()
    assert kind == "double"
    n = int(n)
    points = numbers(">f8", 3 * n).reshape(-1, 3).astype(float)
    assert line() == f"VERTICES {n} {2 * n}"
    assert (numbers(">i4", 2 * n).reshape(-1, 2) == [[1, k] for k in range(n)]).all(), "each point is a vertex"
    scalars = {}
    while at < len(data):
        words = line().split()
        if words[0] == "NORMALS":
            numbers(">f8", 3 * n)
        elif words[0] == "SCALARS":
            assert words[2:] == ["double", "1"] and line() == "LOOKUP_TABLE default"
            scalars[words[1]] = numbers(">f8", n).astype(float)
        else:
            assert words == ["POINT_DATA", str(n)], words
    return points, scalars, header


def fcsv(text):
    """Names and places of fiducials, RAS."""
    head = dict(line[1:].split("=", 1) for line in text.splitlines() if line.startswith("#") and "=" in line)
    head = {key.strip(): value.strip() for key, value in head.items()}
    assert head["Markups fiducial file version"], "without a version it is a list of Slicer 3"
    sign = {"LPS": -1, "1": -1, "RAS": 1, "0": 1}[head["CoordinateSystem"]]
    rows = csv.reader(line for line in text.splitlines() if line and not line.startswith("#"))
    return {row[11]: [sign * float(row[1]), sign * float(row[2]), float(row[3])] for row in rows}


def itk_to_parent(text):
    """The motion to the parent, RAS, of an ITK file."""
    assert text.startswith("#Insight Transform File V1.0")
    words = dict(line.split(": ", 1) for line in text.splitlines() if line and not line.startswith("#"))
    assert words["Transform"] in ("AffineTransform_double_3_3", "MatrixOffsetTransformBase_double_3_3"), words["Transform"]
    numbers, centre = (np.array(words[key].split(), float) for key in ("Parameters", "FixedParameters"))
    from_parent = np.eye(4)
    from_parent[:3, :3] = numbers[:9].reshape(3, 3)
    from_parent[:3, 3] = numbers[9:] + centre - from_parent[:3, :3] @ centre
    return np.linalg.inv(TURN @ from_parent @ TURN)


class Scene:
    """The nodes of a scene: `models`, `planes`, `lists`, `transforms` and the `camera`, by name, in RAS."""

    def __init__(self, path):
        self.archive = zipfile.ZipFile(path)
        names = self.archive.namelist()
        assert len(names) == len(set(names)) and self.archive.testzip() is None
        scene = min((name for name in names if name.lower().endswith(".mrml")), key=lambda name: name.count("/"))
        self.folder = scene.rpartition("/")[0]
        root = ElementTree.fromstring(self.archive.read(scene))
        assert root.tag == "MRML"
        self.nodes = {node.get("id"): node for node in root}
        assert len(self.nodes) == len(root), "identifiers are unique"
        for id, node in self.nodes.items():
            assert id.startswith(f"vtkMRML{node.tag}Node"), id
        self.transforms, self.models, self.planes, self.lists, self.camera = {}, {}, {}, {}, None
        used = set()
        for node in root:
            if node.tag == "Camera" and node.get("singletonTag") == "1":
                self.camera = {key: list(map(float, node.get(key).split())) for key in ("position", "focalPoint", "viewUp")}
            if node.tag in STORAGE:
                used.add(self.stored(node)[0])
            if node.tag == "LinearTransform":
                self.transforms[node.get("name")] = self.own_to_parent(node).tolist()
            if node.tag in SHAPES:
                assert self.referred(node, "display").tag == f"{node.tag}Display", "what has no display node is not drawn"
                getattr(self, node.tag.removeprefix("Markups").lower())(node, self.to_world(node))
        files = {name for name in names if name != scene}
        assert used == files, f"files that no node names, or that are not there: {used ^ files}"

    def referred(self, node, role):
        for part in (node.get("references") or "").split(";"):
            name, _, ids = part.partition(":")
            if name == role and ids.split():
                return self.nodes[ids.split()[0]]
        return None

    def stored(self, node):
        storage = self.referred(node, "storage")
        assert storage.tag == STORAGE[node.tag], storage.tag
        name = f"{self.folder}/{unquote(storage.get('fileName'))}"
        return name, self.archive.read(name)

    def own_to_parent(self, node):
        stated = np.array(node.get("matrixTransformToParent").split(), float).reshape(4, 4)
        _, data = self.stored(node)
        matrix = itk_to_parent(data.decode())
        assert np.abs(matrix - stated).max() < 1e-9, "the scene and the file of a transform say the same"
        assert abs(np.linalg.det(matrix[:3, :3]) - 1) < 1e-9, "a rotation"
        return matrix

    def to_world(self, node):
        matrix, above = np.eye(4), self.referred(node, "transform")
        while above is not None:
            assert above.tag == "LinearTransform"
            matrix, above = self.own_to_parent(above) @ matrix, self.referred(above, "transform")
        return matrix

    def model(self, node, to_world):
        name, data = self.stored(node)
        if name.endswith(".stl"):
            (points, header), scalars = stl(data), {}
        else:
            points, scalars, header = legacy_vtk(data)
        space = next((space for space in ("RAS", "LPS") if f"SPACE={space}" in header), None)
        space = space or self.referred(node, "storage").get("coordinateSystem") or "RAS"
        display = self.referred(node, "display")
        shown = display.get("activeScalarName") if display.get("scalarVisibility") == "true" else None
        assert shown is None or shown in scalars, shown
        model = {"points": moved(to_world @ (TURN if space == "LPS" else np.eye(4)), points), "scalars": scalars, "shown": shown}
        if shown:
            assert display.get("scalarRangeFlag") == "UseManual"
            model["range"] = list(map(float, display.get("scalarRange").split()))
            model["table"] = self.table(self.nodes[display.get("colorNodeID")])
        self.models[node.get("name")] = model

    def table(self, node):
        rows = [line.split() for line in self.stored(node)[1].decode().splitlines() if line and line[0] != "#"]
        colours = np.array([[float(value) for value in row[2:]] for row in rows])
        assert [int(row[0]) for row in rows] == list(range(int(node.get("numcolors")))) and node.get("type") == "13"
        assert colours.shape[1] == 4 and (colours[:, 3] == 255).all()
        return colours[:, :3]

    def colours(self, name):
        """The colours of a model's points, up to 255, as a lookup table gives them."""
        model = self.models[name]
        low, high = model["range"]
        table = model["table"]
        places = np.floor((model["scalars"][model["shown"]] - low) / (high - low) * len(table))
        return table[np.clip(places, 0, len(table) - 1).astype(int)]

    def markup(self, node, kind):
        markup = json.loads(self.stored(node)[1])["markups"][0]
        assert markup["type"] == kind and markup.get("coordinateUnits", "mm") == "mm"
        return markup, {"LPS": -1, "RAS": 1}[markup.get("coordinateSystem", "LPS")]

    def fiducial(self, node, to_world):
        markup, sign = self.markup(node, "Fiducial")
        points = markup["controlPoints"]
        assert all(point["positionStatus"] == "defined" for point in points)
        places = moved(to_world, [np.multiply(point["position"], [sign, sign, 1]) for point in points])
        self.lists[markup.get("name", node.get("name"))] = {p["label"]: place.tolist() for p, place in zip(points, places)}

    def plane(self, node, to_world):
        markup, sign = self.markup(node, "Plane")
        assert markup["planeType"] == "pointNormal" and len(markup["size"]) == 3
        flip = np.diag([sign, sign, 1.0, 1.0])
        base, own = (flip @ np.reshape(markup[key], (4, 4)) for key in ("baseToNode", "objectToBase"))
        pose = to_world @ base @ own
        for key, column in (("center", 3), ("normal", 2)):
            vector = flip[:3, :3] @ markup[key]
            assert np.abs((base @ own)[:3, column] - vector).max() < 1e-9, f"{key} is that of the matrices"
        self.planes[markup.get("name", node.get("name"))] = pose.tolist()


if __name__ == "__main__":
    scene, out = Scene(sys.argv[1]), Path(sys.argv[2])
    out.mkdir(exist_ok=True)
    about = {key: getattr(scene, key) for key in ("planes", "lists", "transforms", "camera")}
    for name, model in scene.models.items():
        (out / f"{name}.points").write_bytes(model["points"].astype("<f8").tobytes())
        for column, values in model["scalars"].items():
            (out / f"{name}.{column}").write_bytes(values.astype("<f8").tobytes())
    about["models"] = {name: {"columns": list(model["scalars"]), "shown": model["shown"]} for name, model in scene.models.items()}
    (out / "scene.json").write_text(json.dumps(about))
