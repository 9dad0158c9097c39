"""Studies: the rows are those of a sweep, asked for one by one."""

import csv
import json
import subprocess
import sys

import pytest
from conftest import small_sweep

import osteoflow

KEY = "plan.bone.shape_seed"


def rows_of(folder):
    with open(folder / "runs.csv", newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def runs_of(folder):
    return {file.name: file.read_bytes() for file in sorted((folder / "runs").glob("*.json"))}


def test_rows_that_are_asked_for_are_those_of_a_sweep(tmp_path, command):
    graph = small_sweep(tmp_path)
    ended = command("sweep", graph, "--out", tmp_path / "swept")
    assert ended.returncode == 0, ended.stderr
    with osteoflow.Study(graph, out=tmp_path / "study", progress=False) as study:
        rows = study.run_many([{KEY: seed} for seed in (1, 2, 3)], repeats=2)
        assert [row.run for row in rows] == [0, 1, 2, 3, 4, 5]
        again = study.run({KEY: 2}, repeat=1)
        assert (again.run, dict(again)) == (3, dict(rows[3]))
        assert again.settings == {KEY: 2, "repeat": 1} and again.status == "complete" and again.seed == 4
    swept, asked = rows_of(tmp_path / "swept"), rows_of(tmp_path / "study")
    assert [{**row, KEY: row["shape"]} for row in swept] == [{**row, "shape": row[KEY]} for row in asked]
    design = json.loads((tmp_path / "study" / "sweep.json").read_text())
    assert design["origin"] == "asked" and design["n_runs"] == 6
    one = json.loads((tmp_path / "study" / "runs" / "000003.json").read_text())
    assert one["asked"]["settings"] == [f"{KEY}=2"]
    summary = json.loads((tmp_path / "study" / "summary.json").read_text())
    assert summary["n_runs"] == 6 and len(summary["groups"]) == 3
    alone = command("sweep", tmp_path / "study", "--only", 3, "--record", tmp_path / "alone")
    assert alone.returncode == 0 and "other results" not in alone.stderr, alone.stderr
    assert json.loads((tmp_path / "alone" / "results.json").read_text())["landmarks"] == again.results["landmarks"]


def test_the_folder_does_not_depend_on_workers_batches_sharing_and_interruptions(tmp_path):
    graph = small_sweep(tmp_path)
    asks = [{KEY: seed} for seed in (4, 2, 9, 4)]
    for name, workers, share in [("a", 1, True), ("b", 3, False)]:
        with osteoflow.Study(graph, out=tmp_path / name, workers=workers, share=share, progress=False) as study:
            study.run_many(asks, repeats=2)
    with osteoflow.Study(graph, out=tmp_path / "c", progress=False) as study:
        for ask in asks:
            study.run(ask), study.run(ask, repeat=1)
    # A study whose process ended without a word, and lost a run.
    code = f"import osteoflow; s = osteoflow.Study({str(graph)!r}, out={str(tmp_path / 'd')!r}); s.run_many([{{{KEY!r}: 4}}, {{{KEY!r}: 2}}], 2)"
    subprocess.run([sys.executable, "-c", f"{code}; import os; os._exit(1)"], check=False)
    (tmp_path / "d" / "runs" / "000002.json").unlink()
    with osteoflow.Study(graph, out=tmp_path / "d", resume=True, progress=False) as study:
        assert [row.run for row in study.run_many(asks, repeats=2)] == [0, 1, 2, 3, 4, 5, 0, 1]
    for name in "bcd":
        assert runs_of(tmp_path / name) == runs_of(tmp_path / "a"), name
        for table in ("runs.csv", "points.csv", "summary.json"):
            assert (tmp_path / name / table).read_bytes() == (tmp_path / "a" / table).read_bytes(), (name, table)


def test_rows_that_cannot_be_run_say_why_and_do_not_raise(tmp_path):
    graph = small_sweep(tmp_path)
    with osteoflow.Study(graph, out=tmp_path / "s", columns={"y_mm": "landmarks.P1.position_mm.1"}, progress=False) as study:
        wrong = study.run({"plan.bone.shape_sed": 1})
        assert wrong.status == "failed" and "shape_sed" in wrong.reason and wrong["x_mm"] is None
        good = study.run({KEY: 1})
        assert good.status == "complete" and isinstance(good["y_mm"], float) and len(good) == 2
        with pytest.raises(KeyError, match="there is no column 'z_mm'.*x_mm, y_mm"):
            good["z_mm"]
    assert [row["status"] for row in rows_of(tmp_path / "s")] == ["failed", "complete"]


def test_what_cannot_be_asked_for_and_what_has_changed_is_refused_by_name(tmp_path, command):
    graph = small_sweep(tmp_path)
    study = osteoflow.Study(graph, out=tmp_path / "s", progress=False)
    for settings, why in [({"graph.seed": 3}, "another repeat"), ({"sweep.repeat": 3}, "what a run has"), (["x"], "is no setting")]:
        with pytest.raises(osteoflow.UsageError, match=why):
            study.run(settings)
    study.run({KEY: 1})
    with pytest.raises(osteoflow.UsageError, match="in use|is written"):
        osteoflow.Study(graph, out=tmp_path / "s", resume=True)
    graph.write_text(graph.read_text().replace("bone.edge_mm = 5.0", "bone.edge_mm = 4.0"))
    with pytest.raises(osteoflow.OsteoflowError, match="small.toml has changed"):
        study.run({KEY: 2})
    study.close()
    del study
    with pytest.raises(osteoflow.UsageError, match="holds a sweep already"):
        osteoflow.Study(graph, out=tmp_path / "s")
    with pytest.raises(osteoflow.UsageError, match=r"edge_mm: it 5\.0(?!.*\[sweep\])"):
        osteoflow.Study(graph, out=tmp_path / "s", resume=True)
    resumed = command("sweep", graph, "--out", tmp_path / "s", "--resume")
    assert resumed.returncode == 2 and "asked for one by one" in resumed.stderr


def test_an_optimiser_asks_for_rows(tmp_path):
    optuna = pytest.importorskip("optuna")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    graph = small_sweep(tmp_path)

    def optimise(out, n_trials, resume):
        with osteoflow.Study(graph, out=out, resume=resume, progress=False) as study:
            search = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=1))
            search.optimize(lambda trial: study.run({"plan.bone.edge_mm": trial.suggest_float("edge_mm", 3.0, 5.0)})["x_mm"], n_trials)
        return search.best_value

    best = optimise(tmp_path / "s", 6, resume=False)
    rows = rows_of(tmp_path / "s")
    assert len(rows) == 6 and best == min(float(row["x_mm"]) for row in rows)
    assert optimise(tmp_path / "cut", 3, resume=False) is not None
    assert optimise(tmp_path / "cut", 6, resume=True) == best
    assert runs_of(tmp_path / "cut") == runs_of(tmp_path / "s")


