"""Surface registration of bones: the program osteoflow, called from Python.

Lengths are millimetres, angles radians, times nanoseconds. `t_a_b` is a 4 x 4 matrix that takes coordinates in b to
coordinates in a. Every function runs the code of the command of the same name and gives the same bits.

    import osteoflow
    fit = osteoflow.register("bone.stl", "scan.ply")
    print(fit.verdict["answer"], fit.t_target_source)

Research software, not a medical device.
"""

from __future__ import annotations

import csv as _csv
import json as _json
import os as _os
import sys as _sys
import tempfile as _tempfile
import warnings as _warnings
from pathlib import Path as _Path
from typing import Any, Callable, Iterable, Mapping, Optional, Sequence, Union

import numpy as _np

from . import _core
from ._command import BEFORE as _BEFORE
from ._core import OsteoflowError, Refused, UsageError, __version__
from ._study import Row, Study
from ._types import Cloud, Item, Mesh, Recording, Wire, _Wires
from ._view import view

__all__ = [
    "Cloud", "Graph", "GraphRun", "Item", "Mesh", "OsteoflowError", "OsteoflowWarning", "Recording", "Refused",
    "Registration", "Row", "Study", "UsageError", "Wire", "__version__", "read", "register", "simulate", "sweep", "view", "write",
]

# Plugins are looked at by another process; a sweep is of this build of the program.
_core.hosted_by(_sys.executable or "", _BEFORE, _core.__file__)
if hasattr(_os, "register_at_fork"):
    _os.register_at_fork(after_in_child=_core.forked)


class OsteoflowWarning(UserWarning):
    """What the command prints as a warning."""


def _warn(texts: Iterable[str]) -> None:
    for text in texts:
        _warnings.warn(text, OsteoflowWarning, stacklevel=3)


def _options(**options: Any) -> list[str]:
    """Keyword arguments as options of the command line; None and False leave one out."""
    words: list[str] = []
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            words.append(option)
        else:
            words.append(f"{option}={_os.fspath(value) if isinstance(value, _os.PathLike) else value}")
    return words


def _sets(settings: Union[Mapping[str, Any], Sequence[str], None]) -> list[str]:
    """`--set` for each key."""
    return [f"--set={setting}" for setting in _core.setting_texts(settings)]


def _files(files: Sequence[Union[str, "_os.PathLike[str]"]]) -> list[str]:
    return [_os.fspath(file) for file in files]


def read(
    path: Union[str, "_os.PathLike[str]"],
    *,
    unit_mm: float = 1.0,
    frame: str = "file",
    threshold_hu: Optional[float] = None,
    series: Optional[str] = None,
) -> Any:
    """Read a file of any format that the program reads, recognised by its content.

    Returns a `Mesh` (PLY, STL, OBJ, OFF, VTK with faces; the bone's surface of a CT in NIfTI, NRRD, MetaImage or a DICOM folder), a
    `Cloud` (PLY, PCD, OBJ, VTK, text), a dict of name to (3,) array (picked points: .mrk.json, .fcsv, .pp, CSV), a (4, 4)
    array (a pose: text, JSON, .tfm, whose inverse is taken), or a `Recording` (run.mcap). All in mm; LPS where the file
    states a space.

    unit_mm : the file's unit in mm, 1000 for metres.
    threshold_hu, series : of a CT, as of `register`.

    Raises OsteoflowError if the file cannot be read, UsageError for an option that does not fit it.
    """
    kind, content, space, notes = _core.read(_os.fspath(path), float(unit_mm), frame, threshold_hu, series)
    if kind == "recording":
        return Recording(path)
    if kind in ("pose", "points"):
        _warn(f"{_os.fspath(path)}: {note}" for note in notes)
        return _np.array(content) if kind == "pose" else {name: _np.array(xyz) for name, xyz in content}
    head, columns = content
    if kind == "mesh":
        return Mesh(columns["vertices"], columns["faces"], frame=head["frame"], space=space or None, notes=notes)
    extras = {name[len("extra/"):]: values for name, values in columns.items() if name.startswith("extra/")}
    viewpoint = head.get("viewpoint")
    return Cloud(
        columns["points"], columns.get("normals"), extras, frame=head["frame"], viewpoint=viewpoint, space=space or None,
        notes=notes,
    )


