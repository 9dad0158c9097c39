"""Nodes of Osteoflow in Python.

    from osteoflow_node import Cloud, Pose, Surface, node, param

    @node("my_icp.plain", output="t_target_source")
    def icp(source: Cloud, target: Surface, init: Pose) -> Pose:
        ...

The program hands this module to the interpreter; it needs numpy, and no package of Osteoflow. Lengths are millimetres, angles radians,
times nanoseconds; a pose `t_a_b` takes coordinates in `b` to coordinates in `a`. Columns are numpy arrays on memory that the program
shares: read-only, and valid as long as somebody holds them. docs/extend/python-nodes.md describes everything.
"""

import array
import base64
import csv
import dataclasses
import hashlib
import importlib.machinery
import importlib.util
import inspect
import json
import logging
import mmap
import os
import platform
import shutil
import site
import socket
import struct
import sys
import sysconfig
import threading
import time
import traceback
import types
import typing
import weakref



def cannot_import(package, error):
    """What to do where a package is missing."""
    return (f"the interpreter {sys.executable} ({sys.version.split()[0]}) cannot import {package}: {error}; install it there, "
            f"{sys.executable} -m pip install {NAMES_OF_PACKAGES.get(package, package)}, or name another interpreter: --python FILE, "
            "OSTEOFLOW_PYTHON, or plugins = [{ file = \"..\", interpreter = \"..\" }] in the graph")


# Packages that pip calls otherwise.
NAMES_OF_PACKAGES = {"cv2": "opencv-python", "PIL": "pillow", "skimage": "scikit-image", "sklearn": "scikit-learn", "yaml": "pyyaml"}
try:
    import numpy as np
except ImportError as error:
    WITHOUT_NUMPY = cannot_import("numpy", error)
    if __name__ != "__main__":
        raise ImportError(WITHOUT_NUMPY) from error
    print("\nosteoflow plugin: " + json.dumps({"refused": WITHOUT_NUMPY}))
    sys.exit(0 if sys.argv[1:2] == ["describe"] else WITHOUT_NUMPY)

__all__ = [
    "Axes", "Cloud", "Context", "Flag", "Mesh", "NodeError", "Planes", "Points", "Pose", "Region", "Surface", "Text", "Value",
    "column", "node", "param", "payload", "port", "source",
]

PROTOCOL = 1
"""The version of the protocol; docs/extend/processes.md describes it."""

DTYPES = {"f64": np.dtype("<f8"), "f32": np.dtype("<f4"), "i64": np.dtype("<i8"), "u32": np.dtype("<u4"), "u8": np.dtype("u1")}
CODES = {1: "f64", 2: "f32", 3: "i64", 4: "u32", 5: "u8"}


class NodeError(Exception):
    """Why a node gives no result: lower case, no full stop. Shown as it is, without the place in the file."""


# ── payloads ─────────────────────────────────────────────────────────────────────────────────────────────────────────────


class Value:
    """A payload of any type: head fields and columns by name."""

    payload = None

    def __init__(self, head, columns, payload=None):
        self.head, self.columns = head, columns
        if payload is not None:
            self.payload = payload

    def __repr__(self):
        columns = ", ".join(f"{name} {array.shape}" for name, array in self.columns.items())
        return f"{type(self).__name__}({self.head}, {columns})"

    @classmethod
    def _of(cls, head, columns, payload):
        if cls is Value:
            return Value(head, columns, payload)
        self = cls.__new__(cls)
        Value.__init__(self, head, columns, payload)
        return self


def _field(name, doc):
    return property(lambda self: self.head.get(name), doc=doc)


def _column(name, doc):
    return property(lambda self: self.columns.get(name), doc=doc)


NO_NUMBERS = {"c": "complex numbers", "U": "texts", "S": "bytes", "M": "dates", "m": "spans of time", "V": "records"}


def _rows(name, values, width, dtype=np.float64):
    values = np.asanyarray(values)
    if np.ma.is_masked(values):
        raise NodeError(f"{name} has {np.ma.count_masked(values)} masked values, which would become numbers; leave their rows out, or fill them")
    if values.dtype.kind in NO_NUMBERS:
        raise NodeError(f"{name} holds {NO_NUMBERS[values.dtype.kind]} ({values.dtype}); give real numbers")
    values = np.ascontiguousarray(values, dtype=dtype)
    if width == 1 and values.ndim == 1:
        return values
    if values.ndim != 2 or values.shape[1] != width:
        raise NodeError(f"{name} must have shape (n, {width}), found {values.shape}")
    return values


class Cloud(Value):
    """Points in mm, (n, 3), with normals of length 1 and further columns where they are known."""

    payload = ("geometry/Cloud", 1)
    frame = _field("frame", "the frame of the coordinates")
    stamp_ns = _field("stamp_ns", "when it was measured")
    label = _field("label", "its label, or None")
    viewpoint = _field("viewpoint", "the sensor's pose: x, y, z and the quaternion x, y, z, w; or None")
    points = _column("points", "(n, 3), mm")
    normals = _column("normals", "(n, 3), of length 1, or None")

    def __init__(self, frame, points, normals=None, stamp_ns=0, label=None, viewpoint=None, extras=None):
        head = {"frame": frame, "stamp_ns": int(stamp_ns), "label": label, "viewpoint": viewpoint}
        columns = {"points": _rows("points", points, 3)}
        if normals is not None:
            columns["normals"] = _rows("normals", normals, 3)
        for name, values in (extras or {}).items():
            columns[f"extra/{name}"] = _rows(name, values, 1)
        super().__init__(head, columns)

    @property
    def extras(self):
        """Further columns by name, (n,)."""
        return {name[6:]: values for name, values in self.columns.items() if name.startswith("extra/")}

    def __len__(self):
        return len(self.points)

    def chosen(self, which):
        """The points for which `which` (a mask or indices) holds, with all their columns."""
        return Cloud._of(dict(self.head), {name: values[which] for name, values in self.columns.items()}, self.payload)


class Mesh(Value):
    """Triangles: vertices in mm, (n, 3), and the indices of corners, (m, 3)."""

    payload = ("geometry/Mesh", 1)
    frame = _field("frame", "the frame of the coordinates")
    vertices = _column("vertices", "(n, 3), mm")
    faces = _column("faces", "(m, 3), indices of vertices")

    def __init__(self, frame, vertices, faces, origin="user"):
        columns = {"vertices": _rows("vertices", vertices, 3), "faces": _rows("faces", faces, 3, np.uint32)}
        super().__init__({"frame": frame, "origin": origin}, columns)


class Surface(Value):
    """What scans are registered onto: points of the CT surface with normals, and its triangles where it has them."""

    payload = ("algorithms/Target", 1)
    frame = _field("frame", "the frame of the coordinates")
    points = _column("points", "(n, 3), mm")
    normals = _column("normals", "(n, 3), of length 1, or None")
    vertices = _column("mesh/vertices", "(k, 3), mm, or None")
    faces = _column("mesh/faces", "(m, 3), indices of vertices, or None")

    def __init__(self, frame, points, normals=None, origin="user"):
        columns = {"points": _rows("points", points, 3)}
        if normals is not None:
            columns["normals"] = _rows("normals", normals, 3)
        super().__init__({"frame": frame, "origin": origin}, columns)


