"""What the tests share: the command beside the package, and the files of the repository."""

import json
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
#: The command whose answers the package must give; tests/python_package.rs names it.
COMMAND = os.environ.get("OSTEOFLOW_COMMAND", str(ROOT / "target/release/osteoflow"))

TWO_FILES = ROOT / "graphs/two_files.toml"

#: Registrations.
SWEEP = """
extends = "{graph}"

[sweep]
repeat = 2

[sweep.factor]
icp = {{ key = "icp.kind", values = ["icp.point_to_plane", "icp.point_to_point"] }}

[sweep.columns]
answer = "verdict.answer"
"""

#: Plans on small bones: runs that take a few milliseconds.
SMALL = """
[graph]
format = 1
name   = "small"
seed   = 3

[node.plan]
kind         = "plan.simulated"
bone.edge_mm = 5.0

[results]
landmarks = "plan.landmarks"

[sweep]
repeat = 2

[sweep.factor]
shape = { key = "plan.bone.shape_seed", values = [1, 2, 3] }

[sweep.columns]
x_mm = "landmarks.P1.position_mm.0"
"""


def graph_with_sweep(folder):
    """A sweep of four registrations."""
    graph = folder / "sweep.toml"
    graph.write_text(SWEEP.format(graph=TWO_FILES.as_posix()))
    return graph


def small_sweep(folder):
    """A sweep of six runs that take a few milliseconds."""
    graph = folder / "small.toml"
    graph.write_text(SMALL)
    return graph


def assert_same_sweep(folder, alone):
    """Compares the files of two sweeps byte for byte, except sweep.json, which names the machines, and the times."""
    def content(of):
        return {str(file.relative_to(of)): file.read_bytes() for file in sorted(of.rglob("*")) if file.is_file()}

    ours, theirs = content(folder), content(alone)
    assert list(ours) == list(theirs)
    for name in ours:
        if name not in ("sweep.json", "times.csv") and not name.startswith("runs/times/"):
            assert ours[name] == theirs[name], name


@pytest.fixture(autouse=True, scope="session")
def no_store():
    """Nothing is taken from an earlier run."""
    os.environ["OSTEOFLOW_CACHE"] = "off"


@pytest.fixture(scope="session")
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