COUNTED = '''
from dataclasses import dataclass
from osteoflow_node import Text, param, source

N_BUILT = 0


@dataclass
class Params:
    n: int = param(0, doc="Any number.")


@source("counted.builds", output="text", unsteady=True)
class Builds:
    """How many nodes this process has built."""

    def __init__(self, params: Params):
        global N_BUILT
        N_BUILT += 1

    def items(self) -> Text:
        yield 0, Text(str(N_BUILT))
'''


def test_one_process_of_a_plugin_serves_the_rows_of_all_calls(tmp_path, monkeypatch):
    monkeypatch.setenv("OSTEOFLOW_PYTHON", sys.executable)
    (tmp_path / "counted.py").write_text(COUNTED)
    graph = tmp_path / "g.toml"
    graph.write_text(
        'plugins = ["counted.py"]\n[graph]\nformat = 1\n[node.a]\nkind = "counted.builds"\n[results]\nn = "a.text"\n'
        '[sweep]\ntwice = 0\n[sweep.columns]\nn = "n"\n'
    )
    with osteoflow.Study(graph, out=tmp_path / "s", workers=1, progress=False) as study:
        rows = [study.run({"a.n": n}) for n in (1, 2)] + study.run_many([{"a.n": 3}, {"a.n": 4}, {"a.n": 1}])
    assert [row["n"] for row in rows] == ["1", "2", "3", "4", "1"], rows
