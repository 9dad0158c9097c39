"""The module of 3D Slicer, with the program, the real VTK and a double of 3D Slicer.

3D Slicer itself is in no registry of packages; `slicer_double.py` refuses what its source refuses.
"""

import importlib
import json
import os
import stat
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import COMMAND, ROOT
from test_readme import blocks

vtk = pytest.importorskip("vtk", reason="there is no vtk")
pytestmark = pytest.mark.skipif(os.name != "posix", reason="programs of these tests are scripts of a shell")

FOLDER = ROOT / "tests/data/folder"
PICKS = ROOT / "tests/data/picks"
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
#: The registration stops at steps of 0.001 mm, and a turned bone is sampled at other points.
SAME_MM = 0.05


@pytest.fixture(scope="module")
def module(tmp_path_factory):
    """What `osteoflow new slicer` writes, imported."""
    import slicer_double

    folder = tmp_path_factory.mktemp("slicer") / "module"
    subprocess.run([COMMAND, "new", "slicer", folder], check=True, capture_output=True)
    sys.path.insert(0, str(folder))
    try:
        widget = importlib.import_module("Osteoflow")
    finally:
        sys.path.remove(str(folder))
    return slicer_double, widget, widget.osteoflow_slicer


@pytest.fixture(autouse=True)
def scene(module):
    """A scene without nodes; what 3D Slicer would log as an error fails the test."""
    double = module[0]
    double.slicer.mrmlScene.Clear()
    for texts in (double.errors, double.answers, double.asked):
        texts.clear()
    yield double.slicer.mrmlScene
    double.slicer.mrmlScene.broken = ()
    assert double.errors == []


def motion(turn, axis, shift):
    transform = vtk.vtkTransform()
    transform.Translate(shift)
    transform.RotateWXYZ(turn, axis)
    matrix = np.eye(4)
    transform.GetMatrix().DeepCopy(matrix.ravel(), transform.GetMatrix())
    return matrix


#: The transforms above bone and scan, and above the points that were picked on them, in RAS.
ABOVE_BONE = motion(25.0, (0.3, 1.0, -0.2), (12.0, -40.0, 35.0))
ABOVE_SCAN = motion(-70.0, (1.0, 0.2, 0.5), (-90.0, 15.0, 60.0))


def moved(matrix, points):
    return np.asarray(points) @ matrix[:3, :3].T + matrix[:3, 3]


class Case:
    """The small procedure of tests/data in the scene, each node below the transform of its side."""

    def __init__(self, module, scene, above_bone=ABOVE_BONE, above_scan=ABOVE_SCAN):
        self.double, self.widget, self.logic = module
        self.scene = scene
        self.above = {"bone": above_bone, "scan": above_scan}
        self.turns = {side: self.transform(matrix, f"above the {side}") for side, matrix in self.above.items()}
        self.bone = self.model("bone", self.read("bone.stl", vtk.vtkSTLReader()), "bone")
        self.scan = self.model("scan", self.read("scan.ply", vtk.vtkPLYReader()), "scan")
        self.inputs = self.logic.Inputs(bone=self.bone, scan=self.scan)

    @staticmethod
    def read(name, reader):
        reader.SetFileName(str(FOLDER / name))
        reader.Update()
        return Case.changed(reader.GetOutput(), FLIP)

    @staticmethod
    def changed(surface, matrix):
        transform = vtk.vtkTransform()
        transform.SetMatrix(np.asarray(matrix).ravel())
        change = vtk.vtkTransformFilter()
        change.SetTransform(transform)
        change.SetInputData(surface)
        change.Update()
        return change.GetPolyDataOutput()

    def below(self, node, side):
        if side is not None:
            assert node.SetAndObserveTransformNodeID(self.turns[side].GetID())
        return node

    def transform(self, matrix, name):
        node = self.scene.AddNewNodeByClass("vtkMRMLLinearTransformNode", name)
        assert node.SetMatrixTransformToParent(self.double.util.vtkMatrixFromArray(np.asarray(matrix)))
        return node

    def model(self, name, surface, side):
        node = self.scene.AddNewNodeByClass("vtkMRMLModelNode", name)
        node.SetAndObservePolyData(surface)
        return self.below(node, side)

    def points(self, name, points, side):
        """A list of points in LPS by their labels."""
        node = self.scene.AddNewNodeByClass("vtkMRMLMarkupsFiducialNode", name)
        for label, position in points.items():
            node.AddControlPoint(list(moved(FLIP, position)), label)
        return self.below(node, side)

    def pick(self):
        """The landmarks on both."""
        for side in ("bone", "scan"):
            markup = json.loads((PICKS / f"{side}_points.mrk.json").read_text())["markups"][0]
            assert markup["coordinateSystem"] == "LPS"
            picked = {row["label"]: row["position"] for row in markup["controlPoints"]}
            setattr(self.inputs, f"{side}_points", self.points(f"picked on the {side}", picked, side))

    def plan(self):
        """The cutting planes, and the points at which the error is predicted."""
        plan = json.loads((FOLDER / "plan.json").read_text())
        for row in plan["planes"]:
            pose = FLIP @ np.array(row["matrix"])
            node = self.scene.AddNewNodeByClass("vtkMRMLMarkupsPlaneNode", row["name"])
            node.SetAxes(*(list(axis) for axis in pose[:3, :3].T))
            node.SetOrigin(list(pose[:3, 3]))
            self.inputs.planes.append(self.below(node, "bone"))
        self.inputs.targets = self.points("where I cut", plan["assessment"], "bone")
        return plan

    def start(self, program=COMMAND):
        return self.logic.Registration(self.inputs, str(program))

    @staticmethod
    def wait(registration, seconds=120.0):
        end = time.monotonic() + seconds
        while registration.step() == "running":
            assert time.monotonic() < end, registration.progress()
            time.sleep(0.02)
        assert not registration.folder.exists(), "files of the run are left"
        return registration

    def run(self):
        registration = self.wait(self.start())
        assert registration.state == "done", registration.fault
        return registration.result

    def made(self):
        """The names of the nodes that runs have made."""
        return [node.GetName() for node in self.scene.nodes if node.GetAttribute("Osteoflow.run")]


