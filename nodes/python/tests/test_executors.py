"""Sweeps on executors: the same bytes whatever the executor does, or an error that says what it did."""

import hashlib
import io
import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import osteoflow
import pytest
from conftest import ROOT, assert_same_sweep, graph_with_sweep, small_sweep


#: Answers by the arguments of their task, so that the same is computed once.
ANSWERS = {}


def answer_of(task, arguments):
    key = str(arguments[:-1])
    if key not in ANSWERS:
        ANSWERS[key] = task(*arguments)
    return dict(ANSWERS[key])


class Alters(ThreadPoolExecutor):
    """Changes the first `n` answers."""

    def __init__(self, change, n=1):
        super().__init__(2)
        self.change, self.n, self.n_submitted = change, n, 0

    def submit(self, task, *arguments):
        self.n_submitted += 1
        if self.n_submitted > self.n:
            return super().submit(answer_of, task, arguments)
        return super().submit(lambda: self.change(answer_of(task, arguments), task, arguments))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A small sweep, and its folder of one machine."""
    folder = tmp_path_factory.mktemp("small")
    graph = small_sweep(folder)
    osteoflow.sweep(graph, out=folder / "alone")
    return graph, folder / "alone"


def with_content(answer, content):
    """The answer with another shard, as if the worker had sent it."""
    return {**answer, "shard": content, "sha256": hashlib.sha256(content).hexdigest()}


def edited(content, edit):
    """The tar of a shard after `edit` of its sweep.json."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=io.BytesIO(content)) as tar, tarfile.open(fileobj=packed, mode="w") as out:
        for member in tar:
            data = tar.extractfile(member).read() if member.isfile() else None
            if member.name == "sweep.json":
                about = json.loads(data)
                edit(about)
                data = json.dumps(about).encode()
                member.size = len(data)
            out.addfile(member, None if data is None else io.BytesIO(data))
    return packed.getvalue()


def of_next(task, arguments):
    """The answer for the next task."""
    graph, common, folder, index, of, ticket = arguments
    return answer_of(task, (graph, common, folder, index % of + 1, of, ticket))


def raises(error):
    def change(*_):
        raise error

    return change


