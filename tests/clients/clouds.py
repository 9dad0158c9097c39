"""Clouds and surfaces: what is exported is read by other programs with the same numbers, and what they write is read."""

import contextlib
import io
import shutil

import numpy as np
from client import Missing, Row, client, compiled, converted, debian, folder, osteoflow, recorded, run

# What writers of text leave of coordinates of up to 1 m: six or seven digits.
DIGITS_MM = 5e-3


def ours(path):
    """The points of a file as this program reads it: as a CSV of doubles."""
    out = folder() / f"ours-{path.parent.name}-{path.name}.csv"
    out.unlink(missing_ok=True)
    osteoflow("convert", path, out)
    text = np.genfromtxt(out, delimiter=",", skip_header=1)
    return np.atleast_2d(text)[:, :3]


def exports():
    """The exported scan and bone, and the same converted to every format that other programs read."""
    export = recorded() / "export"
    scan = {"scan.ply": export / "scan.ply", "scan.vtk": export / "scan.vtk"}
    for ending in ["pcd", "csv"]:
        scan[f"scan.{ending}"] = converted(export / "scan.ply", f"scan.{ending}")
    # An OBJ holds no columns.
    places = folder() / "places.csv"
    np.savetxt(places, ours(export / "scan.vtk"), fmt="%.17g", delimiter=",", header="x,y,z", comments="")
    scan["scan.obj"] = converted(places, "scan.obj")
    bone = {"bone.stl": export / "bone.stl"}
    for ending in ["ply", "obj"]:
        bone[f"bone.{ending}"] = converted(export / "bone.stl", f"bone.{ending}")
    return scan, bone


def off(found, expected):
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    return float(np.abs(found - expected).max()) if found.shape == expected.shape else float("inf")


def truth():
    """The points of the exported scan and the corners of the exported bone, by this program's own reader."""
    export = recorded() / "export"
    return ours(export / "scan.vtk"), ours(export / "bone.stl")


def box(points):
    points = np.asarray(points, float)
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


@client("PCL", version=lambda: debian("libpcl-dev"))
def pcl():
    flags = "-I/usr/include/eigen3 -lpcl_io -lpcl_io_ply -lpcl_common".split()
    version = ".".join(debian("libpcl-dev").split(".")[:2])
    program = compiled("pcl_read.cpp", f"-I/usr/include/pcl-{version}", *flags)
    scan, bone = exports()
    points, corners = truth()

    def loaded(file):
        out = folder() / "pcl.bin"
        run(program, "read", file, out)
        return np.fromfile(out, "<f4").reshape(-1, 3)

    yield Row("scan.ply read", off(loaded(scan["scan.ply"]), points))
    yield Row("scan.pcd read", off(loaded(scan["scan.pcd"]), points))
    yield Row("bone.ply read, corners in the order of their faces", off(loaded(bone["bone.ply"]), loaded(bone["bone.stl"])))
    assert len(loaded(bone["bone.stl"])) > len(corners), "three corners for each face"
    for kind in ["binary", "compressed", "ascii", "blob", "blob_compressed"]:
        written = folder() / f"pcl-{kind}.pcd"
        run(program, kind, scan["scan.pcd"], written)
        said = osteoflow("convert", written, folder() / f"pcl-{kind}.vtk").stderr
        assert "bytes follow" not in said, said
        yield Row(f"written PCD ({kind}) read here", off(ours(written), points))
    written = folder() / "pcl.ply"
    run(program, "ply", scan["scan.ply"], written)
    yield Row("written PLY read here", off(ours(written), points))


@client("Open3D", module="open3d")
def open3d():
    import open3d as o3d

    scan, bone = exports()
    points, corners = truth()
    for name in ["scan.ply", "scan.pcd"]:
        cloud = o3d.io.read_point_cloud(str(scan[name]))
        assert cloud.has_colors(), name
        yield Row(f"{name} read, with colours", off(cloud.points, points))
        for ending in ["ply", "pcd"]:
            written = folder() / f"open3d-{name}.{ending}"
            o3d.io.write_point_cloud(str(written), cloud)
            yield Row(f"{name} written as {ending} read here", off(ours(written), cloud.points))
    for name in ["bone.stl", "bone.ply", "bone.obj"]:
        mesh = o3d.io.read_triangle_mesh(str(bone[name]))
        yield Row(f"{name} read, extent", off(box(mesh.vertices), box(corners)))
        written = folder() / f"open3d-{name}"
        mesh.compute_vertex_normals()
        mesh.compute_triangle_normals()
        o3d.io.write_triangle_mesh(str(written), mesh)
        digits = DIGITS_MM if name == "bone.obj" else 1e-4
        yield Row(f"{name} written and read here, extent", off(box(ours(written)), box(corners)), tolerance=digits)


