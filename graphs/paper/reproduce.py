#!/usr/bin/env python3
"""Runs the experiments of this folder and writes a page that compares our numbers with the paper's.

Each graph is swept by `osteoflow sweep` into a folder of its own below --out, with the report of each. page.md is the page with a
request in JSON instead of each number of ours: a number of a sweep's summary.json, the time of nodes, a table of settings, or
the comparison with another experiment by `osteoflow compare`. Rows that differ in one word are joined. Of all experiments the results
and the details are two pages, else one. Nothing is computed here but spreads and shares of times.

Exit code 3: an experiment has no result, or a row no number; both are listed. A bone that cannot be simulated is refused before
anything is run, in the words of `osteoflow simulate`. It needs Python 3.9 and nothing else.
"""

import argparse
import collections
import csv
import itertools
import json
import re
import shlex
import subprocess
import sys
import tempfile
from datetime import datetime
from pathlib import Path

HERE = Path(__file__).resolve().parent
# In the paper's order, then ours.
EXPERIMENTS = [
    "calibration", "accuracy_camera", "accuracy_stylus", "cutting", "sensitivity", "point_count", "laser_spot", "in_vivo",
    "variants", "roi_extent", "readings", "error_terms", "laser_detectors",
]
# One procedure of each is timed, node by node.
TIMED = ["accuracy_camera", "accuracy_stylus"]
MAX_REASONS = 2
EXAMPLES = """
examples:
  graphs/paper/reproduce.py                                                  all of it, on the built-in bones
  graphs/paper/reproduce.py --bone TIBIA.stl --plan PLAN.json --out R        on a bone of your own
  graphs/paper/reproduce.py --only sensitivity --out R
  graphs/paper/reproduce.py --out R --resume                                 goes on where it was stopped
"""


def arguments():
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for the sweeps; default: a new one below runs/")
    parser.add_argument("--resume", action="store_true", help="go on in --out: finished runs stay")
    parser.add_argument("--only", nargs="+", default=[], choices=EXPERIMENTS, metavar="NAME", help="only these experiments")
    parser.add_argument("--bone", type=Path, help="a closed surface of a fibula (STL, PLY) instead of the built-in bones")
    parser.add_argument("--plan", type=Path, help="its plan or anatomy, as for osteoflow simulate --plan")
    parser.add_argument("--set", action="append", default=[], dest="sets", metavar="KEY=VALUE", help="change any key of all graphs")
    parser.add_argument("--page", type=Path, help="the page; default: docs/method/paper-reproduction.md for all of it, else in --out")
    parser.add_argument("--workers", help="number of runs at a time; default: the number of cores")
    parser.add_argument("--program", default="osteoflow", help="the command osteoflow")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    args = parser.parse_args()
    if (args.bone is None) != (args.plan is None):
        parser.error("--bone and --plan belong together")
    if args.resume and args.out is None:
        parser.error("--resume needs --out")
    return args


class Failed(Exception):
    """A command that failed, with its exit code; it has said why."""


def osteoflow(args, *words, accept=(0,), show=False):
    """Runs the program, and returns what it prints."""
    stderr = None if show and not args.quiet else subprocess.PIPE
    ran = subprocess.run([args.program, *map(str, words)], stdout=subprocess.PIPE, stderr=stderr, text=True, check=False)
    if ran.returncode not in accept:
        sys.stderr.write(ran.stderr or "")
        raise Failed(ran.returncode)
    return ran.stdout


def bone_keys(args):
    """The keys that set a bone of the user's own, with their values in TOML."""
    if args.bone is None:
        return []
    files = [("bone_file", args.bone), ("plan_file", args.plan)]
    nodes = ["recording", "plan", "bone", "real_bone"]
    return [(f"{node}.{key}", json.dumps(str(file.resolve()))) for node in nodes for key, file in files]


def sets_of(args, name):
    """The settings of an experiment's sweep."""
    sets = list(args.sets)
    # The calibration has no bone.
    if args.bone is not None and name != "calibration":
        values = ", ".join(f"{key} = {value}" for key, value in bone_keys(args))
        sets.append(f"sweep.factor.bone.values=[{{ {values} }}]")
        sets.append(f"sweep.factor.bone.labels=[{json.dumps(args.bone.stem)}]")
    return [word for text in sets for word in ("--set", text)]


