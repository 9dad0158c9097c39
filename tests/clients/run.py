"""Tests what other people's programs make of our files and streams, and what we make of theirs.

    python3 tests/clients/run.py --check [CLIENT ..]     prints a line for each thing that was exchanged
    python3 tests/clients/run.py --write                 writes docs/clients.md, too

OSTEOFLOW_PROGRAM names the program, target/release/osteoflow otherwise. `tests/clients/install` installs the clients into
target/clients, whose Python has them. Exit code 0: all that is here agrees; 1: something does not; 2: numpy is missing.
"""

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
Each row is a test of [tests/clients](../tests/clients), which is skipped by its name where its client is not installed:

```text
tests/clients/install                                                     installs what can be had
cargo test --release --test suite clients:: -- --nocapture                tests what is there
UPDATE=1 cargo test --release --test suite clients:: -- --nocapture       writes this page, too
```

Clouds and surfaces keep 1e-4 mm ([formats](use/formats.md)); streams are in single precision. A difference of up to 0.004 mm is of
texts with six or seven digits, as their programs write them. 3D Slicer was not run: files for it are held to the rules of its source
(583e9b37) by tests/clients/scene.py and `tests/slicer_scenes.rs`, markups also to their schema (`tests/slicer_plans.rs`). Lichtblick itself cannot be had from a registry: its decoders of messages are tested, and
the rule by which it places a cloud and the bone.

One run, at its end, in CloudCompare, Rerun and the page (`tests/clients/screenshots.py` writes these pictures):

| CloudCompare: `scan.ply` on `bone.stl` | Rerun: `run.mcap` with `bone.stl` | the page |
|---|---|---|
| ![CloudCompare](clients/cloudcompare.png) | ![Rerun](clients/rerun.png) | ![page](clients/page.png) |

| Client | Version | What | Largest difference |
|---|---|---|---|
"""


def page(rows, skipped):
    text = HEAD
    last = None
    for name, version, row in rows:
        difference = "" if not row.unit else "0" if row.difference == 0 else f"{row.difference:.0e} {row.unit}"
        text += f"| {name} | {version if name != last else ''} | {row.what} | {difference} |\n"
        last = name
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