@pytest.fixture
def case(module, scene):
    return Case(module, scene)


@pytest.fixture(scope="module")
def right():
    """The registration of the same files by the command, in RAS."""
    words = [COMMAND, "register", FOLDER / "bone.stl", FOLDER / "scan.ply", "--format", "json"]
    ended = subprocess.run(words, capture_output=True, text=True, check=True)
    return FLIP @ np.reshape(json.loads(ended.stdout)["T"], (4, 4)) @ FLIP


def expected(case, right):
    return case.above["bone"] @ right @ np.linalg.inv(case.above["scan"])


def off_mm(case, matrix, right):
    """The largest distance at the scan between a motion and that of the command."""
    surface = case.scan.GetPolyData()
    points = moved(case.above["scan"], [surface.GetPoint(k) for k in range(0, surface.GetNumberOfPoints(), 50)])
    return np.linalg.norm(moved(matrix, points) - moved(expected(case, right), points), axis=1).max()


def program_of(folder, text):
    """A program that is a script of a shell; `$REAL` in it is the real one."""
    file = folder / "osteoflow"
    file.write_text(f"#!/bin/sh\nREAL={COMMAND}\n{text}\n")
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    return file


def test_the_test_of_the_module_itself_passes_with_the_program_that_is_found(module, monkeypatch, tmp_path):
    program_of(tmp_path, 'exec $REAL "$@"')
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    module[1].OsteoflowTest().runTest()


def test_the_python_of_the_page_runs(case, monkeypatch, tmp_path, capsys):
    program_of(tmp_path, 'exec $REAL "$@"')
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert f"it and what it has started {case.logic.GRACE_S:g} s later" in (ROOT / "docs/use/slicer.md").read_text()
    install, register = blocks("docs/use/slicer.md")
    if importlib.util.find_spec("osteoflow") is None:
        print("skipped: the wheel is not installed, so that it does not write the module")
    else:
        exec(install, {})
        assert sorted(file.name for file in (tmp_path / "osteoflow-slicer").iterdir()) == ["Osteoflow.py", "OsteoflowLib", "graphs"]
    exec(register, {"slicer": case.double.slicer})
    assert "TRUSTED: " in capsys.readouterr().out and "Osteoflow 1: scan to bone" in case.made()


