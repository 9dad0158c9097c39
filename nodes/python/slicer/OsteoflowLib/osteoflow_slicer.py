"""A registration by Osteoflow of nodes of 3D Slicer: what goes out to the program, what comes back, and nothing of the widget.

3D Slicer is RAS, files are LPS: `flipped` and `flipped_motion` are the only places that know it. Everything goes out in world
coordinates. Research software, not a medical device.

What is called of 3D Slicer was read in its source at 583e9b37, below Libs/MRML/Core unless another folder is named:

- vtkMRMLTransformNode.h, .cxx: GetMatrixTransformBetweenNodes gives 0 where a transform is not linear; IsTransformToWorldLinear;
  SetMatrixTransformToParent gives 0 for a composite one; the roles of what was registered.
- vtkMRMLTransformableNode.h: GetParentTransformNode, SetAndObserveTransformNodeID.
- vtkMRMLSegmentationNode.cxx: GetClosedSurfaceRepresentation copies a surface in the node's coordinates, which
  CreateClosedSurfaceRepresentation has made; Libs/vtkSegmentationCore/vtkSegmentation.h: GetConversionParameter,
  vtkBinaryLabelmapToClosedSurfaceConversionRule.h: the name of the smoothing factor.
- vtkMRMLModelNode.cxx: GetPolyData gives None for an unstructured grid; vtkMRMLVolumeNode.cxx: GetIJKToRASMatrix;
  vtkMRMLLabelMapVolumeNode.h, vtkMRMLVectorVolumeNode.h: both are scalar volumes, too.
- vtkMRMLMarkupsNode.h: GetNthControlPointPositionWorld gives 0 on failure, PositionDefined;
  vtkMRMLMarkupsPlaneNode.cxx: GetObjectToWorldMatrix, SetAxes and SetOrigin (of the node), GetIsPlaneValid.
- vtkMRMLDisplayNode.h: SetActiveScalar, UseManualScalarRange; Libs/MRML/Logic/vtkMRMLColorLogic.h: the identifier of a colour table.
- vtkMRMLTextNode.h: SetText; vtkMRMLNode.h: SetAttribute, SetDescription, SetNodeReferenceID; vtkMRMLScene.cxx: AddNewNodeByClass
  gives None for an unknown class, RemoveNode, IsNodePresent.
- Base/QTGUI/qSlicerScriptedLoadableModuleFactory.cxx: each Python file of a folder is taken for a module, so this one lies below it.
- Base/Python/slicer/util.py: getNodesByClass, arrayFromVolume, arrayFromVTKMatrix, vtkMatrixFromArray, startupEnvironment;
  executePythonModule finds the interpreter as `find_program` does.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Optional

import numpy as np
import slicer
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

NOTICE = "research use only, not for clinical use"
GRAPHS = Path(__file__).resolve().parents[1] / "graphs"
#: As many assumptions as the terminal shows.
SHOWN_ASSUMPTIONS = 3
#: Time that the program has to stop in order, before it is killed.
GRACE_S = 3.0
#: By how much a scan may come back elsewhere: its file has 32-bit floats, which keep 1e-4 mm.
MOVED_MM = 1e-3
COLOURS = "vtkMRMLColorTableNodeFileDivergingBlueRed.txt"
COLOURED_MM = 1.0
DISTANCE = "distance_mm"


class Fault(Exception):
    """Why there is no registration, and what to do."""

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(f"{message}\n{remedy}" if remedy else message)
        self.message, self.remedy = message, remedy


@dataclass
class Inputs:
    """What the user has chosen."""

    #: A segmentation, a model or a volume.
    bone: Any = None
    segment: str = ""
    threshold_hu: Optional[float] = None
    #: A model, or a file.
    scan: Any = None
    scan_file: str = ""
    #: Millimetres in the scan's unit; it holds for the points picked on the scan, too.
    scan_unit_mm: float = 1.0
    #: Whether the camera was at the origin of the scan's own coordinates.
    camera_at_origin: bool = False
    bone_points: Any = None
    scan_points: Any = None
    #: Whether these points are screws, rings or skin markers.
    off_surface: bool = False
    planes: list = field(default_factory=list)
    #: Points at which the error is predicted.
    targets: Any = None


# Coordinates


def flipped(points: Any) -> np.ndarray:
    """Points or directions (n, 3) in LPS from RAS, or in RAS from LPS."""
    return np.asarray(points, dtype=np.float64) * (-1.0, -1.0, 1.0)


def flipped_motion(matrix: Any) -> np.ndarray:
    """A motion between spaces in RAS from one between these in LPS, or the other way."""
    flip = np.diag([-1.0, -1.0, 1.0, 1.0])
    return flip @ np.asarray(matrix, dtype=np.float64) @ flip


def moved(matrix: np.ndarray, points: Any) -> np.ndarray:
    return np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def to_world(node: Any) -> np.ndarray:
    """The transforms above a node, RAS."""
    parent = node.GetParentTransformNode()
    if parent is None:
        return np.eye(4)
    matrix = vtk.vtkMatrix4x4()
    if not parent.IsTransformToWorldLinear() or not slicer.vtkMRMLTransformNode.GetMatrixTransformBetweenNodes(parent, None, matrix):
        raise Fault(f"the transform above {node.GetName()} deforms it", "harden it first if the shape is meant so")
    world = slicer.util.arrayFromVTKMatrix(matrix)
    if np.linalg.det(world[:3, :3]) <= 0.0:
        raise Fault(f"the transform above {node.GetName()} mirrors it", "take it away, or harden it if the mirror image is meant")
    return world


def _scale_note(node: Any, world: np.ndarray, notes: list) -> None:
    scales = np.linalg.svd(world[:3, :3], compute_uv=False)
    if np.any(np.abs(scales - 1.0) > 1e-6):
        notes.append(f"the transform above {node.GetName()} stretches it by {scales.min():.6g} to {scales.max():.6g}")


# What goes out


def _points_and_faces(surface: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
    if surface is None or surface.GetNumberOfPoints() == 0:
        raise Fault(f"{name} holds no surface and no points")
    points = vtk_to_numpy(surface.GetPoints().GetData()).astype(np.float64)
    triangles = vtk.vtkTriangleFilter()
    triangles.SetInputData(surface)
    triangles.PassVertsOff()
    triangles.PassLinesOff()
    triangles.Update()
    cells = triangles.GetOutput().GetPolys()
    corners = vtk_to_numpy(cells.GetConnectivityArray()) if cells.GetNumberOfCells() else np.empty(0)
    return points, corners.astype(np.int64).reshape(-1, 3)


def _legacy_vtk(points: np.ndarray, faces: np.ndarray) -> bytes:
    head = f"# vtk DataFile Version 3.0\n3D Slicer, mm, SPACE=LPS, {NOTICE}\nBINARY\nDATASET POLYDATA\nPOINTS {len(points)} double\n"
    parts = [head.encode(), np.ascontiguousarray(points, dtype=">f8").tobytes(), b"\n"]
    if len(faces):
        rows = np.column_stack([np.full(len(faces), 3), faces])
        parts += [f"POLYGONS {len(faces)} {rows.size}\n".encode(), rows.astype(">i4").tobytes(), b"\n"]
    return b"".join(parts)


NRRD_TYPES = {
    "int8": "int8", "uint8": "uint8", "int16": "int16", "uint16": "uint16", "int32": "int32", "uint32": "uint32",
    "int64": "int64", "uint64": "uint64", "float32": "float", "float64": "double",
}


def _nrrd(voxels: np.ndarray, t_lps_ijk: np.ndarray) -> bytes:
    """A volume whose array is (k, j, i)."""
    vector = lambda v: "(" + ",".join(repr(float(c)) for c in v) + ")"
    head = [
        "NRRD0004", f"# {NOTICE}", f"type: {NRRD_TYPES[voxels.dtype.name]}", "dimension: 3", "space: left-posterior-superior",
        "sizes: " + " ".join(str(n) for n in reversed(voxels.shape)),
        "space directions: " + " ".join(vector(t_lps_ijk[:3, k]) for k in range(3)),
        "kinds: domain domain domain", "endian: little", "encoding: raw", "space origin: " + vector(t_lps_ijk[:3, 3]),
    ]
    little = np.ascontiguousarray(voxels, dtype=voxels.dtype.newbyteorder("<"))
    return ("\n".join(head) + "\n\n").encode() + little.tobytes()


def _surface_of(node: Any, segment: str, notes: list) -> bytes:
    """A segment or a model as a file in LPS."""
    if node.IsA("vtkMRMLSegmentationNode"):
        segmentation = node.GetSegmentation()
        if segmentation is None or not segment or segmentation.GetSegment(segment) is None:
            raise Fault(f"no segment of {node.GetName()} is chosen", "choose the segment that is the bone")
        surface = vtk.vtkPolyData()
        if not node.CreateClosedSurfaceRepresentation() or not node.GetClosedSurfaceRepresentation(segment, surface):
            raise Fault(f"{node.GetName()} gives no closed surface of the segment", "show it in 3D in Segment Editor; is it empty?")
        factor = segmentation.GetConversionParameter("Smoothing factor")
        if factor and float(factor) > 0.0:
            notes.append(f"the surface of the segment is smoothed by 3D Slicer (smoothing factor {factor}), which moves it; 0 leaves it")
    else:
        surface = node.GetPolyData()
    world = to_world(node)
    _scale_note(node, world, notes)
    points, faces = _points_and_faces(surface, node.GetName())
    return _legacy_vtk(flipped(moved(world, points)), faces)


def _volume_of(node: Any, notes: list) -> bytes:
    if node.IsA("vtkMRMLLabelMapVolumeNode"):
        raise Fault(f"{node.GetName()} is a label map, not a CT", "import it into a segmentation, and choose its segment")
    image = node.GetImageData()
    if image is None or image.GetNumberOfPoints() == 0 or image.GetNumberOfScalarComponents() != 1:
        raise Fault(f"{node.GetName()} is no volume of single numbers", "choose the CT")
    voxels = slicer.util.arrayFromVolume(node)
    if voxels.dtype.name not in NRRD_TYPES:
        raise Fault(f"{node.GetName()} has voxels of {voxels.dtype.name}", "cast it in the module Cast Scalar Volume")
    matrix = vtk.vtkMatrix4x4()
    node.GetIJKToRASMatrix(matrix)
    world = to_world(node)
    _scale_note(node, world, notes)
    t_ras_ijk = world @ slicer.util.arrayFromVTKMatrix(matrix)
    return _nrrd(voxels, np.diag([-1.0, -1.0, 1.0, 1.0]) @ t_ras_ijk)


def _scan_points(node: Any) -> np.ndarray:
    """The points of a model in the world, RAS, its own unit."""
    return moved(to_world(node), _points_and_faces(node.GetPolyData(), node.GetName())[0])


def _markup(node: Any, kind: str, **more: Any) -> dict:
    return {"type": kind, "coordinateSystem": "LPS", "coordinateUnits": "mm", "name": node.GetName(), **more}


def _point_list(node: Any, unit_mm: float, notes: list, name: str = "") -> dict:
    if not node.IsA("vtkMRMLMarkupsFiducialNode"):
        raise Fault(f"{node.GetName()} is no list of points", "choose a point list of Markups")
    to_world(node)
    points, labels = [], []
    for k in range(node.GetNumberOfControlPoints()):
        label, position = node.GetNthControlPointLabel(k), [0.0, 0.0, 0.0]
        if node.GetNthControlPointPositionStatus(k) != slicer.vtkMRMLMarkupsNode.PositionDefined:
            notes.append(f"{node.GetName()}: {label or k + 1} is not placed, and left out")
            continue
        if not node.GetNthControlPointPositionWorld(k, position):
            raise Fault(f"{node.GetName()}: point {k + 1} has no position")
        labels.append(label)
        points.append(position)
    if not points:
        raise Fault(f"{node.GetName()} has no points", "place them")
    at = flipped(points) * unit_mm
    rows = [{"label": label, "position": list(p), "positionStatus": "defined"} for label, p in zip(labels, at)]
    return _markup(node, "Fiducial", controlPoints=rows, **({"name": name} if name else {}))


def _plane(node: Any) -> dict:
    if not node.IsA("vtkMRMLMarkupsPlaneNode"):
        raise Fault(f"{node.GetName()} is no plane", "choose planes of Markups")
    if not node.GetIsPlaneValid():
        raise Fault(f"{node.GetName()} is not placed", "place the plane, or leave it out")
    to_world(node)
    matrix = vtk.vtkMatrix4x4()
    node.GetObjectToWorldMatrix(matrix)
    pose = slicer.util.arrayFromVTKMatrix(matrix)
    axes = flipped((pose[:3, :3] / np.linalg.norm(pose[:3, :3], axis=0)).T)
    return _markup(
        node, "Plane", center=list(flipped(pose[:3, 3])), normal=list(axes[2]), orientation=[float(c) for c in axes.T.ravel()],
    )


def _markups_file(markups: list) -> bytes:
    schema = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#"
    return json.dumps({"@schema": schema, "markups": markups}, indent=1).encode()


def _text(value: Any) -> str:
    """A string of TOML."""
    return json.dumps(str(value), ensure_ascii=False)


def files_of(inputs: Inputs) -> tuple[dict[str, bytes], list[str]]:
    """The files of a run by their names, in LPS and mm, and what is to be said of them."""
    notes: list[str] = []
    bone, scan = inputs.bone, inputs.scan
    if bone is None:
        raise Fault("no bone is chosen", "choose a segmentation, a model or a CT")
    if (scan is None) == (not inputs.scan_file):
        raise Fault("one scan is needed, a model or a file")
    if bone is scan:
        raise Fault("bone and scan are the same model")
    if (inputs.bone_points is None) != (inputs.scan_points is None):
        raise Fault("landmarks are picked on one side only", "pick them on bone and scan under the same names, or leave out both")
    if inputs.bone_points is not None and inputs.bone_points is inputs.scan_points:
        raise Fault("the landmarks of bone and scan are the same list", "choose the list that was picked on the scan")
    if not (np.isfinite(inputs.scan_unit_mm) and inputs.scan_unit_mm > 0.0):
        raise Fault("the scan's unit must be a positive number of mm", "1 for millimetres, 1000 for metres")
    files: dict[str, bytes] = {}
    lines = ["[graph]", 'name = "slicer"', "", "[node.bone]"]
    if bone.IsA("vtkMRMLScalarVolumeNode"):
        files["bone.nrrd"] = _volume_of(bone, notes)
        lines.append('path = "bone.nrrd"')
        if inputs.threshold_hu is not None:
            lines.append(f"threshold_hu = {float(inputs.threshold_hu)!r}")
    elif bone.IsA("vtkMRMLModelNode") or bone.IsA("vtkMRMLSegmentationNode"):
        files["bone.vtk"] = _surface_of(bone, inputs.segment, notes)
        lines.append('path = "bone.vtk"')
    else:
        raise Fault(f"{bone.GetName()} is no bone", "choose a segmentation, a model or a CT")
    lines += ["", "[node.scan]"]
    camera = np.zeros(3)
    if scan is None:
        if not Path(inputs.scan_file).is_file():
            raise Fault(f"there is no file {inputs.scan_file}")
        lines += [f"path = {_text(Path(inputs.scan_file).resolve().as_posix())}", f"unit_mm = {float(inputs.scan_unit_mm)!r}"]
    else:
        if not scan.IsA("vtkMRMLModelNode"):
            raise Fault(f"{scan.GetName()} is no model", "choose the scan's model, or its file")
        world = to_world(scan)
        _scale_note(scan, world, notes)
        files["scan.vtk"] = _legacy_vtk(flipped(_scan_points(scan)) * inputs.scan_unit_mm, np.empty((0, 3)))
        camera = flipped(world[:3, 3]) * inputs.scan_unit_mm
        lines.append('path = "scan.vtk"')
    if inputs.camera_at_origin:
        lines.append(f"camera = {[float(c) + 0.0 for c in camera]}")
    base = "two_files.toml"
    if inputs.bone_points is not None:
        base = "variants/two_files_picked.toml"
        files["bone_points.mrk.json"] = _markups_file([_point_list(inputs.bone_points, 1.0, notes)])
        files["scan_points.mrk.json"] = _markups_file([_point_list(inputs.scan_points, inputs.scan_unit_mm, notes)])
        lines += ["", "[node.bone_points]", 'path = "bone_points.mrk.json"', "", "[node.scan_points]", 'path = "scan_points.mrk.json"']
    verdict = ["on_surface = false"] if inputs.off_surface and inputs.bone_points is not None else []
    if inputs.planes or inputs.targets is not None:
        plan = [_plane(node) for node in inputs.planes]
        if inputs.targets is not None:
            plan.append(_point_list(inputs.targets, 1.0, notes, "assessment"))
        files["plan.mrk.json"] = _markups_file(plan)
        lines += ["", "[node.plan]", 'kind = "plan.file"', 'path = "plan.mrk.json"', "", "[node.export]", 'in.planes = "plan.planes"']
        verdict += [f'in.{port} = "plan.{wire}"' for port, wire in (("plan", "report"), ("assessment", "assessment"), ("planes", "planes"))]
        verdict.append("assessment_on_surface = false")
    if verdict:
        lines += ["", "[node.verdict]", *verdict]
    graph = GRAPHS / base
    if not graph.is_file():
        raise Fault(f"{graph} is missing", "write the module again with `osteoflow new slicer`")
    files["run.toml"] = "\n".join([f"extends = {_text(graph.as_posix())}", "", *lines, ""]).encode()
    return files, notes


def _digests(files: dict[str, bytes]) -> dict[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


# The program


def find_program(given: str = "") -> tuple[list[str], bool]:
    """The command, and whether it is of 3D Slicer's own Python, whose environment it then needs."""
    if given:
        found = shutil.which(given)
        if found is None:
            raise Fault(f"there is no program {given}", "choose the file osteoflow, or leave the field empty for that of 3D Slicer's Python")
        return [found], False
    if importlib.util.find_spec("osteoflow") is not None:
        return [shutil.which("PythonSlicer") or sys.executable, "-m", "osteoflow"], True
    found = shutil.which("osteoflow")
    if found is None:
        raise Fault(
            "the program osteoflow is not installed",
            "in the Python console: slicer.util.pip_install(\"FILE.whl\") with the wheel of osteoflow, or choose the program under Advanced",
        )
    return [found], False