def command(args, only):
    """The command that repeats these experiments; all if there is none."""
    words = ["graphs/paper/reproduce.py"]
    for option, file in [("--bone", args.bone), ("--plan", args.plan)]:
        words += [option, str(file)] if file else []
    words += ["--only", *only] if only else []
    words += [word for text in args.sets for word in ("--set", text)]
    return shlex.join(words)


def command_of(args, name):
    """The command of one experiment."""
    if args.bone is None and not args.sets and not args.only:
        return f"osteoflow sweep graphs/paper/{name}.toml"
    return command(args, [name])


def short(reason):
    """A reason without node, point and the numbers of its run: its first part that is a sentence.

    >>> short('a.toml:69: node "hole", item 0: P2: no hole of 2 mm radius: 75 points have no partner; is the laser on?')
    'no hole of 2 mm radius'
    >>> short('a.toml:3: node "hole", item 0: P1: 2 holes look alike, at [1.0, 2.0, 3.0] and [4.0, 5.0, 6.0] mm')
    '2 holes look alike'
    >>> short('a.toml:9: node "judge", item 0: the result is refused: the landmarks are swapped; aim again')
    'the landmarks are swapped'
    >>> short('a.toml:3: node "ct_surface": the surface is open; close it')
    'the surface is open'
    """
    after = re.sub(r'^.*?node ".*?: ', "", reason) if 'node "' in reason else reason
    after = after.removeprefix("the result is refused: ")
    parts = after.split(": ")
    part = next((part for part in parts if " " in part), parts[0])
    return part.split(";")[0].split(", at [")[0].strip()


def counted(n, unit):
    return f"{n:,} {unit}" if n == 1 else f"{n:,} {unit}s"


def units(all_units):
    return ", ".join(counted(unit["n"], unit["name"]) for unit in all_units)


class Experiment:
    """A sweep that was run."""

    def __init__(self, name, folder):
        self.name = name
        self.folder = folder
        self.summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        with open(folder / "runs.csv", newline="", encoding="utf-8") as file:
            refused = [(row["run"], row["reason"]) for row in csv.DictReader(file) if row["status"] != "complete"]
        self.n_refused = len(refused)
        self.first_reason = refused[0] if refused else None
        self.reasons = collections.Counter(short(reason) for _, reason in refused).most_common()

    def has_results(self):
        return self.summary["n_runs"] != self.n_refused

    def group(self, setting):
        """The group of this setting."""
        groups = self.summary["groups"]
        return next((g for g in groups if all(g["setting"].get(key) == value for key, value in setting.items())), None)

    def reasons_text(self):
        shown = [f"{reason} ({counted(n, 'run')})" for reason, n in self.reasons[:MAX_REASONS]]
        rest = sum(n for _, n in self.reasons[MAX_REASONS:])
        return "; ".join(shown + ([f"others ({counted(rest, 'run')})"] if rest else []))


def number_of(group, path, show):
    """A number of a group: its value, what the page shows, and its n. None if there is none.

    >>> axis = {"mean": 0.5, "sd": 0.1, "min": 0.3, "max": 0.9, "n_units": [{"name": "bone", "n": 3}]}
    >>> group = {"points": {"e_mm": {"x": axis, "y": axis, "z": axis}}}
    >>> number_of(group, "points.e_mm.x", None)
    (0.5, '0.50 \u00b1 0.10 (0.30 to 0.90)', '3 bones')
    >>> number_of(group, "points.e_mm.*", "sd")
    (None, '[0.10; 0.10; 0.10]', '3 bones')
    >>> r = {"draw": "first_mm", "column": "z_mm", "n": 200, "unit": "placement", "pearson": {"r": -0.98}}
    >>> number_of({"correlations": [r]}, "correlation.first_mm.z_mm", None)
    (-0.98, '-0.980', '200 placements')
    >>> number_of(group, "points.e_mm.w", None)
    """
    if group is None:
        return None
    if ".*" in path:
        axes = [number_of(group, path.replace("*", axis), show) for axis in "xyz"]
        return None if None in axes else (None, "[" + "; ".join(text for _, text, _ in axes) + "]", axes[0][2])
    parts = path.split(".")
    if parts[0] == "correlation":
        for found in group.get("correlations", []):
            if [found["draw"], found["column"]] == parts[1:] and found["pearson"].get("r") is not None:
                r = found["pearson"]["r"]
                return r, f"{r:.3f}", counted(found["n"], found["unit"])
        return None
    at, n = group, ""
    for part in parts:
        at = at.get(part)
        if not isinstance(at, dict):
            return None
        n = units(at["n_units"]) if "n_units" in at else n
    value = at.get(show or "mean")
    if value is None or (show is None and at.get("min") is None):
        return None
    if show:
        return value, f"{value:.2f}", n
    sd = f" \u00b1 {at['sd']:.2f}" if at.get("sd") is not None else ""
    return value, f"{value:.2f}{sd} ({at['min']:.2f} to {at['max']:.2f})", n