def write(path: Union[str, "_os.PathLike[str]"], content: Any, *, space: Optional[str] = None, double: bool = False) -> None:
    """Write a file; its ending names the format. Nothing is overwritten.

    content : a `Mesh` (.ply, .stl, .obj), a `Cloud` or an (n, 3) array in mm (.ply, .pcd, .vtk, .obj, .csv), a dict of name to
        point in mm (.mrk.json, .fcsv, .csv), or a (4, 4) array, a rigid motion in mm (.txt, .json, .tfm).
    space : "LPS" or "RAS", the space of the numbers, which some formats state. Default: that of `content`.
    double : the numbers of a .ply or .pcd as doubles. Default: as 32-bit floats, which PCL and Open3D read, where these keep
        1e-4 mm, else as doubles with an `OsteoflowWarning`.
    """
    file = _os.fspath(path)
    if isinstance(content, Mapping):
        points = [(str(name), [float(c) for c in xyz]) for name, xyz in content.items()]
        return _core.write_points(file, points, space or "")
    if not isinstance(content, (Cloud, Mesh)):
        array = _np.asarray(content, dtype=_np.float64)
        if array.shape == (4, 4):
            return _core.write_pose(file, array.tolist())
        content = Cloud(array)
    shape = content._shape()
    if space is not None:
        shape = (*shape[:-1], space)
    _warn(_core.write_shape(file, shape, double))