class Process:
    """The program, which works beside 3D Slicer."""

    def __init__(self, command: list[str], folder: Path, is_own_python: bool) -> None:
        self._log = folder / "log.txt"
        self._kill_at: Optional[float] = None
        environment = dict(os.environ) if is_own_python else slicer.util.startupEnvironment()
        options: dict = {"start_new_session": True} if os.name == "posix" else {"creationflags": subprocess.CREATE_NO_WINDOW}
        with open(self._log, "wb") as log:
            try:
                self._child = subprocess.Popen(
                    command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=log, **options,
                )
            except OSError as error:
                raise Fault(f"{command[0]} cannot be started: {error.strerror}", "choose another program under Advanced") from error

    def _signal(self, name: str) -> None:
        """To the program and what it has started."""
        if self._child.poll() is not None:
            return
        if os.name == "posix":
            try:
                os.killpg(self._child.pid, getattr(signal, name))
            except ProcessLookupError:
                pass
        else:
            self._child.kill()

    def cancel(self) -> None:
        if self._kill_at is None:
            self._kill_at = time.monotonic() + GRACE_S
            self._signal("SIGINT")

    def kill(self) -> None:
        self._signal("SIGKILL")
        self._child.wait()

    def poll(self) -> Optional[int]:
        """The exit code; None while it works."""
        if self._kill_at is not None and time.monotonic() > self._kill_at:
            self.kill()
        return self._child.poll()

    def lines(self) -> list[str]:
        return self._log.read_text(encoding="utf-8", errors="replace").splitlines() if self._log.exists() else []