def spread(theirs):
    """The spread of a number as the paper gives it; the page states the rule. None if it gives none."""
    numbers = []
    for word in re.split("[ ,]", theirs):
        try:
            numbers.append(float(word))
        except ValueError:
            pass
    if not numbers:
        return None
    first = numbers[0]
    if "\u00b1" in theirs and len(numbers) > 1:
        return first - numbers[1], first + numbers[1]
    if theirs.startswith("at most"):
        return 0.0, first
    return (0.5 * first, 1.5 * first) if len(numbers) == 1 else (min(numbers), max(numbers))


def judgement(request, theirs, value):
    """Whether a number is within the spread, and the words for it. None if there is no spread.

    >>> [judgement({}, "0.3 \u00b1 0.2 (0.1 to 0.8)", ours)[1] for ours in (0.3, 0.6, 0.05)]
    ['yes (0.1 to 0.5)', '**above** 0.1 to 0.5', '**below** 0.1 to 0.5']
    >>> [judgement({}, "0.9", ours)[1] for ours in (0.2, 0.5)]
    ['**below** 0.45 to 1.35', 'yes (0.45 to 1.35)']
    >>> judgement({}, "at most 2", 2.5)[1], judgement({}, "1.9, 1.7, 3.6", 2.0)[1]
    ('**above** 0 to 2', 'yes (1.7 to 3.6)')
    >>> judgement({"magnitude": True, "within": [0.9, 1.0]}, "0.98", -0.95)
    (True, 'yes (0.9 to 1)')
    >>> judgement({}, "not given", 1.0)
    """
    limits = request.get("within") or spread(theirs)
    if limits is None or value is None:
        return None
    value = abs(value) if request.get("magnitude") else value
    text = " to ".join(f"{round(limit, 4):g}" for limit in limits)
    if value < limits[0]:
        return False, f"**below** {text}"
    return (False, f"**above** {text}") if value > limits[1] else (True, f"yes ({text})")


def cells(row):
    """Cells of a row. A bar would begin another cell, a line break another row.

    >>> cells(["mean |.|", "a\\nb"])
    'mean \\\\|.\\\\| | a b'
    """
    return " | ".join(str(cell).replace("|", "\\|").replace("\n", " ") for cell in row)


def table(heads, rows):
    return "\n".join([f"| {cells(heads)} |", "|" + " --- |" * len(heads)] + [f"| {cells(row)} |" for row in rows])


def joined(words):
    """Words of joined rows: once where they are all the same.

    >>> joined(["5.5", "3.1"]), joined(["yes", "yes"]), joined(["points 100", "points 500"]), joined(["camera", "stylus"])
    ('5.5; 3.1', 'yes', 'points 100; 500', 'camera; stylus')
    """
    if len(set(words)) == 1:
        return words[0]
    begin = words[0].rpartition(" ")[0]
    shared = begin and not begin[0].isdigit() and all(word.rpartition(" ")[0] == begin for word in words)
    return "; ".join([words[0], *(word.removeprefix(f"{begin} ") if shared else word for word in words[1:])])