def test_nodes_below_transforms_go_out_in_world_coordinates_and_the_answer_is_that_of_the_command(case, right):
    case.pick()
    plan = case.plan()
    result = case.run()
    assert result.answer.answer == "trusted", result.text
    found = case.double.util.arrayFromTransformMatrix(result.transform)
    assert off_mm(case, found, right) < SAME_MM
    # The scan is shown in its own coordinates and moved by the transform; the user's own nodes stay as they were.
    assert result.applied and result.scan.GetParentTransformNode() is result.transform
    assert case.scan.GetParentTransformNode() is case.turns["scan"]
    own = moved(case.above["scan"], [case.scan.GetPolyData().GetPoint(k) for k in range(100)])
    shown = [result.scan.GetPolyData().GetPoint(k) for k in range(100)]
    assert np.abs(own - shown).max() < 1e-9
    assert result.scan.GetDisplayNode().scalar == case.logic.DISTANCE
    # Planes are those of the plan, seen from the scan.
    assert [node.GetName() for node in result.planes] == [f"Osteoflow 1: {row['name']} on the scan" for row in plan["planes"]]
    for node, row in zip(result.planes, plan["planes"]):
        matrix = vtk.vtkMatrix4x4()
        node.GetObjectToWorldMatrix(matrix)
        pose = case.double.util.arrayFromVTKMatrix(matrix)
        planned = np.linalg.inv(found) @ case.above["bone"] @ FLIP @ np.array(row["matrix"])
        assert np.abs(pose[:3, 2:] - planned[:3, 2:]).max() < 1e-6
    assert [row["name"] for row in result.answer.predicted["points"]] == list(plan["assessment"])
    assert "predicted error at plane_1:" in result.text and "predicted error at M5:" in result.text
    references = [result.transform.GetNodeReferenceID(f"spatialRegistration{role}") for role in ("Moving", "Fixed")]
    assert references == [case.scan.GetID(), case.bone.GetID()]


def test_the_distances_are_those_of_the_scan_on_the_bone(case):
    result = case.run()
    surface = result.scan.GetPolyData()
    distances = surface.GetPointData().GetScalars()
    bone = vtk.vtkImplicitPolyDataDistance()
    bone.SetInput(Case.changed(case.bone.GetPolyData(), case.above["bone"]))
    found = case.double.util.arrayFromTransformMatrix(result.transform)
    for k in range(0, surface.GetNumberOfPoints(), 400):
        x = bone.EvaluateFunction(moved(found, surface.GetPoint(k)))
        assert abs(x - distances.GetValue(k)) < 1e-3, (k, x, distances.GetValue(k))


@pytest.mark.parametrize("name, wrong", [
    ("flipped", lambda points: np.asarray(points, dtype=float)),
    ("flipped", lambda points: np.asarray(points, dtype=float) * (-1, 1, 1)),
    ("flipped_motion", lambda matrix: np.asarray(matrix)),
    ("flipped_motion", lambda matrix: FLIP @ np.linalg.inv(matrix) @ FLIP),
    ("to_world", lambda node: np.eye(4)),
    ("_pose", lambda value: np.linalg.inv(value["matrix"])),
])
def test_a_conversion_that_is_left_out_is_noticed(case, right, monkeypatch, name, wrong):
    case.pick()
    monkeypatch.setattr(case.logic, name, wrong)
    registration = case.wait(case.start())
    result = registration.result
    if registration.state == "done" and result.transform is not None:
        assert off_mm(case, case.double.util.arrayFromTransformMatrix(result.transform), right) > 10.0
    else:
        assert registration.state == "failed" or result.answer.answer == "refused"


def test_a_mirrored_scan_is_never_moved_onto_the_bone(case):
    case.scan.SetAndObservePolyData(Case.changed(case.scan.GetPolyData(), np.diag([-1.0, 1.0, 1.0, 1.0])))
    result = case.run()
    assert result.answer.answer == "refused" and "mirror image" in result.text, result.text
    assert result.transform is None and case.made() == ["Osteoflow 1: verdict"]


def test_landmarks_that_are_swapped_are_refused(case):
    case.pick()
    chosen = case.inputs
    chosen.bone_points, chosen.scan_points = chosen.scan_points, chosen.bone_points
    result = case.run()
    assert result.answer.answer == "refused" and "is init right" in result.text, result.text
    assert result.transform is None and case.made() == ["Osteoflow 1: verdict"]


def test_screws_off_the_surface_are_refused_as_landmarks_and_taken_as_screws(case, right):
    screws = {"S1": (-70.0, -75.0, -960.0), "S2": (-100.0, -90.0, -935.0), "S3": (-85.0, -60.0, -900.0)}
    t_scan_bone = FLIP @ np.linalg.inv(right) @ FLIP
    case.inputs.bone_points = case.points("screws", screws, "bone")
    case.inputs.scan_points = case.points("touched", {name: moved(t_scan_bone, at) for name, at in screws.items()}, "scan")
    refused = case.run()
    assert refused.answer.answer == "refused" and "lie off the surface" in refused.text, refused.text
    case.inputs.off_surface = True
    result = case.run()
    assert result.answer.answer == "trusted", result.text
    assert off_mm(case, case.double.util.arrayFromTransformMatrix(result.transform), right) < SAME_MM


def stretched(case):
    """A scan that is 3 % too long, of which the program doubts the answer."""
    case.scan.SetAndObservePolyData(Case.changed(case.scan.GetPolyData(), np.diag([1.03, 1.03, 1.03, 1.0])))
    case.plan()