class Pose(Value):
    """A rigid motion: takes coordinates in `from_` to coordinates in `to`."""

    payload = ("geometry/Pose", 1)
    to = _field("to", "the frame of the coordinates that it gives")
    from_ = _field("from", "the frame of the coordinates that it takes")
    stamp_ns = _field("stamp_ns", "when it held")

    def __init__(self, to, from_, matrix, stamp_ns=0):
        matrix = np.asarray(matrix, dtype=np.float64)
        if matrix.shape != (4, 4):
            raise NodeError(f"the matrix of a pose must have shape (4, 4), found {matrix.shape}")
        rotation = matrix[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0.0:
            raise NodeError("the matrix of a pose must turn and move, but it scales, shears or mirrors")
        isometry = [*map(float, matrix[:3, 3]), *_quaternion(rotation)]
        super().__init__({"to": to, "from": from_, "stamp_ns": int(stamp_ns), "isometry": isometry}, {})

    @property
    def matrix(self):
        """(4, 4)."""
        x, y, z, i, j, k, w = self.head["isometry"]
        matrix = np.eye(4)
        matrix[:3, 3] = x, y, z
        matrix[:3, :3] = [
            [w * w + i * i - j * j - k * k, 2 * (i * j - w * k), 2 * (w * j + i * k)],
            [2 * (w * k + i * j), w * w - i * i + j * j - k * k, 2 * (j * k - w * i)],
            [2 * (i * k - w * j), 2 * (w * i + j * k), w * w - i * i - j * j + k * k],
        ]
        return matrix


def _quaternion(rotation):
    """The unit quaternion x, y, z, w of a rotation matrix (Shepperd 1978: by the largest of the four)."""
    m = rotation
    squares = np.array([1 + m[0, 0] - m[1, 1] - m[2, 2], 1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2],
                        1 + m[0, 0] + m[1, 1] + m[2, 2]])
    largest = int(np.argmax(squares))
    d = squares[largest]
    q = [
        [d, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
        [m[0, 1] + m[1, 0], d, m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
        [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], d, m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], d],
    ][largest]
    q = np.array(q, dtype=np.float64)
    return [float(c) for c in q / np.linalg.norm(q)]


class Points(Value):
    """Named points in mm, such as landmarks."""

    payload = ("geometry/Points", 1)
    frame = _field("frame", "the frame of the coordinates")
    positions = _column("positions", "(n, 3), mm")
    stamps_ns = _column("stamps_ns", "(n,)")
    confidences = _column("confidences", "(n,), NaN for none")

    def __init__(self, frame, names, positions, stamp_ns=0, confidences=None):
        names, positions = list(names), _rows("positions", positions, 3)
        if len(names) != len(positions):
            raise NodeError(f"{len(names)} names for {len(positions)} points")
        if confidences is None:
            confidences = np.full(len(names), np.nan)
        columns = {"positions": positions, "stamps_ns": np.full(len(names), int(stamp_ns), dtype=np.int64),
                   "confidences": _rows("confidences", confidences, 1)}
        super().__init__({"frame": frame, "stamp_ns": int(stamp_ns), "names": "\n".join(names)}, columns)

    @property
    def names(self):
        """Their names, in order."""
        return self.head["names"].split("\n") if len(self.positions) else []


class Planes(Value):
    """Cutting planes: poses `t_frame_plane`, whose z axis is the normal."""

    payload = ("geometry/Planes", 1)
    frame = _field("frame", "the frame of the coordinates")
    isometries = _column("isometries", "(n, 7): x, y, z and the quaternion x, y, z, w; NaN where the place is unknown")

    @property
    def names(self):
        """Their names, in order."""
        return self.head["names"].split("\n") if len(self.isometries) else []


class Region(Value):
    """A box with the axes of its frame, mm."""

    payload = ("geometry/Region", 1)
    frame = _field("frame", "the frame of the coordinates")
    min = _field("min", "its lowest corner")
    max = _field("max", "its highest corner")


class Axes(Value):
    """Anatomical axes along which errors are resolved."""

    payload = ("geometry/Axes", 1)
    frame = _field("frame", "the frame of the coordinates")


class Flag(Value):
    """Yes or no."""

    payload = ("report/Flag", 1)

    def __init__(self, value):
        super().__init__({"flag": bool(value)}, {})

    value = _field("flag", "whether")


class Text(Value):
    """A text."""

    payload = ("report/Text", 1)

    def __init__(self, value):
        super().__init__({"text": str(value)}, {})

    value = _field("text", "the text")


BUILT_IN = [Axes, Cloud, Flag, Mesh, Planes, Points, Pose, Region, Surface, Text]

# ── payloads of one's own ────────────────────────────────────────────────────────────────────────────────────────────────

FIELDS = {bool: "bool", int: "int", float: "float", str: "text", "list[float]": "floats"}


def column(kind="f64", width=1, unit="", doc=""):
    """A column of one's own payload: rows of `width` values of `kind` (f64, f32, i64, u32, u8)."""
    return dataclasses.field(default=None, metadata={"column": kind, "width": width, "unit": unit, "doc": doc})


def payload(name, version=1):
    """Makes a dataclass a payload type: `@payload("mine/Report")`. Fields are bool, int, float, str, list[float] (any may be
    Optional) and `column(...)`. Raise the version with each change."""

    def decorate(cls):
        cls = dataclasses.dataclass(cls)
        hints = typing.get_type_hints(cls)
        fields, columns = [], []
        for field in dataclasses.fields(cls):
            about, (kind, optional) = field.metadata, _optional(hints[field.name])
            entry = {"name": field.name}
            if "column" in about:
                entry.update(column=about["column"], width=about["width"])
                columns.append(entry)
            else:
                key = "list[float]" if kind == list[float] else kind
                if key not in FIELDS:
                    raise TypeError(f"{cls.__name__}.{field.name}: a payload has fields of bool, int, float, str, list[float], "
                                    f"and columns by column(..), found {kind}")
                entry["field"] = FIELDS[key]
                fields.append(entry)
            entry.update({key: about[key] for key in ("unit", "doc") if about.get(key)})
            if optional:
                entry["optional"] = True
        cls.payload, cls._schema = (name, version), fields + columns
        cls._of = classmethod(lambda cls, head, columns, _: cls(**{
            entry["name"]: (head if "field" in entry else columns).get(entry["name"]) for entry in cls._schema}))
        cls.head = property(lambda self: {entry["name"]: getattr(self, entry["name"]) for entry in fields})
        cls.columns = property(lambda self: {
            entry["name"]: _rows(entry["name"], getattr(self, entry["name"]), entry["width"], DTYPES[entry["column"]])
            for entry in columns if getattr(self, entry["name"]) is not None})
        return cls

    return decorate


