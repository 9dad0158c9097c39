"""What the tests share: the command beside the package, and the files of the repository."""

import json
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
#: The command whose answers the package must give; tests/python_package.rs names it.
COMMAND = os.environ.get("OSTEOFLOW_COMMAND", str(ROOT / "target/release/osteoflow"))


@pytest.fixture(autouse=True, scope="session")
def no_store():
    """Nothing is taken from an earlier run."""
    os.environ["OSTEOFLOW_CACHE"] = "off"


@pytest.fixture
def files():
    """The folder with a small simulated procedure."""
    return ROOT / "tests/data/folder"


@pytest.fixture
def command():
    """Runs the command; the finished process."""

    def run(*arguments):
        words = [COMMAND, *map(str, arguments)]
        return subprocess.run(words, capture_output=True, text=True, timeout=300, cwd=ROOT, check=False)

    return run


@pytest.fixture
def command_json(command):
    """Runs the command, which must succeed; its JSON."""

    def run(*arguments):
        ended = command(*arguments, "--format", "json")
        assert ended.returncode == 0, ended.stderr
        return json.loads(ended.stdout)

    return run