def test_a_doubtful_transform_is_made_and_named_so_and_applied_only_on_demand(case):
    stretched(case)
    result = case.run()
    assert result.answer.answer == "doubtful", result.text
    assert result.short_text.startswith("DOUBTFUL: ") and result.answer.reasons[0]["reason"] in result.short_text
    assert case.made() == [
        "Osteoflow 1: verdict (doubtful)", "Osteoflow 1: scan to bone (doubtful)", "Osteoflow 1: scan, mm from the bone (doubtful)",
    ]
    assert result.scan.GetParentTransformNode() is None and result.may_be_applied and not result.planes
    result.apply()
    assert result.scan.GetParentTransformNode() is result.transform and len(result.planes) == 2
    assert all("(doubtful)" in node.GetName() for node in result.planes)
    with pytest.raises(case.logic.Fault, match="there is no transform to apply"):
        result.apply()


def test_a_doubtful_transform_that_was_deleted_is_not_applied(case):
    stretched(case)
    result = case.run()
    case.scene.RemoveNode(result.transform)
    with pytest.raises(case.logic.Fault, match="deleted"):
        result.apply()
    assert not result.planes and result.scan.GetParentTransformNode() is None


def test_a_scan_in_metres_is_refused_with_its_unit_named_and_registered_with_it(case, right):
    case.pick()
    metres = np.diag([1e-3, 1e-3, 1e-3, 1.0])
    case.scan.SetAndObservePolyData(Case.changed(case.scan.GetPolyData(), metres))
    for k in range(3):
        case.inputs.scan_points.SetNthControlPointPosition(k, *moved(metres, case.inputs.scan_points._points[k][0]))
    case.turns["scan"].SetMatrixTransformToParent(case.double.util.vtkMatrixFromArray(metres @ ABOVE_SCAN @ np.linalg.inv(metres)))
    refused = case.run()
    assert refused.answer.answer == "refused" and refused.transform is None and "unit_mm = 1000" in refused.text
    assert case.made() == ["Osteoflow 1: verdict"]
    case.inputs.scan_unit_mm = 1000.0
    result = case.run()
    assert result.answer.answer == "trusted" and "unit 1000 mm" in result.text, result.text
    found = case.double.util.arrayFromTransformMatrix(result.transform)
    points = np.array([result.scan.GetPolyData().GetPoint(k) for k in range(0, 10000, 50)])
    assert np.linalg.norm(moved(found, points) - moved(expected(case, right), points), axis=1).max() < SAME_MM


def test_two_runs_in_a_row_leave_both_answers(case):
    case.run()
    first = {node.GetID(): node.GetName() for node in case.scene.nodes}
    second = case.run()
    assert second.run == 2
    assert all(case.scene.GetNodeByID(node_id).GetName() == name for node_id, name in first.items())
    assert sorted(case.made()) == sorted(f"Osteoflow {run}: {what}" for run in (1, 2) for what in ("verdict", "scan to bone", "scan, mm from the bone"))
    # Numbers of a scene that was opened again are not given twice, even if the text was deleted.
    case.scene.RemoveNode(second.text_node)
    assert case.run().run == 3


def test_a_scan_in_a_file_is_registered_and_shown(case, right, tmp_path):
    file = tmp_path / "Prüfling \"links\" 1.ply"
    file.write_bytes((FOLDER / "scan.ply").read_bytes())
    case.inputs.scan, case.inputs.scan_file, case.inputs.camera_at_origin = None, str(file), True
    case.above["scan"] = np.eye(4)
    result = case.run()
    assert result.answer.answer == "trusted", result.text
    assert off_mm(case, case.double.util.arrayFromTransformMatrix(result.transform), right) < SAME_MM
    assert result.scan.GetPolyData().GetNumberOfVerts() == result.scan.GetPolyData().GetNumberOfPoints() == 10000
    assert file.name in result.text and not any("where the camera was" in text for text in result.answer.assumptions)


def test_a_file_in_metres_is_read_in_its_unit(case, right, tmp_path):
    file = tmp_path / "scan.xyz"
    points = moved(FLIP, [case.scan.GetPolyData().GetPoint(k) for k in range(10000)])
    np.savetxt(file, points / 1000.0, fmt="%.9f")
    case.inputs.scan, case.inputs.scan_file, case.inputs.scan_unit_mm = None, str(file), 1000.0
    case.above["scan"] = np.eye(4)
    result = case.run()
    assert result.answer.answer == "trusted", result.text
    assert off_mm(case, case.double.util.arrayFromTransformMatrix(result.transform), right) < SAME_MM


def test_the_camera_is_where_the_origin_of_the_scan_is(case):
    case.inputs.camera_at_origin = True
    graph = case.logic.files_of(case.inputs)[0]["run.toml"].decode()
    line = next(line for line in graph.splitlines() if line.startswith("camera = "))
    assert np.allclose(json.loads(line.partition("=")[2]), moved(FLIP, ABOVE_SCAN[:3, 3]))
    result = case.run()
    assert result.answer.answer == "trusted" and not any("where the camera was" in text for text in result.answer.assumptions)