_PROGRESS = re.compile(r"^(running .*: \d+ nodes, seed|\d+ of \d+ nodes have worked)")


# What comes back


@dataclass
class Answer:
    """What the program found, in LPS and mm."""

    answer: str
    sentence: str
    reasons: list
    assumptions: list
    predicted: Optional[dict]
    chance: Optional[float]
    warnings: list
    version: str
    #: Scan to bone; none if it is refused.
    t_bone_scan: Optional[np.ndarray] = None
    #: The scan in its own coordinates, and how far each point lies from the bone.
    points: Optional[np.ndarray] = None
    distances: Optional[np.ndarray] = None
    #: Planes in the scan's coordinates, by name.
    planes: dict = field(default_factory=dict)
    #: The surface of the bone in a CT.
    bone_surface: Any = None


def read_ply(path: Path) -> np.ndarray:
    """The vertices of a binary PLY as rows with named columns."""
    content = path.read_bytes()
    end = content.index(b"end_header\n") + len(b"end_header\n")
    types = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}
    columns, n, is_vertex = [], 0, False
    for line in content[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        if words[:1] == ["format"] and words[1] != "binary_little_endian":
            raise Fault(f"{path.name} is {words[1]}")
        if words[:1] == ["element"]:
            is_vertex = words[1] == "vertex"
            n = int(words[2]) if is_vertex else n
        elif words[:1] == ["property"] and is_vertex:
            columns.append((words[2], types[words[1]]))
    return np.frombuffer(content, np.dtype(columns), count=n, offset=end)


def _pose(value: dict) -> np.ndarray:
    matrix = np.array(value["matrix"], dtype=np.float64)
    off = np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max()
    is_rigid = off < 1e-6 and np.linalg.det(matrix[:3, :3]) > 0.0 and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])
    if (value["to"], value["from"]) != ("ct", "camera") or not is_rigid or not np.isfinite(matrix).all():
        raise Fault("the program gave no rigid motion from the scan to the bone", "report it with the version of osteoflow")
    return matrix


