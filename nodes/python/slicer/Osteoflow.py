"""The module Osteoflow of 3D Slicer: its widget. `OsteoflowLib/osteoflow_slicer.py` has what it does.

Of 3D Slicer at 583e9b37 were read: Base/Python/slicer/ScriptedLoadableModule.py, Utilities/Templates/Modules/Scripted/TemplateKey.py
(classes, scene events), Libs/MRML/Widgets/qMRMLNodeComboBox.h and qMRMLCheckableNodeComboBox.h (properties, currentNode, checkedNodes),
Base/Python/slicer/parameterNodeWrapper/guiConnectors.py (ctkPathLineEdit.currentPath, QComboBox.currentIndex, QCheckBox.checked) and
Modules/Scripted/Endoscopy/Endoscopy.py (QTimer, selectors).
"""

import ctk
import qt
import slicer
import vtk
from OsteoflowLib import osteoflow_slicer
from slicer.ScriptedLoadableModule import (
    ScriptedLoadableModule, ScriptedLoadableModuleLogic, ScriptedLoadableModuleTest, ScriptedLoadableModuleWidget,
)
from slicer.util import VTKObservationMixin

INTERVAL_MS = 200
UNITS = [("millimetres", 1.0), ("centimetres", 10.0), ("metres", 1000.0)]


class Osteoflow(ScriptedLoadableModule):
    def __init__(self, parent):
        ScriptedLoadableModule.__init__(self, parent)
        self.parent.title = "Osteoflow"
        self.parent.categories = ["Registration"]
        self.parent.dependencies = ["Segmentations", "Markups"]
        self.parent.contributors = ["The Osteoflow developers"]
        self.parent.helpText = (
            "Registers the scan of a bone's surface onto the bone in CT, and says whether the result can be trusted. "
            "Research software, not a medical device: not for clinical use."
        )
        self.parent.acknowledgementText = ""