def test_a_segment_is_registered_and_its_smoothing_is_said(case, right):
    node = case.below(case.scene.AddNewNodeByClass("vtkMRMLSegmentationNode", "Segmentation"), "bone")
    decoy = vtk.vtkSphereSource()
    decoy.Update()
    node.GetSegmentation().segments = {"1": case.double.Segment("tibia", decoy.GetOutput()), "2": case.double.Segment("fibula", case.bone.GetPolyData())}
    case.inputs.bone, case.inputs.segment = node, "2"
    result = case.run()
    assert result.answer.answer == "trusted" and "smoothing factor 0.5" in result.text and "segment fibula" in result.text
    assert off_mm(case, case.double.util.arrayFromTransformMatrix(result.transform), right) < SAME_MM


def test_a_volume_is_registered_where_its_voxels_lie(case, right):
    """An oblique, left-handed grid of three lengths below a transform, of the part of the bone about the scan."""
    bone = case.bone.GetPolyData()
    middle = moved(right, np.mean([case.scan.GetPolyData().GetPoint(k) for k in range(10000)], axis=0))
    size = (56, 48, 130)
    grid = motion(12.0, (0.2, -0.4, 1.0), (0.0, 0.0, 0.0)) @ np.diag([-0.7, 0.8, 0.9, 1.0])
    grid[:3, 3] = middle - grid[:3, :3] @ (np.array(size) - 1) / 2.0
    inside = vtk.vtkPolyDataToImageStencil()
    inside.SetInputData(Case.changed(bone, np.linalg.inv(grid)))
    inside.SetOutputWholeExtent(0, size[0] - 1, 0, size[1] - 1, 0, size[2] - 1)
    blank = vtk.vtkImageData()
    blank.SetDimensions(size)
    blank.AllocateScalars(vtk.VTK_SHORT, 1)
    blank.GetPointData().GetScalars().Fill(1200)
    stencil = vtk.vtkImageStencil()
    stencil.SetInputData(blank)
    stencil.SetStencilConnection(inside.GetOutputPort())
    stencil.SetBackgroundValue(-100)
    stencil.Update()
    smooth = vtk.vtkImageGaussianSmooth()
    smooth.SetInputData(stencil.GetOutput())
    smooth.SetStandardDeviations(0.7, 0.7, 0.7)
    smooth.Update()
    node = case.below(case.scene.AddNewNodeByClass("vtkMRMLScalarVolumeNode", "CT"), "bone")
    node.SetAndObserveImageData(smooth.GetOutput())
    node.SetIJKToRASMatrix(case.double.util.vtkMatrixFromArray(grid))
    case.inputs.bone = node
    refused = case.run()
    assert refused.answer.answer == "refused" and "threshold_hu is not given" in refused.text, "there is no air, by which HU are known"
    case.inputs.threshold_hu = 550.0
    result = case.run()
    assert result.transform is not None, result.text
    # A voxel is 0.8 mm, and in or out of the bone.
    assert off_mm(case, case.double.util.arrayFromTransformMatrix(result.transform), right) < 0.6
    surface = vtk.vtkImplicitPolyDataDistance()
    surface.SetInput(Case.changed(bone, ABOVE_BONE))
    shown = result.bone_surface.GetPolyData()
    off = [abs(surface.EvaluateFunction(shown.GetPoint(k))) for k in range(0, shown.GetNumberOfPoints(), 50)]
    assert len(off) > 100 and np.median(off) < 0.4, np.median(off)


def test_cancel_ends_the_program_and_leaves_nothing(case, tmp_path):
    begun = tmp_path / "begun"
    # It does not heed Ctrl-C, nor does what it has started.
    program = program_of(tmp_path, f"trap '' INT\nsleep 300 & echo $! $$ > {begun}.part; mv {begun}.part {begun}\nwait")
    case.logic.GRACE_S, grace = 0.3, case.logic.GRACE_S
    try:
        registration = case.start(program)
        assert registration.step() == "running", "the start has waited"
        while not begun.exists():
            time.sleep(0.01)
        registration.cancel()
        assert "stopping" in registration.progress()
        case.wait(registration, 10.0)
    finally:
        case.logic.GRACE_S = grace
    assert registration.state == "cancelled" and registration.result is None and case.made() == []
    state = lambda pid: subprocess.run(["ps", "-o", "stat=", "-p", pid], capture_output=True, text=True).stdout.strip()
    for pid in begun.read_text().split():
        # A process that was killed ends when it is next scheduled, and is a zombie until it is waited for.
        end = time.monotonic() + 10.0
        while state(pid)[:1] not in ("", "Z"):
            assert time.monotonic() < end, (pid, state(pid))
            time.sleep(0.02)


