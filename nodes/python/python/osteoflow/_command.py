"""The command without the package, so without numpy, whose import takes most of a short run: `python -I _command.py sweep ...`."""

import importlib.util
import signal
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path


def main() -> int:
    folder = Path(__file__).parent
    library = next(file for ending in EXTENSION_SUFFIXES if (file := folder / f"_core{ending}").is_file())
    spec = importlib.util.spec_from_file_location("osteoflow._core", library)
    core = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(core)
    core.hosted_by(sys.executable, ["-m", "osteoflow"], str(library))
    # The command handles Ctrl-C itself.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return core.command(["osteoflow", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