def read_answer(folder: Path, code: int, log: list[str], sent: dict[str, str]) -> Answer:
    """The answer of a run in its folder; `sent` has the SHA-256 of the files that it had to read."""
    said = "\n".join(line for line in log if line.strip() and not _PROGRESS.match(line))
    if code not in (0, 3) or not (folder / "out/results.json").is_file():
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        raise Fault(said or "the program said nothing", f"the program ended without an answer ({how})")
    results = json.loads((folder / "out/results.json").read_text(encoding="utf-8"))
    manifest = json.loads((folder / "out/manifest.json").read_text(encoding="utf-8"))
    read = {(row["path"], row["sha256"]) for row in manifest["inputs"]}
    for name, digest in sent.items():
        if name != "run.toml" and (name, digest) not in read:
            raise Fault(f"the program did not read {name} as it was written", "run it again")
    verdict = results["verdict"]
    answer = verdict["answer"]
    warnings = [w if isinstance(w, str) else f"{w.get('node', '')}: {w.get('message', w)}".lstrip(": ") for w in manifest["warnings"]]
    found = Answer(
        answer, verdict.get("sentence", ""), verdict["reasons"], verdict["assumptions"], verdict.get("predicted"),
        verdict.get("chance_of_being_wrong"), warnings, manifest["engine_version"],
    )
    # A word that is not known here is no leave to use the pose.
    if code != 0 or answer not in ("trusted", "doubtful"):
        found.answer = "refused"
        if not found.reasons:
            found.sentence = found.sentence or said
        return found
    found.t_bone_scan = _pose(results["poses"]["t_ct_camera"])
    t_scan_bone = np.linalg.inv(found.t_bone_scan)
    export = folder / "out/export"
    rows = read_ply(export / "scan.ply")
    found.points = moved(t_scan_bone, np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"]))
    found.distances = rows["scalar_distance_mm"].astype(np.float64)
    if (export / "planes.mrk.json").is_file():
        for plane in json.loads((export / "planes.mrk.json").read_text(encoding="utf-8"))["markups"]:
            pose = np.eye(4)
            pose[:3, :3] = np.reshape(plane["orientation"], (3, 3))
            pose[:3, 3] = plane["center"]
            found.planes[plane["name"]] = t_scan_bone @ pose
    if "bone.nrrd" in sent:
        reader = vtk.vtkSTLReader()
        reader.SetFileName(str(export / "bone.stl"))
        reader.Update()
        found.bone_surface = reader.GetOutput()
    return found


def text_of(answer: Answer, notes: list[str], inputs_text: str, shown_assumptions: Optional[int] = None) -> str:
    """The verdict in words: first the answer, then why, then what it assumes."""
    lines = [f"{answer.answer.upper()}: {answer.sentence}" if answer.sentence else answer.answer.upper()]
    for reason in answer.reasons:
        lines.append(f"  {reason['answer']}: {reason['reason']}")
        # That of a failure is to repeat it in the run's folder, which is not kept.
        if reason.get("remedy") and reason.get("rule") != "failure":
            lines.append(f"    what to do: {reason['remedy']}")
    shown = answer.assumptions[:shown_assumptions]
    lines += [f"  assumed: {text}" for text in shown]
    if len(shown) < len(answer.assumptions):
        lines.append(f"  {len(answer.assumptions) - len(shown)} more assumptions in the text node")
    if answer.chance is not None:
        lines.append(f"  chance of being wrong: {100.0 * answer.chance:.0f} % (of simulated registrations)")
    if answer.t_bone_scan is not None and answer.predicted:
        for kind in ("points", "cuts"):
            for row in answer.predicted.get(kind) or []:
                low, high = row["interval_mm"]
                lines.append(f"  predicted error at {row['name']}: {low:.2f} to {high:.2f} mm (90 %)")
    lines += [f"  note: {note}" for note in [*notes, *answer.warnings]]
    lines += ["", inputs_text, f"osteoflow {answer.version}; {NOTICE}"]
    return "\n".join(lines)


# Nodes


def _run_number() -> int:
    classes = ("vtkMRMLTextNode", "vtkMRMLLinearTransformNode", "vtkMRMLModelNode", "vtkMRMLMarkupsPlaneNode")
    numbers = [node.GetAttribute("Osteoflow.run") for name in classes for node in slicer.util.getNodesByClass(name)]
    return 1 + max((int(number) for number in numbers if number), default=0)


def _cloud(points: np.ndarray, faces: Optional[Any]) -> Any:
    surface = vtk.vtkPolyData()
    at = vtk.vtkPoints()
    at.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    surface.SetPoints(at)
    if faces is not None and faces.GetNumberOfCells():
        own = vtk.vtkCellArray()
        own.DeepCopy(faces)
        surface.SetPolys(own)
        return surface
    cells, n = vtk.vtkCellArray(), len(points)
    cells.SetData(numpy_to_vtkIdTypeArray(np.arange(n + 1, dtype=np.int64), deep=True), numpy_to_vtkIdTypeArray(np.arange(n, dtype=np.int64), deep=True))
    surface.SetVerts(cells)
    return surface


@dataclass
class Result:
    """What was found and the nodes that show it."""

    answer: Answer
    notes: list
    text: str
    short_text: str
    run: int = 0
    transform: Any = None
    scan: Any = None
    bone_surface: Any = None
    planes: list = field(default_factory=list)
    text_node: Any = None
    applied: bool = False
    created: list = field(default_factory=list)

    @property
    def may_be_applied(self) -> bool:
        return self.transform is not None and not self.applied

    def apply(self) -> None:
        """Moves the scan onto the bone, and the planes to the scan: of a doubtful answer only by the user's own wish."""
        if not self.may_be_applied:
            raise Fault("there is no transform to apply")
        if not all(slicer.mrmlScene.IsNodePresent(node) for node in (self.transform, self.scan)):
            raise Fault("transform or scan were deleted", "run it again")
        if not self.scan.SetAndObserveTransformNodeID(self.transform.GetID()):
            raise Fault("the transform cannot be applied to the scan")
        before = len(self.created)
        try:
            for name, pose in self.answer.planes.items():
                self.planes.append(self._plane(name, pose))
        except Exception:
            self.scan.SetAndObserveTransformNodeID(None)
            self._remove(before)
            self.planes = []
            raise
        self.applied = True

    def _new(self, kind: str, what: str) -> Any:
        doubt = " (doubtful)" if self.answer.answer == "doubtful" else ""
        node = slicer.mrmlScene.AddNewNodeByClass(kind, f"Osteoflow {self.run}: {what}{doubt}")
        if node is None:
            raise Fault(f"3D Slicer makes no {kind}")
        self.created.append(node)
        node.SetAttribute("Osteoflow.run", str(self.run))
        node.SetAttribute("Osteoflow.answer", self.answer.answer)
        node.SetDescription(NOTICE)
        return node

    def _remove(self, first: int = 0) -> None:
        for node in reversed(self.created[first:]):
            slicer.mrmlScene.RemoveNode(node)
        del self.created[first:]

    def _plane(self, name: str, pose_lps: np.ndarray) -> Any:
        node = self._new("vtkMRMLMarkupsPlaneNode", f"{name} on the scan")
        x, y, z = flipped(pose_lps[:3, :3].T)
        node.SetAxes(list(x), list(y), list(z))
        node.SetOrigin(list(flipped(pose_lps[:3, 3])))
        node.SetSizeMode(slicer.vtkMRMLMarkupsPlaneNode.SizeModeAbsolute)
        node.SetSize(40.0, 40.0)
        node.SetLocked(1)
        self._display(node)
        return node

    def _display(self, node: Any) -> Any:
        node.CreateDefaultDisplayNodes()
        display = node.GetDisplayNode()
        if display is None:
            raise Fault(f"3D Slicer shows no {node.GetName()}")
        self.created.append(display)
        return display

    def add_nodes(self, inputs: Inputs) -> None:
        """All nodes or, where one cannot be made, none."""
        self.run = _run_number()
        try:
            self.text_node = self._new("vtkMRMLTextNode", "verdict")
            self.text_node.SetText(self.text, vtk.VTK_ENCODING_UTF_8)
            if self.answer.t_bone_scan is not None:
                self._add_scan(inputs)
        except Exception:
            self._remove()
            raise

    def _add_scan(self, inputs: Inputs) -> None:
        answer = self.answer
        self.transform = self._new("vtkMRMLLinearTransformNode", "scan to bone")
        if not self.transform.SetMatrixTransformToParent(slicer.util.vtkMatrixFromArray(flipped_motion(answer.t_bone_scan))):
            raise Fault("3D Slicer takes no matrix for the transform")
        roles = slicer.vtkMRMLTransformNode
        self.transform.SetNodeReferenceID(roles.GetFixedNodeReferenceRole(), inputs.bone.GetID())
        if inputs.scan is not None:
            self.transform.SetNodeReferenceID(roles.GetMovingNodeReferenceRole(), inputs.scan.GetID())
        points, faces = flipped(answer.points), None
        if inputs.scan is not None:
            sent = _scan_points(inputs.scan) * inputs.scan_unit_mm
            if len(sent) == len(points):
                if np.abs(sent - points).max() > MOVED_MM:
                    raise Fault("the scan that came back is not the one that was sent", "report it with the version of osteoflow")
                points, faces = sent, inputs.scan.GetPolyData().GetPolys()
        surface = _cloud(points, faces)
        distances = numpy_to_vtk(np.ascontiguousarray(answer.distances), deep=True)
        distances.SetName(DISTANCE)
        surface.GetPointData().SetScalars(distances)
        self.scan = self._new("vtkMRMLModelNode", "scan, mm from the bone")
        self.scan.SetAndObservePolyData(surface)
        display = self._display(self.scan)
        display.SetActiveScalar(DISTANCE, vtk.vtkAssignAttribute.POINT_DATA)
        display.SetAndObserveColorNodeID(COLOURS)
        display.SetScalarRangeFlag(slicer.vtkMRMLDisplayNode.UseManualScalarRange)
        display.SetScalarRange(-COLOURED_MM, COLOURED_MM)
        display.SetScalarVisibility(1)
        if answer.bone_surface is not None:
            corners = flipped(vtk_to_numpy(answer.bone_surface.GetPoints().GetData()))
            self.bone_surface = self._new("vtkMRMLModelNode", "surface of the bone in the CT")
            self.bone_surface.SetAndObservePolyData(_cloud(corners, answer.bone_surface.GetPolys()))
            self._display(self.bone_surface)
        if answer.answer == "trusted":
            self.apply()


class Registration:
    """One run, from the nodes that were chosen to those that show the answer. `step` is called by a timer until it has ended."""

    def __init__(self, inputs: Inputs, program: str = "") -> None:
        command, is_own_python = find_program(program)
        files, self.notes = files_of(inputs)
        self.inputs = inputs
        #: "running", then "done", "cancelled" or "failed".
        self.state = "running"
        self.fault: Optional[Fault] = None
        self.result: Optional[Result] = None
        self._cancelled = False
        self._sent = _digests(files)
        self._began = time.monotonic()
        try:
            self.folder = Path(tempfile.mkdtemp(prefix="osteoflow-", dir=slicer.app.temporaryPath))
        except OSError as error:
            raise Fault(f"{slicer.app.temporaryPath}: {error.strerror}", "choose another temporary folder in the settings of 3D Slicer") from error
        try:
            for name, content in files.items():
                (self.folder / name).write_bytes(content)
            self._process = Process([*command, "run", "run.toml", "--out", "out", "--no-record"], self.folder, is_own_python)
        except OSError as error:
            self._clean()
            raise Fault(f"{self.folder}: {error.strerror}", "is the disk full?") from error
        except BaseException:
            self._clean()
            raise

    def _clean(self) -> None:
        """No file of a patient is left."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def progress(self) -> str:
        lines = [line for line in self._process.lines() if _PROGRESS.match(line)] if self.state == "running" else []
        shown = lines[-1] if lines else "starting"
        if self._cancelled:
            shown = "stopping"
        return f"{time.monotonic() - self._began:.0f} s: {shown}"

    def cancel(self) -> None:
        """The next steps end it; no node is made."""
        self._cancelled = True
        if self.state == "running":
            self._process.cancel()

    def abandon(self) -> None:
        """Ends it at once, as when the scene is closed."""
        if self.state == "running":
            self._process.kill()
            self.state = "cancelled"
            self._clean()

    def step(self) -> str:
        if self.state != "running":
            return self.state
        code = self._process.poll()
        if code is None:
            return self.state
        try:
            if self._cancelled or code == 130:
                self.state = "cancelled"
            else:
                self._finish(code)
                self.state = "done"
        except Fault as fault:
            self.fault, self.state = fault, "failed"
        except Exception as error:  # what the program wrote is not what is known here
            self.fault = Fault(f"the answer cannot be shown: {type(error).__name__}: {error}", "are module and program of one version?")
            self.state = "failed"
        finally:
            self._clean()
        return self.state

    def _finish(self, code: int) -> None:
        answer = read_answer(self.folder, code, self._process.lines(), self._sent)
        now = _digests(files_of(self.inputs)[0])
        changed = [name for name in {**self._sent, **now} if self._sent.get(name) != now.get(name)]
        if changed:
            names = ", ".join(sorted(name.split(".")[0] for name in changed))
            raise Fault(f"the scene was changed while the program worked: {names}", "run it again")
        result = Result(answer, self.notes, "", "")
        result.text = text_of(answer, self.notes, self._names())
        result.short_text = text_of(answer, self.notes, self._names(), SHOWN_ASSUMPTIONS)
        result.add_nodes(self.inputs)
        self.result = result

    def _names(self) -> str:
        chosen = self.inputs
        is_segment = chosen.bone.IsA("vtkMRMLSegmentationNode")
        segment = f", segment {chosen.bone.GetSegmentation().GetSegment(chosen.segment).GetName()}" if is_segment else ""
        scan = chosen.scan.GetName() if chosen.scan is not None else Path(chosen.scan_file).name
        unit = f", unit {chosen.scan_unit_mm:g} mm" if chosen.scan_unit_mm != 1.0 else ""
        return f"bone: {chosen.bone.GetName()}{segment}; scan: {scan}{unit}"