class OsteoflowWidget(ScriptedLoadableModuleWidget, VTKObservationMixin):
    def __init__(self, parent=None):
        ScriptedLoadableModuleWidget.__init__(self, parent)
        VTKObservationMixin.__init__(self)
        self.logic = None

    def setup(self):
        ScriptedLoadableModuleWidget.setup(self)
        self.logic = OsteoflowLogic()
        form = self._section("Bone, in the CT")
        self.bone = self._selector(form, "Bone:", ["vtkMRMLSegmentationNode", "vtkMRMLModelNode", "vtkMRMLScalarVolumeNode"])
        self.bone.connect("currentNodeChanged(vtkMRMLNode*)", self.show_segments)
        self.segment = qt.QComboBox()
        form.addRow("Segment:", self.segment)
        self.segment_ids = []
        self.threshold = qt.QLineEdit()
        self.threshold.placeholderText = "of a CT: half-way between soft tissue and bone"
        form.addRow("Bone above, HU:", self.threshold)

        form = self._section("Scan")
        self.scan = self._selector(form, "Model:", ["vtkMRMLModelNode"])
        self.scan_file = ctk.ctkPathLineEdit()
        form.addRow("or file:", self.scan_file)
        self.unit = qt.QComboBox()
        for name, _ in UNITS:
            self.unit.addItem(name)
        form.addRow("Unit:", self.unit)
        self.camera = qt.QCheckBox("the camera was at the scan's origin")
        form.addRow("", self.camera)

        form = self._section("Landmarks and plan, optional")
        self.bone_points = self._selector(form, "Landmarks on the bone:", ["vtkMRMLMarkupsFiducialNode"])
        self.scan_points = self._selector(form, "Landmarks on the scan:", ["vtkMRMLMarkupsFiducialNode"])
        self.off_surface = qt.QCheckBox("they are screws, rings or skin markers")
        form.addRow("", self.off_surface)
        self.planes = slicer.qMRMLCheckableNodeComboBox()
        self.planes.nodeTypes = ["vtkMRMLMarkupsPlaneNode"]
        self.planes.setMRMLScene(slicer.mrmlScene)
        form.addRow("Cutting planes:", self.planes)
        self.targets = self._selector(form, "Predict the error at:", ["vtkMRMLMarkupsFiducialNode"])

        form = self._section("Registration")
        self.program = ctk.ctkPathLineEdit()
        form.addRow("Program, if not of the wheel:", self.program)
        self.register = qt.QPushButton("Register")
        self.register.connect("clicked(bool)", self.on_register)
        self.cancel = qt.QPushButton("Cancel")
        self.cancel.enabled = False
        self.cancel.connect("clicked(bool)", self.on_cancel)
        form.addRow(self.register, self.cancel)
        self.progress = qt.QLabel("")
        form.addRow("Progress:", self.progress)
        self.verdict = qt.QPlainTextEdit()
        self.verdict.setReadOnly(True)
        form.addRow(self.verdict)
        self.apply = qt.QPushButton("Apply the doubtful transform")
        self.apply.enabled = False
        self.apply.connect("clicked(bool)", self.on_apply)
        form.addRow(self.apply)

        self.timer = qt.QTimer()
        self.timer.setInterval(INTERVAL_MS)
        self.timer.connect("timeout()", self.on_timer)
        self.addObserver(slicer.mrmlScene, slicer.mrmlScene.StartCloseEvent, self.on_scene_close)
        self.show_segments()

    def _section(self, text):
        section = ctk.ctkCollapsibleButton()
        section.text = text
        self.layout.addWidget(section)
        return qt.QFormLayout(section)

    def _selector(self, form, label, types):
        selector = slicer.qMRMLNodeComboBox()
        selector.nodeTypes = types
        selector.noneEnabled = True
        selector.addEnabled = False
        selector.removeEnabled = False
        selector.selectNodeUponCreation = False
        selector.setMRMLScene(slicer.mrmlScene)
        form.addRow(label, selector)
        return selector

    def show_segments(self, _node=None):
        """The segments of the bone, if it is a segmentation."""
        self.segment.clear()
        node = self.bone.currentNode()
        is_segmentation = node is not None and node.IsA("vtkMRMLSegmentationNode") and node.GetSegmentation() is not None
        self.segment_ids = list(node.GetSegmentation().GetSegmentIDs()) if is_segmentation else []
        for segment in self.segment_ids:
            self.segment.addItem(node.GetSegmentation().GetSegment(segment).GetName())
        self.segment.enabled = is_segmentation

    def inputs(self):
        text = self.threshold.text.strip()
        try:
            threshold = float(text) if text else None
        except ValueError:
            raise osteoflow_slicer.Fault(f"\"{text}\" is no number of HU") from None
        index = self.segment.currentIndex
        return osteoflow_slicer.Inputs(
            bone=self.bone.currentNode(), segment=self.segment_ids[index] if 0 <= index < len(self.segment_ids) else "",
            threshold_hu=threshold, scan=self.scan.currentNode(), scan_file=self.scan_file.currentPath,
            scan_unit_mm=UNITS[self.unit.currentIndex][1], camera_at_origin=self.camera.checked,
            bone_points=self.bone_points.currentNode(), scan_points=self.scan_points.currentNode(), off_surface=self.off_surface.checked,
            planes=list(self.planes.checkedNodes()), targets=self.targets.currentNode(),
        )

    def on_register(self, _checked=False):
        self.verdict.setPlainText("")
        self.apply.enabled = False
        try:
            self.logic.start(self.inputs(), self.program.currentPath)
        except osteoflow_slicer.Fault as fault:
            self._end("failed", str(fault))
            return
        self.register.enabled, self.cancel.enabled = False, True
        self.timer.start()

    def on_cancel(self, _checked=False):
        self.logic.registration.cancel()

    def on_timer(self):
        registration = self.logic.registration
        state = registration.step()
        self.progress.text = registration.progress()
        if state == "done":
            self._end(registration.result.answer.answer, registration.result.short_text)
            self.apply.enabled = registration.result.may_be_applied
        elif state == "failed":
            self._end("failed", str(registration.fault))
        elif state == "cancelled":
            self._end("cancelled", "cancelled; nothing was made")

    def _end(self, word, text):
        self.timer.stop()
        self.register.enabled, self.cancel.enabled = True, False
        self.progress.text = word
        self.verdict.setPlainText(text)

    def on_apply(self, _checked=False):
        result = self.logic.registration.result
        reasons = "\n".join(reason["reason"] for reason in result.answer.reasons)
        if not slicer.util.confirmYesNoDisplay(f"The answer is doubtful:\n\n{reasons}\n\nApply it all the same? Not for clinical use."):
            return
        try:
            result.apply()
        except osteoflow_slicer.Fault as fault:
            self.verdict.setPlainText(str(fault))
        self.apply.enabled = result.may_be_applied

    def on_scene_close(self, _caller=None, _event=None):
        """The nodes of a run are of the scene that is closed."""
        was_running = self.logic.abandon()
        self.apply.enabled = False
        if was_running:
            self._end("cancelled", "cancelled, as the scene was closed")

    def cleanup(self):
        self.timer.stop()
        self.logic.abandon()
        self.removeObservers()


