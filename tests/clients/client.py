"""What every test of a client needs: the program, its files, and rows of docs/clients.md.

A test is a function with the decorator `client`, which names the client and what it needs. It yields a `Row` for each thing that
was exchanged. What is missing on this machine skips the test by its name.
"""

import importlib
import importlib.metadata
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
INSTALLED = ROOT / "target" / "clients"
PROGRAM = Path(os.environ.get("OSTEOFLOW_PROGRAM", ROOT / "target" / "release" / "osteoflow"))
KEPT_MM = 1e-4  # what exports keep, see docs/use/formats.md

TESTS = []


class Missing(Exception):
    """A client that is not on this machine."""


@dataclass
class Row:
    """Something that was exchanged, and the largest difference of its numbers."""

    what: str
    difference: float = 0.0
    unit: str = "mm"
    tolerance: float = KEPT_MM

    @property
    def holds(self):
        return self.difference <= self.tolerance  # false for NaN


def client(name, version=None, module=None, package=None, program=None):
    """Registers a test. Its version is that of the package, or what `version` returns."""

    def register(test):
        def found():
            if module and not _has(module):
                raise Missing(f"no Python package {package or module}")
            if program and not shutil.which(program):
                raise Missing(f"no program {program}")
            return version() if version else importlib.metadata.version(package or module)

        TESTS.append((name, found, test))
        return test

    return register


def _has(module):
    try:
        importlib.import_module(module)
    except ImportError:
        return False
    return True


def run(*arguments, check=True, timeout=300, **options):
    """Runs a program; its output as text."""
    arguments = [str(argument) for argument in arguments]
    done = subprocess.run(arguments, capture_output=True, text=True, encoding="utf-8", errors="replace", timeout=timeout, **options)
    if check and done.returncode != 0:
        raise AssertionError(f"{' '.join(arguments)} ended with {done.returncode}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done


def osteoflow(*arguments, check=True):
    """Runs the program under test, in the project's folder."""
    quiet = {**os.environ, "NO_COLOR": "1", "OSTEOFLOW_CACHE": "off"}
    return run(PROGRAM, *arguments, check=check, cwd=ROOT, env=quiet)


def debian(package):
    """The version of an installed package of Debian."""
    if not shutil.which("dpkg-query"):
        raise Missing(f"no package {package} of Debian")
    found = run("dpkg-query", "-W", "-f=${Version}", package, check=False)
    if found.returncode != 0 or not found.stdout:
        raise Missing(f"no package {package} of Debian")
    return found.stdout.split("+")[0].split("-")[0]


def compiled(source, *flags, name=None):
    """The program of a C++ file beside this one."""
    source = Path(__file__).parent / source
    program = folder() / (name or source.stem)
    if not program.exists():
        compiler = shutil.which("c++") or shutil.which("g++")
        if not compiler:
            raise Missing("no C++ compiler")
        done = run(compiler, "-O1", "-w", "-o", program, source, *flags, check=False)
        if done.returncode != 0:
            raise Missing(f"{source.name} cannot be built: {done.stderr[-500:]}")
    return program


_FOLDER = []


def folder():
    """A folder for this process, removed at its end."""
    if not _FOLDER:
        _FOLDER.append(tempfile.TemporaryDirectory(prefix="clients-"))
    return Path(_FOLDER[0].name)


_RUNS = {}


def recorded(graph="graphs/fibula.toml", *more):
    """The folder of a run, made once."""
    key = (graph, *more)
    if key not in _RUNS:
        out = folder() / f"run-{len(_RUNS)}"
        osteoflow("run", graph, "--out", out, *more)
        _RUNS[key] = out
    return _RUNS[key]


def converted(source, name, *options):
    """A file in another format, made once."""
    out = folder() / name
    if not out.exists():
        osteoflow("convert", source, out, *options)
    return out


class Item:
    """One item of a recorded wire; docs/use/recording.md has the layout."""

    def __init__(self, message):
        self.message, self.at = message, 0
        magic, self.stamp_ns, self.number, body, n_fields, n_columns, _ = self._take("<8sqQB3xIII")
        assert magic == b"OSTEOVW1"
        self.empty, self.fields, self.columns = None, {}, {}
        if body == 1:
            self.empty = f"{self._text()}: {self._text()}"
            return
        if body == 2:
            self._text(), self._take("<I")
        for _ in range(n_fields):
            self._field()
        for _ in range(n_columns):
            self._column()

    def _take(self, form):
        values = struct.unpack_from(form, self.message, self.at)
        self.at += struct.calcsize(form)
        return values

    def _text(self):
        (n,) = self._take("<I")
        self.at += n
        return bytes(self.message[self.at - n : self.at]).decode()

    def _field(self):
        (kind,), name = self._take("<B"), self._text()
        if kind == 5:
            self.fields[name] = self._text()
        elif kind == 4:
            self.fields[name] = self._take(f"<{self._take('<I')[0]}d")
        else:
            (self.fields[name],) = self._take({1: "<?", 2: "<q", 3: "<d"}[kind])

    def _column(self):
        import numpy as np

        name = self._text()
        kind, width, n_bytes = self._take("<BIQ")
        self.at += -self.at % 8
        form = {1: "<f8", 2: "<f4", 3: "<i8", 4: "<u4", 5: "u1"}[kind]
        n = n_bytes // np.dtype(form).itemsize
        self.columns[name] = np.frombuffer(self.message, form, n, self.at).reshape(-1, width)
        self.at += n_bytes


def items(run_folder, wire):
    """The items of a recorded wire, by the reader of the package mcap."""
    if not _has("mcap"):
        raise Missing("no Python package mcap")
    from mcap.reader import make_reader

    found = []
    with open(run_folder / "run.mcap", "rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=[f"/exact/{wire}"]):
            # A sequence of bytes in CDR: 4 bytes of its head, 4 of its length.
            found.append(Item(message.data[8 if channel.message_encoding == "cdr" else 0 :]))
    return found


def main(write):
    """Runs all tests; writes docs/clients.md, or prints its rows."""
    rows, skipped, failed = [], [], []
    only = sys.argv[2:] if write is None else []
    for name, found, test in TESTS:
        if only and not any(word.lower() in name.lower() for word in only):
            continue
        try:
            version = found()
            for row in test():
                rows.append((name, version, row))
                word = "ok" if row.holds else "WRONG"
                print(f"{word:5} {name} {version}: {row.what}: {row.difference:.2g} {row.unit}", flush=True)
                if not row.holds:
                    failed.append(f"{name}: {row.what}: {row.difference:.3g} {row.unit} is more than {row.tolerance:g}")
        except Missing as missing:
            skipped.append((name, str(missing)))
            print(f"skipped: {name}: {missing}", flush=True)
        except Exception as error:  # noqa: BLE001 (a test that breaks is a failure with its reason, and the others go on)
            failed.append(f"{name}: {type(error).__name__}: {error}")
            print(f"WRONG {failed[-1]}", flush=True)
    print(f"{len(rows)} rows of {len({name for name, *_ in rows})} clients, {len(skipped)} skipped, {len(failed)} wrong")
    return rows, skipped, failed
