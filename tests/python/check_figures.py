"""Reads the tables of a report's charts with Python's csv, and compares them with the marks of the SVG beside each and with the
results of the run or sweep: check_figures.py DIR. Prints the number of tables and of numbers compared."""

import csv
import json
import math
import re
import statistics
import sys
import xml.etree.ElementTree as xml
from collections import defaultdict
from pathlib import Path

SVG = "{http://www.w3.org/2000/svg}"
# Places are rounded to 0.1 px, and so are the ticks from which the scales are taken.
TOLERANCE_PX = 0.3
DIGITS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--", "\u202f")


def tick(label):
    """The number at a tick."""
    if any(c in "⁰¹²³⁴⁵⁶⁷⁸⁹⁻" for c in label):
        return 10.0 ** int(label[2:].translate(DIGITS))
    return float(label.translate(DIGITS))


class Scale:
    """From places to values: a line through the outermost ticks, of the values or of their logarithms."""

    def __init__(self, ticks):
        values = [tick(label) for _, label in ticks]
        self.logarithmic = len(ticks) > 2 and min(values) > 0 and not self.fits(ticks, values)
        if self.logarithmic:
            values = [math.log10(value) for value in values]
        ends = sorted(zip(values, (place for place, _ in ticks)))
        (v0, p0), (v1, p1) = ends[0], ends[-1]
        self.of = lambda value: p0 + (value - v0) / (v1 - v0) * (p1 - p0)

    @staticmethod
    def fits(ticks, values):
        (p0, p1), (v0, v1) = (ticks[0][0], ticks[-1][0]), (values[0], values[-1])
        return all(abs(p0 + (v - v0) / (v1 - v0) * (p1 - p0) - p) < 1 for v, (p, _) in zip(values, ticks))

    def place(self, value):
        return self.of(math.log10(value) if self.logarithmic else value)


def numbers(path):
    """Pairs of the numbers of a path without its letters."""
    found = [float(number) for number in re.findall(r"-?[0-9.]+", path)]
    return list(zip(found[::2], found[1::2]))


def drawn(panel):
    """Ticks of both axes, texts, and the marks of a panel in order: kind, x, y."""
    ticks, texts, marks = {"x": [], "y": []}, [], []
    elements = list(panel)
    for k, element in enumerate(elements):
        kind, words = element.tag.removeprefix(SVG), element.get("class", "").split()
        path = element.get("d", "")
        if kind == "text":
            texts.append(element.text)
        elif words == ["grid"]:
            ticks["y"].append((numbers(path.split("H")[0])[0][1], elements[k + 1].text))
        elif words == ["axis"] and path.endswith("v5"):
            ticks["x"].append((numbers(path)[0][0], elements[k + 1].text))
        elif kind == "circle":
            marks.append(("dot", float(element.get("cx")), float(element.get("cy"))))
        elif kind == "path" and words[0] == "line":
            marks.extend(("line", x, y) for x, y in numbers(path))
        elif words and words[0] == "band":
            points = numbers(path)
            half = len(points) // 2
            for (x, upper), (_, lower) in zip(points[:half], reversed(points[half:])):
                marks.extend([("lower bound", x, lower), ("upper bound", x, upper)])
        elif kind == "g":
            whiskers, box, median = (element[k] for k in (1, 2, 3))
            x, low, q1, _, q3, high = (float(n) for n in re.findall(r"-?[0-9.]+", whiskers.get("d"))[:6])
            top = float(box.get("y"))
            assert abs(top - q3) < 0.11 and abs(top + float(box.get("height")) - q1) < 0.61, "a box beside its whiskers"
            middle = numbers(median.get("d").split("H")[0])[0][1]
            parts = [("lower whisker", low), ("quartile 1", q1), ("median", middle), ("quartile 3", q3)]
            marks.extend((part, x, y) for part, y in [*parts, ("upper whisker", high)])
    return ticks, texts, marks


def check_drawing(table, heads, rows):
    """Every row is a mark at its place, and every mark a row."""
    panels = [group for group in xml.parse(table.with_suffix(".svg")).getroot() if group.tag == SVG + "g"]
    count = 0
    for panel in panels:
        ticks, texts, marks = drawn(panel)
        own = rows[count : count + len(marks)]
        count += len(marks)
        assert len({row[0] for row in own}) == 1 and len(own) == len(marks), f"{table.name}: {len(own)} rows, {len(marks)} marks"
        used = [[k for k in range(4, len(heads)) if row[k]] for row in own]
        assert all(columns == used[0] and len(columns) == 2 for columns in used), f"{table.name}: two numbers in each row"
        x_column, y_column = used[0]
        for head in (heads[x_column], heads[y_column]):
            assert head in texts, f"{table.name}: no axis {head!r} in {texts}"
        y_scale = Scale(ticks["y"])
        names = [label for _, label in ticks["x"]]
        # A unit may be named by a number.
        cells = {row[x_column] for row in own}
        is_named = cells <= set(names) or not all(is_number(cell) for cell in cells)
        x_scale = None if is_named else Scale(ticks["x"])
        for row, (kind, x, y) in zip(own, marks):
            assert row[2] == kind, f"{table.name}: {row} is drawn as {kind}"
            there = y_scale.place(float(row[y_column]))
            assert abs(there - y) < TOLERANCE_PX, f"{table.name}: {row} belongs at y = {there:.2f}, and is drawn at {y}"
            if is_named:
                nearest = min(ticks["x"], key=lambda tick: abs(tick[0] - x))[1]
                start, _, end = nearest.partition("…")
                assert row[x_column].startswith(start) and row[x_column].endswith(end), f"{table.name}: {row} is drawn at {nearest}"
            else:
                there = x_scale.place(float(row[x_column]))
                assert abs(there - x) < TOLERANCE_PX, f"{table.name}: {row} belongs at x = {there:.2f}, and is drawn at {x}"
    assert count == len(rows), f"{table.name}: {len(rows)} rows, {count} marks"


