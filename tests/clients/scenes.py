"""A scene for 3D Slicer: read by the rules of its source (scene.py), coloured and drawn by VTK; the scan in ParaView.

3D Slicer itself cannot be had from a registry. Its reader of models and what draws them are VTK's.
"""

import json
import os
import shutil

import numpy as np
from client import ROOT, Missing, Row, client, debian, folder, osteoflow, recorded, run
from clouds import box, off
from scene import TURN, Scene, moved

BACKGROUND = (255, 0, 255)


def scene_of():
    return recorded("graphs/fibula.toml", "--set", "export.scene=true") / "export"


def poly_data(points, corners):
    """Vertices, or triangles of three points each."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

    data, places, cells = vtk.vtkPolyData(), vtk.vtkPoints(), vtk.vtkCellArray()
    places.SetData(numpy_to_vtk(np.ascontiguousarray(points, float), deep=True))
    n = len(points) // corners
    indices = np.column_stack([np.full(n, corners), np.arange(n * corners).reshape(n, corners)])
    cells.SetCells(n, numpy_to_vtkIdTypeArray(np.ascontiguousarray(indices, np.int64).ravel(), deep=True))
    data.SetPoints(places)
    data.SetPolys(cells) if corners == 3 else data.SetVerts(cells)
    return data


def drawn(data, camera, scale=None):
    """The picture of a model by the scene's camera, and the matrix from RAS to its -1 to 1."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    mapper, actor, renderer, window = vtk.vtkPolyDataMapper(), vtk.vtkActor(), vtk.vtkRenderer(), vtk.vtkRenderWindow()
    mapper.SetInputData(data)
    if scale:
        table, low, high = scale
        lookup = vtk.vtkLookupTable()
        lookup.SetNumberOfTableValues(len(table))
        for k, colour in enumerate(table / 255):
            lookup.SetTableValue(k, *colour, 1)
        mapper.SetLookupTable(lookup)
        mapper.SetScalarRange(low, high)
        actor.GetProperty().LightingOff()
    actor.SetMapper(mapper)
    actor.GetProperty().SetPointSize(3)
    renderer.AddActor(actor)
    renderer.SetBackground(np.array(BACKGROUND) / 255)
    view = renderer.GetActiveCamera()
    view.SetPosition(camera["position"]), view.SetFocalPoint(camera["focalPoint"]), view.SetViewUp(camera["viewUp"])
    renderer.ResetCameraClippingRange()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(600, 600)
    window.AddRenderer(renderer)
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    grab.Update()
    picture = vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars()).reshape(600, 600, -1)[..., :3]
    matrix = view.GetCompositeProjectionTransformMatrix(1, -1, 1)
    return picture, np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])


def places(points, matrix):
    """Columns and rows of points in a picture; those outside of it are left out."""
    at = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    at = np.floor((at[:, :2] / at[:, 3:] + 1) * 300).astype(int)
    inside = ((at >= 0) & (at < 600)).all(axis=1)
    return at[inside], inside


def wider(mask, n):
    """A mask with what is up to `n` pixels beside it."""
    padded = np.pad(mask, n)
    shifts = [padded[y : y + mask.shape[0], x : x + mask.shape[1]] for y in range(2 * n + 1) for x in range(2 * n + 1)]
    return np.any(shifts, axis=0)


