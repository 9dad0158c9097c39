"""What a sweep on an executor costs: the time and bytes of a task, and the gain of a second worker.

    python compare_executors.py [--rows 12] [--repeat 5]

Prints the figures of docs/project/measured.md: rows of a few milliseconds, which show the cost of a task, and registrations, on one and on
two worker processes. All are measured in turn; a row shows the fastest, and the gain is that of each turn. Nothing is taken from
the store.
"""

import argparse
import os
import pickle
import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import osteoflow

ROOT = Path(__file__).resolve().parents[2]

SMALL = """
[graph]
format = 1
name   = "small"

[node.plan]
kind         = "plan.simulated"
bone.edge_mm = 5.0

[results]
landmarks = "plan.landmarks"

[sweep]
repeat = {rows}

[sweep.columns]
x_mm = "landmarks.P1.position_mm.0"
"""

REGISTRATIONS = f"""
extends = "{(ROOT / "graphs/two_files.toml").as_posix()}"

[sweep]
repeat = {{rows}}

[sweep.columns]
rms_mm = "icp.rms_mm"
"""


class Measures(ProcessPoolExecutor):
    """Keeps the size of each task and of its answer."""

    def __init__(self, workers):
        super().__init__(workers)
        self.sent, self.answers = [], []

    def submit(self, task, *arguments):
        self.sent.append(len(pickle.dumps((task, arguments))))
        future = super().submit(task, *arguments)
        future.add_done_callback(lambda future: self.answers.append(len(pickle.dumps(future.result()))))
        return future


def seconds(graph, **options):
    began = time.perf_counter()
    osteoflow.sweep(graph, table="dicts", progress=False, **options)
    return time.perf_counter() - began


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=12)
    parser.add_argument("--repeat", type=int, default=5)
    asked = parser.parse_args()
    os.environ["OSTEOFLOW_CACHE"] = "off"
    with tempfile.TemporaryDirectory() as folder:
        for name, text in [("small", SMALL), ("registrations", REGISTRATIONS)]:
            graph = Path(folder, f"{name}.toml")
            graph.write_text(text.format(rows=asked.rows))
            times = {"alone": [], "1 worker": [], "2 workers": [], "2 workers, 4 tasks": []}
            with Measures(1) as one, Measures(2) as two, ProcessPoolExecutor(2) as other:
                for executor in (one, two, other):
                    list(executor.map(int, range(4)))
                for _ in range(asked.repeat):
                    times["alone"].append(seconds(graph, workers=1, share=False))
                    times["1 worker"].append(seconds(graph, executor=one, share=False))
                    times["2 workers"].append(seconds(graph, executor=two, share=False))
                    times["2 workers, 4 tasks"].append(seconds(graph, executor=other, tasks=4, share=False))
                row = {key: min(all_s) / asked.rows for key, all_s in times.items()}
                print(f"{name}: {asked.rows} rows, {asked.repeat} times")
                for key, row_s in row.items():
                    print(f"  {key:20} {1e3 * row_s:8.1f} ms a row")
                print(f"  a task costs {1e3 * (row['1 worker'] - row['alone']):.1f} ms more than its row")
                gains = [a / b for a, b in zip(times["1 worker"], times["2 workers"])]
                print(f"  two workers are {statistics.median(gains):.2f} times faster than one ({min(gains):.2f} to {max(gains):.2f})")
                sent, answers = statistics.median(one.sent), statistics.median(one.answers)
                print(f"  a task is {sent:.0f} bytes, its answer {answers:.0f}")


if __name__ == "__main__":
    main()