#: Answers that are not those of the task, and what the error says of them.
DAMAGES = {
    "another task": (lambda answer, task, a: of_next(task, a), "answered for task 2 of 6"),
    "another shard under this number": (
        lambda answer, task, a: with_content(answer, of_next(task, a)["shard"]), r"it has the runs \[1\], but was asked for \[0\]",
    ),
    "truncated": (lambda answer, *_: {**answer, "shard": answer["shard"][:-100]}, "its SHA-256 is another"),
    "truncated by the worker": (lambda answer, *_: with_content(answer, answer["shard"][:-100]), "is damaged"),
    "one bit": (
        lambda answer, *_: {**answer, "shard": answer["shard"][:50] + bytes([answer["shard"][50] ^ 1]) + answer["shard"][51:]},
        "its SHA-256 is another",
    ),
    "no shard": (lambda answer, *_: with_content(answer, b""), "is damaged"),
    "nothing": (lambda *_: None, "NoneType"),
    "a broken pool": (raises(BrokenProcessPool("a worker died")), "a worker died"),
    "an exception of the scheduler": (raises(RuntimeError("KilledWorker")), "KilledWorker"),
    "a module that is missing": (raises(ModuleNotFoundError("osteoflow")), "ModuleNotFoundError"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_lost_or_damaged_answer_is_computed_again_and_three_end_the_sweep_by_name(name, small, tmp_path):
    graph, alone = small
    change, said = DAMAGES[name]
    with Alters(change) as executor:
        osteoflow.sweep(graph, out=tmp_path / "swept", executor=executor)
        assert executor.n_submitted == 7, "six tasks, and one again"
    assert_same_sweep(tmp_path / "swept", alone)

    def of_the_first(answer, task, arguments):
        return change(answer, task, arguments) if arguments[3] == 1 else answer

    with Alters(of_the_first, n=100) as executor:
        with pytest.raises(osteoflow.OsteoflowError, match=f"run 0 was lost 3 times: .*{said}"):
            osteoflow.sweep(graph, out=tmp_path / "failed", executor=executor)
    assert not (tmp_path / "failed").exists()


class Cancels(ThreadPoolExecutor):
    """Cancels the first `n` tasks, without a word to those who wait."""

    def __init__(self, n):
        super().__init__(2)
        self.n = n

    def submit(self, task, *arguments):
        if self.n == 0:
            return super().submit(answer_of, task, arguments)
        self.n -= 1
        future = Future()
        future.cancel()
        return future


def test_a_cancelled_task_is_submitted_again(small, tmp_path):
    graph, alone = small
    with Cancels(2) as executor:
        osteoflow.sweep(graph, out=tmp_path / "swept", executor=executor)
    assert_same_sweep(tmp_path / "swept", alone)
    with Cancels(100) as executor, pytest.raises(osteoflow.OsteoflowError, match="was lost 3 times: CancelledError"):
        osteoflow.sweep(graph, executor=executor)


class Twice(ThreadPoolExecutor):
    """Runs each task twice."""

    def submit(self, task, *arguments):
        return super().submit(lambda: [task(*arguments), task(*arguments)][-1])


def test_a_task_that_runs_twice_changes_nothing(small, tmp_path):
    graph, alone = small
    with Twice(2) as executor:
        osteoflow.sweep(graph, out=tmp_path / "swept", executor=executor)
    assert_same_sweep(tmp_path / "swept", alone)


def test_an_executor_that_takes_no_task_is_an_error_that_says_so(small):
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(osteoflow.OsteoflowError, match="the executor takes no more tasks.*after shutdown"):
        osteoflow.sweep(small[0], executor=executor)


def test_what_is_wrong_is_said_before_the_first_task(small, tmp_path):
    graph, alone = small
    with Alters(raises(AssertionError("a task ran")), n=100) as executor:
        with pytest.raises(osteoflow.UsageError, match="alone is not empty"):
            osteoflow.sweep(graph, out=alone, executor=executor)
        with pytest.raises(osteoflow.UsageError, match="tasks is 0"):
            osteoflow.sweep(graph, executor=executor, tasks=0)
        with pytest.raises(osteoflow.UsageError, match="not resumed"):
            osteoflow.sweep(graph, out=alone, executor=executor, resume=True)
        with pytest.raises(osteoflow.UsageError, match="shapes"):
            osteoflow.sweep(graph, set={"sweep.factor.shapes": 1}, executor=executor)
        assert executor.n_submitted == 0
    with pytest.raises(osteoflow.UsageError, match="tasks is for an executor"):
        osteoflow.sweep(graph, tasks=2)


def test_a_task_may_have_several_runs(small, tmp_path):
    graph, alone = small
    for tasks, n_submitted in [(1, 1), (4, 4), (7, 6)]:
        with Alters(None, n=0) as executor:
            osteoflow.sweep(graph, out=tmp_path / f"{tasks}", executor=executor, tasks=tasks)
            assert executor.n_submitted == n_submitted
        assert_same_sweep(tmp_path / f"{tasks}", alone)


def test_runs_that_fail_are_rows_as_on_one_machine(tmp_path):
    graph = graph_with_sweep(tmp_path)
    settings = {"icp.max_pair_distance_mm": 0.001, "sweep.repeat": 1}
    osteoflow.sweep(graph, settings, out=tmp_path / "alone")
    with ThreadPoolExecutor(2) as executor:
        rows = osteoflow.sweep(graph, settings, out=tmp_path / "swept", executor=executor, table="dicts")
    assert [row["status"] for row in rows] == ["refused", "refused"]
    assert_same_sweep(tmp_path / "swept", tmp_path / "alone")


def test_a_worker_with_another_sweep_is_refused_by_name(files, tmp_path):
    graph = graph_with_sweep(tmp_path)
    scan = tmp_path / "scan.ply"
    shutil.copy(files / "scan.ply", scan)
    text = graph.read_text()

    def refused(on_worker, expected, tasks=1):
        """Sweeps where the worker does something before its task."""

        class Other(ThreadPoolExecutor):
            def submit(self, task, *arguments):
                return super().submit(lambda: on_worker(task, arguments))

        with Other(1) as executor, pytest.raises(osteoflow.UsageError, match=expected):
            osteoflow.sweep(graph, {"scan.path": str(scan), "sweep.repeat": 1}, executor=executor, tasks=tasks)

    def with_file(file, content):
        def on_worker(task, arguments):
            before = file.read_bytes()
            file.write_bytes(content)
            try:
                return task(*arguments)
            finally:
                file.write_bytes(before)

        return on_worker

    other_scan = (files / "laser_p1.ply").read_bytes()
    refused(with_file(scan, other_scan), "worker .* has another sweep: input file .*scan.ply: it sha256 .*the same files")
    other_graph = text.replace("extends", "graph.seed = 99\nextends", 1).encode()
    refused(with_file(graph, other_graph), r"has another sweep: \[graph\] seed: it 99, the other 1")
    refused(with_file(graph, b"[graph]"), "worker .*: .*")
    refused(lambda task, a: {**task(*a), "version": "0.0.9"}, "has osteoflow 0.0.9, but here is 0.2.0")
    refused(lambda task, a: task(*a[:2], "/nowhere", *a[3:]), "there is no folder /nowhere")

    # The package with another compiled part: a byte more at its end.
    package = Path(osteoflow.__file__).parent
    other = tmp_path / "site" / "osteoflow"
    shutil.copytree(package, other, ignore=shutil.ignore_patterns("__pycache__"))
    library = next(file for file in other.iterdir() if file.suffix in (".so", ".pyd"))
    with open(library, "ab") as end:
        end.write(b"\0")

    def of_other_build(task, arguments):
        code = "import pickle, sys; task, a = pickle.load(sys.stdin.buffer); sys.stdout.buffer.write(pickle.dumps(task(*a)))"
        environment = {**os.environ, "PYTHONPATH": str(other.parent)}
        given = pickle.dumps((task, arguments))
        ran = subprocess.run([sys.executable, "-c", code], input=given, capture_output=True, env=environment, check=True)
        return pickle.loads(ran.stdout)

    refused(of_other_build, "has another sweep: program, sha256: it ")


def test_processors_with_other_features_are_a_warning(small, tmp_path):
    graph, alone = small

    def old(about):
        about["command"]["cpu_features"] = ["sse2"]

    with Alters(lambda answer, *_: with_content(answer, edited(answer["shard"], old)), n=2) as executor:
        with pytest.warns(osteoflow.OsteoflowWarning, match="2 of 6 tasks ran on a processor with other features"):
            osteoflow.sweep(graph, out=tmp_path / "swept", executor=executor)
    assert_same_sweep(tmp_path / "swept", alone)


def test_a_pool_of_processes_gives_the_bytes_of_one_machine(tmp_path):
    graph = graph_with_sweep(tmp_path)
    settings = {"sweep.repeat": 1}
    osteoflow.sweep(graph, settings, out=tmp_path / "alone")
    with ProcessPoolExecutor(2) as processes:
        osteoflow.sweep(graph, settings, out=tmp_path / "swept", executor=processes)
    assert_same_sweep(tmp_path / "swept", tmp_path / "alone")


def distributed():
    """dask.distributed, whose tests are left out by name where it is missing."""
    pytest.importorskip("dask", reason="Dask is not installed")
    return pytest.importorskip("distributed", reason="dask.distributed is not installed")


class Counts:
    """An executor that counts its tasks, and calls `done` when one of them has ended."""

    def __init__(self, executor, done=lambda: None):
        self.executor, self.done, self.n_submitted = executor, done, 0

    def submit(self, *arguments):
        self.n_submitted += 1
        future = self.executor.submit(*arguments)
        future.add_done_callback(lambda future: self.done())
        return future


@pytest.fixture(scope="module")
def registrations(tmp_path_factory):
    """A sweep of six registrations for Dask, and its folder of one machine."""
    distributed()
    folder = tmp_path_factory.mktemp("registrations")
    graph = graph_with_sweep(folder)
    osteoflow.sweep(graph, {"sweep.repeat": 3}, out=folder / "alone")
    return graph, {"sweep.repeat": 3}, folder / "alone"


def test_two_workers_of_dask_give_the_bytes_of_one_machine(registrations, tmp_path):
    dask = distributed()
    graph, settings, alone = registrations
    with dask.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        with dask.Client(cluster) as client:
            executor = Counts(client.get_executor())
            osteoflow.sweep(graph, settings, out=tmp_path / "swept", executor=executor)
            assert executor.n_submitted == 6
            ran = client.run(os.getpid)
            assert len(ran) == 2 and os.getpid() not in ran.values(), "two processes of their own"
    assert_same_sweep(tmp_path / "swept", alone)


def test_a_worker_of_dask_that_is_killed_in_the_middle_changes_nothing(registrations, tmp_path):
    dask = distributed()
    import dask as configuration

    graph, settings, alone = registrations
    killed = []
    # No failures allowed: Dask gives up the task of the killed worker at once, so that the sweep must submit it again.
    with configuration.config.set({"distributed.scheduler.allowed-failures": 0}):
        with dask.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
            with dask.Client(cluster) as client:
                pid_of = client.run(os.getpid)

                def kill():
                    """Kills a worker while it runs a task, once another task has ended."""
                    if killed:
                        return
                    while not (busy := [worker for worker, calls in client.call_stack().items() if calls]):
                        time.sleep(0.01)
                    killed.append(busy[0])
                    os.kill(pid_of[busy[0]], signal.SIGKILL)

                executor = Counts(client.get_executor(), lambda: started.set())
                started = threading.Event()
                killer = threading.Thread(target=lambda: started.wait(60) and kill())
                killer.start()
                osteoflow.sweep(graph, settings, out=tmp_path / "swept", executor=executor)
                killer.join()
    assert len(killed) == 1
    assert executor.n_submitted > 6, "the task of the killed worker was submitted again"
    assert_same_sweep(tmp_path / "swept", alone)


def examples():
    """The Python of docs/use/clusters.md, by the first word of its comment."""
    page = (ROOT / "docs/use/clusters.md").read_text()
    blocks = re.findall(r"^```python\n# (\w+)(.*?)^```", page, re.MULTILINE | re.DOTALL)
    return {name: f"# {name}{rest}" for name, rest in blocks}


@pytest.mark.parametrize("name, needs", [("The", "osteoflow"), ("Dask", "distributed"), ("Ray", "ray")])
def test_the_examples_of_the_page_give_the_tables_of_one_machine(name, needs, small, tmp_path):
    pytest.importorskip(needs, reason=f"{needs} is not installed")
    graph, alone = small
    shutil.copy(graph, tmp_path / "study.toml")
    (tmp_path / "study.py").write_text(examples()[name])
    ran = subprocess.run([sys.executable, "study.py"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "study/runs.csv").read_bytes() == (alone / "runs.csv").read_bytes()


def test_the_page_has_three_examples():
    assert list(examples()) == ["Dask", "The", "Ray"]