@client("VTK (scene of 3D Slicer)", module="vtkmodules", package="vtk")
def vtk_scene():
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    export = scene_of()
    scene = Scene(export / "scene.mrb")
    bone, scan = scene.models["bone"], scene.models["scan"]

    reader = vtk.vtkPolyDataReader()
    reader.SetFileName(str(export / "scan.vtk"))
    reader.ReadAllScalarsOn()
    reader.Update()
    shown = reader.GetOutput().GetPointData().GetScalars()
    assert shown.GetName() == scan["shown"] == "distance_mm", "what programs colour it by"
    yield Row("scene.mrb: the scan under its transform, against scan.vtk", off(moved(TURN, vtk_to_numpy(reader.GetOutput().GetPoints().GetData())), scan["points"]))

    surface, distance = poly_data(bone["points"], 3), vtk.vtkImplicitPolyDataDistance()
    clean = vtk.vtkCleanPolyData()
    clean.SetInputData(surface)
    clean.Update()
    distance.SetInput(clean.GetOutput())
    by_vtk = np.array([distance.EvaluateFunction(point) for point in scan["points"]])
    assert by_vtk.min() < -0.05 and by_vtk.max() > 0.05, "both sides are there"
    yield Row("scan.vtk: distance_mm, against vtkImplicitPolyDataDistance", off(vtk_to_numpy(shown), by_vtk))

    ply = vtk.vtkPLYReader()
    ply.SetFileName(str(export / "scan.ply"))
    ply.Update()
    colours = vtk_to_numpy(ply.GetOutput().GetPointData().GetScalars())[:, :3].astype(float)
    near = np.abs(scan["scalars"]["distance_mm"]) < 5  # farther ones are grey on the page, and end the scale of a table
    yield Row("scene.mrb: colours of the scan, against those of the page in scan.ply, of 255", off(scene.colours("scan")[near], colours[near]), "", 2)

    cloud = poly_data(scan["points"], 1)
    cloud.GetPointData().SetScalars(numpy_to_vtk(scan["scalars"]["distance_mm"], deep=True))
    for name, data, points, scale in [("bone", surface, bone["points"], None), ("scan", cloud, scan["points"], (scan["table"], *scan["range"]))]:
        picture, matrix = drawn(data, scene.camera, scale)
        at, inside = places(points, matrix)
        assert name == "bone" or inside.all(), "the camera sees the whole scan"
        is_drawn = (picture != BACKGROUND).any(axis=2)
        is_place = np.zeros((600, 600), bool)
        is_place[at[:, 1], at[:, 0]] = True
        # A face at the edge of the bone covers the middle of no pixel.
        seen = wider(is_drawn, 1)[is_place].mean()
        assert is_place.sum() > 1000 and seen > 0.999, f"{name} is drawn at {seen:.4f} of its {is_place.sum()} pixels"
        assert name == "bone" or not (is_drawn & ~wider(is_place, 4)).any(), "nothing is drawn elsewhere"
        yield Row(f"scene.mrb: the {name} drawn at its places by the scene's camera", 0.0, "")

    # What is missing stays so, and what follows it is read.
    values = np.array([[0, 0, 0, np.nan, 1], [1, 0, 0, 2.5, 2], [0, 1, 0, -1, 3]], "<f8")
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n" + "".join(f"property double {name}\n" for name in ["x", "y", "z", "first", "second"])
    source, written = folder() / "missing.ply", folder() / "missing.vtk"
    source.write_bytes(head.encode() + b"end_header\n" + values.tobytes())
    osteoflow("convert", source, written)
    reader.SetFileName(str(written))
    reader.Update()
    point_data = reader.GetOutput().GetPointData()
    for k, name in enumerate(["first", "second"]):
        assert np.array_equal(vtk_to_numpy(point_data.GetArray(name)), values[:, 3 + k], equal_nan=True), name
    yield Row("a column with a missing value (NaN) written as vtk read", 0.0, "")


@client("ParaView", version=lambda: debian("paraview"), program="pvpython")
def paraview():
    if not shutil.which("xvfb-run"):
        raise Missing("no xvfb-run, without which it needs a screen")
    export, found = scene_of(), folder() / "paraview.json"
    script = folder() / "opened.py"
    script.write_text(
        "import json, sys\nfrom paraview import servermanager\nfrom paraview.simple import *\n"
        "from vtkmodules.util.numpy_support import vtk_to_numpy as numpy\n"
        "out = {}\nfor name in sys.argv[2:]:\n"
        "    source, view = OpenDataFile(name), CreateView('RenderView')\n"
        "    shown = Show(source, view)\n    Render(view)\n"
        "    data = servermanager.Fetch(source)\n"
        "    column = data.GetPointData().GetArray(shown.ColorArrayName[1] or 0)\n"
        "    out[name] = [list(shown.ColorArrayName), numpy(data.GetPoints().GetData()).tolist(), numpy(column).tolist() if column else []]\n"
        "json.dump(out, open(sys.argv[1], 'w'))\n"
    )
    files = [export / name for name in ["scan.vtk", "scan.ply", "bone.stl"]]
    quiet = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    # A display of its own: two that look for a free one at once take the same. On a busy machine it is at times gone again at once.
    for attempt in range(4):
        screen = ["xvfb-run", "-a", "-n", 1000 + (os.getpid() + 10 * attempt) % 30000]
        done = run(*screen, "pvpython", script, found, *files, env=quiet, cwd=ROOT, check=False)
        if done.returncode == 0:
            break
    else:
        raise AssertionError(f"pvpython ended with {done.returncode}: {done.stdout[-800:]}{done.stderr[-800:]}")
    scene, read = Scene(export / "scene.mrb"), json.loads(found.read_text())
    scan = scene.models["scan"]
    (colouring, points, values), (_, of_ply, _), (_, corners, _) = (read[str(file)] for file in files)
    assert colouring == ["POINTS", "distance_mm"], colouring
    yield Row("scan.vtk read", off(moved(TURN, points), scan["points"]))
    yield Row("scan.vtk coloured by distance_mm as it is opened", off(values, scan["scalars"]["distance_mm"]))
    yield Row("scan.ply read", off(moved(TURN, of_ply), scan["points"]))
    yield Row("bone.stl read, extent", off(box(moved(TURN, corners)), box(scene.models["bone"]["points"])))
