"""Follows docs/begin/first-week.md with an installed wheel: every command in the order of the page, each with the exit code it must have.

wheel.py runs it after try_wheel.py, in a folder with nothing but the page. Unlike the test of the page in the checkout, which compares
every line, it compares the first line of what each command prints; and it lets pip install what the page names.
"""

from __future__ import annotations

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

PAGE = Path("first-week.md").resolve()
START = Path("reader").resolve()
COMMAND = str(Path(sys.executable).with_name("osteoflow"))
#: Seconds that one command may take.
LIMIT_S = 300
#: The one command of the page that is refused.
REFUSED = "osteoflow register wound/bone.stl wound/scan.ply --camera 0,0,0"
#: Files that the page says its commands leave.
LEFT = """week/bone.stl two/report.html two/export/scan.vtk week.mrb scan.vtk registered/pose.tfm my_procedure/first/run.mcap
    my_procedure/first/report.html my_icp/S/report.html my_icp/S/citations.bib my_icp/S/runs.csv my_icp/study.zip""".split()


def blocks() -> list[tuple[str, list[str]]]:
    """The page's blocks of code: what follows the three marks, and the lines."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.findall(r"^```(\S[^\n]*)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [(kind, body.splitlines()) for kind, body in found]


def commands(lines: list[str]) -> list[str]:
    bare = (line.split(" #")[0].strip() for line in lines)
    return [command for line in bare if line for command in line.split(" && ")]


def served(words: list[str], at: Path) -> tuple[int, str]:
    """Opens the page that a command serves, waits for the results of its run, and interrupts it as the reader would."""
    results = at / words[words.index("--out") + 1] / "results.json"
    process = subprocess.Popen(words, cwd=at, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, encoding="utf-8")
    try:
        address = next(found.group() for line in process.stderr if (found := re.search(r"http://\S+", line)))
        page = urllib.request.urlopen(address, timeout=60).read().decode()
        assert "<html" in page, page[:200]
        until = time.monotonic() + LIMIT_S
        while not results.exists():
            assert time.monotonic() < until and process.poll() is None, f"{words}: {results} does not come"
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=60)[0] or ""
        return (0 if process.returncode == 130 else process.returncode), said
    finally:
        process.kill()
        process.wait()


def follow(command: str, at: Path) -> tuple[int, str, Path]:
    """Exit code and output of a command, and the folder in which the reader is after it."""
    words = shlex.split(command)
    if words[0] == "cd":
        at = (at / words[1]).resolve()
        assert at.is_relative_to(START), f"{command} leaves the folder"
        return 0, "", at
    words[0] = {"osteoflow": COMMAND, "python3": sys.executable}[words[0]]
    if words[1] == "view":
        return (*served(words, at), at)
    ended = subprocess.run(
        words, cwd=at, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8", timeout=LIMIT_S, check=False
    )
    return ended.returncode, ended.stdout, at


def without_numbers(line: str) -> str:
    """A line of which durations and last digits may differ."""
    return re.sub(r"-?[0-9]+(\.[0-9]+)?", "#", line)


def main() -> None:
    assert shutil.which("cargo") is None and shutil.which("rustc") is None, "Rust is here"
    if os.name != "posix" or sys.version_info < (3, 10):
        print("skipped: a node in Python needs Linux or macOS and Python 3.10")
        return
    START.mkdir()
    os.environ["NO_COLOR"] = "1"
    at, printed, n_commands, n_compared = START, None, 0, 0
    for kind, lines in blocks():
        if kind.startswith("file "):
            (at / kind[len("file "):]).write_text("\n".join(lines) + "\n", encoding="utf-8")
        elif kind == "text" and printed is not None:
            shown = [without_numbers(line) for line in printed.splitlines()]
            assert without_numbers(lines[0]) in shown, f"the page shows {lines[0]!r}, but this is printed:\n{printed}"
            n_compared += 1
        printed = None
        if kind != "sh":
            continue
        for command in commands(lines):
            begun = time.monotonic()
            code, printed, at = follow(command, at)
            expected = 3 if command == REFUSED else 0
            assert code == expected, f"{command}: exit code {code} instead of {expected}\n{printed}"
            n_commands += 1
            print(f"ok  {time.monotonic() - begun:5.1f} s  {command}", flush=True)
    missing = [name for name in LEFT if not (START / name).is_file()]
    assert not missing, f"{missing} are not there"
    assert n_commands >= 25 and n_compared >= 5, (n_commands, n_compared)


if __name__ == "__main__":
    main()