def is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


def check_same(what, found, expected, rounded=0):
    """The same numbers to the last digit, in any order; of what is computed anew, up to rounding."""
    found, expected = sorted(found), sorted(expected)
    same = len(found) == len(expected) and all(math.isclose(a, b, rel_tol=rounded) for a, b in zip(found, expected))
    assert same and found, f"{what}: {found[:5]} .. ({len(found)}), expected {expected[:5]} .. ({len(expected)})"


def by(rows, *columns):
    """Numbers of the dots along y, by these columns."""
    groups = defaultdict(list)
    for row in rows:
        if row[2] == "dot":
            groups[tuple(row[k] for k in columns)].append(float(row[-1]))
    return groups


def check_run(table, rows, results):
    """The numbers of a run's charts are those of its results."""
    if table.stem.startswith("tre-"):
        points = results["metrics"][table.stem.replace("-", "_") + "_mm"]["points"]
        for axis in ("x", "y", "z", "norm"):
            check_same(f"{table.name} {axis}", by(rows, 4)[axis,], [point[axis] for point in points])
    elif table.stem == "convergence":
        residuals = by(rows, 1)["residual, RMS of the pairs",]
        assert len(residuals) in (results["icp"]["iterations"], results["icp"]["iterations"] + 1), table.name
    elif table.stem == "residuals":
        bars = {row[4]: float(row[5]) for row in rows if row[2] == "upper bound"}
        assert 99.5 < sum(bars.values()) <= 100 + 1e-9, f"{table.name}: {sum(bars.values())} % of the points"
    else:
        return False
    return True


def check_sweep(table, rows, runs, points):
    """The numbers of a sweep's charts are those of runs.csv and points.csv."""
    kind, _, name = table.stem.partition("-")
    name = name.partition("-")[2] if kind == "difference" else name
    scale = math.degrees(1) if name.endswith("_rad") else 1
    complete = [run for run in runs if run["status"] == "complete"]
    if kind == "column":
        for (setting,), values in by(rows, 4).items():
            of = [run for run in complete if all(value in run.values() for value in setting.split(", "))]
            check_same(f"{table.name} {setting}", values, [float(run[name]) * scale for run in of])
            q1, median, q3 = statistics.quantiles(values, n=4, method="inclusive") if len(values) > 1 else values * 3
            for part, value in [("quartile 1", q1), ("median", median), ("quartile 3", q3)]:
                shown = [float(row[-1]) for row in rows if row[2] == part and row[4] == setting]
                check_same(f"{table.name} {setting} {part}", shown, [value], rounded=1e-12)
    elif kind == "difference":
        value = {run["run"]: float(run[name]) * scale for run in complete}
        for row in rows:
            if row[2] == "dot":
                first, second = re.match(r"runs (\d+) and (\d+):", row[3]).groups()
                assert float(row[-1]) == value[second] - value[first], f"{table.name}: {row}"
    elif kind == "points":
        for axis in {row[1] or row[4] for row in rows}:
            own = [float(row[-1]) for row in rows if row[2] == "dot" and axis in (row[1], row[4])]
            of = [point for point in points if point["measure"] == name and point["axis"] == axis]
            check_same(f"{table.name} {axis}", own, [float(point["value_mm"]) for point in of])
    elif kind == "scatter":
        column = next(column for column in runs[0] if name.startswith(column + "-"))
        check_same(table.name, [n for of in by(rows, 0).values() for n in of], [float(run[column]) * scale for run in complete])
    else:
        return False
    return True


def main(folder):
    tables, n_numbers, n_compared = sorted((folder / "figures").glob("*.csv")), 0, 0
    drawings = [path for path in (folder / "figures").glob("*.svg") if 'class="chart"' in path.read_text(encoding="utf-8")]
    assert {table.stem for table in tables} == {path.stem for path in drawings}, "each chart has a table, and nothing else has"

    def read(name):
        with (folder / name).open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    for table in tables:
        with table.open(newline="", encoding="utf-8") as file:
            heads, *rows = list(csv.reader(file))
        assert heads[:4] == ["panel", "series", "mark", "tooltip"] and rows, table.name
        check_drawing(table, heads, rows)
        if (folder / "runs.csv").exists():
            n_compared += check_sweep(table, rows, read("runs.csv"), read("points.csv"))
        else:
            n_compared += check_run(table, rows, json.loads((folder / "results.json").read_text(encoding="utf-8")))
        n_numbers += len(rows)
    print(f"{len(tables)} tables, {n_compared} compared with results, {n_numbers} numbers")


main(Path(sys.argv[1]))
