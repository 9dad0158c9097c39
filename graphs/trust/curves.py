#!/usr/bin/env python3
"""Prints the detection curves of a sweep of curves.toml as a table in Markdown.

For each mistake: the size from which the answer is wrong, where the error passes the limits (times_limit 1, by straight lines between
the medians of a bone's runs; smallest and largest of the bones); the smallest size from which on no wrong answer is trusted; how many
wrong answers are trusted, of how many; under each size the shares of right and of trusted answers; and the rule that mostly tells it.
Runs without a result are counted and left out. It needs Python 3.9 and nothing else.
"""

import argparse
import collections
import csv
import statistics
import sys
from pathlib import Path


def read(folder):
    """The runs of each mistake by size, its unit, and the number of runs without a result."""
    mistakes, units, n_without = collections.OrderedDict(), {}, 0
    path = folder / "runs.csv"
    with open(path, newline="", encoding="utf-8") as file:
        for run in csv.DictReader(file):
            missing = [column for column in ("mistake", "bone", "times_limit", "trusted") if column not in run]
            if missing:
                sys.exit(f"{path}: no column {missing[0]!r}; is it a sweep of graphs/trust/curves.toml?")
            if not run["times_limit"]:
                n_without += 1
                continue
            name, _, size = run["mistake"].partition(": ")
            number, _, unit = size.partition(" ")
            units[name] = unit
            mistakes.setdefault(name, collections.OrderedDict()).setdefault(float(number or 0), []).append(run)
    return mistakes, units, n_without


def wrong_from(sizes, sound):
    """The size at which each bone's error passes the limits; None where its largest one does not."""
    by_bone = collections.OrderedDict()
    for size, runs in sizes.items():
        for run in runs:
            by_bone.setdefault(run["bone"], {}).setdefault(size, []).append(float(run["times_limit"]))
    passed = []
    for bone, errors in by_bone.items():
        points = [(0.0, sound.get(bone, 0.0))] + [(size, statistics.median(errors[size])) for size in sorted(errors)]
        crossing = (a + (b - a) * (1 - low) / (high - low) for (a, low), (b, high) in zip(points, points[1:]) if low <= 1 < high)
        passed.append(next(crossing, None))
    return passed


def row(name, unit, sizes, sound):
    runs = [(size, run) for size in sorted(sizes) for run in sizes[size]]
    wrong = [(size, run) for size, run in runs if float(run["times_limit"]) > 1]
    trusted = [size for size, run in wrong if run["trusted"] == "1"]
    told = [size for size in sorted(sizes) if size > max(trusted, default=0) and any(size == at for at, _ in wrong)]
    passed = [size for size in wrong_from(sizes, sound) if size is not None]
    rules = collections.Counter(run["rule"] for _, run in wrong if run["rule"])
    bones = {run["bone"] for _, run in runs}

    def share(size, column):
        return f"{100 * sum(run[column] == '1' for run in sizes[size]) / len(sizes[size]):.0f}"

    return [
        name,
        f"{len(bones)}, {len(runs)}",
        f"{min(passed):.2g} to {max(passed):.2g} {unit}" if passed else "never",
        f"{told[0]:g} {unit}" if told else ("never" if wrong else ""),
        f"{len(trusted)} of {len(wrong)}",
        "; ".join(f"{size:g}: {share(size, 'right')}, {share(size, 'trusted')}" for size in sorted(sizes)),
        rules.most_common(1)[0][0] if rules else "",
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the folder of the sweep")
    mistakes, units, n_without = read(parser.parse_args().folder)
    sound = {}
    for runs in mistakes.get("none", {}).values():
        by_bone = collections.defaultdict(list)
        for run in runs:
            by_bone[run["bone"]].append(float(run["times_limit"]))
        sound = {bone: statistics.median(errors) for bone, errors in by_bone.items()}
    header = ["mistake", "bones, runs", "wrong from", "told from", "wrong and trusted", "size: right %, trusted %", "told by"]
    print(f"| {' | '.join(header)} |\n|{' --- |' * len(header)}")
    for name, sizes in mistakes.items():
        print(f"| {' | '.join(row(name, units[name], sizes, sound))} |")
    if n_without:
        print(f"\n{n_without} runs had no result.")


if __name__ == "__main__":
    main()
