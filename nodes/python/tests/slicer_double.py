"""A double of 3D Slicer for tests: what the module Osteoflow calls of it, over the real VTK, and no more.

It was written after the source of 3D Slicer at 583e9b37, whose place is named at each class. What the wrapper of VTK refuses (another
class of argument) is a TypeError, as there. What 3D Slicer logs as an error and goes on from is appended to `errors`, with the value that
the real function returns. A name that is not here is an AttributeError.
"""

import itertools
import os
import sys
import tempfile
import types
import unittest

import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy

#: What 3D Slicer would have logged as errors.
errors = []
#: What the user answers to a question, and what was asked.
answers, asked = [], []


def typed(value, *kinds):
    if not isinstance(value, kinds):
        raise TypeError(f"{value!r} is no {' or '.join(kind.__name__ for kind in kinds)}")
    return value


def numbers(value, n):
    value = typed(value, list, tuple, np.ndarray)
    if len(value) != n:
        raise TypeError(f"expected a sequence of {n} values, got {len(value)} values")
    return [float(c) for c in value]


def error(text, returned=None):
    errors.append(text)
    return returned


class vtkMRMLNode:
    """Libs/MRML/Core/vtkMRMLNode.h: 421, 429 (attributes), 471 (description), 729 (references)."""

    def __init__(self):
        self._scene, self._id, self._name, self._attributes, self._references, self._description = None, None, None, {}, {}, None

    def IsA(self, name):
        return int(any(kind.__name__ == typed(name, str) for kind in type(self).__mro__))

    def GetClassName(self):
        return type(self).__name__

    def GetID(self):
        return self._id

    def GetName(self):
        return self._name

    def SetName(self, name):
        self._name = typed(name, str)

    def GetScene(self):
        return self._scene

    def SetAttribute(self, name, value):
        self._attributes[typed(name, str)] = typed(value, str)

    def GetAttribute(self, name):
        return self._attributes.get(typed(name, str))

    def SetDescription(self, text):
        self._description = typed(text, str)

    def GetDescription(self):
        return self._description

    def SetNodeReferenceID(self, role, node_id):
        self._references[typed(role, str)] = typed(node_id, str)

    def GetNodeReferenceID(self, role):
        return self._references.get(role)


class vtkMRMLTransformableNode(vtkMRMLNode):
    """Libs/MRML/Core/vtkMRMLTransformableNode.cxx: 100."""

    def GetParentTransformNode(self):
        node_id = self._references.get("transform")
        return self._scene.GetNodeByID(node_id) if self._scene is not None and node_id else None

    def SetAndObserveTransformNodeID(self, node_id):
        if node_id is None:
            self._references.pop("transform", None)
            return True
        parent = self._scene.GetNodeByID(typed(node_id, str)) if self._scene is not None else None
        while isinstance(parent, vtkMRMLTransformNode):
            if parent is self:
                return error("parent transform cannot be self or a child transform", False)
            parent = parent.GetParentTransformNode()
        self._references["transform"] = node_id
        return True

    def _world(self, point):
        parent = self.GetParentTransformNode()
        while parent is not None:
            point = parent._to_parent.TransformPoint(point)
            parent = parent.GetParentTransformNode()
        return point


