"""The command without the package, so without numpy, whose import takes most of a short run: `python -I _command.py sweep ...`.

With it the library also starts other processes of itself.
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
    folder = Path(__file__).parent
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
