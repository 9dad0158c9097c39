#!/usr/bin/env python3
"""Turns and shifts the scans of a public set at random, registers them by shape alone, and prints a table in Markdown.

benchmark.py FOLDER                            FOLDER/preoperative/NAME.stl and FOLDER/intraoperative/NAME*.xyz, mm, in one frame
benchmark.py FOLDER --set range                FOLDER/NAME.ply, FOLDER/bun.conf and FOLDER/bun_zipper.ply, metres
benchmark.py FOLDER --peers --python PYTHON    with Open3D and KISS-Matcher beside us (graphs/real/peers.py)
benchmark.py FOLDER --out DIR                  keeps the sweep in DIR; again with a larger --repeat, it adds starts to those there

Each row is a sweep of graphs/real/recover.toml. `preoperative_NAME.stl` and `intraoperative_NAME.xyz` beside each other are pairs, too.
It needs Python 3.9 and nothing else.
"""

import argparse
import collections
import csv
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ANSWERS = ["trusted", "doubtful", "refused"]


def pairs_in_one_frame(folder):
    """(name, surface, scan, true pose) of each scan whose surface is there."""
    names = [
        (sorted((folder / "preoperative").glob("*.stl")), sorted((folder / "intraoperative").glob("*.xyz")), ""),
        (sorted(folder.glob("preoperative_*.stl")), sorted(folder.glob("intraoperative_*.xyz")), "operative_"),
    ]
    found = []
    for surfaces, scans, mark in names:
        for scan in scans:
            name = scan.stem.split(mark)[-1] if mark else scan.stem
            fitting = [s for s in surfaces if name == (s.stem.split(mark)[-1] if mark else s.stem)]
            # The scans of several cameras share a surface.
            fitting = fitting or [s for s in surfaces if not mark and name.startswith(s.stem + "_")]
            if not fitting:
                print(f"{scan}: no surface of that name, left out", file=sys.stderr)
                continue
            found.append((name, max(fitting, key=lambda s: len(s.stem)), scan, None))
    if not found:
        sys.exit(f"{folder}: no pair of preoperative/NAME.stl and intraoperative/NAME.xyz; docs/method/real-sets.md has the layouts")
    return found


def range_pairs(folder, out):
    """The scans of bun.conf on the model. Its lines are translation in metres and quaternion x y z w of the inverse rotation."""
    found = []
    for line in (folder / "bun.conf").read_text().splitlines():
        words = line.split()
        if not words or words[0] != "bmesh" or not (folder / words[1]).exists():
            continue
        x, y, z, qx, qy, qz, qw = map(float, words[2:9])
        qx, qy, qz = -qx, -qy, -qz
        rows = [
            [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy), 1000 * x],
            [2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx), 1000 * y],
            [2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy), 1000 * z],
            [0, 0, 0, 1],
        ]
        truth = out / (Path(words[1]).stem + ".txt")
        truth.write_text("\n".join(" ".join(repr(float(c)) for c in row) for row in rows) + "\n")
        found.append((Path(words[1]).stem, folder / "bun_zipper.ply", folder / words[1], truth))
    if not found:
        sys.exit(f"{folder}/bun.conf: none of its scans is in the folder")
    return found


def toml(value):
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def values_of(pairs, is_range):
    of_range = {"bone.unit_mm": 1000.0, "scan.unit_mm": 1000.0, "score.right_mm": 1.5, "score.right_deg": 2.0}
    values = []
    for _, surface, scan, truth in pairs:
        value = {"bone.path": str(surface.resolve()), "scan.path": str(scan.resolve())}
        value.update({"perturb.truth": str(truth.resolve())} if truth else {})
        value.update(of_range if is_range else {})
        values.append(value)
    return values


def methods(is_range, has_kiss):
    """Ours, then each peer as fast and as good as its settings make it."""
    fast_mm, fine_mm = (5.0, 2.0) if is_range else (8.0, 4.0)

    def peer(kind, voxel_mm, **params):
        return {
            "coarse.kind": kind, "coarse.voxel_mm": voxel_mm, **{f"coarse.{key}": value for key, value in params.items()},
            "icp.kind": "peers.point_to_plane", "icp.first_mm": 2.0 * voxel_mm,
            "remove": ["node.verdict.in.icp", "node.verdict.in.start", "results.icp", "results.start", "record"],
        }

    found = {
        "osteoflow": {"coarse.kind": "coarse.global"},
        f"FPFH and RANSAC, {fast_mm:g} mm, 100,000": peer("peers.fpfh_ransac", fast_mm),
        f"FPFH and RANSAC, {fine_mm:g} mm, 4,000,000": peer("peers.fpfh_ransac", fine_mm, max_iterations=4_000_000),
    }
    if has_kiss:
        found[f"KISS-Matcher, {fast_mm:g} mm"] = peer("peers.kiss_matcher", fast_mm)
        found[f"KISS-Matcher, {fine_mm:g} mm"] = peer("peers.kiss_matcher", fine_mm)
    return found


