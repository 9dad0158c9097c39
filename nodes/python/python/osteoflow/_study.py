"""A sweep whose rows are asked for one by one, such as by an optimiser."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Iterable, Iterator, Mapping, Optional, Sequence, Union

from . import _core

Settings = Union[Mapping[str, Any], Sequence[str]]


class Row(Mapping):
    """A row of a study: a mapping of the columns to their numbers or words, `row["tre_mm"]`; None where the run has none.

    status : "complete", "refused" (its procedure or its verdict refused it) or "failed" (it could not be run). Only a complete row
        has all results; refused ones may have some columns.
    reason : why it is not complete, or None.
    verdict : the answer of the verdict, or None if nothing judged the run.
    settings : dict, what was asked for, the repeat and the draws.
    run, seed : its number in the folder, and its seed.
    results : dict, the content of its results.json.
    warnings : of nodes, one sentence each.
    """

    def __init__(self, text: str) -> None:
        row = json.loads(text)
        self._columns: dict[str, Any] = row["columns"]
        self.run: int = row["run"]
        self.seed: int = row["seed"]
        self.status: str = row["status"]
        self.reason: Optional[str] = row["reason"]
        self.verdict: Optional[str] = row["verdict"]
        self.settings: dict[str, Any] = row["values"]
        self.warnings: list[str] = row["warnings"]
        self.results: dict[str, Any] = row["results"] or {}

    def __getitem__(self, column: str) -> Any:
        try:
            return self._columns[column]
        except KeyError:
            columns = ", ".join(self._columns) or "none"
            raise KeyError(f"there is no column {column!r}; [sweep.columns] of the graph has {columns}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        columns = ", ".join(f"{name} = {value}" for name, value in self._columns.items())
        why = "" if self.reason is None else f": {self.reason}"
        return f"<row {self.run}, {self.status}, {columns}{why}>"


class Study:
    """A sweep whose rows are asked for one by one: `Study("fibula.toml", out="S").run({"icp.max_pair_distance_mm": 3.0})`.

    The rows go into the folder `out` as those of a sweep (docs/use/sweeps.md); `close`, or leaving a with statement, writes its
    tables and its summary. What was asked for before is answered from the folder, with the same bits. Nodes that rows share are
    computed once, and processes of plugins serve all rows.

    graph : the graph file. Of its [sweep] hold columns, points, limits, same_seed, twice, and what is drawn for each repeat;
        factors and comparisons do not.
    out : the folder; new or empty.
    columns : columns in addition to those of the graph: {"tre_mm": "metrics.tre_true_mm.mean_abs.norm"}, paths in results.json.
    set : changes of the graph in all rows.
    resume : go on with the study in `out`: refused with another graph, input, plugin or program, by name.
    retry_failed : run failed rows again when they are asked for again.
    workers : number of rows at a time; the rows do not depend on it. Default: the number of cores.

    Raises UsageError with all faults of the graph.
    """

    def __init__(
        self,
        graph: Union[str, "os.PathLike[str]"],
        *,
        out: Union[str, "os.PathLike[str]"],
        columns: Optional[Mapping[str, str]] = None,
        set: Union[Settings, None] = None,
        resume: bool = False,
        retry_failed: bool = False,
        workers: Optional[int] = None,
        share: bool = True,
        cache: bool = True,
        plugins: Sequence[Union[str, "os.PathLike[str]"]] = (),
        progress: bool = True,
    ) -> None:
        sets = _core.setting_texts(set) + _core.setting_texts({f"sweep.columns.{name}": path for name, path in (columns or {}).items()})
        files = [os.fspath(file) for file in plugins]
        self.out = Path(out)
        self.progress = progress
        self._core = _core.Sweep(os.fspath(graph), sets, files, self.out, resume, retry_failed, workers, share, cache).study()

    def run(self, settings: Settings = (), repeat: int = 0) -> Row:
        """The row of these settings: {"icp.max_pair_distance_mm": 3.0}, keys as `--set` takes them.

        repeat : number of the repeat; its seed is graph.seed + repeat, and what the graph draws is drawn by it.

        A run that is refused or fails, also for settings with a fault, is a row with its status and its reason. Raises UsageError
        for keys that no row may set; OsteoflowError if the graph or an input has changed since the study began; KeyboardInterrupt.
        """
        return Row(self._core.run([(settings, repeat)], self.progress)[0])

    def run_many(self, settings: Iterable[Settings], repeats: int = 1) -> list[Row]:
        """The rows of many settings, each with the repeats 0 to `repeats` - 1, run on the workers; in this order."""
        asks = [(one, repeat) for one in settings for repeat in range(repeats)]
        return [Row(row) for row in self._core.run(asks, self.progress)]

    def close(self) -> None:
        """Write runs.csv, points.csv and summary.json of all rows so far. More rows may follow."""
        self._core.close()

    def __enter__(self) -> Study:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()