def test_cancel_in_the_middle_of_the_real_program_leaves_nothing(case):
    for delay_s in (0.0, 0.2, 0.4):
        registration = case.start()
        time.sleep(delay_s)
        registration.cancel()
        assert case.wait(registration, 20.0).state == "cancelled" and case.made() == []


def test_progress_is_that_of_the_program(case, tmp_path):
    program = program_of(tmp_path, "echo 'running slicer: 9 nodes, seed 1, 2 workers' >&2; echo '4 of 9 nodes have worked, 5 items, 5 s gone' >&2; sleep 300")
    registration = case.start(program)
    while "4 of 9" not in registration.progress():
        assert registration.step() == "running"
        time.sleep(0.02)
    registration.abandon()
    assert registration.state == "cancelled" and not registration.folder.exists()


def test_a_program_that_is_missing_is_named_with_what_to_do(case, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(case.logic.Fault, match="pip_install"):
        case.logic.Registration(case.inputs)
    with pytest.raises(case.logic.Fault, match="no program /nowhere/osteoflow"):
        case.start("/nowhere/osteoflow")
    assert case.made() == []


def test_a_temporary_folder_that_cannot_be_written_is_named(case, monkeypatch):
    monkeypatch.setattr(case.double.slicer.app, "temporaryPath", "/nowhere")
    with pytest.raises(case.logic.Fault, match="/nowhere: No such file"):
        case.start()


def test_the_program_of_the_wheel_runs_in_the_python_of_3d_slicer(case, monkeypatch, tmp_path):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object() if name == "osteoflow" else None)
    python = tmp_path / "PythonSlicer"
    python.write_text("")
    python.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert case.logic.find_program() == ([str(python), "-m", "osteoflow"], True)


FAILURES = {
    "usage": ("echo 'error: node \"bone\": no such kind' >&2; exit 2", "no such kind", "exit code 2"),
    "crash": ("kill -SEGV $$", "the program said nothing", "signal 11"),
    "silence": ("exit 0", "the program said nothing", "exit code 0"),
    "other files": ("printf '\\n' >> scan.vtk; $REAL \"$@\"", "did not read scan.vtk as it was written", "run it again"),
    "unknown": ("$REAL \"$@\"; echo '[]' > out/results.json", "the answer cannot be shown", "of one version"),
    "not rigid": ("$REAL \"$@\"; sed -i 's/\"from\": *\"camera\"/\"from\": \"world\"/g' out/results.json", "no rigid motion", "report it"),
}


@pytest.mark.parametrize("name", FAILURES)
def test_a_program_that_fails_leaves_its_words_and_no_nodes(case, tmp_path, name):
    text, message, remedy = FAILURES[name]
    registration = case.wait(case.start(program_of(tmp_path, text)))
    assert registration.state == "failed" and registration.result is None and case.made() == []
    assert message in registration.fault.message and remedy in registration.fault.remedy, registration.fault


def test_an_answer_of_another_word_is_no_leave_to_use_the_pose(case, tmp_path):
    program = program_of(tmp_path, "$REAL \"$@\"; sed -i 's/\"answer\": *\"trusted\"/\"answer\": \"perfect\"/' out/results.json")
    registration = case.wait(case.start(program))
    assert registration.state == "done" and registration.result.transform is None and case.made() == ["Osteoflow 1: verdict"]


def test_planes_whose_sides_are_exchanged_are_refused_by_name(case):
    case.plan()
    case.inputs.planes.reverse()
    result = case.run()
    assert result.answer.answer == "refused" and case.made() == ["Osteoflow 1: verdict"]
    assert "\"plane_2\": both normals lead from \"plane_1\"" in result.text and "repro" not in result.text, result.text


@pytest.mark.parametrize("what", ["scan", "bone", "bone_points", "deleted"])
def test_a_scene_that_changes_under_way_gives_no_answer(case, what):
    case.pick()
    registration = case.start()
    if what == "scan":
        case.turns["scan"].SetMatrixTransformToParent(case.double.util.vtkMatrixFromArray(np.eye(4)))
    elif what == "bone":
        case.bone.SetAndObservePolyData(Case.changed(case.bone.GetPolyData(), np.diag([1.01, 1.0, 1.0, 1.0])))
    elif what == "bone_points":
        case.inputs.bone_points.SetNthControlPointPosition(1, 0.0, 0.0, 0.0)
    else:
        case.scene.RemoveNode(case.turns["scan"])
    assert case.wait(registration).state == "failed" and case.made() == []
    assert "scene was changed" in registration.fault.message and ("scan" if what == "deleted" else what) in registration.fault.message


