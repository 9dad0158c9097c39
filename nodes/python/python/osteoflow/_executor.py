"""Runs of a sweep as tasks of a `concurrent.futures.Executor`."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tarfile
import tempfile
from concurrent.futures import FIRST_COMPLETED, CancelledError, wait
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

from . import _core

#: How often a run is submitted before the sweep fails.
ATTEMPTS = 3


def _run_shard(graph: str, common: list[str], index: int, of: int) -> bytes:
    """One shard of a sweep, as the tar of its folder. Runs on a worker."""
    with tempfile.TemporaryDirectory(prefix="osteoflow-shard-") as temporary:
        folder = os.path.join(temporary, "shard")
        # A process of its own: a worker may have been forked, which loses the threads of its parent.
        words = [sys.executable, "-m", "osteoflow", "sweep", "--quiet", *common, "--workers=1", f"--shard={index}/{of}"]
        ended = subprocess.run([*words, f"--out={folder}", "--", graph], capture_output=True, text=True, check=False)
        # 3: the run has no results, which is a row with its reason.
        if ended.returncode not in (0, 3):
            error = _core.UsageError if ended.returncode == 2 else _core.OsteoflowError
            raise error(ended.stderr.strip() or f"run {index} of {of} ended with exit code {ended.returncode}")
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w") as tar:
            tar.add(folder, arcname=".")
        return packed.getvalue()


def sweep_on(executor: Any, graph: str, common: list[str], folder: Path, temporary: Path) -> None:
    """Sweeps on `executor` and merges the shards in `folder`.

    A task that is cancelled, or whose worker is lost (BrokenExecutor, OSError, EOFError), is submitted again; an error of the
    sweep itself is raised.
    """
    n_runs = _core.n_runs([*common, "--", graph])
    attempts = dict.fromkeys(range(1, n_runs + 1), 1)

    def submit(index: int):
        return executor.submit(_run_shard, graph, common, index, n_runs)

    waiting = {submit(index): index for index in attempts}
    try:
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                index = waiting.pop(future)
                try:
                    packed = future.result()
                except (BrokenExecutor, CancelledError, OSError, EOFError) as lost:
                    if attempts[index] == ATTEMPTS:
                        message = f"run {index} of {n_runs} was lost {ATTEMPTS} times: {lost!r}"
                        raise _core.OsteoflowError(message) from lost
                    attempts[index] += 1
                    waiting[submit(index)] = index
                    continue
                shard = temporary / f"shard-{index}"
                with tarfile.open(fileobj=io.BytesIO(packed)) as tar:
                    if hasattr(tarfile, "data_filter"):
                        tar.extractall(shard, filter="data")
                    else:
                        tar.extractall(shard)
    finally:
        for future in waiting:
            future.cancel()
    shards = [str(temporary / f"shard-{index}") for index in sorted(attempts)]
    _core.sweep([f"--out={folder}", "--merge", *shards], False)