@client("CloudCompare", version=lambda: debian("cloudcompare"), program="CloudCompare")
def cloudcompare():
    import os

    if not shutil.which("xvfb-run"):
        raise Missing("no xvfb-run, without which its command line needs a screen")
    scan, bone = exports()
    points, corners = truth()
    quiet = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}

    def saved(source, what, form, ending):
        copy = folder() / f"cc-{ending}-{source.name}"
        shutil.copy(source, copy)
        arguments = ["-SILENT", "-NO_TIMESTAMP", "-AUTO_SAVE", "OFF", f"-{what}_EXPORT_FMT", form]
        precise = ["-PREC", "9"] if form == "ASC" else []
        arguments += [*precise, "-O", copy, f"-SAVE_{'CLOUDS' if what == 'C' else 'MESHES'}"]
        done = run("xvfb-run", "-a", "CloudCompare", *arguments, env=quiet, check=False)
        out = copy.with_suffix(f".{ending}")
        if not out.exists():
            raise AssertionError(f"CloudCompare wrote no {out.name}: {done.stdout[-800:]}")
        return out, done.stdout

    for name in ["scan.ply", "scan.pcd"]:
        written, said = saved(scan[name], "C", "ASC", "asc")
        table = np.loadtxt(written, comments="//")
        yield Row(f"{name} read", off(table[:, :3], points))
        if name == "scan.ply":
            assert table.shape[1] >= 7, f"colours and distance come with it, {table.shape}: {said[-300:]}"
    for name in ["scan.ply"]:
        for form, ending in [("PLY", "ply"), ("ASC", "asc"), ("BIN", "bin")]:
            written, _ = saved(scan[name], "C", form, ending)
            if ending == "bin":
                done = osteoflow("convert", written, folder() / "bin.csv", check=False)
                assert done.returncode != 0 and "CloudCompare" in done.stderr, done.stderr
                yield Row("written .bin refused by its name, with what to save instead", 0.0, "")
            else:
                yield Row(f"{name} written as {ending} read here", off(ours(written), points))
    for name in ["bone.stl", "bone.ply", "bone.obj"]:
        written, _ = saved(bone[name], "M", "PLY", "ply")
        yield Row(f"{name} read, written as ply and read here, extent", off(box(ours(written)), box(corners)))


@client("MeshLab (pymeshlab)", module="pymeshlab")
def meshlab():
    import pymeshlab

    scan, bone = exports()
    points, corners = truth()
    for name, path in {"scan.ply": scan["scan.ply"], **bone}.items():
        meshes = pymeshlab.MeshSet()
        meshes.load_new_mesh(str(path))
        found = meshes.current_mesh().vertex_matrix()
        expected = points if name.startswith("scan") else corners
        yield Row(f"{name} read, extent", off(box(found), box(expected)))
        if name == "scan.ply":
            yield Row("scan.ply read, points", off(found, points))
        written = folder() / f"meshlab-{name}"
        meshes.save_current_mesh(str(written))
        yield Row(f"{name} written and read here, extent", off(box(ours(written)), box(expected)))