class vtkMRMLTransformNode(vtkMRMLTransformableNode):
    """Libs/MRML/Core/vtkMRMLTransformNode.cxx: 422, 951, 1490, 1566; .h: roles."""

    def __init__(self):
        super().__init__()
        self._to_parent = vtk.vtkTransform()

    def IsLinear(self):
        return int(isinstance(self._to_parent, vtk.vtkLinearTransform))

    def IsTransformToWorldLinear(self):
        node = self
        while node is not None:
            if not node.IsLinear():
                return 0
            node = node.GetParentTransformNode()
        return 1

    def SetAndObserveTransformToParent(self, transform):
        self._to_parent = typed(transform, vtk.vtkAbstractTransform)

    def SetMatrixTransformToParent(self, matrix):
        typed(matrix, vtk.vtkMatrix4x4)
        if not self.IsLinear():
            return error("Cannot set matrix because vtkMRMLTransformNode contains a composite or non-linear transform", 0)
        self._to_parent.SetMatrix(matrix)
        return 1

    def GetMatrixTransformToParent(self, matrix):
        typed(matrix, vtk.vtkMatrix4x4)
        if not self.IsLinear():
            matrix.Identity()
            return error("Failed to get transformation matrix because transform is not linear", 0)
        matrix.DeepCopy(self._to_parent.GetMatrix())
        return 1

    @staticmethod
    def GetMatrixTransformBetweenNodes(source, target, matrix):
        typed(matrix, vtk.vtkMatrix4x4)
        assert target is None and source is not None, "only to the world is here"
        matrix.Identity()
        while source is not None:
            own = vtk.vtkMatrix4x4()
            if not source.GetMatrixTransformToParent(own):
                matrix.Identity()
                return 0
            vtk.vtkMatrix4x4.Multiply4x4(own, matrix, matrix)
            source = source.GetParentTransformNode()
        return 1

    @staticmethod
    def GetMovingNodeReferenceRole():
        return "spatialRegistrationMoving"

    @staticmethod
    def GetFixedNodeReferenceRole():
        return "spatialRegistrationFixed"


class vtkMRMLLinearTransformNode(vtkMRMLTransformNode):
    pass


class vtkMRMLDisplayNode(vtkMRMLNode):
    """Libs/MRML/Core/vtkMRMLDisplayNode.h: 76, 392, 452, 460, 523, 561."""

    UseManualScalarRange = 0

    def __init__(self):
        super().__init__()
        self.shown, self.scalar, self.colours, self.range, self.visible = None, None, None, None, 0

    def SetActiveScalar(self, name, location):
        typed(location, int)
        has = self.shown is not None and self.shown.GetPointData().HasArray(typed(name, str))
        self.scalar = name if has and location == vtk.vtkAssignAttribute.POINT_DATA else error(f"there is no array {name}")

    def SetAndObserveColorNodeID(self, node_id):
        known = ("DivergingBlueRed", "Viridis", "ColdToHotRainbow")
        is_known = typed(node_id, str) in [f"vtkMRMLColorTableNodeFile{name}.txt" for name in known]
        self.colours = node_id if is_known else error(f"there is no {node_id}")

    def SetScalarRangeFlag(self, flag):
        typed(flag, int)

    def SetScalarRange(self, low, high):
        self.range = (typed(low, float), typed(high, float))

    def SetScalarVisibility(self, visible):
        self.visible = typed(visible, int)


class vtkMRMLModelDisplayNode(vtkMRMLDisplayNode):
    pass


class vtkMRMLMarkupsPlaneDisplayNode(vtkMRMLDisplayNode):
    pass


class vtkMRMLDisplayableNode(vtkMRMLTransformableNode):
    """Libs/MRML/Core/vtkMRMLModelNode.cxx: 829, and the like in vtkMRMLMarkupsPlaneNode.cxx: 1132."""

    DISPLAY = None

    def GetDisplayNode(self):
        return self._scene.GetNodeByID(self._references["display"]) if self._scene and "display" in self._references else None

    def CreateDefaultDisplayNodes(self):
        if self.GetDisplayNode() is not None:
            return
        if self._scene is None:
            return error("CreateDefaultDisplayNodes failed: scene is invalid")
        display = self._scene.AddNewNodeByClass(self.DISPLAY)
        self._references["display"] = display.GetID()
        if isinstance(self, vtkMRMLModelNode):
            display.shown = self.GetMesh()


class vtkMRMLModelNode(vtkMRMLDisplayableNode):
    """Libs/MRML/Core/vtkMRMLModelNode.cxx: 152, 234, 240, 261."""

    DISPLAY = "vtkMRMLModelDisplayNode"

    def __init__(self):
        super().__init__()
        self._mesh = None

    def SetAndObserveMesh(self, mesh):
        if typed(mesh, vtk.vtkPointSet).GetClassName() not in ("vtkPolyData", "vtkUnstructuredGrid"):
            return error("SetAndObserveMesh: mesh should be a vtkPolyData or an vtkUnstructuredGrid.")
        self._mesh = mesh

    def SetAndObservePolyData(self, surface):
        self.SetAndObserveMesh(typed(surface, vtk.vtkPolyData))

    def GetMesh(self):
        return self._mesh

    def GetPolyData(self):
        return self._mesh if isinstance(self._mesh, vtk.vtkPolyData) else None