@pytest.mark.parametrize("broken", ["vtkMRMLTextNode", "vtkMRMLLinearTransformNode", "vtkMRMLModelNode", "vtkMRMLMarkupsPlaneNode"])
def test_a_node_that_cannot_be_made_leaves_none_of_the_others(case, broken):
    case.plan()
    before = list(case.scene.nodes)
    registration = case.start()
    case.scene.broken = (broken,)
    assert case.wait(registration).state == "failed" and f"makes no {broken}" in registration.fault.message
    assert case.scene.nodes == before
    case.double.errors.clear()


def test_what_cannot_be_registered_is_refused_before_the_program_starts(case):
    double, scene, Inputs = case.double, case.scene, case.logic.Inputs
    add = lambda kind: scene.AddNewNodeByClass(kind, f"a {kind}")
    grid = add("vtkMRMLTransformNode")
    grid.SetAndObserveTransformToParent(vtk.vtkThinPlateSplineTransform())
    mirror = case.transform(np.diag([1.0, 1.0, -1.0, 1.0]), "mirror")
    surface = case.bone.GetPolyData()
    below = lambda node, parent: (node.SetAndObserveTransformNodeID(parent.GetID()), node)[1]
    bent, turned = below(case.model("bent", surface, None), grid), below(case.model("turned", surface, None), mirror)
    volume = add("vtkMRMLVolumeNode")
    segmentation, empty, plane, mesh = add("vtkMRMLSegmentationNode"), add("vtkMRMLModelNode"), add("vtkMRMLMarkupsPlaneNode"), add("vtkMRMLModelNode")
    mesh.SetAndObserveMesh(vtk.vtkUnstructuredGrid())
    points, none = case.points("points", {"P1": [0, 0, 0]}, None), add("vtkMRMLMarkupsFiducialNode")
    none.AddControlPoint([0.0, 0.0, 0.0], "P1")
    none.UnsetNthControlPointPosition(0)
    label_map = add("vtkMRMLLabelMapVolumeNode")
    both = dict(bone=case.bone, scan=case.scan)
    wrong = [
        (dict(scan=case.scan), "no bone is chosen"),
        (dict(bone=case.bone), "one scan is needed"),
        (dict(**both, scan_file="scan.ply"), "one scan is needed"),
        (dict(bone=case.bone, scan=case.bone), "the same model"),
        (dict(bone=case.bone, scan_file="/nowhere/scan.ply"), "there is no file"),
        (dict(bone=bent, scan=case.scan), "deforms it"),
        (dict(bone=case.bone, scan=turned), "mirrors it"),
        (dict(bone=volume, scan=case.scan), "is no bone"),
        (dict(bone=label_map, scan=case.scan), "is a label map"),
        (dict(bone=add("vtkMRMLScalarVolumeNode"), scan=case.scan), "is no volume of single numbers"),
        (dict(bone=segmentation, scan=case.scan), "no segment"),
        (dict(bone=segmentation, segment="9", scan=case.scan), "no segment"),
        (dict(bone=empty, scan=case.scan), "holds no surface"),
        (dict(bone=mesh, scan=case.scan), "holds no surface"),
        (dict(bone=case.bone, scan=segmentation), "is no model"),
        (dict(**both, bone_points=points), "on one side only"),
        (dict(**both, bone_points=points, scan_points=points), "the same list"),
        (dict(**both, bone_points=points, scan_points=none), "has no points"),
        (dict(**both, targets=plane), "is no list of points"),
        (dict(**both, planes=[points]), "is no plane"),
        (dict(**both, planes=[plane]), "is not placed"),
        (dict(**both, scan_unit_mm=0.0), "positive number"),
        (dict(**both, scan_unit_mm=float("nan")), "positive number"),
    ]
    for given, message in wrong:
        with pytest.raises(case.logic.Fault, match=message):
            case.logic.Registration(Inputs(**given), COMMAND)
    assert case.made() == [] and double.errors == []