def _optional(hint):
    """The type within `Optional[..]`, and whether it was one."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        inner = [part for part in typing.get_args(hint) if part is not type(None)]
        if len(inner) == 1 and len(inner) < len(typing.get_args(hint)):
            return inner[0], True
    return hint, False


# ── kinds ────────────────────────────────────────────────────────────────────────────────────────────────────────────────

KINDS = []


def param(default=dataclasses.MISSING, *, doc="", ge=None, gt=None, le=None, lt=None, choices=None, path=False):
    """A parameter: its default, what it means, and the values that it takes. Lengths end in _mm, times in _s, angles in _deg or
    _rad. `path`: it names a file, relative to the graph, which is hashed with the run."""
    about = {"description": doc, "minimum": ge, "exclusiveMinimum": gt, "maximum": le, "exclusiveMaximum": lt, "enum": choices,
             "format": "input-path" if path else None}
    about = {key: value for key, value in about.items() if value not in (None, "")}
    if isinstance(default, (list, dict)):
        return dataclasses.field(default_factory=lambda: type(default)(default), metadata=about)
    return dataclasses.field(default=default, metadata=about)


@dataclasses.dataclass(frozen=True)
class port:
    """What is known of a port beside its type: `Annotated[Pose, port(to="target", from_="source")]`. A frame is the name of an
    input, whose frame is meant, `@name`, a frame, or `$parameter`, the frame that it names."""

    doc: str = ""
    join: str = ""
    frame: str | None = None
    to: str | None = None
    from_: str | None = None
    n: int | None = None


def node(kind, *, output=None, example="", literature=(), unsteady=False):
    """Makes a function or class a node: its typed parameters are the ports, by their names. `output` names the output, where it is
    one; several are a NamedTuple or dataclass of payloads as the return type. A class takes its parameters in `__init__`, and
    fires by `process`. `unsteady` says that it may answer otherwise though inputs, parameters and seed are the same."""
    return _kind(kind, "node", output, example, literature, unsteady)


def source(kind, *, output=None, example="", literature=(), unsteady=False, live=False, max_delay_ms=0.0, silent_after_s=None):
    """Makes a generator function a source: it yields `(stamp_ns, payload)`. `live`: a device decides when and what; it stamps by
    `ctx.clock_ns()`, waits by `ctx.wait(..)` and ends when that says so. An output of several that is None then stays silent.
    `max_delay_ms`: by how much the stamp of an item may lie before that of an earlier one on another output. `silent_after_s`:
    after how long without an item the user is told."""
    if not live and (max_delay_ms or silent_after_s is not None):
        raise TypeError(f"{kind}: max_delay_ms and silent_after_s are of a live source; add live=True")
    if not 0.0 <= max_delay_ms < 1e9 or silent_after_s is not None and not 0.0 < silent_after_s < 1e6:
        raise TypeError(f"{kind}: max_delay_ms must be 0 or more, silent_after_s above 0, found {max_delay_ms}, {silent_after_s}")
    times = {"max_delay_ns": round(max_delay_ms * 1e6)}
    if silent_after_s is not None:
        times["silent_after_ns"] = round(silent_after_s * 1e9)
    return _kind(kind, "source", output, example, literature, unsteady, times if live else None)


def _kind(kind, role, output, example, literature, unsteady, live=None):
    def decorate(made):
        KINDS.append(Kind(made, kind, role, output, example, list(literature), unsteady, live))
        return made

    return decorate


class Kind:
    """A kind of node, as its function or class describes it."""

    def __init__(self, made, kind, role, output, example, literature, unsteady, live=None):
        self.live = live
        self.made, self.kind, self.role, self.example, self.literature = made, kind, role, example, literature
        self.unsteady = unsteady
        self.is_class = inspect.isclass(made)
        fires = made.process if self.is_class and role == "node" else made.items if self.is_class else made
        hints = typing.get_type_hints(fires, include_extras=True)
        self.params = None
        if self.is_class:
            given = typing.get_type_hints(made.__init__) if made.__init__ is not object.__init__ else {}
            self.params = given.get("params")
        self.inputs, self.arguments = [], []
        for name in inspect.signature(fires).parameters:
            if name == "self":
                continue
            if name == "ctx":
                self.arguments.append(("ctx", None))
            elif name == "params" and not self.is_class:
                self.params = hints.get("params")
                self.arguments.append(("params", None))
            else:
                if role == "source":
                    raise TypeError(f"{kind}: a source takes params and ctx alone, found \"{name}\"")
                self.arguments.append(("port", len(self.inputs)))
                self.inputs.append(Port.of(kind, name, hints))
        if self.params is not None and not dataclasses.is_dataclass(self.params):
            raise TypeError(f"{kind}: params must be a dataclass, found {self.params}")
        self.outputs, self.tuple = self._outputs(hints.get("return"), output)
        self.fires = fires

    def place(self):
        """The file and line of the function, of its `return` if there is but one of something else than what is expected."""
        code = self.fires.__code__
        try:
            text = inspect.getsource(self.fires)
        except OSError:
            text = ""
        lines = [line for line, text in enumerate(text.splitlines(), code.co_firstlineno)
                 if text.split()[:1] == ["return"] and f"return {self.tuple.__name__}(" not in text]
        return f"{os.path.basename(code.co_filename)}:{lines[0] if len(lines) == 1 else code.co_firstlineno}: "

    def _outputs(self, given, output):
        if given in (None, type(None)):
            if self.role == "source":
                raise TypeError(f"{self.kind}: a source says what it yields: -> Cloud")
            return [], None
        inner, _ = _unannotated(given)
        if typing.get_origin(inner) is not None and self.role == "source":
            raise TypeError(f"{self.kind}: a source says what it yields: -> Cloud")
        names = getattr(inner, "_fields", None)
        if names is None and dataclasses.is_dataclass(inner) and not hasattr(inner, "payload"):
            names = [field.name for field in dataclasses.fields(inner)]
        if names is None:
            name = output or _unannotated(given)[0].__name__.lower()
            return [Port.of(self.kind, name, {name: given})], None
        hints = typing.get_type_hints(inner, include_extras=True)
        return [Port.of(self.kind, name, hints) for name in names], inner

    def described(self):
        """Its entry in the description of the plugin."""
        doc = inspect.getdoc(self.made) or f"{self.kind}, without a description."
        outputs = {"Fixed": [output.described() for output in self.outputs]}
        return {
            "kind": self.kind, "doc": doc, "params": self.schema(), "example": self.example, "literature": self.literature,
            "role": "live_source" if self.live else self.role, "constant": False, "unsteady": self.unsteady, "kept": "no", "outputs": outputs,
            "inputs": [dict(port=p.described(), join=p.join, optional=p.optional, unused=False) for p in self.inputs],
        }

    def schema(self):
        """The JSON Schema of its parameters."""
        schema = {"type": "object", "additionalProperties": False, "properties": {}}
        if self.params is None:
            return schema
        hints, required = typing.get_type_hints(self.params), []
        for field in dataclasses.fields(self.params):
            entry = {**_schema_of(f"{self.kind}: params.{field.name}", hints[field.name]), **field.metadata}
            if field.default is not dataclasses.MISSING:
                entry["default"] = field.default
            elif field.default_factory is not dataclasses.MISSING:
                entry["default"] = field.default_factory()
            else:
                required.append(field.name)
            schema["properties"][field.name] = entry
        return {**schema, "required": required} if required else schema


def _schema_of(what, hint):
    hint, optional = _optional(hint)
    simple = {bool: "boolean", int: "integer", float: "number", str: "string"}
    if hint in simple:
        kind = {"type": [simple[hint], "null"] if optional else simple[hint]}
    elif typing.get_origin(hint) in (list, tuple):
        parts = [part for part in typing.get_args(hint) if part is not Ellipsis]
        kind = {"type": "array", "items": _schema_of(what, parts[0])}
        if typing.get_origin(hint) is tuple and Ellipsis not in typing.get_args(hint):
            kind.update(minItems=len(parts), maxItems=len(parts))
    else:
        raise TypeError(f"{what} must be bool, int, float, str, or a list or tuple of one, found {hint}")
    return kind


def _unannotated(hint):
    """A type, and the `port` that it is annotated with."""
    if typing.get_origin(hint) is typing.Annotated:
        inner, *more = typing.get_args(hint)
        return inner, next((about for about in more if isinstance(about, port)), port())
    return hint, port()


class Port:
    """A port, from its annotation."""

    @classmethod
    def of(cls, kind, name, hints):
        if name not in hints:
            raise TypeError(f"{kind}: port \"{name}\" has no type; write {name}: Cloud, or another payload")
        self = cls()
        hint, about = _unannotated(hints[name])
        hint, self.optional = _optional(hint)
        self.many = typing.get_origin(hint) is list
        if self.many:
            hint = typing.get_args(hint)[0]
        if not (hint is Value or getattr(hint, "payload", None)):
            raise TypeError(f"{kind}: port \"{name}\" is a {hint}, but must be a payload, such as Cloud or Pose")
        self.name, self.type, self.about = name, hint, about
        rule = about.join or ("collect" if self.many else "once" if hint in (Surface, Axes, Mesh) else "each")
        self.join = {"rule": rule}
        if rule == "collect":
            self.join["n"] = about.n
        elif rule in ("stamp", "interpolate"):
            self.join.update({"tolerance_ns": 0} if rule == "stamp" else {"max_gap_ns": None})
        return self

    def described(self):
        about, given = self.about, self.type.payload
        return {"name": self.name, "doc": about.doc or f"{(inspect.getdoc(self.type) or self.name).splitlines()[0]}",
                "payload": list(given) if given else None, "frames": [about.frame, about.to, about.from_]}


def describe(file):
    """The description of the plugin in a file."""
    load(file)
    if not KINDS:
        raise ImportError("it has no node; write @node(\"stage.name\") above a function")
    ports = [port for kind in KINDS for port in kind.inputs + kind.outputs]
    own = {port.type.payload: port.type._schema for port in ports if hasattr(port.type, "_schema")}
    return {
        "name": os.path.splitext(os.path.basename(file))[0],
        "version": str(getattr(sys.modules["__plugin__"], "__version__", "0")),
        "sdk": "osteoflow_node.py", "abi": [1, 0],
        "compiler": f"{platform.python_implementation()} {platform.python_version()}, numpy {np.__version__}",
        "kinds": [kind.described() for kind in KINDS],
        "payloads": [{"name": name, "version": version, "schema": schema} for (name, version), schema in own.items()],
        **dict(zip(("loads", "watched"), loads())),
    }


def load(file, copies=None):
    """Runs the file of a plugin. `copies` is a folder with the file and the modules beside it as they were: what is in it is run
    instead of what is there now, under its own name."""
    file = os.path.abspath(file)
    sys.path.insert(0, os.path.dirname(file))
    recorded = os.environ.pop("OSTEOFLOW_RECORDED_MODULES", None)
    if recorded is not None:
        at = sys.meta_path.index(importlib.machinery.PathFinder)
        sys.meta_path.insert(at, RecordedModules(os.path.dirname(file), json.loads(recorded)))
    index = {}
    if copies is not None:
        with open(os.path.join(copies, "index.json"), encoding="utf-8") as opened:
            index = {name: (path, os.path.join(copies, copy)) for name, path, copy in json.load(opened)}
        sys.meta_path.insert(0, CopiedModules(index))
    loader = CopiedModule("__plugin__", *index.get("__plugin__", (file, file)))
    spec = importlib.util.spec_from_file_location("__plugin__", file, loader=loader)
    module = importlib.util.module_from_spec(spec)
    sys.modules["__plugin__"] = module
    loader.exec_module(module)
    return loader.sha256


class CopiedModule(importlib.machinery.SourceFileLoader):
    """Loads a module from a copy; its `__file__` is the file that was copied."""

    def __init__(self, name, path, copy):
        super().__init__(name, path)
        self.copy, self.sha256 = copy, None

    def get_data(self, path):
        if path != self.path:
            return super().get_data(path)
        data = super().get_data(self.copy)
        self.sha256 = hashlib.sha256(data).hexdigest()
        return data

    def path_stats(self, path):
        raise OSError("a copy has no compiled file beside it")


class RecordedModules:
    """In a replay: finds modules in the folder of the plugin and in the current one only if the recorded run had loaded them, and runs
    them from their source, whatever was compiled from it. Others are passed over, as if they were not there."""

    def __init__(self, folder, files):
        self.folders, self.files = (folder + os.sep, os.getcwd() + os.sep), set(files)

    def find_spec(self, name, path=None, target=None):
        find = importlib.machinery.PathFinder.find_spec
        spec = find(name, path, target)
        file = spec and (getattr(spec.loader, "archive", None) or spec.origin)
        if not file or not self.holds(file := os.path.abspath(file)):
            return spec
        if file in self.files:
            if type(spec.loader) is importlib.machinery.SourceFileLoader:
                spec.loader = CopiedModule(name, file, file)
            return spec
        logging.getLogger("osteoflow_node").warning(
            "%s is passed over: the recorded run had loaded no such module; if you trust it, name the plugin yourself: --plugin", file)
        elsewhere = [place for place in (sys.path if path is None else path) if not self.holds(os.path.abspath(place) + os.sep)]
        spec = find(name, elsewhere, target)
        if spec is None:
            # The finder behind this one would find it.
            raise ModuleNotFoundError(f"no module named {name!r} in the recorded run", name=name)
        return spec

    def holds(self, path):
        """Whether it is below these folders, and in no folder of packages, which are named by their versions."""
        return path.startswith(self.folders) and not os.path.realpath(path).startswith(sum(WATCHED.folders(), ()))


class CopiedModules:
    """Finds the modules of which there are copies, by name."""

    def __init__(self, index):
        self.index = index

    def find_spec(self, name, path=None, target=None):
        if name not in self.index or name == "__plugin__":
            return None
        file, copy = self.index[name]
        inside = [os.path.dirname(file)] if os.path.basename(file) == "__init__.py" else None
        loader = CopiedModule(name, file, copy)
        return importlib.util.spec_from_file_location(name, file, loader=loader, submodule_search_locations=inside)


# ── what is loaded ───────────────────────────────────────────────────────────────────────────────────────────────────────

THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
                 "OSTEOFLOW_NUM_THREADS")


class FewProcessors:
    """Lets the process see as many processors as OSTEOFLOW_NUM_THREADS says, for as long as libraries count them to decide on
    their threads, as TBB does, which has no variable for it."""

    def __init__(self):
        self.all = None
        limit = os.environ.get("OSTEOFLOW_NUM_THREADS", "")
        if limit.isdigit() and int(limit) > 0 and hasattr(os, "sched_setaffinity"):
            self.all = os.sched_getaffinity(0)
            # Processes that begin together take different ones.
            seen, first = sorted(self.all), os.getpid()
            os.sched_setaffinity(0, {seen[(first + k) % len(seen)] for k in range(int(limit))})

    def end(self):
        if self.all is not None:
            os.sched_setaffinity(0, self.all)
            self.all = None


class Watched:
    """What code of the plugin's author opens, calls and loads, which no list of modules has: its hook sees each event."""

    MAX_FILES, MAX_BYTES = 256, 256 << 20

    def __init__(self):
        self.files, self.written, self.at_import, self.given, self.is_new = {}, set(), None, set(), False
        self.of_path = self.real = None

    def event(self, event, args):
        """Must raise nothing: an audit hook that raises would stop what it sees."""
        try:
            if event == "open":
                self.opened(*args)
            elif event == "ctypes.dlopen":
                self.is_new = True
            elif event in ("subprocess.Popen", "os.exec", "os.posix_spawn"):
                self.read(shutil.which(os.fsdecode(args[0] or args[1][0])))
            elif event == "os.system":
                self.read(shutil.which(os.fsdecode(args[0]).split()[0]))
        except Exception:
            pass

    def opened(self, path, mode, flags):
        if isinstance(path, int):
            return
        path = os.path.abspath(os.fsdecode(path))
        if (mode and set(mode) & set("wax+")) or flags & (os.O_WRONLY | os.O_RDWR):
            self.written.add(path)
        elif path not in self.written and path not in self.given:
            self.read(path)

    def read(self, path):
        if path is None or not os.path.isfile(path):
            return
        path = os.path.abspath(path)
        stat = os.stat(path)
        stamp = stat.st_mtime_ns, stat.st_size
        is_wanted = path in self.files or len(self.files) < self.MAX_FILES and stat.st_size <= self.MAX_BYTES
        if is_wanted and self.files.get(path) != stamp and self.is_authors(path):
            self.files[path], self.is_new = stamp, True

    def is_authors(self, path):
        """Whether code of the plugin's author asks for this file of nobody else, itself or by a library; no import of a package."""
        frame, known = sys._getframe(2), None
        while frame is not None:
            file = frame.f_code.co_filename
            if file.startswith("<frozen importlib"):
                return False
            if not file.startswith("<") and file != load.__code__.co_filename:
                known = known or sum(self.folders(), SYSTEM)
                if not os.path.realpath(file).startswith(known):
                    return not os.path.realpath(path).startswith(known)
            frame = frame.f_back
        return False

    def folders(self):
        """The folders of installed packages, and those of the interpreter's own modules, each with the separator at its end."""
        if self.of_path != (of_path := tuple(sys.path)):
            paths = sysconfig.get_paths()
            packages_in = {paths["purelib"], paths["platlib"], *getattr(site, "getsitepackages", list)()}
            if getattr(site, "ENABLE_USER_SITE", False):
                packages_in.add(site.getusersitepackages())
            packages_in.update(path for path in of_path if path and _holds_packages(path))
            of_python = (paths[key] for key in ("stdlib", "platstdlib"))
            real = [tuple(sorted({os.path.realpath(path) + os.sep for path in of})) for of in (packages_in, of_python)]
            self.of_path, self.real = of_path, real
        return self.real

    def imported(self):
        """The plugin is imported: what is opened from now on is data of its firings."""
        self.at_import = set(self.files)

    def give(self, params):
        """Files that are parameters are inputs of the run by themselves."""
        for value in params.values():
            self.given.update({os.path.abspath(value)} if isinstance(value, str) else ())


