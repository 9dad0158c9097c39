"""What nodes in Python are written with, for functions of a notebook: `from osteoflow.nodes import Cloud, Pose, node`.

It is the module `osteoflow_node` that the program hands to plugins, and can be imported by that name, too, once this one is.
"""

from __future__ import annotations

import json as _json
import sys as _sys
import types as _types
import weakref as _weakref
from typing import Any as _Any
from typing import Callable as _Callable
from typing import Optional as _Optional

import numpy as _np

from . import _core


def _load() -> _types.ModuleType:
    name = "osteoflow_node"
    if name not in _sys.modules:
        if _sys.version_info < (3, 10):
            raise ImportError("nodes in Python need Python 3.10 or newer")
        module = _types.ModuleType(name)
        _sys.modules[name] = module
        exec(compile(_core.NODE_MODULE, "osteoflow_node.py", "exec"), module.__dict__)
    return _sys.modules[name]


_module = _load()
__all__ = list(_module.__all__)
globals().update({_name: getattr(_module, _name) for _name in __all__})

_KINDS: _Any = _weakref.WeakKeyDictionary()


def _kind(function: _Callable, node: str) -> _Any:
    """What the decorator said of a function; for one without, what its annotations say."""
    kind = next((kind for kind in reversed(_module.KINDS) if kind.made is function), None)
    return kind or _module.Kind(function, f"function of node {node}", "node", None, "", [], False)


class Function:
    """A function in place of a node of a graph: fired by the run, with the items of the node's inputs."""

    def __init__(self, function: _Callable, node: str, ports: _Optional[tuple]) -> None:
        if ports is None:
            raise _core.UsageError(f'nodes: there is no node "{node}"')
        self.inputs, outputs, self.seed = ports
        if not self.inputs:
            raise _core.UsageError(f'nodes: "{node}" is a source; give what it gives by inputs={{"{node}": ..}}')
        self.node, self.kind = node, _kind(function, node)
        if self.kind.role != "node":
            raise _core.UsageError(f'nodes: "{node}": a function must be a node, but {self.kind.kind} is a source')
        if self.kind.params is not None:
            raise _core.UsageError(f'nodes: "{node}": a function here takes no params; it sees the variables around it')
        unknown = [port.name for port in self.kind.inputs if port.name not in self.inputs]
        if unknown:
            have = ", ".join(self.inputs)
            raise _core.UsageError(f'nodes: "{node}" has no input {", ".join(unknown)}; it has {have}')
        made: _Any = function() if self.kind.is_class else function
        self.fires = made.process if self.kind.is_class else made
        self.types = {kind.payload[0]: kind for kind in _module.BUILT_IN}
        self.types.update({port.type.payload[0]: port.type for port in self.kind.inputs if port.type.payload})
        self.order = [self._output(port, outputs) for port in self.kind.outputs]
        self.n_outputs, self.has_warned = len(outputs), False
        self.without = [name for index, (name, _) in enumerate(outputs) if index not in self.order]

    def _output(self, port: _Any, outputs: list) -> int:
        """The output that a result goes to: by its name or, of one result, by its payload."""
        payload = port.type.payload and port.type.payload[0]
        by_name = [index for index, (name, _) in enumerate(outputs) if name == port.name]
        by_payload = [index for index, (_, carried) in enumerate(outputs) if carried == payload]
        found = by_name or (by_payload if len(self.kind.outputs) == 1 else [])
        carried = outputs[found[0]][1] if len(found) == 1 else None
        if len(found) != 1 or carried not in (None, payload):
            have = ", ".join(f"{name} ({carried})" for name, carried in outputs)
            raise _core.UsageError(f'nodes: "{self.node}" has no output "{port.name}" of {payload}; it has {have}')
        return found[0]

    def __call__(self, sent: str, slots: list, stop: _Any) -> tuple:
        context = _module.Context({"node": self.node, "seed": self.seed}, stop)
        context.begin(_json.loads(sent))
        if not self.has_warned:
            self.has_warned = True
            context.warn("computed by a function of the program that ran the graph: the run cannot be repeated from its files")
        given: list = [None] * self.n_outputs
        try:
            answer = self._fire(slots, context)
            server = _types.SimpleNamespace(kind=self.kind)
            for index, value in zip(self.order, _module.Server.answers(server, answer)):
                if value is not None:
                    floats = {entry["name"] for entry in getattr(value, "_schema", ()) if entry.get("field") == "float"}
                    head = {name: float(field) if name in floats else field for name, field in value.head.items() if field is not None}
                    # A copy: what the function keeps, it may change.
                    columns = {name: _np.array(column, order="C") for name, column in value.columns.items()}
                    given[index] = value.payload[0], (0, head, columns)
        except _module.NodeError as error:
            return _json.dumps(context.done()), str(error), []
        except Exception as error:
            code = getattr(self.fires, "__code__", None)
            return _json.dumps(context.done()), _module.where(error, code.co_filename if code else ""), []
        return _json.dumps(context.done()), None, given

    def _fire(self, slots: list, context: _Any) -> _Any:
        arguments = []
        for what, index in self.kind.arguments:
            if what == "ctx":
                arguments.append(context)
                continue
            port = self.kind.inputs[index]
            items = [self._value(item) for item in slots[self.inputs.index(port.name)] if not item[3]]
            if not items and not port.many and not port.optional:
                raise _module.NodeError(f'input "{port.name}" has no value')
            arguments.append(items if port.many else items[0] if items else None)
        return self.fires(*arguments)

    def _value(self, item: tuple) -> _Any:
        _, _, payload, _, head, columns = item
        return self.types.get(payload, _module.Value)._of(head, columns, (payload, 1))