class Registration:
    """A registration.

    t_target_source : (4, 4) float64, takes coordinates in the source's frame to the target's, mm; the command's bits.
    verdict : dict with `answer` ("trusted", "doubtful"), `reasons` and more; None with no_verdict=True.
    report : dict, all that `osteoflow register --format json` prints.

    Each key of `report` is an attribute, too: converged, stop_reason, iterations, n_pairs, rms_mm, undetermined, start,
    warnings, notes, align_ms (list, ms), params ...
    """

    def __init__(self, report: dict) -> None:
        self.report = report
        #: Target and source as they were given, and the files of landmarks: what `view` shows.
        self._given: tuple = ()
        self.t_target_source = _np.array(report["T"], dtype=_np.float64).reshape(4, 4)
        self.verdict: Optional[dict] = report.get("verdict")

    def __getattr__(self, name: str) -> Any:
        report = self.__dict__.get("report", {})
        # The keys of the answer, then those of the report of the method.
        for found in (report, report.get("report", {})):
            if name in found:
                return found[name]
        raise AttributeError(f"a registration has no {name!r}; there are {', '.join(report)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.report]

    def __repr__(self) -> str:
        answer = self.verdict["answer"] if self.verdict else "not judged"
        return f"<registration, {answer}, {self.n_pairs} pairs, {self.rms_mm:.4f} mm RMS>"


def _given(value: Any, what: str) -> tuple[str, Any]:
    """The file of an input, or its name and its content in memory."""
    if isinstance(value, (str, _os.PathLike)):
        return _os.fspath(value), None
    if isinstance(value, (Cloud, Mesh)):
        return what, value._shape()
    return what, Cloud(value)._shape()


def register(
    target: Any,
    source: Any,
    init: Any = None,
    method: str = "point_to_plane",
    *,
    landmarks: Optional[tuple] = None,
    pairing: Optional[str] = None,
    max_pair_distance_mm: Optional[float] = None,
    max_iterations: Optional[int] = None,
    step_mm: Optional[float] = None,
    step_rad: Optional[float] = None,
    set: Union[Mapping[str, Any], Sequence[str], None] = None,
    stop: str = "converge",
    threshold_hu: Optional[float] = None,
    series: Optional[str] = None,
    component: Union[str, int, None] = None,
    source_component: Union[str, int, None] = None,
    box: Optional[Sequence[float]] = None,
    sphere: Optional[Sequence[float]] = None,
    region: Union[str, "_os.PathLike[str]", None] = None,
    target_points: int = 150_000,
    max_points: int = 100_000,
    seed: int = 1,
    unit_mm: float = 1.0,
    target_unit_mm: Optional[float] = None,
    source_unit_mm: Optional[float] = None,
    init_unit_mm: Optional[float] = None,
    camera: Optional[Sequence[float]] = None,
    workers: Optional[int] = None,
    cache: bool = True,
    repeat: int = 1,
    verdict: bool = True,
    require: str = "doubtful",
    out: Union[str, "_os.PathLike[str]", None] = None,
    write_source: Union[str, "_os.PathLike[str]", None] = None,
    space: Optional[str] = None,
    trace: bool = False,
    progress: bool = True,
    fiducials: Optional[tuple] = None,
    sensor: Union[str, "_os.PathLike[str]", None] = None,
    tip_radius_mm: Optional[float] = None,
    targets: Union[str, "_os.PathLike[str]", None] = None,
) -> Registration:
    """Register `source`, which moves, onto `target`, which stays: `osteoflow register` with its defaults.

    target, source : a file, a `Mesh` or `Cloud` as of `read`, or an (n, 3) array in mm. C-contiguous float64 arrays are read
        in place, others are copied once. A target without normals gets estimated ones; a surface is sampled.
    init : the start, source to target: a (4, 4) array in mm, a file, or "identity". Default: by the shape of the bone alone.
    method : point_to_plane, point_to_point, symmetric, generalized, point_to_mesh or published.
    landmarks : two files of picked points, of target and source, to start from.
    fiducials : the same of points off the surface, such as screws, rings or skin markers; the verdict compares them with the surface.
    targets : a file of named points in the target's frame, near the scan or far from it, at which the error is predicted:
        `verdict["predicted"]["points"]`, each with its RMS, its interval of 90 % and its ellipsoid.
    set : any parameter of the method, {"trim_fraction": 0.2}; `osteoflow inspect icp.point_to_plane` lists them.
    camera : (3,), position of the camera in the source's frame, mm.
    sensor : what `source` was measured with: "structured_light" (the default), "laser", "depth_camera", "ultrasound" or "stylus", or a
        file (TOML) with the keys of `sensor` of surface.prepare; the verdict expects its errors.
    tip_radius_mm : radius of the ball of a stylus' tip, whose middle the points are.
    component, source_component : which part of target and source: "largest", its number by size, or "nearest:X,Y,Z" (mm).
    box, sphere, region : (6,) two opposite corners, (4,) centre and radius in the source's frame, mm, or a file that the page saved;
        only the points of `source` that are in all of them are registered.
    workers : number of threads; the pose does not depend on it. Default: the number of cores.
    cache : False neither loads a prepared target file from the store nor saves one.
    verdict : False saves the time to judge the pose.
    require : the worst verdict with which a pose is given, "doubtful" or "trusted".
    out, write_source : files to write, as of the command.
    trace : True puts every step under `trace`.

    The remaining options are those of `osteoflow register --help`.

    Raises Refused if there is no pose, or it is refused (`error.report` holds what is known); UsageError for options;
    OsteoflowError for files; KeyboardInterrupt. Warnings of the command are OsteoflowWarning.
    """
    as_given = (target, source, landmarks or fiducials)
    target_name, target = _given(target, "target")
    source_name, source = _given(source, "source")
    for name, unit, is_file in [("target", target_unit_mm, target is None), ("source", source_unit_mm, source is None)]:
        if not is_file and (unit or unit_mm) != 1.0:
            raise UsageError(f"{name} is in memory and must be in mm; unit_mm is for files")
    start = None
    if init is not None and not isinstance(init, (str, _os.PathLike)):
        start = _np.asarray(init, dtype=_np.float64)
        if start.shape != (4, 4):
            raise ValueError(f"init has shape {start.shape}, but must be (4, 4)")
        init, start = None, start.tolist()
    options = dict(
        init=init, method=method, landmarks=landmarks, fiducials=fiducials, targets=targets, pairing=pairing, max_pair_distance_mm=max_pair_distance_mm,
        max_iterations=max_iterations, step_mm=step_mm, step_rad=step_rad, stop=stop, threshold_hu=threshold_hu, series=series,
        component=component if component is None else str(component), region=region, sphere=sphere, box=box,
        source_component=source_component if source_component is None else str(source_component),
        target_points=target_points, max_points=max_points, seed=seed, unit_mm=unit_mm, target_unit_mm=target_unit_mm, source_unit_mm=source_unit_mm,
        init_unit_mm=init_unit_mm, camera=camera, keep=dict(no_cache=not cache), repeat=repeat, no_verdict=not verdict, require=require,
        out=out, write_source=write_source, sensor=None if sensor is None else str(sensor), tip_radius_mm=tip_radius_mm,
    )
    options = {name: value for name, value in options.items() if value is not None}
    answer = _core.register((target_name, target), (source_name, source), start, options, set, workers, space, trace, progress)
    fit = Registration(_json.loads(answer))
    fit._given = as_given
    _warn(fit.report["warnings"])
    return fit


class GraphRun(_Wires):
    """A finished run: a mapping of its wires, `run["to_bone.cloud"].array`.

    results : dict, the content of results.json.
    warnings : of nodes, one sentence each.
    out_dir : the folder with the files of the run, or None.
    """

    def __init__(self, ran: tuple) -> None:
        results, self.warnings, out_dir, self._core = ran
        self.results: dict = _json.loads(results)
        self.out_dir = None if out_dir is None else _Path(out_dir)

    def __repr__(self) -> str:
        return f"<run, results {', '.join(self.results)}, {len(self)} wires>"


def _pose_item(matrix: Any, frames: tuple, wire: str, stamp_ns: int) -> tuple:
    to, source = frames
    if to is None or source is None:
        raise UsageError(f"the frames of wire \"{wire}\" are not known from the graph, so a 4 x 4 array does not say where it leads")
    m = _np.asarray(matrix, dtype=_np.float64)
    return stamp_ns, {"to": to, "from": source, "stamp_ns": stamp_ns, "isometry": _core.seven(m.tolist())}, {}


def _mapping_item(given: Mapping[str, Any], payload: str) -> tuple:
    """The item of a dict: a report as in results.json, or the fields and columns of another payload."""
    if payload.startswith("report/") and "json" not in given and payload not in ("report/Flag", "report/Text"):
        return 0, {"json": _json.dumps(given, default=lambda value: _np.asarray(value).tolist())}, {}
    stamp_ns = given.get("stamp_ns", 0) if not isinstance(given, Item) else given.stamp_ns
    columns = {name: value for name, value in given.items() if isinstance(value, _np.ndarray) and name != "isometry"}
    head = {name: value for name, value in given.items() if name not in columns and value is not None}
    return int(stamp_ns), head, columns


class Graph:
    """A graph file: `Graph("fibula.toml").run(set={...}, inputs={"scan": array})`."""

    def __init__(self, path: Union[str, "_os.PathLike[str]"], *, plugins: Sequence[Union[str, "_os.PathLike[str]"]] = ()) -> None:
        self.path = _os.fspath(path)
        self.plugins = _files(plugins)

    def _checked(self, set: Any, out: Any = None, force: bool = False, record: bool = True, workers: Optional[int] = None, cache: bool = True) -> Any:
        return _core.Graph(self.path, set, self.plugins, out, force, record, workers, cache)

    def check(self, set: Union[Mapping[str, Any], Sequence[str], None] = None) -> list[str]:
        """Check the graph: the warnings. Raises UsageError with every fault at its line."""
        return self._checked(set).warnings()

    def wires(self, set: Union[Mapping[str, Any], Sequence[str], None] = None) -> dict[str, Optional[str]]:
        """Every wire with its payload, such as "geometry/Cloud"; None if it carries any."""
        return {name: about[0] for name, about in self._checked(set).wires().items()}

    def run(
        self,
        set: Union[Mapping[str, Any], Sequence[str], None] = None,
        inputs: Optional[Mapping[str, Any]] = None,
        *,
        nodes: Optional[Mapping[str, Callable[..., Any]]] = None,
        wires: Union[None, str, Sequence[str]] = "all",
        out: Union[str, "_os.PathLike[str]", None] = None,
        force: bool = False,
        record: bool = True,
        workers: Optional[int] = None,
        cache: bool = True,
        progress: bool = True,
    ) -> GraphRun:
        """Run the graph: `osteoflow run` with its defaults.

        set : changes of the graph, {"icp.kind": "icp.point_to_point", "graph.seed": 7}.
        inputs : by wire ("scan.cloud", or "scan" if the node has one output of that payload), what replaces the node's output: a `Cloud`, a
            `Mesh`, an (n, 3) array in mm, a (4, 4) array (a pose), a dict (a report, or the fields and columns of another payload), or a
            list of such, one item each. The node is not built, but its parameters are checked. Outputs of it that are not given
            carry no value, where no node needs one. A run with inputs writes no recording.
        nodes : by node, a function that is called in its place, in this process: its typed parameters are inputs of the node, what
            it returns is an output, as of a node in Python (`from osteoflow.nodes import Cloud, Pose, Surface`). Such a run cannot
            be repeated, and its results, manifest and recording say so.
        wires : the wires to keep in memory: "all", some names, or None.
        out : folder for results.json, manifest.json and, with record, run.mcap. Default: no files are written.

        Raises Refused if there are no results, with the reason; UsageError with all faults of the graph; KeyboardInterrupt.
        """
        graph = self._checked(set, out, force, record, workers, cache)
        _warn(graph.warnings())
        known = graph.wires()
        given = {}
        for name, value in (inputs or {}).items():
            wire = self._wire(graph, known, name, value)
            given[wire] = self._items(wire, known[wire], value)
        keep = None if wires == "all" else {graph.wire(name) for name in ([wires] if isinstance(wires, str) else wires or ())}
        functions = {}
        if nodes:
            from .nodes import Function

            functions = {node: Function(function, node, graph.ports(node)) for node, function in nodes.items()}
        by_node = {node: (function, function.without) for node, function in functions.items()}
        run = GraphRun(graph.run(given, by_node, keep, progress))
        _warn(run.warnings)
        return run

    @staticmethod
    def _wire(graph: Any, known: Mapping[str, tuple], name: str, value: Any) -> str:
        """The wire of this name, or the one of this node that carries what `value` is."""
        first = value[0] if isinstance(value, (list, tuple)) and value and not _np.isscalar(value[0]) else value
        if isinstance(first, Mapping):
            return graph.wire(name)
        is_pose = not isinstance(first, (Mesh, Cloud)) and _np.shape(first) == (4, 4)
        payload = "geometry/Mesh" if isinstance(first, Mesh) else "geometry/Pose" if is_pose else "geometry/Cloud"
        of_node = {wire: about[0] or "" for wire, about in known.items() if wire.rpartition(".")[0] == name}
        fitting = [wire for wire, carried in of_node.items() if carried == payload]
        # Reports are not what an array stands for.
        others = [wire for wire, carried in of_node.items() if not carried.startswith("report/")]
        chosen = fitting or others
        return chosen[0] if len(chosen) == 1 else graph.wire(name)

    @staticmethod
    def _items(wire: str, about: tuple, value: Any) -> tuple:
        """The payload's name, and the items."""
        payload, frame, to, source = about
        many = value if isinstance(value, (list, tuple)) and not _np.isscalar(value) else [value]
        items, names = [], []
        for one in many:
            if isinstance(one, Mapping):
                if payload is None:
                    raise UsageError(f"wire \"{wire}\" carries any payload, so a dict does not say which")
                names.append(payload)
                items.append(_mapping_item(one, payload))
                continue
            if isinstance(one, _np.ndarray) and one.shape == (4, 4) and payload == "geometry/Pose":
                names.append("geometry/Pose")
                items.append(_pose_item(one, (to, source), wire, 0))
                continue
            shape = one if isinstance(one, (Cloud, Mesh)) else Cloud(one)
            in_frame = frame if shape.frame in (None, "file") else shape.frame
            if in_frame is None:
                raise UsageError(f"the frame of wire \"{wire}\" is not known from the graph; give Cloud(points, frame=\"camera\")")
            names.append("geometry/Mesh" if isinstance(shape, Mesh) else "geometry/Cloud")
            items.append(shape._item(in_frame))
        if len({*names}) > 1:
            raise UsageError(f"wire \"{wire}\" carries one payload, but {' and '.join(sorted({*names}))} were given")
        return (names[0] if names else payload or ""), items


def simulate(
    out: Union[str, "_os.PathLike[str]"],
    *,
    seed: int = 42,
    points: int = 20_000,
    bone: Union[str, "_os.PathLike[str]", None] = None,
    plan: Union[str, "_os.PathLike[str]", None] = None,
    set: Union[Mapping[str, Any], Sequence[str], None] = None,
    shape: str = "mcap",
    force: bool = False,
) -> _Path:
    """Write a simulated procedure into the folder `out`, and return it: `osteoflow simulate`.

    seed : of all that is random. points : of each cloud. bone, plan : your own bone (a closed surface, mm) and its plan.
    shape : "mcap" (one recording) or "folder" (plain files). truth.json in the folder holds the ground truth, mm.
    """
    _warn(_core.simulate(out, seed, points, bone, plan, set, shape, force))
    return _Path(out)


def _table(file: _Path, table: str) -> Any:
    """A CSV as a DataFrame if pandas is there, else as a list of dicts with numbers where they are such."""
    if table != "dicts":
        try:
            import pandas
        except ImportError:
            if table == "pandas":
                raise
        else:
            return pandas.read_csv(file)

    def value(text: str) -> Any:
        for number in (int, float):
            try:
                return number(text)
            except ValueError:
                pass
        return {"true": True, "false": False, "": None}.get(text, text)

    with open(file, newline="", encoding="utf-8") as lines:
        return [{key: value(text) for key, text in row.items()} for row in _csv.DictReader(lines)]


def sweep(
    path: Union[str, "_os.PathLike[str]"],
    set: Union[Mapping[str, Any], Sequence[str], None] = None,
    *,
    out: Union[str, "_os.PathLike[str]", None] = None,
    resume: bool = False,
    retry_failed: bool = False,
    workers: Optional[int] = None,
    share: bool = True,
    cache: bool = True,
    plugins: Sequence[Union[str, "_os.PathLike[str]"]] = (),
    table: Optional[str] = None,
    executor: Any = None,
    tasks: Optional[int] = None,
    progress: bool = True,
) -> Any:
    """Run a graph many times as its table [sweep] says, and return the table runs.csv: `osteoflow sweep`.

    Returns a pandas DataFrame if pandas is there, else a list of dicts, a row for each run; a run that fails is a row with
    its reason. table="pandas" or "dicts" asks for one of them.

    set : changes of the graph in all runs, also of the sweep: {"sweep.repeat": 20}.
    out : folder to write into (runs.csv, points.csv, summary.json, ...). Default: a temporary one, which is removed.
    resume : go on with the sweep in `out`; set={"sweep.repeat": 20} may ask for more repeats.
    retry_failed : with resume, run those again that failed.
    executor : a `concurrent.futures.Executor` whose workers have this package and the files of the graph under the same
        paths, such as of Dask (docs/use/clusters.md). The tables are byte for byte those of one machine. A task whose worker is lost
        is submitted at most three times.
    tasks : number of tasks for the executor, of adjacent runs each. Default: one for each run.
    """
    graph = _os.fspath(path)
    if tasks is not None and executor is None:
        raise UsageError("tasks is for an executor; give one, or leave it out")
    with _tempfile.TemporaryDirectory(prefix="osteoflow-sweep-") as temporary:
        folder = _Path(temporary, "sweep") if out is None else _Path(out)

        def request(out: _Path) -> Any:
            return _core.Sweep(graph, set, _files(plugins), out, resume, retry_failed, workers, share, cache)

        if executor is None:
            request(folder).run(progress)
        else:
            from ._executor import sweep_on

            if resume:
                raise UsageError("a sweep on an executor is not resumed; leave out resume, or the executor")
            words = [*_sets(set), *(f"--plugin={file}" for file in _files(plugins)), *_options(no_share=not share, no_cache=not cache)]
            _warn(sweep_on(executor, request, graph, words, folder, _Path(temporary), tasks, progress))
        return _table(folder / "runs.csv", table or "")
