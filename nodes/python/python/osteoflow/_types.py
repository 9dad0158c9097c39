"""Clouds, surfaces and wires as numpy arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Optional

import numpy as np

from . import _core


def _numbers(values: Any, what: str) -> np.ndarray:
    """A C-contiguous float64 array; the given one where it is such."""
    given = np.asanyarray(values)
    if np.ma.is_masked(given):
        raise ValueError(f"{what} has {np.ma.count_masked(given)} masked values, which would become numbers; leave their rows out")
    if given.dtype.kind not in "biufO":
        raise ValueError(f"{what} holds {given.dtype}, but must be real numbers")
    return np.ascontiguousarray(given, dtype=np.float64)


def _rows(values: Any, what: str, width: int = 3) -> np.ndarray:
    """An (n, width) float64 array, C-contiguous; the given one where it is such."""
    array = _numbers(values, what)
    if array.ndim != 2 or array.shape[1] != width:
        raise ValueError(f"{what} has shape {array.shape}, but must be (n, {width})")
    return array


@dataclass
class Cloud:
    """Points of a surface.

    points : (n, 3) float64, mm. Kept as it is if C-contiguous float64, else copied once. Do not write to it while a function
        of this package reads it.
    normals : (n, 3) float64 of length 1, or None.
    extras : further columns by name, each (n,).
    frame : name of the frame of the coordinates; needed for inputs of graphs only.
    stamp_ns : time of the scan, ns.
    viewpoint : (7,), the sensor's pose in `frame` (translation in mm, quaternion), or None; inputs of graphs only.
    space : "LPS" where the numbers are known to be LPS, else None.
    notes : what a reader found suspicious, one sentence each.
    """

    points: np.ndarray
    normals: Optional[np.ndarray] = None
    extras: dict[str, np.ndarray] = field(default_factory=dict)
    frame: Optional[str] = None
    stamp_ns: int = 0
    label: Optional[str] = None
    viewpoint: Optional[np.ndarray] = None
    space: Optional[str] = None
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.points = _rows(self.points, "points")
        if self.normals is not None:
            self.normals = _rows(self.normals, "normals")
        self.extras = {name: _numbers(v, name) for name, v in self.extras.items()}

    def __len__(self) -> int:
        return len(self.points)

    def __array__(self, dtype: Any = None, copy: Optional[bool] = None) -> np.ndarray:
        return self.points if dtype is None else self.points.astype(dtype)

    def _shape(self) -> tuple:
        return self.points, self.normals, self.extras, self.space or ""

    def _item(self, frame: Optional[str]) -> tuple:
        head: dict[str, Any] = {"frame": frame, "stamp_ns": int(self.stamp_ns)}
        if self.label is not None:
            head["label"] = self.label
        if self.viewpoint is not None:
            head["viewpoint"] = [float(v) for v in self.viewpoint]
        columns = {"points": self.points}
        if self.normals is not None:
            columns["normals"] = self.normals
        columns.update({f"extra/{name}": values for name, values in self.extras.items()})
        return int(self.stamp_ns), head, columns


@dataclass
class Mesh:
    """A surface of triangles.

    vertices : (n, 3) float64, mm.
    faces : (m, 3) uint32, indices of the corners of triangles, outside seen counter-clockwise.
    frame, space, notes : as of `Cloud`.
    """

    vertices: np.ndarray
    faces: np.ndarray
    frame: Optional[str] = None
    space: Optional[str] = None
    notes: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.vertices = _rows(self.vertices, "vertices")
        faces = np.asarray(self.faces)
        if faces.size and (faces.min() < 0 or faces.max() > np.iinfo(np.uint32).max):
            raise ValueError("faces must be indices of vertices, from 0")
        self.faces = np.ascontiguousarray(faces, dtype=np.uint32)
        if self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise ValueError(f"faces has shape {self.faces.shape}, but must be (m, 3)")

    def _shape(self) -> tuple:
        return self.vertices, self.faces, self.space or ""

    def _item(self, frame: Optional[str]) -> tuple:
        return 0, {"frame": frame, "origin": "user"}, {"vertices": self.vertices, "faces": self.faces}


class Item(Mapping):
    """One item of a wire: a mapping of the payload's fields and columns, by the names that `osteoflow inspect --payloads` lists.

    number : its number on the wire, from 0.
    stamp_ns : the time at which its content held, ns.
    payload : its type, such as "geometry/Cloud"; "" if it is empty.
    empty : (node, reason) if a node gave no result, else None.
    """

    def __init__(self, raw: tuple) -> None:
        self.number, self.stamp_ns, self.payload, self.empty, head, columns = raw
        self._fields = {**head, **columns}
        self._first = next(iter(columns), None)

    def __getitem__(self, name: str) -> Any:
        if name not in self._fields and self.empty:
            raise KeyError(f"item {self.number} is empty: {self.empty[0]}: {self.empty[1]}")
        return self._fields[name]

    def __iter__(self):
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    @property
    def array(self) -> np.ndarray:
        """Its numbers: (n, 3) mm of a cloud, 4 x 4 of a pose, the vertices of a surface, else its first column.

        Raises ValueError for an empty item, and for a payload without columns.
        """
        if self.empty:
            raise ValueError(f"item {self.number} is empty: {self.empty[0]}: {self.empty[1]}")
        if self.payload == "geometry/Pose":
            return np.array(_core.matrix(self["isometry"].tolist()))
        if self._first is None:
            raise ValueError(f"{self.payload} has no columns; its fields are {', '.join(self._fields)}")
        return self._fields[self._first]

    def __array__(self, dtype: Any = None, copy: Optional[bool] = None) -> np.ndarray:
        return self.array if dtype is None else self.array.astype(dtype)

    def __repr__(self) -> str:
        what = f"empty: {self.empty[1]}" if self.empty else f"{self.payload}: {', '.join(self._fields)}"
        return f"<item {self.number} at {self.stamp_ns} ns, {what}>"


class Wire(Sequence):
    """The items of a wire, in order."""

    def __init__(self, name: str, items: list) -> None:
        self.name = name
        self._items = [Item(item) for item in items]

    def __getitem__(self, index):
        return self._items[index]

    def __len__(self) -> int:
        return len(self._items)

    @property
    def stamps_ns(self) -> np.ndarray:
        """The stamps of all items, (k,) int64, ns."""
        return np.array([item.stamp_ns for item in self._items], dtype=np.int64)

    @property
    def array(self) -> np.ndarray:
        """The array of its one item; of several, their arrays stacked, (k, ...).

        Raises ValueError if there is no item, one is empty, or they differ in shape.
        """
        if len(self._items) == 1:
            return self._items[0].array
        if not self._items:
            raise ValueError(f"wire {self.name} has no items")
        arrays = [item.array for item in self._items]
        if len({array.shape for array in arrays}) != 1:
            raise ValueError(f"the {len(arrays)} items of wire {self.name} differ in shape; take one: wire[0].array")
        return np.stack(arrays)

    def __array__(self, dtype: Any = None, copy: Optional[bool] = None) -> np.ndarray:
        return self.array if dtype is None else self.array.astype(dtype)

    def __repr__(self) -> str:
        return f"<wire {self.name}, {len(self)} items>"


class _Wires(Mapping):
    """Wires by name, each read when it is asked for."""

    _core: Any

    def __getitem__(self, name: str) -> Wire:
        try:
            return Wire(name, self._core.items(name))
        except KeyError:
            raise KeyError(f"there is no wire {name!r}; there are {', '.join(self._core.names())}") from None

    def __iter__(self):
        return iter(self._core.names())

    def __len__(self) -> int:
        return len(self._core.names())


class Recording(_Wires):
    """A recording of a run: a mapping of its wires, `Recording("run.mcap")["to_bone.cloud"]`.

    name, graph, seed, version : of the run, and the text of the graph as it ran.
    results : the content of results.json, or None if the run did not get so far.
    truncated : why a damaged file ends early, or None; everything before that is intact.
    """

    def __init__(self, path: "str | os.PathLike[str]") -> None:
        import json

        self.path = os.fspath(path)
        self._core = _core.Wires.open(self.path)
        about = json.loads(self._core.about())
        self.name: str = about["name"]
        self.graph: str = about["graph"]
        self.seed: int = about["seed"]
        self.version: str = about["version"]
        self.results: Optional[dict] = about["results"]
        self.interrupted: bool = about["interrupted"]
        self.truncated: Optional[str] = about["truncated"]

    def __repr__(self) -> str:
        return f"<recording {self.path}, {len(self)} wires>"