class vtkMRMLVolumeNode(vtkMRMLDisplayableNode):
    """Libs/MRML/Core/vtkMRMLVolumeNode.cxx: 383 (which has no shear), 443."""

    def __init__(self):
        super().__init__()
        self._image, self._ijk_to_ras = None, vtk.vtkMatrix4x4()

    def SetAndObserveImageData(self, image):
        self._image = typed(image, vtk.vtkImageData)

    def GetImageData(self):
        return self._image

    def SetIJKToRASMatrix(self, matrix):
        self._ijk_to_ras.DeepCopy(typed(matrix, vtk.vtkMatrix4x4))

    def GetIJKToRASMatrix(self, matrix):
        typed(matrix, vtk.vtkMatrix4x4).DeepCopy(self._ijk_to_ras)


class vtkMRMLScalarVolumeNode(vtkMRMLVolumeNode):
    pass


class vtkMRMLLabelMapVolumeNode(vtkMRMLScalarVolumeNode):
    """Libs/MRML/Core/vtkMRMLLabelMapVolumeNode.h: 36."""


class Segment:
    """Libs/vtkSegmentationCore/vtkSegment.h: 129."""

    def __init__(self, name, surface):
        self._name, self.source, self.surface = name, surface, None

    def GetName(self):
        return self._name


class Segmentation:
    """Libs/vtkSegmentationCore/vtkSegmentation.h: 241, 250, 494."""

    def __init__(self):
        self.segments, self.parameters = {}, {"Smoothing factor": "0.5"}

    def GetSegment(self, segment):
        return self.segments.get(typed(segment, str))

    def GetSegmentIDs(self):
        return tuple(self.segments)

    def GetConversionParameter(self, name):
        return self.parameters.get(typed(name, str), "")


class vtkMRMLSegmentationNode(vtkMRMLDisplayableNode):
    """Libs/MRML/Core/vtkMRMLSegmentationNode.cxx: 927, 949."""

    def __init__(self):
        super().__init__()
        self._segmentation = Segmentation()

    def GetSegmentation(self):
        return self._segmentation

    def CreateClosedSurfaceRepresentation(self):
        for segment in self._segmentation.segments.values():
            segment.surface = segment.source
        return bool(self._segmentation.segments)

    def GetClosedSurfaceRepresentation(self, segment, surface):
        typed(surface, vtk.vtkPolyData)
        found = self._segmentation.GetSegment(segment)
        if found is None:
            return error("GetClosedSurfaceRepresentation: Invalid segment", False)
        if found.surface is None:
            return error("GetClosedSurfaceRepresentation: No closed surface representation in segment", False)
        surface.DeepCopy(found.surface)
        return True


class vtkMRMLMarkupsNode(vtkMRMLDisplayableNode):
    """Libs/MRML/Core/vtkMRMLMarkupsNode.cxx: 516, 792, 2329; .h: placement status."""

    PositionUndefined, PositionPreview, PositionDefined, PositionMissing = range(4)

    def __init__(self):
        super().__init__()
        self._points, self._locked = [], 0

    def AddControlPoint(self, position, label=""):
        self._points.append([numbers(position, 3), typed(label, str), self.PositionDefined])
        return len(self._points) - 1

    def UnsetNthControlPointPosition(self, n):
        self._points[n][2] = self.PositionUndefined

    def SetNthControlPointPosition(self, n, x, y, z):
        self._points[n][0] = [x, y, z]

    def GetNumberOfControlPoints(self):
        return len(self._points)

    def GetNthControlPointLabel(self, n):
        return self._points[n][1]

    def GetNthControlPointPositionStatus(self, n):
        return self._points[n][2]

    def GetNthControlPointPositionWorld(self, n, position):
        numbers(typed(position, list), 3)
        if not 0 <= n < len(self._points):
            return error("GetNthControlPointPositionWorld failed: control point does not exist", 0)
        position[:] = self._world(self._points[n][0])
        return 1

    def SetLocked(self, locked):
        self._locked = typed(locked, int)


