"""The console script `osteoflow`: runs `osteoflow/_command.py` without importing the package `osteoflow`, and with it numpy."""

import importlib.util
from pathlib import Path


def main() -> int:
    """Runs the command with the arguments of the process; its exit code."""
    package = importlib.util.find_spec("osteoflow")
    assert package is not None and package.origin is not None, "both packages are of one wheel"
    spec = importlib.util.spec_from_file_location("osteoflow_command._command", Path(package.origin).with_name("_command.py"))
    assert spec is not None and spec.loader is not None
    command = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(command)
    return command.main()
