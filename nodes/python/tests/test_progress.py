"""Progress on a terminal, and only there."""

import os
import re
import subprocess
import sys
import threading

import pytest
from conftest import TWO_FILES, small_sweep

pty = pytest.importorskip("pty", reason="there are no pseudo-terminals")


def shown_on_a_terminal(code):
    """What a program in Python writes to stderr, which is a terminal 120 wide."""
    import fcntl
    import struct
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 120, 0, 0))
    text = bytearray()

    def read():
        try:
            while some := os.read(ours, 65536):
                text.extend(some)
        except OSError:
            pass  # Linux ends a terminal whose other side is closed by EIO.

    reader = threading.Thread(target=read)
    reader.start()
    environment = {**os.environ, "TERM": "xterm"}
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.DEVNULL, stderr=theirs, env=environment)
    os.close(theirs)
    assert process.wait(120) == 0, text.decode()
    reader.join(10)
    os.close(ours)
    return text.decode()


def on_executor(graph, progress):
    return (
        "import osteoflow, time, concurrent.futures as f\n"
        "class Slow(f.ThreadPoolExecutor):\n"
        "    def submit(self, task, *a):\n"
        "        return super().submit(lambda: (time.sleep(0.2), task(*a))[1])\n"
        f"with Slow(1) as executor: osteoflow.sweep({str(graph)!r}, executor=executor, progress={progress})\n"
    )


def test_a_sweep_on_an_executor_counts_its_runs_and_removes_the_line(tmp_path):
    text = shown_on_a_terminal(on_executor(small_sweep(tmp_path), True))
    counts = [int(n) for n in re.findall(r"(\d)/6 runs", text)]
    assert counts == sorted(counts) and {1, 5} <= {*counts}, counts
    assert text.rstrip("\r\n").endswith("\x1b[2K") or text.rstrip("\r\n").endswith("\x1b[K"), repr(text[-80:])


def test_a_lost_task_is_named(tmp_path):
    code = (
        "import osteoflow, time, concurrent.futures as f\n"
        "class Loses(f.ThreadPoolExecutor):\n"
        "    n = 0\n"
        "    def submit(self, task, *a):\n"
        "        self.n += 1\n"
        "        n = self.n\n"
        "        return super().submit(lambda: (time.sleep(0.3), 1 / (n > 1), task(*a))[2])\n"
        f"with Loses(1) as executor: osteoflow.sweep({str(small_sweep(tmp_path))!r}, executor=executor)\n"
    )
    assert "task 1 is submitted again: ZeroDivisionError" in shown_on_a_terminal(code)


def test_progress_false_shows_nothing_and_neither_does_a_pipe(tmp_path):
    graph = small_sweep(tmp_path)
    assert shown_on_a_terminal(on_executor(graph, False)) == ""
    words = [sys.executable, "-c", on_executor(graph, True)]
    assert subprocess.run(words, capture_output=True, text=True, check=True, timeout=120).stderr == ""


def test_runs_and_sweeps_show_the_bar_of_the_command(tmp_path):
    import_it = "import osteoflow; "
    text = shown_on_a_terminal(f"{import_it}osteoflow.Graph({str(TWO_FILES)!r}).run(wires=None)")
    assert re.search(r"\d/\d+ nodes", text), repr(text)
    sweep = "{'sweep.repeat': 500, 'sweep.factor.shape.values': [1]}"
    text = shown_on_a_terminal(f"{import_it}osteoflow.sweep({str(small_sweep(tmp_path))!r}, {sweep}, share=False)")
    assert re.search(r"\d+/500 runs", text), repr(text)
