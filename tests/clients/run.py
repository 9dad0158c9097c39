"""Tests what other people's programs make of our files and streams, and what we make of theirs.

    python3 tests/clients/run.py --check [CLIENT ..]     prints a line for each thing that was exchanged
    python3 tests/clients/run.py --write                 writes docs/clients.md, too

OSTEOFLOW_PROGRAM names the program, target/release/osteoflow otherwise. `tests/clients/install` installs the clients into
target/clients, whose Python has them. Exit code 0: all that is here agrees; 1: something does not; 2: numpy is missing.
"""

import itertools
import sys

try:
    import numpy  # noqa: F401
except ImportError:
    print("no Python package numpy")
    sys.exit(2)

import clouds  # noqa: F401 (each module registers its tests)
import firefox  # noqa: F401
import images  # noqa: F401
import links  # noqa: F401
import logs  # noqa: F401
import opencv  # noqa: F401
import recordings  # noqa: F401
import scenes  # noqa: F401
import series  # noqa: F401
import streams  # noqa: F401
from client import ROOT, main

HEAD = """# Clients

Which programs of others read what is written here, and whose files and streams are read, with the largest difference of the numbers.
Each row is tests of [tests/clients](../tests/clients), which are skipped by name where their client is not installed:

```text
tests/clients/install                                                     installs what can be had
cargo test --release --test suite clients:: -- --nocapture                tests what is there
UPDATE=1 cargo test --release --test suite clients:: -- --nocapture       writes this page, too
```

Clouds and surfaces keep 1e-4 mm ([formats](use/formats.md)); streams are in single precision. A difference of up to 0.004 mm is of
texts with six or seven digits. 3D Slicer was not run: tests hold files for it to the rules of its source (583e9b37) and to its schema. Of Lichtblick the decoders of messages are
tested, and the rule by which it places a cloud and the bone.

One run, at its end, in CloudCompare, Rerun and the page (`tests/clients/screenshots.py` writes these pictures):

| CloudCompare: `scan.ply` on `bone.stl` | Rerun: `run.mcap` with `bone.stl` | the page |
|---|---|---|
| ![CloudCompare](clients/cloudcompare.png) | ![Rerun](clients/rerun.png) | ![page](clients/page.png) |

| Client | Version | What | Largest difference |
|---|---|---|---|
"""


def end(what):
    """What follows the last comma, outside of brackets."""
    tail = what.rpartition(", ")[2] if ", " in what else ""
    return "" if ")" in tail else tail


def joined(whats):
    """The things of a row; what ends them all alike is said once.

    >>> joined(["bone.stl read, extent", "bone.ply read, extent"]), joined(["bone.stl read, extent"])
    ('extent: bone.stl read; bone.ply read', 'bone.stl read, extent')
    """
    tail = end(whats[0])
    if len(whats) == 1 or not tail:
        return "; ".join(whats)
    return f"{tail}: " + "; ".join(what.removesuffix(f", {tail}") for what in whats)


def page(rows, skipped):
    text = HEAD
    for name, of in itertools.groupby(rows, key=lambda row: row[0]):
        # A row for the things of one end and one difference.
        by_row, version = {}, None
        for _, version, row in of:
            difference = "" if not row.unit else "0" if row.difference == 0 else f"{row.difference:.0e} {row.unit}"
            by_row.setdefault((end(row.what), difference), []).append(row.what)
        for k, ((_, difference), whats) in enumerate(by_row.items()):
            text += f"| {name} | {'' if k else version} | {joined(whats)} | {difference} |\n"
    if skipped:
        text += "\nNot on the machine that wrote this page: " + "; ".join(f"{name} ({why})" for name, why in skipped) + ".\n"
    return text


if len(sys.argv) < 2 or sys.argv[1] not in ("--check", "--write"):
    sys.exit(__doc__)
writes = sys.argv[1] == "--write"
rows, skipped, failed = main(True if writes else None)
if writes and not failed:
    (ROOT / "docs" / "clients.md").write_text(page(rows, skipped), encoding="utf-8")
sys.exit(1 if failed else 0)