SYSTEM = ("/lib", "/usr/lib", "/usr/bin", "/usr/share", "/bin", "/etc/", "/proc/", "/sys/", "/dev/", "/System/")
WATCHED = Watched()


def loads():
    """What is loaded beside the file of the plugin: modules and libraries of its author by content, packages by version and by their
    lists of files, the interpreter, the limits of threads, and what the author's code opened and called; and the files and folders
    whose change makes another look necessary."""
    of_packages, of_python = WATCHED.folders()
    files, named, module_files = {}, {}, set()

    def add_packaged(name, file):
        """By the first name of its path, which is that of the package: `numpy/..`, `numpy.libs/..`, `six.py`."""
        real = os.path.realpath(file)
        inside = next(real[len(folder):] for folder in of_packages if real.startswith(folder))
        named.setdefault(inside.split(os.sep)[0].split(".")[0], []).append((name, os.path.abspath(file)))

    for name, module in sorted(sys.modules.items()):
        spec = getattr(module, "__spec__", None)
        loader = getattr(spec, "loader", None)
        file = getattr(loader, "archive", None) or getattr(spec, "origin", None) or getattr(module, "__file__", None)
        # What setuptools loads into each interpreter computes nothing.
        own = ("__plugin__", "__main__", "osteoflow_node", "_distutils_hack")
        if name in own or not isinstance(file, str) or not os.path.isfile(file):
            continue
        real, is_archive = os.path.realpath(file), hasattr(loader, "archive")
        module_files.add(os.path.abspath(file))
        if real.startswith(of_packages) and not is_archive:
            add_packaged(name, file)
        elif not real.startswith(of_python) or name in ("sitecustomize", "usercustomize"):
            name = os.path.basename(file) if is_archive else name
            files[os.path.abspath(file)] = (name, getattr(loader, "sha256", None) or _sha256(file))
    preloaded = {os.path.basename(word) for word in os.environ.get("LD_PRELOAD", "").replace(":", " ").split()}
    system = (*of_packages, *of_python, os.path.realpath(sys.base_prefix) + os.sep, "/lib", "/usr/lib", "/System/", os.path.realpath(sys.executable))
    for file in _mapped():
        real = os.path.realpath(file)
        if real.startswith(of_packages):
            add_packaged(os.path.basename(file), file)
        elif file not in files and (not real.startswith(system) or os.path.basename(file) in preloaded):
            files[file] = (os.path.basename(file), _sha256(file))
    found, builds, watched, edited = _packages(named)
    files.update({file: (name, _sha256(file)) for name, file in edited})
    opened = {}
    for file in list(WATCHED.files):
        if os.path.isfile(file) and file not in module_files and file not in WATCHED.given and file not in WATCHED.written:
            is_data = WATCHED.at_import is not None and file not in WATCHED.at_import
            (opened if is_data else files).setdefault(file, (_short(file), _sha256(file)))
    environment = [f"{platform.python_implementation()} {platform.python_version()}", *builds]
    environment += [f"{name}={os.environ[name]}" for name in THREAD_LIMITS if name in os.environ]
    listed = lambda files: [{"name": name, "path": path, "sha256": digest} for path, (name, digest) in sorted(files.items())]
    about = {"files": listed(files), "packages": found, "environment": environment, "opened": listed(opened)}
    config = os.path.join(sys.prefix, "pyvenv.cfg")
    folders = [os.path.abspath(path) for path in sys.path if os.path.isdir(path)]
    return about, [os.path.realpath(sys.executable), *([config] if os.path.isfile(config) else []), *watched, *folders]


