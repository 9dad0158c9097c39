"""The command `osteoflow`: the library of the package, without the package and numpy, whose import takes most of a short run.

`osteoflow_command/__init__.py` is also a program of its own, with which the library starts other processes of itself.
"""

import importlib.util
import signal
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

#: What another process of the command begins with, after the interpreter. Isolated: no file of the current folder is imported.
BEFORE = ["-I", str(Path(__file__))]


def library():
    """The module `osteoflow._core`, loaded once and told how to start the command."""
    loaded = sys.modules.get("osteoflow._core")
    if loaded is not None:
        return loaded
    # Beside this package, or where an editable installation keeps the sources.
    folder = Path(__file__).resolve().parent.parent / "osteoflow"
    files = [folder / f"_core{ending}" for ending in EXTENSION_SUFFIXES]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        sys.exit(f"error: the library of osteoflow is missing in {folder}; install the package again: pip install --force-reinstall osteoflow")
    spec = importlib.util.spec_from_file_location("osteoflow._core", file)
    core = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(core)
    core.hosted_by(sys.executable or "", BEFORE, str(file))
    return core


def main() -> int:
    """Runs the command with the arguments of the process; its exit code."""
    core = library()
    # The command handles Ctrl-C itself, unless whoever started it has it ignored.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return core.command(["osteoflow", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
