"""The command: `python -m osteoflow run graphs/fibula.toml`."""

import signal
import sys

from . import _core


def main() -> int:
    # The command handles Ctrl-C itself.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _core.command(["osteoflow", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