@client("VTK", module="vtkmodules", package="vtk")
def vtk():
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    scan, bone = exports()
    points, corners = truth()
    readers = {"vtk": vtk.vtkPolyDataReader, "ply": vtk.vtkPLYReader, "stl": vtk.vtkSTLReader, "obj": vtk.vtkOBJReader}
    writers = {"vtk": vtk.vtkPolyDataWriter, "ply": vtk.vtkPLYWriter, "stl": vtk.vtkSTLWriter}
    for name, path in [("scan.vtk", scan["scan.vtk"]), ("scan.ply", scan["scan.ply"]), *bone.items()]:
        reader = readers[path.suffix[1:]]()
        reader.SetFileName(str(path))
        reader.Update()
        data = reader.GetOutput()
        found = vtk_to_numpy(data.GetPoints().GetData())
        if name.startswith("scan"):
            yield Row(f"{name} read", off(found, points))
        else:
            yield Row(f"{name} read, extent", off(box(found), box(corners)))
        for ending, writer in writers.items() if name.startswith("bone") else [("vtk", writers["vtk"])]:
            for is_binary in [False, True]:
                written = folder() / f"vtk-{is_binary}-{name}.{ending}"
                writer_of = writer()
                writer_of.SetFileName(str(written))
                writer_of.SetInputData(data)
                writer_of.SetFileTypeToBinary() if is_binary else writer_of.SetFileTypeToASCII()
                writer_of.Write()
                kind = "binary" if is_binary else "ASCII"
                yield Row(f"{name} written as {ending} ({kind}) read here", off(box(ours(written)), box(found)), tolerance=1e-4 if is_binary else DIGITS_MM)
        if path.suffix not in (".vtk", ".stl"):
            continue
        worst = {"text": 0.0, "base64, appended and raw, compressed and not, both orders of bytes": 0.0}
        for mode in ["Ascii", "Binary", "Appended", "Raw"]:
            writer_of = vtk.vtkXMLPolyDataWriter()
            writer_of.SetInputData(data)
            getattr(writer_of, f"SetDataModeTo{mode.replace('Raw', 'Appended')}")()
            writer_of.SetEncodeAppendedData(mode != "Raw")
            for compressor, order, width in [("None", "LittleEndian", 32), ("ZLib", "BigEndian", 64)]:
                written = folder() / f"vtk-{mode}-{compressor}-{name}.vtp"
                writer_of.SetFileName(str(written))
                getattr(writer_of, f"SetCompressorTypeTo{compressor}")()
                getattr(writer_of, f"SetByteOrderTo{order}")()
                writer_of.SetHeaderType(width)
                writer_of.Write()
                how = list(worst)[mode != "Ascii"]
                worst[how] = max(worst[how], off(box(ours(written)), box(found)))
        for how, difference in worst.items():
            yield Row(f"{name} written as vtp ({how}) read here", difference, tolerance=DIGITS_MM if how == "text" else 1e-4)


@client("PyVista", module="pyvista")
def pyvista():
    import pyvista as pv

    scan, bone = exports()
    points, corners = truth()
    cloud = pv.read(str(scan["scan.vtk"]))
    yield Row("scan.vtk read", off(cloud.points, points))
    yield Row("scan.ply read", off(pv.read(str(scan["scan.ply"])).points, points))
    mesh = pv.read(str(bone["bone.stl"]))
    yield Row("bone.stl read, extent", off(box(mesh.points), box(corners)))
    # It writes a text into the field data of every legacy file.
    mesh.add_field_data(["of the bone", "und ein % mehr"], "note")
    for is_binary in [False, True]:
        for name, data in [("cloud", cloud), ("mesh", mesh)]:
            written = folder() / f"pyvista-{name}-{is_binary}.vtk"
            data.save(str(written), binary=is_binary)
            kind = "binary" if is_binary else "ASCII"
            yield Row(f"{name} written as vtk ({kind}) with a text in its field data, read here", off(box(ours(written)), box(data.points)), tolerance=1e-4 if is_binary else DIGITS_MM)


@client("trimesh", module="trimesh")
def of_trimesh():
    import trimesh

    scan, bone = exports()
    points, corners = truth()
    loaded = trimesh.load(scan["scan.ply"], process=False)
    yield Row("scan.ply read", off(loaded.vertices, points))
    for name, path in bone.items():
        mesh = trimesh.load(path, process=False)
        yield Row(f"{name} read, extent", off(mesh.bounds.ravel(), box(corners)))
        for ending in ["ply", "stl", "obj", "off"]:
            written = folder() / f"trimesh-{name}.{ending}"
            mesh.export(written)
            yield Row(f"{name} written as {ending} read here, extent", off(box(ours(written)), box(corners)))


@client("meshio", module="meshio")
def of_meshio():
    import meshio

    _, bone = exports()
    _, corners = truth()
    for name, path in bone.items():
        with contextlib.redirect_stdout(io.StringIO()):
            mesh = meshio.read(path)
        yield Row(f"{name} read, extent", off(box(mesh.points), box(corners)))
        for form, ending in [("ply", "ply"), ("stl", "stl"), ("obj", "obj"), ("off", "off")]:
            written = folder() / f"meshio-{name}.{ending}"
            with contextlib.redirect_stdout(io.StringIO()):
                meshio.Mesh(mesh.points, {"triangle": mesh.get_cells_type("triangle")}).write(written, form)
            yield Row(f"{name} written as {ending} read here, extent", off(box(ours(written)), box(corners)))