def _short(file):
    """The name of a file that is opened: below the plugin's folder or the user's, which are other ones on another machine."""
    for folder, name in ((os.path.dirname(os.path.abspath(getattr(sys.modules.get("__plugin__"), "__file__", file))), ""), (os.path.expanduser("~"), "~/")):
        if file.startswith(folder + os.sep):
            return name + file[len(folder) + 1:]
    return file


def _holds_packages(path):
    """Whether packages were installed into a folder, as by `pip install --target`."""
    try:
        return any(name.endswith((".dist-info", ".egg-info")) for name in os.listdir(path))
    except OSError:
        return False


DIGESTS = {}


def _sha256(file):
    stat = os.stat(file)
    stamp = (stat.st_ino, stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns)
    if DIGESTS.get(file, (None,))[0] != stamp:
        with open(file, "rb") as opened:
            DIGESTS[file] = (stamp, hashlib.sha256(opened.read()).hexdigest())
    return DIGESTS[file][1]


def _mapped():
    """The files that are mapped as code; none where the system does not tell."""
    try:
        with open("/proc/self/maps", encoding="utf-8", errors="surrogateescape") as maps:
            parts = [line.rstrip("\n").split(None, 5) for line in maps]
    except OSError:
        return []
    return sorted({part[5] for part in parts if len(part) == 6 and "x" in part[1] and os.path.isfile(part[5])})