class Line:
    """A line of the template: what is before a request, the request, what is after it."""

    def __init__(self, text):
        start, end = text.find('{"of"'), text.rfind("}") + 1
        self.request = json.loads(text[start:end]) if start >= 0 else None
        self.before, self.after = (text[:start], text[end:]) if self.request else (text, "")

    def needs(self):
        return [self.request[key] for key in ("of", "against") if key in self.request] if self.request else []

    def theirs(self):
        """The last cell before the request: what the paper gives."""
        return self.cells()[-1]

    def cells(self):
        """The cells before the request."""
        return self.before[2:].removesuffix(" | ").split(" | ")

    def parts(self):
        """What a number is of: all before the last semicolon, what is behind it, and the unit.

        >>> Line('| 3.1 | TRE; camera; axis x, mm | 0.5 | {"of": "a", "path": "b"} |').parts()
        ('TRE; camera', 'axis x', ', mm')
        """
        what = self.cells()[1]
        unit = ", mm" if what.endswith(", mm") else ""
        before, _, last = what.removesuffix(unit).rpartition("; ")
        return before, last, unit

    def key(self):
        """Rows beside each other with the same key are joined. A line of another kind has a key of its own."""
        is_row = self.request and "path" in self.request and self.before.startswith("| ") and len(self.cells()) == 3
        section = self.cells()[0] if is_row else None
        return (section, self.request["of"], *self.parts()[::2]) if is_row and self.parts()[0] else id(self)


