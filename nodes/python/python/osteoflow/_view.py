"""The page of `osteoflow view` in a notebook."""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import tempfile
import threading
import weakref
from pathlib import Path
from typing import Any, Mapping, Optional, Sequence, Union

from . import _core
from ._core import OsteoflowError, UsageError
from ._study import Row

Settings = Union[Mapping[str, Any], Sequence[str], Row, None]

#: How long the page may take to be served, s: it is, before anything is run.
_PATIENCE_S = 60.0
#: The command whose page is shown.
_COMMAND = [sys.executable, "-m", "osteoflow"]
_JS = Path(__file__).with_name("_view.js")


class _Server:
    """A command that serves the page; it ends with its widget, or with this process."""

    def __init__(self, words: Sequence[str], keeps: Any) -> None:
        self.keeps = keeps
        self.said: list[str] = []
        self.page = ""
        self.found = threading.Event()
        command = [*_COMMAND, "view", *words]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, encoding="utf-8")
        threading.Thread(target=self._read, daemon=True).start()
        self._end = weakref.finalize(self, _Server._stop, self.process)
        atexit.register(self._end)

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.append(line.rstrip())
            if line.startswith("page: "):
                self.page = line.split()[1]
                self.found.set()
        self.found.set()

    def address(self) -> str:
        """Where the page is. Raises OsteoflowError with what the command said, if it serves none."""
        if not self.found.wait(_PATIENCE_S):
            raise OsteoflowError(f"the page was not served within {_PATIENCE_S:.0f} s: {' '.join(self.said)}")
        if not self.page:
            raise OsteoflowError("\n".join(self.said) or "the command ended without a word")
        return self.page

    def close(self) -> None:
        self._end()

    @staticmethod
    def _stop(process: "subprocess.Popen[str]") -> None:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


def _file(what: Any, name: str, folder: Path) -> str:
    """A path as it is; what is in memory as a file in the folder."""
    if isinstance(what, (str, os.PathLike)):
        return os.fspath(what)
    from . import write
    from ._types import Mesh

    path = folder / f"{name}{'.stl' if isinstance(what, Mesh) else '.ply'}"
    if isinstance(what, Mesh):
        write(path, what)
    else:
        write(path, what, double=True)
    return os.fspath(path)


def _widget_class() -> Any:
    try:
        import anywidget
        import traitlets
    except ImportError as error:
        raise UsageError("osteoflow.view needs anywidget: pip install anywidget; without a notebook, run `osteoflow view`") from error

    class View(anywidget.AnyWidget):
        """The page in a notebook; `close()` ends what it shows."""

        _esm = _JS
        address = traitlets.Unicode("").tag(sync=True)
        problem = traitlets.Unicode("").tag(sync=True)
        height = traitlets.Int(640).tag(sync=True)

        def __init__(self, words: Sequence[str], keeps: Any, height: int) -> None:
            super().__init__(height=height)
            self._words, self._keeps = list(words), keeps
            self._server: Optional[_Server] = None
            self.on_msg(self._take)

        def _take(self, _: Any, content: Any, __: Any) -> None:
            """The notebook has said its own address."""
            if self._server is None and isinstance(content, dict) and "origin" in content:
                self._server = _Server([*self._words, f"--allow-origin={content['origin']}"], self._keeps)
                try:
                    self.address = self._server.address()
                except OsteoflowError as error:
                    self.problem = str(error)

        def close(self) -> None:
            if self._server is not None:
                self._server.close()
            super().close()

    return View