def _packages(named):
    """Name and version of the distributions of modules, the digests of their lists of files, the files that say so, and the modules
    and libraries that are not as their distribution has them, or that no distribution has. `named` has the modules by first name."""
    import importlib.metadata as metadata

    found, unknown = {}, []
    for name in sorted(named):
        try:
            found[name] = [metadata.distribution(name)]
        except metadata.PackageNotFoundError:
            unknown.append(name)
    providers = metadata.packages_distributions() if unknown and hasattr(metadata, "packages_distributions") else {}
    found.update({name: [metadata.distribution(provider) for provider in set(providers.get(name, ()))] for name in unknown})
    about, builds, said, edited = set(), set(), [], []
    for name, modules in named.items():
        listed, made = {}, 0.0
        for of in found[name]:
            about.add(f"{of.metadata['Name']} {of.version}")
            folder = str(getattr(of, "_path", ""))
            said += [os.path.join(folder, file) for file in ("METADATA", "PKG-INFO", "RECORD")]
            record = os.path.join(folder, "RECORD")
            if os.path.isfile(record):
                digest, hashes = _record(record)
                builds.add(f"files of {of.metadata['Name']}={digest}")
                listed.update({os.path.join(os.path.dirname(folder), path): said for path, said in hashes.items()})
                made = max(made, os.stat(record).st_mtime)
        edited += [(module, file) for module, file in modules if not found[name] or _is_edited(file, made, listed)]
    said = {file for file in said if os.path.isfile(file)}
    return sorted(about), sorted(builds), sorted(said | {file for modules in named.values() for _, file in modules}), edited


RECORDS = {}


def _record(file):
    """The digest of the files of a distribution, without those that an installation makes, and their hashes by path."""
    if file not in RECORDS:
        with open(file, encoding="utf-8", newline="") as opened:
            rows = [row for row in csv.reader(opened) if len(row) > 1 and row[1]]
        listed = {row[0]: row[1] for row in rows if not row[0].startswith("..") and ".dist-info" not in row[0] and not os.path.isabs(row[0])}
        text = "".join(f"{path} {digest}\n" for path, digest in sorted(listed.items()))
        RECORDS[file] = hashlib.sha256(text.encode()).hexdigest()[:16], listed
    return RECORDS[file]


def _is_edited(file, made, listed):
    """Whether a module or a library was changed after its distribution was made, and has not the content that that says, if it says one."""
    said = listed.get(file, "")
    if not made or os.stat(file).st_mtime <= made or not said.startswith("sha256="):
        return False
    return base64.urlsafe_b64encode(bytes.fromhex(_sha256(file))).rstrip(b"=").decode() != said[len("sha256="):]