def table(runs):
    """Rows of Markdown: of each method and pair, and of each method."""
    groups = collections.OrderedDict()
    for run in runs:
        method = run.get("method", "osteoflow")
        groups.setdefault((method, run["pair"]), []).append(run)
        groups.setdefault((method, "all"), []).append(run)
    several = len({pair for _, pair in groups}) > 2
    head = ["Method", "Pair", "Starts", "Right", "Recall", "Error of right, mm", "degrees", "Right: " + ANSWERS[0], *ANSWERS[1:],
            "Wrong: " + ANSWERS[0], *ANSWERS[1:], "no pose", "CPU of search, s", "of ICP, s"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    methods = list(dict.fromkeys(method for method, _ in groups))
    order = sorted(groups, key=lambda key: (methods.index(key[0]), key[1] == "all"))
    for (method, pair), group in ((key, groups[key]) for key in order):
        if pair == "all" and not several:
            continue
        is_right = [run.get("right") not in ("", None) and float(run["right"]) == 1.0 for run in group]
        right = [run for run, it in zip(group, is_right) if it]
        wrong = [run for run, it in zip(group, is_right) if not it and run.get("right")]

        def median(of, column, digits, unit=1):
            cells = [float(run[column]) / unit for run in of if run.get(column)]
            return f"{statistics.median(cells):.{digits}f}" if cells else ""

        def answers(of):
            return [sum(run.get("answer") == answer for run in of) for answer in ANSWERS]

        row = [method, pair, len(group), len(right), f"{len(right) / len(group):.2f}", median(right, "error_mm", 2), median(right, "error_deg", 2),
               *answers(right), *answers(wrong), len(group) - len(right) - len(wrong), median(group, "search_ms", 2, 1000),
               median(group, "icp_ms", 2, 1000)]
        lines.append("| " + " | ".join(map(str, row)) + " |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the set")
    parser.add_argument("--set", choices=["bones", "range"], default="bones", help="its layout")
    parser.add_argument("--repeat", type=int, default=10, help="number of starts of each pair")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", default="osteoflow")
    parser.add_argument("--out", type=Path, help="keeps the sweep here, and resumes the one that is there")
    parser.add_argument("--peers", action="store_true", help="other libraries beside us")
    parser.add_argument("--python", default=sys.executable, help="the interpreter that has them")
    parser.add_argument("--method", default="", help="of the methods with --peers those whose names have one of these words, separated by commas")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.out or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        is_range = given.set == "range"
        pairs = range_pairs(given.folder, folder) if is_range else pairs_in_one_frame(given.folder)
        sweep = {"factor": {"pair": {"values": values_of(pairs, is_range), "labels": [p[0] for p in pairs]}}}
        graph = [f"extends = {json.dumps(str(HERE / 'recover.toml'))}"]
        if given.peers:
            has_kiss = subprocess.run([given.python, "-c", "import kiss_matcher"], capture_output=True).returncode == 0
            if not has_kiss:
                print(f"{given.python} has no kiss_matcher, which is left out", file=sys.stderr)
            compared = {name: keys for name, keys in methods(is_range, has_kiss).items() if any(word in name for word in given.method.split(","))}
            if not compared:
                sys.exit(f"--method {given.method} names none of {', '.join(methods(is_range, has_kiss))}")
            graph.append(f"plugins = [{{ file = {json.dumps(str(HERE / 'peers.py'))}, interpreter = {json.dumps(given.python)} }}]")
            sweep["factor"]["method"] = {"values": list(compared.values()), "labels": list(compared)}
        graph += [f"[graph]\nname = \"recover_set\"\nseed = {given.seed}", "[sweep.factor]"]
        graph += [f"{name} = {toml(factor)}" for name, factor in sweep["factor"].items()]
        file, out = folder / "recover_set.toml", folder / "sweep"
        file.write_text("\n".join(graph) + "\n")
        command = [given.program, "sweep", str(file), "--set", f"sweep.repeat={given.repeat}", "--out", str(out), "--workers", str(given.workers)]
        # Threads that wait for each other on a busy machine would count as processor time.
        one_thread = {"OMP_NUM_THREADS": "1", **os.environ}
        ended = subprocess.run(command + ["--resume"] * out.exists(), env=one_thread)
        if not (out / "runs.csv").exists():
            sys.exit(ended.returncode or 1)
        with open(out / "runs.csv", newline="", encoding="utf-8") as rows:
            print(table(list(csv.DictReader(rows))))
        if ended.returncode:
            sys.exit(ended.returncode)


if __name__ == "__main__":
    main()