class vtkMRMLMarkupsFiducialNode(vtkMRMLMarkupsNode):
    pass


class vtkMRMLMarkupsPlaneNode(vtkMRMLMarkupsNode):
    """Libs/MRML/Core/vtkMRMLMarkupsPlaneNode.cxx: 518, 620, 780, 920, 1783; .h: SizeModeAbsolute, IsPlaneValid."""

    DISPLAY = "vtkMRMLMarkupsPlaneDisplayNode"
    SizeModeAuto, SizeModeAbsolute = range(2)

    def __init__(self):
        super().__init__()
        self._pose, self._valid = np.eye(4), False

    def GetIsPlaneValid(self):
        return self._valid

    def SetOrigin(self, origin):
        self._pose[:3, 3] = numbers(origin, 3)
        self._valid = True

    def SetAxes(self, x, y, z):
        x, y, z = (np.array(numbers(axis, 3)) for axis in (x, y, z))
        if min(np.cross(y, z) @ x, np.cross(z, x) @ y, np.cross(x, y) @ z) <= 1.0 - 1e-5:
            return error("SetAxes: Invalid direction vectors!")
        if max(abs(x @ y), abs(y @ z), abs(z @ x)) >= 1e-5:
            error("SetAxes: Invalid vectors")
        self._pose[:3, :3] = np.column_stack([x, y, z])
        self._valid = True

    def SetSizeMode(self, mode):
        typed(mode, int)

    def SetSize(self, x, y):
        typed(x, float), typed(y, float)

    def GetObjectToWorldMatrix(self, matrix):
        """As GenerateOrthogonalMatrix: axes stay perpendicular, and keep their stretch."""
        typed(matrix, vtk.vtkMatrix4x4)
        pose = self._pose.copy()
        parent = self.GetParentTransformNode()
        if parent is not None:
            above = vtk.vtkMatrix4x4()
            assert vtkMRMLTransformNode.GetMatrixTransformBetweenNodes(parent, None, above)
            above = util.arrayFromVTKMatrix(above)
            x, y = above[:3, :3] @ pose[:3, 0], above[:3, :3] @ pose[:3, 1]
            z = np.cross(x, y)
            axes = np.column_stack([x, np.cross(z, x), z])
            axes /= np.linalg.norm(axes, axis=0)
            axes /= np.linalg.norm(np.linalg.inv(above[:3, :3]) @ axes, axis=0)
            pose = np.vstack([np.column_stack([axes, (above @ pose)[:3, 3]]), [0, 0, 0, 1]])
        matrix.DeepCopy(pose.ravel())


class vtkMRMLTextNode(vtkMRMLTransformableNode):
    """Libs/MRML/Core/vtkMRMLTextNode.h: SetText; text is taken as ASCII unless its encoding is said."""

    def __init__(self):
        super().__init__()
        self._text = ""

    def SetText(self, text, encoding=-1):
        if typed(encoding, int) != vtk.VTK_ENCODING_UTF_8 and not typed(text, str).isascii():
            error("the text is not of its encoding")
        self._text = typed(text, str)

    def GetText(self):
        return self._text


class vtkMRMLScene(vtk.vtkObject):
    """Libs/MRML/Core/vtkMRMLScene.cxx: 1369, 1432, 1526, 1783; .h: 717."""

    StartCloseEvent = vtk.vtkCommand.UserEvent + 1

    def __init__(self):
        self.nodes, self._count = [], itertools.count(1)
        #: Classes of which no node can be made, to try what a failure leaves.
        self.broken = ()

    def AddNewNodeByClass(self, name, base=""):
        kind = globals().get(typed(name, str))
        if name in self.broken or not (isinstance(kind, type) and issubclass(kind, vtkMRMLNode)):
            return error(f"AddNewNodeByClass: failed to create node by class {name}")
        node = kind()
        node._scene, node._id, node._name = self, f"{name}{next(self._count)}", typed(base, str) or name
        self.nodes.append(node)
        return node

    def GetNodeByID(self, node_id):
        return next((node for node in self.nodes if node.GetID() == typed(node_id, str)), None)

    def IsNodePresent(self, node):
        return int(typed(node, vtkMRMLNode) in self.nodes)

    def RemoveNode(self, node):
        typed(node, vtkMRMLNode)
        if node not in self.nodes:
            return error(f"RemoveNode: {node.GetName()} already removed")
        self.nodes.remove(node)
        node._scene = None
        for other in self.nodes:
            other._references = {role: to for role, to in other._references.items() if to != node.GetID()}

    def Clear(self):
        self.InvokeEvent(self.StartCloseEvent)
        for node in list(self.nodes):
            self.RemoveNode(node)


