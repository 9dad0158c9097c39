"""Tests what other people's programs make of our files and streams, and what we make of theirs.

    python3 tests/clients/run.py --check [CLIENT ..]     prints a line for each thing that was exchanged
    python3 tests/clients/run.py --write                 writes docs/clients.md, too

OSTEOFLOW_PROGRAM names the program, target/release/osteoflow otherwise. `tests/clients/install` installs the clients into
target/clients, whose Python has them. Exit code 0: all that is here agrees; 1: something does not; 2: numpy is missing.
"""

import os
import re
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
from client import KEPT_MM, ROOT, main

HEAD = """# Clients

Which programs of others read what is written here, and whose files and streams are read, with the largest difference of the numbers.
What agrees to 1e-4 mm, which clouds and surfaces [keep](use/formats.md), is one row of a client. A difference of up to 0.004 mm is of
texts with six or seven digits. Each row is tests of [tests/clients](../tests/clients), which are skipped by name where their client is not installed:

```text
tests/clients/install                                                     installs what can be had
cargo test --release --test suite clients:: -- --nocapture                tests what is there
UPDATE=1 cargo test --release --test suite clients:: -- --nocapture       writes this page, too
```

3D Slicer was not run: tests hold files for it to the rules of its source (583e9b37) and to its schema. Of Lichtblick the decoders of messages are
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


DONE = [
    "written and read here",
    "refused with the command that converts it",
    "refused by its name",
    "by the command that its refusal names",
    "by both",
    "read here",
    "refused",
    "received",
    "sent",
    "read",
]
WRITTEN_AS = re.compile(r"(.+) written as (.+) read here")
DONE_WITH = re.compile(f"(.+?) ({'|'.join(DONE)})")


def listed(things):
    """Things beside each other; the words with which all begin are said once.

    >>> listed(["a lens brown", "a lens fisheye"]), listed(["bone.stl"]), listed(["bone.stl", "bone.ply"])
    ('a lens brown, fisheye', 'bone.stl', 'bone.stl, bone.ply')
    """
    words = [thing.split(" ") for thing in things]
    n = len(os.path.commonprefix(words))
    if len(things) == 1 or n == min(map(len, words)):
        n = 0
    return " ".join([*words[0][:n], ", ".join(" ".join(of[n:]) for of in words)])


def joined(whats):
    """The things of a row; what begins or ends several of them is said once, and what was done with several of them.

    >>> joined(["bone.stl read, extent", "bone.ply read, extent"]), joined(["bone.stl read, extent"])
    ('extent: bone.stl, bone.ply read', 'bone.stl read, extent')
    >>> joined(["DICOM, RLE, read", "DICOM, big-endian, read"]), joined(["a read", "b read", "c"])
    ('read: DICOM: RLE; big-endian', 'a, b read; c')
    >>> joined(["a written as stl read here", "a written as ply read here", "b written as stl read here", "b written as ply read here"])
    'a, b written as stl, ply read here'
    """
    by_end, written, done, texts = {}, {}, {}, []
    for what in whats:
        by_end.setdefault(end(what), []).append(what)
    begin = whats[0].partition(", ")[0] + ", "
    if len(whats) > 1 and len(by_end) > 1 and all(what.startswith(begin) for what in whats):
        return f"{begin[:-2]}: " + joined([what.removeprefix(begin) for what in whats])
    for tail, of in by_end.items():
        if tail and len(of) > 1:
            texts.append(f"{tail}: " + joined([what.removesuffix(f", {tail}") for what in of]))
            continue
        for what in of:
            if found := WRITTEN_AS.fullmatch(what):
                written.setdefault(found[1], []).append(found[2])
            elif (found := DONE_WITH.fullmatch(what)) and not tail:
                done.setdefault((found[2], ""), []).append(found[1])
            else:  # what differs in its last word alone
                done.setdefault(("", what if tail else what.rpartition(" ")[0] or what), []).append(what)
    by_formats = {}
    for thing, formats in written.items():
        by_formats.setdefault(tuple(formats), []).append(thing)
    texts += [f"{listed(things)} {verb}".strip() for (verb, _), things in done.items()]
    texts += [f"{listed(things)} written as {', '.join(formats)} read here" for formats, things in by_formats.items()]
    return "; ".join(texts)


def differences(of):
    """The cells of a client's rows: what agrees to `KEPT_MM` is one row with the largest difference; a row for each other one."""
    by_row = {}
    for row in of:
        is_kept = row.unit == "mm" and row.difference <= KEPT_MM
        shown = "" if not row.unit else "kept" if is_kept else f"{row.difference:.0e} {row.unit}"
        by_row.setdefault(shown, []).append(row)
    cells = []
    for shown, rows in by_row.items():
        largest = max(row.difference for row in rows)
        kept = f"{largest:.0e} mm" if largest else "0"
        cells.append((joined([row.what for row in rows]), kept if shown == "kept" else shown))
    return cells


def page(rows, skipped):
    text, by_client, said = HEAD, {}, {}
    for name, version, row in rows:
        by_client.setdefault(name, (version, []))[1].append(row)
    for name, (version, of) in by_client.items():
        cells = differences(of)
        # Counts of messages differ from run to run.
        alike = said.setdefault(re.sub(r"\d+", "", str(cells)), name)
        if alike != name:
            cells = [(f"as {alike}", "as there")]
        for k, (whats, difference) in enumerate(cells):
            text += f"| {name} | {'' if k else version} | {whats} | {difference} |\n"
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