class Page:
    def __init__(self, args, experiments, times):
        self.args, self.experiments, self.times = args, {of.name: of for of in experiments}, times
        text = (HERE / "page.md").read_text(encoding="utf-8")
        self.sections = [[Line(line) for line in part.split("\n")] for part in re.split(r"\n(?=## )", text.rstrip("\n"))]

    def rows(self):
        """The rows of all tables with a number: section, what, theirs, request, experiment."""
        for line in itertools.chain(*self.sections):
            if line.request and "path" in line.request and line.before.startswith("| "):
                head = line.before[2:].split(" | ")[:-2]
                section, what = (head if len(head) == 2 else (None, head[0]))
                yield section, what, line.theirs(), line.request, self.experiments.get(line.request["of"])

    def ours(self, request):
        of = self.experiments.get(request["of"])
        return of and number_of(of.group(request.get("setting", {})), request["path"], request.get("show"))

    def outside(self):
        """A line for each of our numbers that is outside the paper's spread."""
        out = []
        for section, what, theirs, request, _ in self.rows():
            ours = self.ours(request)
            judged = ours and judgement(request, theirs, ours[0])
            if section and judged and not judged[0]:
                out.append(f"{what} ({section}): paper {theirs}, ours {ours[1]}, {judged[1]}")
        return out

    def missing(self):
        """A line for each row whose experiment was run and has no such number."""
        return [
            f"{what}: {of.name} has no {request['path']}"
            for _, what, _, request, of in self.rows() if of and of.has_results() and self.ours(request) is None
        ]

    def without_results(self):
        empty = [of for of in self.experiments.values() if not of.has_results() and of.first_reason]
        return [
            f"{of.name}: none of its {of.n_refused} runs has results; run {of.first_reason[0]}: {of.first_reason[1]}" for of in empty
        ]

    def text(self):
        """The page. Rows and sections about experiments that were not run are left out."""
        out = []
        for section in self.sections:
            was_run = [all(name in self.experiments for name in line.needs()) for line in section]
            own = [ran for line, ran in zip(section, was_run) if line.request and not line.before.startswith("- ")]
            if section[0].before.startswith("## ") and own and not any(own):
                continue
            for _, lines in itertools.groupby((line for line, ran in zip(section, was_run) if ran), Line.key):
                out += self.join(list(lines))
        return "\n".join(out).rstrip() + "\n"

    def join(self, lines):
        """The lines of one key: one row, if all have a number."""
        if len(lines) > 1 and all(self.ours(line.request) for line in lines):
            first, columns = lines[0], zip(*(self.number_cells(line) for line in lines))
            before, _, unit = first.parts()
            last = joined([line.parts()[1] for line in lines])
            row = [first.cells()[0], f"{before}; {last}{unit}", joined([line.theirs() for line in lines]), *map(joined, columns)]
            return [f"| {cells(row)} |"]
        return [line.before + self.reply(line) + line.after if line.request else self.prose(line.before) for line in lines]

    def prose(self, line):
        """A line without a request. A word in braces stands for a list or the command."""
        return self.commands() if line == "{commands}" else line.replace("{command}", command(self.args, self.args.only))

    def reply(self, line):
        for key, reply in [("against", self.pair), ("path", self.number), ("nodes", self.time), ("columns", self.settings)]:
            if key in line.request:
                return reply(line)
        raise ValueError(f"page.md asks for nothing: {line.request}")

    def number(self, line):
        request = line.request
        ours = self.ours(request) or (None, f"**none**: the sweep has no {request['path']}", "0")
        if not line.before.startswith("|"):
            return f"{ours[1]}, n = {ours[2]}"
        return cells(self.number_cells(line))

    def number_cells(self, line):
        """Our number as mean and SD, its n, and whether it is within the spread."""
        request = line.request
        ours = self.ours(request) or (None, f"**none**: the sweep has no {request['path']}", "0")
        judged = judgement(request, line.theirs(), ours[0])
        return [re.sub(r" \(.*", "", ours[1]), ours[2], judged[1].split(" ")[0] if judged else "-"]

    def time(self, line):
        """What nodes took in one procedure, and its share of the time that the paper gives, such as `2.5 ± 0.4 min`."""
        busy, nodes = self.times.get(line.request["of"]), line.request["nodes"]
        if busy is None:
            return cells(["**none**: the procedure was refused", "-"])
        if any(name not in busy for name in nodes):
            return cells([f"**none**: a node of {', '.join(nodes)} is missing", "-"])
        ours_s = sum(busy[name] for name in nodes) if nodes else sum(busy.values())
        words = line.theirs().split(" ")
        unit_s = {"min": 60.0, "ms": 1e-3}.get(words[-1], 1.0)
        try:
            share = f"{100.0 * ours_s / (float(words[0]) * unit_s):.2f} %"
        except ValueError:
            share = "-"
        return cells([f"{1e3 * ours_s:.1f} ms", share])

    def pair(self, line):
        folders = [self.experiments[line.request[key]].folder for key in ("of", "against")]
        margins = [word for column, size in line.request["margins"].items() for word in ("--margin", f"{column}={size}")]
        compared = osteoflow(self.args, "compare", *folders, *margins, "--color", "never").rstrip()
        # Without the settings, which the commands name.
        return f"```text\n{compared[max(compared.find('second against first'), 0):]}\n```"

    def settings(self, line):
        """A table with a row for each setting, or for those with a value in `where`; with `across` one for each number, with the values of
        this factor beside each other."""
        groups, columns = self.experiments[line.request["of"]].summary["groups"], line.request["columns"]
        where, across = line.request.get("where", {}), line.request.get("across")
        # Settings of the user's own may have none of these values.
        groups = [g for g in groups if all(g["setting"].get(name) in values for name, values in where.items())] or groups
        first = groups[0]["setting"] if groups else {}
        names = [name for name in first if any(g["setting"][name] != first[name] for g in groups)]

        def mean(of):
            sd = f" \u00b1 {of['sd']:.2f}" if of.get("sd") is not None else ""
            return f"{of['mean']:.2f}{sd}" if of.get("mean") is not None else "-"

        def n(group):
            without = group["n_without_results"]
            return units(group["units"]) + (f"; {without} without results" if without else "")

        def word(value):
            return value if isinstance(value, str) else json.dumps(value)

        if across in names:
            names.remove(across)
            values = list(dict.fromkeys(word(group["setting"][across]) for group in groups))
            at = {}
            for column, group in itertools.product(columns, groups):
                key = (column, *(word(group["setting"][name]) for name in names))
                at.setdefault(key, {})[word(group["setting"][across])] = mean(group["columns"].get(column, {}))
            heads, rows = ["", *names, f"{across} {values[0]}", *values[1:]], [[*key, *map(of.get, values)] for key, of in at.items()]
        else:
            heads = [*names, *columns]
            rows = [
                [word(group["setting"][name]) for name in names] + [mean(group["columns"].get(c, {})) for c in columns]
                for group in groups
            ]
        of_rows = [n(group) for group in groups]
        if across or len(set(of_rows)) == 1:
            return f"{table(heads, rows)}\n\nn = {joined(list(dict.fromkeys(of_rows)))}."
        of_units, without = [units(group["units"]) for group in groups], [group["n_without_results"] for group in groups]
        if len(set(of_units)) == 1:
            rows = [[*row, n or "-"] for row, n in zip(rows, without)]
            return f"{table([*heads, 'without results'], rows)}\n\nn = {of_units[0]}, those without results included."
        return table([*heads, "n"], [[*row, n] for row, n in zip(rows, of_rows)])

    def commands(self):
        """The command of each experiment, and the reasons for runs without results."""
        all_of = self.experiments.values()
        rows = [[of.name, f"`{command_of(self.args, of.name)}`", of.summary["n_runs"], of.n_refused] for of in all_of]
        out = table(["experiment", "command", "runs", "without results"], rows)
        refused = [f"\n- {of.name}: {of.reasons_text()}" for of in all_of if of.n_refused]
        if refused:
            out += (
                "\n\nA run without results is a procedure that was refused. The most frequent reasons; `runs.csv` of the "
                "experiment has all in full:\n" + "".join(refused))
        return out