class util:
    """Base/Python/slicer/util.py: 380, 1887, 1910, 2055, 2268, 2292, 2340, 3164, 3387."""

    @staticmethod
    def getNodesByClass(name):
        return [node for node in slicer.mrmlScene.nodes if node.IsA(name)]

    @staticmethod
    def getNode(name):
        return next(node for node in slicer.mrmlScene.nodes if node.GetName() == name)

    @staticmethod
    def arrayFromVolume(node):
        image = node.GetImageData()
        if node.GetClassName() not in ("vtkMRMLScalarVolumeNode", "vtkMRMLLabelMapVolumeNode"):
            raise RuntimeError("Unsupported volume type: " + node.GetClassName())
        return vtk_to_numpy(image.GetPointData().GetScalars()).reshape(tuple(reversed(image.GetDimensions())))

    @staticmethod
    def arrayFromVTKMatrix(matrix):
        if not isinstance(matrix, vtk.vtkMatrix4x4):
            raise RuntimeError("Input must be vtk.vtkMatrix3x3 or vtk.vtkMatrix4x4")
        found = np.eye(4)
        matrix.DeepCopy(found.ravel(), matrix)
        return found

    @staticmethod
    def vtkMatrixFromArray(array):
        if array.shape != (4, 4):
            raise RuntimeError("Unsupported numpy array shape: " + str(array.shape) + " expected (4,4)")
        matrix = vtk.vtkMatrix4x4()
        matrix.DeepCopy(array.ravel())
        return matrix

    @staticmethod
    def arrayFromTransformMatrix(node):
        matrix = vtk.vtkMatrix4x4()
        if not node.GetMatrixTransformToParent(matrix):
            raise RuntimeError("Failed to get transformation matrix from node " + node.GetID())
        return util.arrayFromVTKMatrix(matrix)

    @staticmethod
    def startupEnvironment():
        return {name: value for name, value in os.environ.items() if name}

    @staticmethod
    def confirmYesNoDisplay(text):
        asked.append(typed(text, str))
        return answers.pop(0)


class VTKObservationMixin:
    """Base/Python/slicer/util.py: 3164."""

    def __init__(self):
        super().__init__()
        self._observed = []

    def addObserver(self, obj, event, method):
        self._observed.append((obj, obj.AddObserver(event, method)))

    def removeObservers(self):
        for obj, tag in self._observed:
            obj.RemoveObserver(tag)
        self._observed.clear()


# Widgets: properties and methods of Qt, CTK and 3D Slicer that the module uses; others are refused.


class Widget:
    PROPERTIES, SIGNALS = {"enabled": True}, ()

    def __init__(self, *_):
        values = {}
        for kind in reversed(type(self).__mro__):
            values.update(getattr(kind, "PROPERTIES", {}))
        self.__dict__.update(values=values, slots={})

    def __getattr__(self, name):
        if name in self.__dict__.get("values", {}):
            return self.values[name]
        raise AttributeError(f"{type(self).__name__} has no {name}")

    def __setattr__(self, name, value):
        if name not in self.values:
            raise AttributeError(f"{type(self).__name__} has no property {name}")
        self.values[name] = value

    def connect(self, signal, slot):
        if signal not in self.SIGNALS:
            raise ValueError(f"{type(self).__name__} has no signal {signal}")
        self.slots[signal] = slot

    def emit(self, signal, *values):
        self.slots[signal](*values)