def test_the_double_refuses_what_3d_slicer_refuses(case):
    double, scene = case.double, case.scene
    transform, plane, text = (scene.AddNewNodeByClass(kind) for kind in ("vtkMRMLLinearTransformNode", "vtkMRMLMarkupsPlaneNode", "vtkMRMLTextNode"))
    for call in (
        lambda: transform.SetMatrixTransformToParent(np.eye(4)),
        lambda: case.scan.SetAndObserveTransformNodeID(transform),
        lambda: case.scan.SetAndObservePolyData(vtk.vtkImageData()),
        lambda: plane.SetOrigin([1.0, 2.0]),
        lambda: text.SetAttribute("Osteoflow.run", 1),
        lambda: double.vtkMRMLDisplayNode().SetScalarRange("low", "high"),
    ):
        with pytest.raises(TypeError):
            call()
    for call in (lambda: case.scan.GetTransform(), lambda: double.QLabel().setTexts("a"), lambda: setattr(double.QLabel(), "txt", "a")):
        with pytest.raises(AttributeError):
            call()
    curved = scene.AddNewNodeByClass("vtkMRMLTransformNode")
    curved.SetAndObserveTransformToParent(vtk.vtkThinPlateSplineTransform())
    wrong = [
        (lambda: scene.AddNewNodeByClass("vtkMRMLLinearTransform"), None, "failed to create"),
        (lambda: curved.SetMatrixTransformToParent(vtk.vtkMatrix4x4()), 0, "non-linear"),
        (lambda: curved.GetMatrixTransformToParent(vtk.vtkMatrix4x4()), 0, "not linear"),
        (lambda: transform.SetAndObserveTransformNodeID(transform.GetID()), False, "self or a child"),
        (lambda: plane.SetAxes([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]), None, "Invalid direction"),
        (lambda: text.SetText("Prüfling"), None, "encoding"),
        (lambda: double.vtkMRMLModelNode().CreateDefaultDisplayNodes(), None, "scene is invalid"),
    ]
    for call, returned, message in wrong:
        assert call() == returned and message in double.errors[-1]
    assert len(double.errors) == len(wrong)
    double.errors.clear()


@pytest.fixture
def widget(case):
    made = case.widget.OsteoflowWidget()
    made.setup()
    made.bone.choose(case.bone)
    made.scan.choose(case.scan)
    made.program.currentPath = COMMAND
    yield made
    made.cleanup()


def turn_timer(widget):
    end = time.monotonic() + 120.0
    while widget.timer.active:
        assert time.monotonic() < end
        widget.timer.emit("timeout()")
        time.sleep(0.02)


def test_the_widget_shows_the_verdict_with_three_assumptions(case, widget):
    widget.register.click()
    assert widget.timer.active and not widget.register.enabled and widget.cancel.enabled
    turn_timer(widget)
    text = widget.verdict.plainText
    assert text.startswith("TRUSTED: ") and text.count("  assumed: ") == 3 and "1 more assumptions in the text node" in text
    assert case.logic.NOTICE in text and widget.progress.text == "trusted"
    assert widget.register.enabled and not widget.cancel.enabled and not widget.apply.enabled
    whole = widget.logic.registration.result.text_node.GetText()
    assert whole.count("  assumed: ") == len(widget.logic.registration.result.answer.assumptions) == 4


def test_the_widget_asks_before_it_applies_a_doubtful_transform(case, widget):
    stretched(case)
    widget.planes.checked = tuple(case.inputs.planes)
    widget.register.click()
    turn_timer(widget)
    result = widget.logic.registration.result
    assert widget.apply.enabled and not result.applied
    case.double.answers[:] = [False, True]
    widget.apply.click()
    assert not result.applied and widget.apply.enabled
    widget.apply.click()
    assert result.applied and not widget.apply.enabled and len(case.double.asked) == 2
    assert all(result.answer.reasons[0]["reason"] in question for question in case.double.asked)


def test_the_widget_shows_what_is_wrong(case, widget):
    widget.threshold.text = "half"
    widget.register.click()
    assert "no number of HU" in widget.verdict.plainText and widget.progress.text == "failed" and widget.register.enabled
    widget.threshold.text = ""
    widget.scan.choose(None)
    widget.register.click()
    assert "one scan is needed" in widget.verdict.plainText and not widget.timer.active


def test_the_widget_offers_the_segments_of_a_segmentation(case, widget):
    node = case.scene.AddNewNodeByClass("vtkMRMLSegmentationNode", "Segmentation")
    node.GetSegmentation().segments = {"a": case.double.Segment("tibia", None), "b": case.double.Segment("fibula", None)}
    widget.bone.choose(node)
    assert widget.segment.items == ("tibia", "fibula")
    widget.segment.currentIndex = 1
    assert widget.inputs().segment == "b"
    widget.bone.choose(case.bone)
    assert widget.segment.items == () and widget.inputs().segment == ""


def test_cancel_and_a_scene_that_is_closed_end_the_run(case, widget):
    widget.register.click()
    widget.cancel.click()
    turn_timer(widget)
    assert widget.progress.text == "cancelled" and case.made() == []
    widget.register.click()
    registration = widget.logic.registration
    case.scene.Clear()
    assert registration.state == "cancelled" and not registration.folder.exists() and not widget.timer.active
    assert "scene was closed" in widget.verdict.plainText and case.scene.nodes == []