def where(error, file):
    """An exception as one line, with the line of the plugin's file at which it came up."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if os.path.abspath(frame.filename) == os.path.abspath(file)]
    if isinstance(error, SyntaxError) and error.filename and os.path.abspath(error.filename) == os.path.abspath(file):
        place = f"{os.path.basename(file)}:{error.lineno}: "
    else:
        place = f"{os.path.basename(file)}:{frames[-1].lineno}: " if frames else ""
    if isinstance(error, ModuleNotFoundError) and str(error).startswith("No module named"):
        return place + cannot_import(error.name.split(".")[0], error)
    said = str(error.msg if isinstance(error, SyntaxError) else error)
    return f"{place}{type(error).__name__}: {said}" if said else f"{place}{type(error).__name__}"


# ── the context ──────────────────────────────────────────────────────────────────────────────────────────────────────────


class Context:
    """What a node may know of the run beside its inputs. All random numbers and times come from here, so that a run is a function
    of graph, inputs and seed."""

    def __init__(self, build, stop_page):
        self.node, self.seed = build["node"], build["seed"]
        self._stop_page = stop_page
        self.begin({"item": 0, "stamp_ns": 0, "recorded": None, "out_dir": None, "absent": []})

    def begin(self, sent):
        self.item, self._stamp_ns, self._out_dir = sent["item"], sent["stamp_ns"], sent["out_dir"]
        self._recorded = None if sent["recorded"] is None else list(sent["recorded"])
        self._absent = {port: empty["reason"] for port, empty in sent["absent"]}
        self._readings, self._warnings, self._used_generator, self._used_other = [], [], False, False

    def done(self):
        return {"stamp_ns": self._stamp_ns, "readings": self._readings, "warnings": self._warnings,
                "used_generator": self._used_generator, "used_other": self._used_other}

    @property
    def stamp_ns(self):
        """The stamp of the firing: the largest of the items that triggered it."""
        self._used_other = True
        return self._stamp_ns

    @property
    def out_dir(self):
        """The folder for files that the node writes, or None if the run has none."""
        self._used_other = True
        return self._out_dir

    def rng(self):
        """A numpy generator seeded by run seed, node name and item."""
        self._used_generator = True
        words = hashlib.sha256(f"{self.seed}\0{self.node}\0{self.item}".encode()).digest()
        return np.random.Generator(np.random.PCG64(int.from_bytes(words, "little")))

    def clock_ns(self):
        """The time of day, recorded with the firing and answered from the recording in a replay."""
        ns = time.time_ns()
        if self._recorded:
            reading = self._recorded.pop(0)
            ns = reading["ns"] if reading["kind"] == "clock" else ns
        self._readings.append({"kind": "clock", "ns": ns})
        return ns

    def cancelled(self):
        """Whether the user asked to stop. A long computation looks from time to time, and raises NodeError."""
        return self._stop_page[0] != 0

    def wait(self, seconds):
        """Waits, but not on when the user asks to stop; whether to go on."""
        until = time.monotonic() + seconds
        while not self.cancelled() and (left := until - time.monotonic()) > 0.0:
            time.sleep(min(left, 0.02))
        return not self.cancelled()

    def warn(self, message):
        """Warns the user about this item; shown, counted, and written to the manifest."""
        self._warnings.append(str(message))

    def absent_reason(self, port):
        """Why an optional port got nothing, or None."""
        return self._absent.get(port)


# ── the connection ───────────────────────────────────────────────────────────────────────────────────────────────────────

HEAD = struct.Struct("<8sqQB3xIII")
MAX_FDS = 64


class Connection:
    """Messages over the socket that is standard input; docs/extend/processes.md."""

    def __init__(self):
        self.socket = socket.socket(fileno=os.dup(0))
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        self.bytes, self.fds, self.lock = b"", [], threading.Lock()

    def receive(self):
        """The next message, or None at the end."""
        while True:
            if len(self.bytes) >= 4:
                end = 4 + int.from_bytes(self.bytes[:4], "little")
                if len(self.bytes) >= end:
                    message, self.bytes = json.loads(self.bytes[4:end]), self.bytes[end:]
                    return message
            fds = array.array("i")
            data, control, _, _ = self.socket.recvmsg(1 << 16, socket.CMSG_SPACE(MAX_FDS * fds.itemsize))
            for level, kind, payload in control:
                if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
                    fds.frombytes(payload[: len(payload) - len(payload) % fds.itemsize])
            self.fds.extend(fds)
            if not data:
                return None
            self.bytes += data

    def take_fds(self, n):
        taken, self.fds = self.fds[:n], self.fds[n:]
        return taken

    def send(self, message, fds=()):
        # Half a character, which an error text may have, is none in JSON.
        data = json.dumps(message, ensure_ascii=False).encode(errors="replace")
        data = len(data).to_bytes(4, "little") + data
        with self.lock:
            if fds:
                control = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))]
                data = data[self.socket.sendmsg([data], control):]
            self.socket.sendall(data)


class Pool:
    """The segments of shared memory that this process writes."""

    def __init__(self):
        self.maps, self.state, self.new, self.fds = [], [], [], []

    def put(self, value):
        parts, n_bytes = encode(value)
        fitting = [i for i, m in enumerate(self.maps) if self.state[i] == "free" and len(m) >= n_bytes]
        if not fitting:
            self._make(n_bytes)
            fitting = [len(self.maps) - 1]
        segment = min(fitting, key=lambda i: len(self.maps[i]))
        self.state[segment] = "used"
        at, memory = 0, self.maps[segment]
        for part in parts:
            memory[at:at + len(part)] = part
            at += len(part)
        return {"segment": segment, "n_bytes": n_bytes}

    def _make(self, n_bytes):
        size = max(1 << 16, 1 << (n_bytes - 1).bit_length())
        fd = os.memfd_create("osteoflow") if hasattr(os, "memfd_create") else _unnamed()
        os.ftruncate(fd, size)
        self.new.append({"id": len(self.maps), "n_bytes": size})
        self.fds.append(fd)
        self.maps.append(mmap.mmap(fd, size))
        self.state.append("free")

    def news(self):
        new, fds = self.new, self.fds
        self.new, self.fds = [], []
        return new, fds

    def answered(self, held):
        self.state = ["used" if i in held else "free" for i in range(len(self.maps))]


def _unnamed():
    import tempfile

    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


class Views:
    """The segments of the program, for reading."""

    def __init__(self):
        self.maps, self.roots = {}, {}

    def add(self, new, fds):
        for segment, fd in zip(new, fds, strict=True):
            self.maps[segment["id"]] = mmap.mmap(fd, segment["n_bytes"], prot=mmap.PROT_READ)
            os.close(fd)

    def item(self, place, types):
        """The item at a place; its columns stay where they are."""
        memory, roots = self.maps[place["segment"]], self.roots.setdefault(place["segment"], [])
        return decode(memory, types, roots)

    def held(self):
        """The segments on which an array still lies."""
        held = []
        for segment, roots in self.roots.items():
            roots[:] = [root for root in roots if root() is not None]
            if roots:
                held.append(segment)
        return held


class Empty:
    """An item without a value."""

    def __init__(self, node, reason):
        self.node, self.reason = node, reason


def decode(memory, types, roots):
    """The value of an item in the encoding of recordings (docs/use/recording.md)."""
    magic, _, _, body, n_fields, n_columns, _ = HEAD.unpack_from(memory, 0)
    if magic != b"OSTEOVW1":
        raise NodeError("the program sent what is no item")
    at = HEAD.size

    def number(form, size):
        nonlocal at
        value = struct.unpack_from(form, memory, at)[0]
        at += size
        return value

    def text():
        nonlocal at
        n = number("<I", 4)
        at += n
        return memory[at - n:at].decode()

    if body == 1:
        return Empty(text(), text())
    name, version = (text(), number("<I", 4)) if body == 2 else (None, None)
    head, columns = {}, {}
    for _ in range(n_fields):
        kind, field = number("<B", 1), text()
        if kind == 1:
            head[field] = number("<B", 1) != 0
        elif kind == 4:
            n = number("<I", 4)
            head[field] = list(struct.unpack_from(f"<{n}d", memory, at))
            at += 8 * n
        else:
            head[field] = text() if kind == 5 else number(*{2: ("<q", 8), 3: ("<d", 8)}[kind])
    for _ in range(n_columns):
        field, kind, width, n_bytes = text(), number("<B", 1), number("<I", 4), number("<Q", 8)
        at += -at % 8
        dtype = DTYPES[CODES[kind]]
        root = np.frombuffer(memory, dtype, n_bytes // dtype.itemsize, at)
        roots.append(weakref.ref(root))
        columns[field] = root if width == 1 else root.reshape(-1, width)
        at += n_bytes
    return types.get(name, Value)._of(head, columns, (name, version))


SCHEMAS = {}


def encode(value):
    """A value in the encoding of recordings: parts, and their length."""
    name, version = value.payload
    schema = SCHEMAS.get(name)
    if schema is None:
        raise NodeError(f"payload {name} is not one that this node gives")
    head, columns = value.head, value.columns
    out = bytearray()

    def text(of):
        if not isinstance(of, str):
            raise NodeError(f"{name}: a text is expected, found {of!r}")
        try:
            data = of.encode()
        except UnicodeEncodeError as error:
            raise NodeError(f"{name}: {of!r} is no text, as it has half of a character (a lone surrogate)") from error
        out.extend(len(data).to_bytes(4, "little") + data)

    text(name)
    out += version.to_bytes(4, "little")
    n_fields = 0
    known = set()
    for entry in schema:
        field = entry["name"]
        known.add(field)
        if "field" not in entry:
            continue
        given, kind = head.get(field), entry["field"]
        if given is None:
            if not entry.get("optional"):
                raise NodeError(f"{name} has no \"{field}\"")
            continue
        n_fields += 1
        out.append({"bool": 1, "int": 2, "float": 3, "text": 5}.get(kind, 4))
        text(field)
        if kind == "bool":
            out.append(bool(given))
        elif kind == "int":
            if not -2**63 <= given < 2**63:
                raise NodeError(f"{name}: \"{field}\" is {given}, which no 64 bits hold")
            out += struct.pack("<q", given)
        elif kind == "float":
            out += struct.pack("<d", given)
        elif kind == "text":
            text(given)
        else:
            out += struct.pack(f"<I{len(given)}d", len(given), *given)
    parts, n_bytes = [], HEAD.size + len(out)
    types = {entry["name"]: entry for entry in schema if "column" in entry}
    pattern = next((entry for field, entry in types.items() if field.endswith("/*")), None)
    for field, rows in columns.items():
        entry = types.get(field) or (pattern if pattern and field.startswith(pattern["name"][:-1]) else None)
        if entry is None:
            raise NodeError(f"{name} has no column \"{field}\"")
        rows = _rows(field, rows, entry["width"], DTYPES[entry["column"]])
        # Of no rows there is no view of bytes.
        label, data = field.encode(), memoryview(rows).cast("B") if rows.size else memoryview(b"")
        code = next(code for code, kind in CODES.items() if kind == entry["column"])
        about = len(label).to_bytes(4, "little") + label + struct.pack("<BIQ", code, entry["width"], len(data))
        about += bytes(-(n_bytes + len(about)) % 8)
        parts += [about, data]
        n_bytes += len(about) + len(data)
    first = HEAD.pack(b"OSTEOVW1", 0, 0, 2, n_fields, len(columns), 0) + bytes(out)
    return [first, *parts], n_bytes


class Log(logging.Handler):
    """Sends what `logging` says to the program."""

    LEVELS = {logging.CRITICAL: 1, logging.ERROR: 1, logging.WARNING: 2, logging.INFO: 3, logging.DEBUG: 4}

    def __init__(self, connection, level):
        super().__init__()
        self.connection, self.most = connection, level

    def emit(self, record):
        level = self.LEVELS.get(record.levelno, 3)
        if level <= self.most:
            self.connection.send({"log": {"level": level, "target": record.name, "message": record.getMessage()}})


class Memory:
    """What is shared with the program, and the constants in it by their segment, for as long as the program keeps them."""

    def __init__(self):
        self.views, self.pool, self.constants = Views(), Pool(), {}


#: Characters of a reason that are sent: as many as a graph's texts have.
LONGEST_REASON = 16_384


class Server:
    """Fires one node."""

    def __init__(self, connection, build, stop_page, kind, memory):
        self.connection, self.kind, self.context = connection, kind, Context(build, stop_page)
        self.views, self.pool, self.constants = memory.views, memory.pool, memory.constants
        self.types = {t.payload[0]: t for t in BUILT_IN}
        self.types.update({port.type.payload[0]: port.type for port in kind.inputs if port.type.payload})
        self.params = self._params(build["params"])
        given = () if self.params is None else (self.params,)
        self.made = kind.made(*given) if kind.is_class else kind.made
        self.running = None

    def _params(self, given):
        if self.kind.params is None:
            return None
        hints = typing.get_type_hints(self.kind.params)
        values = {}
        for name, value in given.items():
            origin = typing.get_origin(_optional(hints[name])[0])
            values[name] = tuple(value) if origin is tuple else float(value) if hints[name] is float else value
        return self.kind.params(**values)

    def answer(self, fire, file, loaded):
        """Fires, and sends the answer."""
        for segment in fire.get("released", ()):
            self.constants.pop(segment, None)
        self.views.add(fire["new"], self.connection.take_fds(len(fire["new"])))
        outputs, began = [], time.process_time_ns()
        try:
            ended, outputs = self.fire(fire)
        except NodeError as error:
            ended = {"failed": str(error)[:LONGEST_REASON]}
        except (Exception, SystemExit) as error:
            logging.getLogger("osteoflow_node").debug("%s", traceback.format_exc())
            ended = {"failed": where(error, file)[:LONGEST_REASON]}
        new, fds = self.pool.news()
        answer = {"item": fire["context"]["item"], "ended": ended, "outputs": outputs, "context": self.context.done(), "new": new,
                  "held": self.views.held(), "cpu_ns": time.process_time_ns() - began, "loads": loaded.news()}
        self.connection.send({"answer": answer}, fds)
        for fd in fds:
            os.close(fd)

    def fire(self, fire):
        self.context.begin(fire["context"])
        self.pool.answered(fire["held"])
        ports = [self.slot(index, slot) for index, slot in enumerate(fire["slots"])]
        fires = self.made.process if self.kind.is_class and self.kind.role == "node" else self.made
        given = {"ctx": self.context, "params": self.params}
        arguments = [ports[index] if what == "port" else given[what] for what, index in self.kind.arguments]
        del ports
        if self.kind.role == "source":
            if self.running is None:
                self.running = iter(self.made.items(*arguments) if self.kind.is_class else self.made(*arguments))
            step = next(self.running, None)
            if step is None:
                return "end", []
            if not (isinstance(step, tuple) and len(step) == 2 and isinstance(step[0], int)):
                raise NodeError("a source yields (stamp_ns, payload)")
            self.context._stamp_ns, answer = step
            answer = self.stamped(answer)
        else:
            answer = fires(*arguments)
        del arguments
        return "well", self.emitted(answer)

    def stamped(self, answer):
        """The answer of a source, in which what has a stamp and was given none has that of its item."""
        stamp_ns = self.context._stamp_ns

        def of(value):
            if stamp_ns == 0 or type(value) not in BUILT_IN or value.head.get("stamp_ns") != 0:
                return value
            # A copy: a source may give the same object again, at another time.
            return type(value)._of(dict(value.head, stamp_ns=stamp_ns), value.columns, value.payload)

        if self.kind.tuple is None or answer is None:
            return of(answer)
        return type(answer)(*map(of, answer))

    def slot(self, index, slot):
        (what, given), = slot.items()
        port = self.kind.inputs[index]
        if what == "absent":
            return [] if port.many else None
        if what == "items":
            return [item for item in (self.item(place) for place in given) if item is not None]
        if what == "constant":
            segment = given["segment"]
            if segment not in self.constants:
                self.constants[segment] = self.item(given)
            return self.constants[segment]
        return self.item(given)

    def item(self, place):
        item = self.views.item(place, self.types)
        return None if isinstance(item, Empty) else item

    def answers(self, answer):
        """What was returned for each output, held to its payload; None for one without a value."""
        ports = self.kind.outputs
        if self.kind.tuple is None:
            answers = [answer] if ports else []
            if not ports and answer is not None:
                raise NodeError(f"it returns a {type(answer).__name__}, but has no output; write -> and the payload")
        else:
            names = [port.name for port in ports]
            if answer is not None and not all(hasattr(answer, name) for name in names):
                name, values = self.kind.tuple.__name__, ", ".join(f"{name}=.." for name in names)
                raise NodeError(f"{self.kind.place()}it returns a {type(answer).__name__}, and a {name} is expected; write return {name}({values})")
            answers = [None] * len(names) if answer is None else [getattr(answer, name) for name in names]
        for port, answer in zip(ports, answers):
            payload = getattr(answer, "payload", None)
            if answer is not None and (payload is None or (port.type is not Value and payload != port.type.payload)):
                raise NodeError(f"output \"{port.name}\" must be a {port.type.__name__}, found a {type(answer).__name__}")
        return answers

    def emitted(self, answer):
        none = "silent" if self.kind.live else {"empty": "the node gave no value"}
        return [none if answer is None else {"value": self.pool.put(answer)} for answer in self.answers(answer)]


def serve(file, copies=None):
    """Serves a node at a time: each message that builds one ends the node before it. What is imported stays, and constants."""
    connection, memory, loaded, few = Connection(), Memory(), None, FewProcessors()
    sys.stdout.reconfigure(line_buffering=True)
    while (message := connection.receive()) is not None:
        (what, about), = message.items()
        if what == "build":
            if loaded is None:
                loaded = Loaded(connection, about)
            server, answer = loaded.build(file, copies, about, memory)
            connection.send(answer)
            if server is None:
                return
        else:
            server.answer(about, file, loaded)
            few.end()


class Loaded:
    """The plugin, and what it was last said to have loaded."""

    def __init__(self, connection, build):
        self.connection, self.n_modules, self.said = connection, None, None
        (stop_fd,) = connection.take_fds(1)
        self.stop_page = mmap.mmap(stop_fd, mmap.PAGESIZE, prot=mmap.PROT_READ)
        parent = os.getppid()

        def watch():
            while os.getppid() == parent:
                time.sleep(0.25)
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()
        logging.basicConfig(level=logging.DEBUG, handlers=[Log(connection, build["log_level"])])

    def build(self, file, copies, build, memory):
        """The node and the answer, or None and why there is none."""
        try:
            if build["version"] != PROTOCOL:
                raise NodeError(f"the program speaks version {build['version']} of the protocol, this module {PROTOCOL}")
            if self.n_modules is None and load(file, copies) != build["plugin"]["sha256"]:
                raise NodeError(f"plugin {file}: it has changed since it was looked at; run again")
            if self.n_modules is None:
                WATCHED.imported()
            WATCHED.give(build["params"])
            SCHEMAS.update({described["name"]: described["schema"] for described in build["payloads"]})
            kind = next(kind for kind in KINDS if kind.kind == build["kind"])
            server = Server(self.connection, build, self.stop_page, kind, memory)
        except NodeError as error:
            return None, {"refused": {"parameter": "", "message": str(error)}}
        except (Exception, SystemExit) as error:
            return None, {"refused": {"parameter": "", "message": where(error, file)}}
        return server, {"built": {"again": True, "loads": self.news(), **(kind.live or {})}}

    def news(self):
        """What is loaded, if it is more than when this was last asked; else None."""
        if self.n_modules == len(sys.modules) and not WATCHED.is_new:
            return None
        self.n_modules, WATCHED.is_new = len(sys.modules), False
        about, _ = loads()
        if about == self.said:
            return None
        self.said = about
        return about


def main(arguments):
    sys.modules["osteoflow_node"] = sys.modules[__name__]
    sys.addaudithook(WATCHED.event)
    what, file, *copies = arguments
    if what == "serve":
        return serve(file, *copies)
    try:
        answer = {"plugin": describe(file)}
    except BaseException as error:
        answer = {"refused": where(error, file)}
    print(f"\nosteoflow plugin: {json.dumps(answer)}")


if __name__ == "__main__":
    main(sys.argv[1:])