class QLabel(Widget):
    PROPERTIES = {"text": ""}


class QLineEdit(Widget):
    PROPERTIES = {"text": "", "placeholderText": ""}


class QCheckBox(Widget):
    PROPERTIES = {"checked": False}


class QPushButton(Widget):
    SIGNALS = ("clicked(bool)",)

    def click(self):
        if self.enabled:
            self.emit("clicked(bool)", False)


class QComboBox(Widget):
    PROPERTIES = {"currentIndex": -1, "items": ()}

    def addItem(self, text):
        self.items = (*self.items, typed(text, str))
        self.currentIndex = max(self.currentIndex, 0)

    def clear(self):
        self.items, self.currentIndex = (), -1


class QPlainTextEdit(Widget):
    PROPERTIES = {"plainText": ""}

    def setReadOnly(self, _is_read_only):
        pass

    def setPlainText(self, text):
        self.plainText = typed(text, str)


class QTimer(Widget):
    PROPERTIES = {"active": False}
    SIGNALS = ("timeout()",)

    def setInterval(self, ms):
        typed(ms, int)

    def start(self):
        self.active = True

    def stop(self):
        self.active = False


class QFormLayout(Widget):
    def addRow(self, *cells):
        for cell in cells:
            typed(cell, str, Widget)


class ctkCollapsibleButton(Widget):
    PROPERTIES = {"text": ""}


class ctkPathLineEdit(Widget):
    PROPERTIES = {"currentPath": ""}


class qMRMLNodeComboBox(Widget):
    """Libs/MRML/Widgets/qMRMLNodeComboBox.h: 61, 73, 74, 75, 87, 173, 325."""

    PROPERTIES = {
        "nodeTypes": [], "noneEnabled": False, "addEnabled": True, "removeEnabled": True, "selectNodeUponCreation": True, "chosen": None,
        "scene": None,
    }
    SIGNALS = ("currentNodeChanged(vtkMRMLNode*)",)

    def setMRMLScene(self, scene):
        self.scene = typed(scene, vtkMRMLScene)

    def currentNode(self):
        return self.chosen

    def choose(self, node):
        assert node is None or any(node.IsA(name) for name in self.nodeTypes), "it does not offer this node"
        self.chosen = node
        if self.slots:
            self.emit("currentNodeChanged(vtkMRMLNode*)", node)


class qMRMLCheckableNodeComboBox(qMRMLNodeComboBox):
    """Libs/MRML/Widgets/qMRMLCheckableNodeComboBox.h: 51."""

    PROPERTIES = {"checked": ()}

    def checkedNodes(self):
        return tuple(self.checked)


class ScriptedLoadableModule:
    """Base/Python/slicer/ScriptedLoadableModule.py."""

    def __init__(self, parent):
        self.parent = parent


class ScriptedLoadableModuleWidget:
    def __init__(self, parent=None):
        super().__init__()
        self.parent, self.layout = parent, types.SimpleNamespace(addWidget=lambda widget: typed(widget, Widget))

    def setup(self):
        pass


class ScriptedLoadableModuleLogic:
    def __init__(self, parent=None):
        super().__init__()


class ScriptedLoadableModuleTest(unittest.TestCase):
    def __init__(self):
        super(unittest.TestCase, self).__init__()
        unittest.TestCase.__init__(self, "runTest")

    def delayDisplay(self, message):
        print(message)


def module(name, **content):
    made = types.ModuleType(name)
    made.__dict__.update(content)
    sys.modules[name] = made
    return made


def of(prefix):
    return {name: value for name, value in globals().items() if name.startswith(prefix)}


slicer = module("slicer", **of("vtkMRML"), **of("qMRML"), util=util, app=types.SimpleNamespace(temporaryPath=tempfile.gettempdir()))
slicer.__path__ = []
slicer.mrmlScene = vtkMRMLScene()
module("slicer.util", VTKObservationMixin=VTKObservationMixin)
module("slicer.ScriptedLoadableModule", **of("ScriptedLoadableModule"))
module("qt", **of("Q"))
module("ctk", **of("ctk"))
