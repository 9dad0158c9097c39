#!/usr/bin/env python3
"""Builds the wheel of osteoflow, and tries it as somebody without Rust would.

    nodes/python/wheel.py                         build into target/wheels, then try in a fresh environment
    nodes/python/wheel.py --python python3.13     try with another interpreter; the wheel is the same for all from 3.9 on
    nodes/python/wheel.py --wheel FILE            only try a wheel
    nodes/python/wheel.py --no-try                only build

It needs Python 3.9 and, to build, Rust and a C compiler; it installs maturin into an environment of its own below target/. The wheel
holds one library, built from what `cargo build --release` has compiled already, as far as it has.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
ROOT = PACKAGE.parents[1]
BIN = "Scripts" if os.name == "nt" else "bin"
#: Of what pip prints nothing is of interest, unless it fails.
INSTALL = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--retries=1", "--timeout=20"]


def run(*command: object, **options: object) -> None:
    """Runs a command, which must succeed."""
    words = [str(word) for word in command]
    print("+", *words, flush=True)
    subprocess.run(words, check=True, **options)


def interpreter(environment: Path) -> Path:
    return environment / BIN / ("python.exe" if os.name == "nt" else "python")


def maturin(target: Path, given: str | None) -> list[str]:
    """The command maturin: that of an interpreter which has it, or of an environment that is made for it."""
    if given is not None:
        return [given, "-m", "maturin"]
    environment = target / "wheel-tools"
    python = interpreter(environment)
    if not python.exists():
        run(sys.executable, "-m", "venv", environment)
    # The version that pyproject.toml asks for. patchelf would only be needed to take libraries along, and there are none.
    run(python, *INSTALL, "maturin>=1.7,<2")
    return [str(python), "-m", "maturin"]


def build(target: Path, out: Path, given: str | None) -> Path:
    """The wheel, tagged by maturin's check with what it needs of the system: on Linux the oldest C library that has its symbols."""
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="wheel-", dir=target) as fresh:
        environment = {**os.environ, "CARGO_TARGET_DIR": str(target)}
        run(*maturin(target, given), "build", "--release", "--locked", "--strip", "--out", fresh, cwd=PACKAGE, env=environment)
        [wheel] = Path(fresh).glob("*.whl")
        out.mkdir(parents=True, exist_ok=True)
        built = out / wheel.name
        shutil.move(wheel, built)
    print(f"{built}: {built.stat().st_size / 1e6:.1f} MB, built in {time.monotonic() - begun:.0f} s")
    return built


def without_rust() -> str:
    """PATH without the folders that have a Rust compiler or cargo."""
    has_rust = lambda folder: any(shutil.which(name, path=folder) for name in ("cargo", "rustc", "rustup", "osteoflow"))
    return os.pathsep.join(folder for folder in os.environ["PATH"].split(os.pathsep) if folder and not has_rust(folder))


def try_out(wheel: Path, python: str, numpy: str) -> None:
    """Installs the wheel into a fresh environment, and runs try_wheel.py and try_first_week.py there, without Rust and outside of the checkout."""
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="osteoflow-wheel-") as folder:
        environment = Path(folder) / "venv"
        run(python, "-m", "venv", environment)
        kept = ("PATH", "HOME", "TMPDIR", "TEMP", "TMP", "SYSTEMROOT", "LANG", "SSL_CERT_FILE", "PIP_INDEX_URL", "PIP_CERT")
        environ = {name: value for name, value in os.environ.items() if name in kept or name.startswith("PIP_")}
        environ["PATH"] = without_rust()
        run(interpreter(environment), *INSTALL, wheel, numpy, env=environ)
        print(f"installed in {time.monotonic() - begun:.0f} s")
        # Copied, so that nothing is taken from the checkout.
        for file in (PACKAGE / "try_wheel.py", PACKAGE / "try_first_week.py", ROOT / "README.md", ROOT / "docs/begin/first-week.md"):
            shutil.copy(file, folder)
        environ["OSTEOFLOW_CACHE"] = str(Path(folder) / "cache")
        # The page has pip install scipy, which is not built for every old numpy.
        for script in ("try_wheel.py", "try_first_week.py") if numpy == "numpy" else ("try_wheel.py",):
            begun = time.monotonic()
            run(interpreter(environment), "-I", script, cwd=folder, env=environ)
            print(f"{script} took {time.monotonic() - begun:.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder of the wheel; default: wheels in the target folder")
    parser.add_argument("--wheel", type=Path, help="a wheel to try, instead of building one")
    parser.add_argument("--no-try", action="store_true", help="only build")
    parser.add_argument("--python", default=sys.executable, help="interpreter to try the wheel with; default: this one")
    parser.add_argument("--numpy", default="numpy", help="what pip installs as numpy, such as numpy==1.22.4; default: the newest")
    parser.add_argument("--maturin", metavar="PYTHON", help="an interpreter that has maturin; default: an environment is made")
    args = parser.parse_args()
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
    target.mkdir(parents=True, exist_ok=True)
    wheel = args.wheel.resolve() if args.wheel else build(target, args.out or target / "wheels", args.maturin)
    if not args.no_try:
        try_out(wheel, args.python, args.numpy)


if __name__ == "__main__":
    try:
        main()
    except subprocess.CalledProcessError as failed:
        sys.exit(f"error: {failed.cmd[0]} ended with exit code {failed.returncode}")
