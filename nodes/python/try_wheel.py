"""Tries an installed wheel: what README types, and what differs where the command is run by an interpreter.

wheel.py runs it in a fresh environment, in a folder with nothing but README.md. It needs the package alone.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

HERE = Path.cwd()
EXAMPLES = HERE / "osteoflow-examples"
COMMAND = [str(Path(sys.executable).with_name("osteoflow"))]
#: The folder that pip installed the packages into.
SITE = Path(str(importlib.metadata.distribution("osteoflow").locate_file("")))
IS_UNIX = os.name == "posix"

#: A node that keeps every second point. Nothing but numpy is imported.
NODE = '''
from osteoflow_node import Cloud, node


@node("half.second", output="cloud")
def half(cloud: Cloud) -> Cloud:
    """Every second point of a cloud."""
    return cloud.chosen(slice(None, None, 2))
'''

#: A graph with that node, and its sweep.
GRAPH = """
extends = "graphs/two_files.toml"
plugins = ["half.py"]

[node.crop]
kind = "half.second"

[sweep]
repeat = 1

[sweep.factor]
icp = { key = "icp.kind", values = ["icp.point_to_plane", "icp.symmetric"] }

[sweep.columns]
answer = "verdict.answer"
pairs  = "icp.n_pairs"
"""


def run(*words: object, code: int = 0, cwd: Path = EXAMPLES, **more: str) -> subprocess.CompletedProcess:
    """Runs the command, which must end with this exit code."""
    ended = subprocess.run(
        [*COMMAND, *map(str, words)], capture_output=True, text=True, encoding="utf-8", cwd=cwd, timeout=300, check=False,
        env={**os.environ, "NO_COLOR": "1", **more},
    )
    assert ended.returncode == code, f"{words}: exit code {ended.returncode}, not {code}\n{ended.stdout}\n{ended.stderr}"
    return ended


def library(site: Path) -> Path:
    """The compiled library of the package in a folder of packages."""
    [file] = (site / "osteoflow").glob("_core*.so" if IS_UNIX else "_core*.pyd")
    return file


def run_json(*words: object) -> dict:
    return json.loads(run(*words, "--format", "json", "--quiet").stdout)


def section(title: str) -> str:
    """A section of README."""
    return (HERE / "README.md").read_text(encoding="utf-8").split(f"\n## {title}\n")[1].split("\n## ")[0]


def shell_blocks(title: str) -> list[str]:
    return re.findall(r"^```sh\n(.*?)^```", section(title), re.MULTILINE | re.DOTALL)


def command_lines(title: str) -> list[list[str]]:
    """The words of every line of a section that types `osteoflow`."""
    lines = [line for block in shell_blocks(title) for line in block.splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if line.startswith("osteoflow ")]


def what_readme_types_gives_the_numbers_that_it_shows() -> None:
    begun = time.monotonic()
    # `new examples DIR`, in the folder in which the reader is; all that follows in DIR.
    [new] = command_lines("Install")
    assert new[:2] == ["new", "examples"] and new[2] == EXAMPLES.name, new
    run(*new, cwd=HERE)
    first, *others = command_lines("Register two files")
    shown = re.search(r"t_target_source, mm\n((?:.*\n){4})", section("Register two files")).group(1)
    shown = [float(cell) for cell in shown.split()]
    fit = json.loads(run(*first, "--format", "json").stdout)
    apart = max(abs(a - b) for a, b in zip(fit["T"], shown))
    assert len(shown) == 16 and apart < 1e-5, f"{fit['T']} is not the pose of README, {shown}"
    assert "trusted" in run(*first).stdout.splitlines()[0]
    print(f"    pip has it; the example has its answer after {time.monotonic() - begun:.1f} s")
    assert others, "README has the same run as a graph"
    for words in others:
        run(*words)
    assert run_json("run", "graphs/fibula.toml", "--out", "fibula")["verdict"]["answer"] == "trusted"


def the_package_is_the_command() -> None:
    [block] = re.findall(r"^```python\n(.*?)^```", section("Register two files"), re.MULTILINE | re.DOTALL)
    os.chdir(EXAMPLES)
    names: dict = {}
    exec(block, names)
    os.chdir(HERE)
    first, *_ = command_lines("Register two files")
    of_command = run_json(*first)["T"]
    assert names["t"].ravel().tolist() == of_command, "other bits"
    package = names["osteoflow"]
    assert package.__version__ == importlib.metadata.version("osteoflow")
    assert run("--version").stdout.split() == ["osteoflow", package.__version__]
    module = subprocess.run([sys.executable, "-m", "osteoflow", "--version"], capture_output=True, text=True, check=True)
    assert module.stdout == run("--version").stdout


def a_command_does_not_wait_for_numpy() -> None:
    assert "numpy" not in run("--version", PYTHONPROFILEIMPORTTIME="1").stderr


def exit_codes_are_those_of_the_command() -> None:
    run("run", "nowhere.toml", code=2)
    run("--nonsense", code=2)
    missing = run("register", "tests/data/folder/bone.stl", "nowhere.ply", code=1)
    assert "nowhere.ply" in missing.stderr and "Traceback" not in missing.stderr
    run("run", "graphs/two_files.toml", "--inject", "icp=panic", "--out", "panicked", code=3)
    told = run("run", "graphs/fibula.toml", cwd=HERE, code=2)
    assert "osteoflow new examples" in told.stderr, told.stderr


def a_run_says_how_it_was_called() -> None:
    words = ["run", "graphs/two_files.toml", "--out", "called", "--no-record"]
    run(*words)
    manifest = json.loads((EXAMPLES / "called/manifest.json").read_text(encoding="utf-8"))
    assert manifest["command"]["arguments"] == words, manifest["command"]


def processes_of_nodes_give_the_same_bits() -> None:
    if not IS_UNIX:
        told = run("run", "graphs/two_files.toml", "--set", "icp.process=true", code=2)
        assert "process" in told.stderr, told.stderr
        return
    run("run", "graphs/two_files.toml", "--out", "inside")
    sets = ["--set", "icp.process=true", "--set", "coarse.process=true", "--no-cache"]
    run("run", "graphs/two_files.toml", "--out", "apart", *sets)
    run("diff", "inside/run.mcap", "apart/run.mcap")
    # Only another process can be stopped.
    stopped = run("run", "graphs/two_files.toml", "--out", "late", "--set", "icp.stop_after_s=0.0001", code=3)
    assert "its process was stopped" in stopped.stderr, stopped.stderr


def nodes_in_python_fire_and_are_swept() -> None:
    (EXAMPLES / "half.py").write_text(NODE, encoding="utf-8")
    (EXAMPLES / "half.toml").write_text(GRAPH, encoding="utf-8")
    if not IS_UNIX or sys.version_info < (3, 10):
        told = run("run", "half.toml", code=2)
        assert "half.py" in told.stderr, told.stderr
        return
    # Without --python, an active environment or numpy elsewhere: the interpreter of the command.
    ran = run_json("run", "half.toml", "--out", "half")
    whole = run_json("run", "graphs/two_files.toml", "--out", "whole")
    assert 0.4 < ran["icp"]["n_pairs"] / whole["icp"]["n_pairs"] < 0.6, (ran["icp"], whole["icp"])
    run("sweep", "half.toml", "--out", "swept", "--workers", "2")
    rows = (EXAMPLES / "swept/runs.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 3 and all("trusted" in row for row in rows[1:]), rows
    design = json.loads((EXAMPLES / "swept/sweep.json").read_text(encoding="utf-8"))
    assert design["program_sha256"] == hashlib.sha256(library(SITE).read_bytes()).hexdigest(), "the program is not the library"


def another_build_is_not_answered_from_the_store_of_this_one() -> None:
    words = ["run", "graphs/two_files.toml", "--no-record", "--out"]
    recalled = lambda out: json.loads((EXAMPLES / out / "manifest.json").read_text(encoding="utf-8"))["store"]["recalled"]
    run(*words, "warm")
    assert recalled("warm"), "an earlier run has left nothing"
    # The same library with one byte more, which no loader reads.
    site = HERE / "other"
    shutil.copytree(SITE / "osteoflow", site / "osteoflow")
    with library(site).open("ab") as file:
        file.write(b"\0")
    other = [sys.executable, "-I", str(site / "osteoflow/_command.py"), *words, "other"]
    subprocess.run(other, check=True, capture_output=True, cwd=EXAMPLES)
    assert not recalled("other"), "an answer of another build"


def files_of_the_current_folder_are_not_imported() -> None:
    trap = HERE / "trap"
    trap.mkdir()
    for name in ("numpy", "json", "signal", "osteoflow", "osteoflow_command", "importlib"):
        (trap / f"{name}.py").write_text("raise SystemExit('imported from the current folder')\n", encoding="utf-8")
    sets = ["--set", "icp.process=true"] if IS_UNIX else []
    run("run", EXAMPLES / "graphs/two_files.toml", *sets, "--out", "ran", cwd=trap)


def the_module_of_3d_slicer_is_in_the_wheel() -> None:
    module = HERE / "slicer"
    run("new", "slicer", module)
    written = sorted(str(file.relative_to(module).as_posix()) for file in module.rglob("*") if file.is_file())
    graphs = ["graphs/two_files.toml", "graphs/variants/two_files_picked.toml"]
    assert written == ["Osteoflow.py", "OsteoflowLib/__init__.py", "OsteoflowLib/osteoflow_slicer.py", *graphs], written


def pages_are_served() -> None:
    served = [["view", "tests/data/folder/bone.stl", "tests/data/folder/scan.ply"], ["run", "graphs/two_files.toml", "--out", "served", "--serve"]]
    for words in served:
        process = subprocess.Popen([*COMMAND, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=EXAMPLES)
        try:
            address = next(found.group() for line in process.stderr if (found := re.search(r"http://\S+", line)))
            page = urllib.request.urlopen(address, timeout=60).read().decode()
            assert "<html" in page and "osteoflow" in page.lower(), page[:200]
            if IS_UNIX:
                next(line for line in process.stderr if "until Ctrl-C" in line)
                process.send_signal(signal.SIGINT)
                assert process.wait(60) in (0, 130), process.returncode
        finally:
            process.kill()
            process.communicate()


def ctrl_c_stops_a_run_in_order() -> None:
    if not IS_UNIX:
        return
    words = ["sweep", "graphs/paper/sensitivity.toml", "--out", "stopped", "--workers", "1", "--quiet"]
    process = subprocess.Popen([*COMMAND, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=EXAMPLES)
    deadline = time.monotonic() + 120
    while not list(EXAMPLES.glob("stopped/runs/*.json")) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    told = process.communicate(timeout=120)[1]
    assert process.returncode == 130 and "Traceback" not in told, (process.returncode, told)


def a_reader_may_stop_reading() -> None:
    if not IS_UNIX:
        return
    piped = f"{shlex.quote(COMMAND[0])} schema; echo code $? >&2"
    ended = subprocess.run(["sh", "-c", f"({piped}) | head -1"], capture_output=True, text=True, check=True)
    assert ended.stderr == "code 0\n", ended.stderr


def main() -> None:
    tries = [
        what_readme_types_gives_the_numbers_that_it_shows,
        the_package_is_the_command,
        a_command_does_not_wait_for_numpy,
        exit_codes_are_those_of_the_command,
        a_run_says_how_it_was_called,
        processes_of_nodes_give_the_same_bits,
        nodes_in_python_fire_and_are_swept,
        another_build_is_not_answered_from_the_store_of_this_one,
        files_of_the_current_folder_are_not_imported,
        the_module_of_3d_slicer_is_in_the_wheel,
        pages_are_served,
        ctrl_c_stops_a_run_in_order,
        a_reader_may_stop_reading,
    ]
    import numpy

    print(f"Python {sys.version.split()[0]}, numpy {numpy.__version__}, {sys.platform}")
    assert shutil.which("cargo") is None and shutil.which("rustc") is None, "Rust is here"
    for attempt in tries:
        begun = time.monotonic()
        attempt()
        print(f"ok  {time.monotonic() - begun:5.1f} s  {attempt.__name__.replace('_', ' ')}", flush=True)


if __name__ == "__main__":
    main()
