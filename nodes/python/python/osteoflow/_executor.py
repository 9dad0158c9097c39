"""Shards of a sweep as tasks of a `concurrent.futures.Executor`."""

from __future__ import annotations

import hashlib
import io
import json
import os
import queue
import socket
import subprocess
import sys
import tarfile
import tempfile
import uuid
from pathlib import Path
from typing import Any, Callable, NamedTuple

from . import _core
from ._command import BEFORE

#: How often a task is submitted before the sweep fails.
ATTEMPTS = 3


class _Task(NamedTuple):
    """What a worker needs to know."""

    graph: str
    #: Options of the command.
    common: list[str]
    folder: str
    shard: int
    of: int
    #: Of this submission alone: Dask takes a task with the arguments of an earlier one for the same, also if that has failed.
    ticket: str


def _run_shard(graph: str, common: list[str], folder: str, index: int, of: int, ticket: str) -> dict[str, Any]:
    """One shard of a sweep, as the tar of its folder. Runs on a worker.

    An error of the sweep is an answer, too: whatever is raised is the loss of a worker.
    """
    answer: dict[str, Any] = {"version": _core.__version__, "host": socket.gethostname(), "index": index, "of": of}
    if not os.path.isdir(folder):
        return {**answer, "error": f"there is no folder {folder}, in which the sweep was started", "is_usage": True}
    with tempfile.TemporaryDirectory(prefix="osteoflow-shard-") as temporary:
        shard = os.path.join(temporary, "shard")
        # A process of its own: a worker may have been forked, which loses the threads of its parent.
        command = [sys.executable, *BEFORE, "sweep", "--quiet"]
        command += ["--workers=1", f"--shard={index}/{of}", f"--out={shard}", *common, "--", graph]
        ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
        if ended.returncode < 0:
            raise OSError(f"the process of task {index} of {of} was ended by signal {-ended.returncode}")
        # 3: no run has results, which are rows with their reasons.
        if ended.returncode not in (0, 3):
            error = ended.stderr.strip() or f"task {index} of {of} ended with exit code {ended.returncode}"
            return {**answer, "error": error, "is_usage": ended.returncode == 2}
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w:gz") as tar:
            for name in ["sweep.toml", "sweep.json", "runs"]:
                tar.add(os.path.join(shard, name), arcname=name)
        content = packed.getvalue()
        return {**answer, "shard": content, "sha256": hashlib.sha256(content).hexdigest()}


class _Damaged(Exception):
    """An answer that is not that of its task."""


def _unpack(answer: Any, task: _Task, runs: list[int], design: Path, shard: Path) -> None:
    """Writes the answer of a task into the folder `shard`.

    Raises _Damaged if it is not that of the task, UsageError if the worker has another sweep or program.
    """
    if not isinstance(answer, dict) or not {"version", "host", "index", "of"} <= answer.keys():
        raise _Damaged(f"the answer is {str(type(answer))}, not that of a task of osteoflow {_core.__version__}")
    worker = f"worker {answer['host']}"
    if answer["version"] != _core.__version__:
        raise _core.UsageError(f"{worker} has osteoflow {answer['version']}, but here is {_core.__version__}; install the same")
    if (answer["index"], answer["of"]) != (task.shard, task.of):
        raise _Damaged(f"{worker} answered for task {answer['index']} of {answer['of']}")
    if "error" in answer:
        raise (_core.UsageError if answer["is_usage"] else _core.OsteoflowError)(f"{worker}: {answer['error']}")
    content = answer.get("shard")
    if not isinstance(content, bytes) or hashlib.sha256(content).hexdigest() != answer.get("sha256"):
        raise _Damaged(f"the answer of {worker} was changed on its way: its SHA-256 is another")
    try:
        with tarfile.open(fileobj=io.BytesIO(content)) as tar:
            if hasattr(tarfile, "data_filter"):
                tar.extractall(shard, filter="data")
            else:
                tar.extractall(shard)
        _core.check_shard(str(design), str(shard), runs)
    except _core.UsageError as other:
        raise _core.UsageError(
            f"{worker} has another sweep: {other}; every worker needs the same files and the same build of osteoflow"
        ) from None
    except (tarfile.TarError, OSError, EOFError, ValueError) as damaged:
        raise _Damaged(f"the answer of {worker} is damaged: {damaged}") from damaged


def _cpu_features(folder: Path) -> Any:
    return json.loads((folder / "sweep.json").read_text(encoding="utf-8"))["command"].get("cpu_features")


def sweep_on(
    executor: Any, request: Callable[[Path], Any], graph: str, common: list[str], folder: Path, temporary: Path, tasks: int | None, progress: bool
) -> list[str]:
    """Sweeps on `executor`, merges the shards in `folder`, and returns warnings.

    A task whose future raises, is cancelled, or has an answer that is damaged or of another task, is submitted again.
    """
    if tasks is not None and tasks < 1:
        raise _core.UsageError(f"tasks is {tasks}, but must be at least 1")
    if folder.is_dir() and any(folder.iterdir()):
        raise _core.UsageError(f"{folder} is not empty; name another folder")
    design = temporary / "design"
    runs = request(design).shards(tasks)
    runs_of = dict(enumerate(runs, 1))
    attempts = dict.fromkeys(runs_of, 0)
    ended: queue.SimpleQueue = queue.SimpleQueue()
    waiting: dict[int, Any] = {}

    def submit(index: int) -> None:
        attempts[index] += 1
        task = _Task(graph, common, os.getcwd(), index, len(runs), uuid.uuid4().hex)
        try:
            future = executor.submit(_run_shard, *task)
        except Exception as closed:
            raise _core.OsteoflowError(
                f"the executor takes no more tasks, {len(waiting)} were under way: {closed!r}; give another executor"
            ) from closed
        waiting[index] = future
        # A callback is also called for a future that is cancelled without ever having run.
        future.add_done_callback(lambda _: ended.put((index, task, future)))

    bar = _core.SweepProgress(sum(map(len, runs)), progress)
    other_processors = set()
    try:
        for index in runs_of:
            submit(index)
        while waiting:
            index, task, future = ended.get()
            if waiting.get(index) is not future:
                continue
            del waiting[index]
            shard = temporary / f"shard-{index}-{attempts[index]}"
            try:
                _unpack(_result(future), task, runs_of[index], design, shard)
            except _Damaged as lost:
                if attempts[index] == ATTEMPTS:
                    what = f"run {runs_of[index][0]}" if len(runs_of[index]) == 1 else f"task {index} of {len(runs)}"
                    raise _core.OsteoflowError(f"{what} was lost {ATTEMPTS} times: {lost}") from lost
                bar.message(f"task {index} is submitted again: {lost}")
                submit(index)
                continue
            bar.ended(len(runs_of[index]))
            if _cpu_features(shard) != _cpu_features(design):
                other_processors.add(index)
    finally:
        bar.end()
        for future in waiting.values():
            future.cancel()
    shards = [str(temporary / f"shard-{index}-{attempts[index]}") for index in runs_of]
    _core.merge(shards, folder)
    if not other_processors:
        return []
    return [
        f"{len(other_processors)} of {len(runs)} tasks ran on a processor with other features than this one, where plugins, "
        "and off Linux all nodes, may give other bits; sweep.json has the features of each"
    ]


def _result(future: Any) -> Any:
    """The answer of a task; its loss is _Damaged, whatever the executor raises."""
    try:
        return future.result()
    except KeyboardInterrupt:
        raise
    except BaseException as lost:  # CancelledError of asyncio, as of Dask, is no Exception.
        raise _Damaged(f"{lost!r}") from lost