def busy_s(args, name):
    """The busy time of each node that computes in one procedure, s; None if it is refused."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        sets = [word for text in args.sets if not text.startswith("sweep.") for word in ("--set", text)]
        sets += [word for key, value in bone_keys(args) for word in ("--set", f"{key}={value}")]
        try:
            osteoflow(args, "run", HERE / f"{name}.toml", *sets, "--no-record", "--quiet", "--out", out)
        except Failed:
            return None
        manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
        computes = [node for node in manifest["nodes"] if not node["source"] and not node["kind"].startswith("metrics.")]
        return {node["name"]: 1e-3 * node["busy_ms"] for node in computes}


def main():
    args = arguments()
    names = [name for name in EXPERIMENTS if not args.only or name in args.only]
    if args.bone is not None:
        with tempfile.TemporaryDirectory() as folder:
            osteoflow(args, "simulate", "--bone", args.bone, "--plan", args.plan, "--points", "1000", "--out", Path(folder) / "s")
    out = args.out or Path("runs") / f"reproduce-{datetime.now():%Y%m%d-%H%M%S}"
    experiments = []
    for k, name in enumerate(names):
        if not args.quiet:
            print(f"{name} ({k + 1} of {len(names)})", file=sys.stderr)
        folder = out / name
        resume = ["--resume"] if args.resume and folder.is_dir() else []
        workers = ["--workers", args.workers] if args.workers else []
        # A sweep whose runs are all refused ends with 3.
        osteoflow(
            args, "sweep", HERE / f"{name}.toml", *sets_of(args, name), "--out", folder, *resume, *workers,
            *(["--quiet"] if args.quiet else []), accept=(0, 3), show=True)
        osteoflow(args, "report", folder, "--quiet", accept=(0, 3))
        experiments.append(Experiment(name, folder))
    page = Page(args, experiments, {name: busy_s(args, name) for name in names if name in TIMED})
    whole = not args.only and not args.sets and args.bone is None
    default = HERE.parents[1] / "docs/method/paper-reproduction.md" if whole else out / "paper-reproduction.md"
    path, (results, _, detail) = args.page or default, page.text().partition("{detail}\n")
    if whole:
        path.with_name(f"{path.stem}-detail.md").write_text(detail, encoding="utf-8")
        path.write_text(results.rstrip() + "\n", encoding="utf-8")
    else:
        path.write_text(results + detail, encoding="utf-8")
    for line in page.outside():
        print(f"outside the paper's spread: {line}")
    for line in page.without_results():
        print(f"without results: {line}", file=sys.stderr)
    for line in page.missing():
        print(f"without a number: {line}", file=sys.stderr)
    print(f"{path} and the sweeps in {out}, with a report of each")
    return 3 if page.without_results() or page.missing() else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Failed as failed:
        sys.exit(failed.args[0])
    except KeyboardInterrupt:
        sys.exit("interrupted: go on with --out and --resume")
