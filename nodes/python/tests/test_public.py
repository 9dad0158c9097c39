"""What the package offers, as text beside this file. `UPDATE=1` rewrites it; a changed line is a change for users, which CHANGELOG.md names."""

import inspect
import os
import re
from pathlib import Path

import osteoflow
import osteoflow.nodes

GOLDEN = Path(__file__).with_name("public.txt")


def lines():
    """Names with their arguments: functions, classes with their methods and attributes, and what a node in Python is written with."""
    for module in (osteoflow, osteoflow.nodes):
        names = getattr(module, "__all__", None) or [name for name in vars(module) if not name.startswith("_")]
        for name in sorted(names):
            thing = getattr(module, name)
            if inspect.ismodule(thing) or (module is not osteoflow and getattr(thing, "__module__", "").startswith(("typing", "dataclasses"))):
                continue
            path = f"{module.__name__}.{name}"
            if not inspect.isclass(thing):
                yield path + (str(inspect.signature(thing)) if callable(thing) else "")
                continue
            bases = ", ".join(base.__name__ for base in thing.__bases__ if base is not object)
            yield f"class {path}" + (f"({bases})" if bases else "")
            for member, value in sorted(vars(thing).items()):
                if member.startswith("_") and member not in ("__init__", "__getitem__", "__enter__", "__exit__", "__len__", "__iter__"):
                    continue
                value = inspect.unwrap(getattr(thing, member))
                yield f"{path}.{member}" + (str(inspect.signature(value)) if inspect.isfunction(value) else "")


def test_what_the_package_offers_is_what_was_read_last():
    # A default that is an object is written with its address.
    text = re.sub(r" object at 0x[0-9a-f]+", "", "\n".join(lines()) + "\n")
    if os.environ.get("UPDATE"):
        GOLDEN.write_text(text, encoding="utf-8")
    kept = GOLDEN.read_text(encoding="utf-8")
    assert text == kept, "UPDATE=1 rewrites public.txt; read the diff, and write what users see into CHANGELOG.md"