def _registered(fit: Any, folder: Path) -> tuple[list[str], list[str]]:
    """The files of a registration, and the settings of the graph of two files that give it again, from the same start."""
    if not fit._given:
        raise UsageError("this registration does not know its files; view one that osteoflow.register has returned")
    target, source, landmarks = fit._given
    files = [_file(target, "bone", folder), _file(source, "scan", folder)]
    # The page writes for other programs, which a registration in memory does not.
    sets = [text.replace('"node.export", ', "").replace('"node.export"', "") for text in fit.report["settings"]]
    start = fit.report["start"]["by"]
    if start == "shape":
        return files, sets
    if start == "landmarks":
        points = [os.path.abspath(os.fspath(file)) for file in landmarks]
    else:
        # A start without points: that which takes four points onto four others.
        points = [os.fspath(folder / f"{name}_points.csv") for name in ("bone", "scan")]
        in_scan = [[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 100.0]]
        rows = fit.report["init"]["matrix"][:3]
        in_bone = [[sum(row[k] * point[k] for k in range(3)) + row[3] for row in rows] for point in in_scan]
        for file, places in zip(points, (in_bone, in_scan)):
            lines = [f"S{k},{x!r},{y!r},{z!r}" for k, (x, y, z) in enumerate(places)]
            Path(file).write_text("\n".join(["label,x,y,z", *lines]) + "\n", encoding="utf-8")
        nodes = {"bone_points": "ct", "scan_points": "camera"}
        for node, frame in nodes.items():
            sets += [f"node.{node}.kind=acquire.points", f"node.{node}.frame={frame}"]
        sets += ["coarse.kind=coarse.three_point", "coarse.in.target=bone_points.points", 'coarse.in.source={from="scan_points.points",n=1}']
    return files, [*sets, *_core.setting_texts(dict(zip(("bone_points.path", "scan_points.path"), points)))]


def view(
    what: Any,
    scan: Any = None,
    *,
    set: Settings = None,
    out: Union[str, "os.PathLike[str]", None] = None,
    picks: Union[str, "os.PathLike[str]"] = "picks",
    address: str = "127.0.0.1:0",
    height: int = 640,
) -> Any:
    """Show the page of `osteoflow view` in a notebook: a registration, a run, a recording, or a graph that is changed there.

    what : a graph file, the folder of a run, a recording, a `GraphRun` with a folder, or what `register` has returned, which is registered
        again from the same start with the same settings; with `scan` the bone: a file, a `Mesh`, or points.
    scan : a file, a `Cloud` or an (n, 3) array, mm: it is registered by the shape of the bone alone, as `register` does.
    set : changes of the graph, {"icp.kind": "icp.point_to_point"}; or a `Row` of a study, whose run is then shown: an outlier.
    out : folder for the runs of a graph, or of a registration. Default: runs/GRAPH-TIME.
    picks : folder for what is picked and drawn on the page.
    address : HOST:PORT to serve at. The browser must reach it: where the kernel is on another machine, forward a fixed port by
        `ssh -L 8766:127.0.0.1:8766 MACHINE` and give "127.0.0.1:8766".
    height : of the page in the notebook, pixels.

    Returns a widget, needs anywidget. It ends with the kernel, or by its `close()`. Raises UsageError for options that do not fit.
    """
    keeps = tempfile.TemporaryDirectory(prefix="osteoflow-view-")
    folder = Path(keeps.name)
    from . import Registration

    if isinstance(what, Registration):
        if scan is not None:
            raise UsageError("a registration has its scan; give it alone, or the bone and a scan")
        words, settings = _registered(what, folder)
        words += [f"--set={setting}" for setting in settings]
        if out is None:
            out = folder / "run"
    else:
        given = getattr(what, "out_dir", what)
        if given is None:
            raise UsageError("this run wrote no files; run it with out=DIR, or give the graph")
        words = [_file(given, "bone", folder)]
    if scan is not None:
        words.append(_file(scan, "scan", folder))
        # Runs of what is in memory are not left behind.
        if out is None and not (isinstance(what, (str, os.PathLike)) and isinstance(scan, (str, os.PathLike))):
            out = folder / "run"
    if isinstance(set, Row):
        # The run of a row: its keys and its seed; which repeat it was is no key of the graph.
        set = {**{key: value for key, value in set.settings.items() if "." in key}, "graph.seed": set.seed}
    words += [f"--set={setting}" for setting in _core.setting_texts(set)]
    if out is not None:
        words.append(f"--out={os.fspath(out)}")
    words += [f"--picks={os.fspath(picks)}", f"--address={address}"]
    return _widget_class()(words, keeps, height)