class OsteoflowLogic(ScriptedLoadableModuleLogic):
    """One registration at a time: `start`, then `registration.step()` until it is not "running"."""

    def __init__(self):
        ScriptedLoadableModuleLogic.__init__(self)
        self.registration = None

    def start(self, inputs, program=""):
        if self.registration is not None and self.registration.state == "running":
            raise osteoflow_slicer.Fault("a registration is running", "wait for it, or cancel it")
        self.registration = osteoflow_slicer.Registration(inputs, program)
        return self.registration

    def abandon(self):
        """Ends what is running; whether anything was."""
        was_running = self.registration is not None and self.registration.state == "running"
        if was_running:
            self.registration.abandon()
        return was_running


class OsteoflowTest(ScriptedLoadableModuleTest):
    """Registers a simulated bone, turned by a transform in the scene, with the program that is installed."""

    def setUp(self):
        slicer.mrmlScene.Clear()

    def runTest(self):
        self.setUp()
        self.test_a_turned_scan_is_found()

    @staticmethod
    def surface(n=120, part=1.0):
        """A bumpy shaft, or the part of it that a scan sees."""
        import math

        points, faces = vtk.vtkPoints(), vtk.vtkCellArray()
        rows, around = n, n
        for i in range(rows):
            for j in range(around):
                z, turn = 160.0 * i / (rows - 1) - 80.0, 2.0 * math.pi * part * j / around
                radius = 9.0 + 2.0 * math.cos(turn) + 1.5 * math.cos(2.0 * turn + 0.03 * z) + 1.2 * math.sin(0.05 * z + turn) + 0.0003 * z * z
                points.InsertNextPoint(radius * math.cos(turn) + 0.0006 * z * z, radius * math.sin(turn), z)
        for i in range(rows - 1):
            for j in range(around if part == 1.0 else around - 1):
                a, b = i * around + j, i * around + (j + 1) % around
                for corners in ((a, b, b + around), (a, b + around, a + around)):
                    faces.InsertNextCell(3, corners)
        surface = vtk.vtkPolyData()
        surface.SetPoints(points)
        surface.SetPolys(faces)
        return surface

    def test_a_turned_scan_is_found(self):
        import time

        import numpy as np

        bone = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "bone")
        bone.SetAndObservePolyData(self.surface())
        moved = vtk.vtkTransform()
        moved.RotateWXYZ(35.0, 0.2, 0.9, -0.4)
        moved.Translate(40.0, -25.0, 60.0)
        away = vtk.vtkTransformFilter()
        away.SetTransform(moved)
        away.SetInputData(self.surface(90, part=0.4))
        away.Update()
        scan = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLModelNode", "scan")
        scan.SetAndObservePolyData(away.GetPolyDataOutput())
        turn = slicer.mrmlScene.AddNewNodeByClass("vtkMRMLLinearTransformNode", "above the scan")
        above = vtk.vtkTransform()
        above.RotateWXYZ(20.0, 1.0, 0.0, 0.3)
        above.Translate(5.0, 8.0, -12.0)
        self.assertTrue(turn.SetMatrixTransformToParent(above.GetMatrix()))
        self.assertTrue(scan.SetAndObserveTransformNodeID(turn.GetID()))
        logic = OsteoflowLogic()
        registration = logic.start(osteoflow_slicer.Inputs(bone=bone, scan=scan))
        end = time.time() + 120.0
        while registration.step() == "running":
            self.assertLess(time.time(), end, "it takes longer than two minutes")
            time.sleep(0.1)
        self.assertEqual(registration.state, "done", str(registration.fault))
        result = registration.result
        self.assertIn(result.answer.answer, ("trusted", "doubtful"), result.text)
        found = slicer.util.arrayFromTransformMatrix(result.transform)
        both = vtk.vtkTransform()
        both.Concatenate(above.GetMatrix())
        both.Concatenate(moved.GetMatrix())
        right = np.linalg.inv(slicer.util.arrayFromVTKMatrix(both.GetMatrix()))
        corners = np.array([[x, y, z, 1.0] for x in (-15, 15) for y in (-15, 15) for z in (-80, 80)]).T
        error = np.abs((found @ np.linalg.inv(right) @ corners - corners)[:3]).max()
        self.assertLess(error, 0.5, "the scan is not where it was taken, mm")
        self.assertEqual(result.applied, result.answer.answer == "trusted")
        self.delayDisplay("Test passed")
