"""The command: `python -m osteoflow run graphs/fibula.toml`."""

import sys

from ._command import main

if __name__ == "__main__":
    sys.exit(main())
