"""Does the tasks of docs/compared.md with each program that is on this machine.

    python3 tests/compared/run.py --check      prints error and processor time of each
    python3 tests/compared/run.py --write      writes the table of docs/compared.md, too

What each program needs is in tests/clients/install. Exit code 0: all that is here ends as the page says; 1: something does not; 2: numpy is missing.
"""

import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "clients"))

try:
    import numpy as np
except ImportError:
    print("no Python package numpy")
    sys.exit(2)

from client import PROGRAM, ROOT, Missing, Row, client, debian, folder, main, run

DATA = ROOT / "tests" / "data" / "folder"
RIGHT_MM = 1.5  # a registration farther off is of another place on the bone
TABLE = []
SEEDS = range(42, 47)
# Of one thread, so that processor times compare; OSTEOFLOW_CACHE is off, as nothing of the others is kept either.
QUIET = {**os.environ, "NO_COLOR": "1", "OSTEOFLOW_CACHE": "off", "PYTHONDONTWRITEBYTECODE": "1", "QT_QPA_PLATFORM": "offscreen"}


def timed(*command, **options):
    """What a program prints, and the processor seconds that it and its children took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = run(*command, env=QUIET, timeout=1800, **options)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def lines(file):
    """Lines of a script that are neither empty nor comments."""
    text = re.sub(r'""".*?"""', "", (HERE / file).read_text(encoding="utf-8"), flags=re.S)
    return sum(1 for line in text.splitlines() if line.strip() and not line.strip().startswith("#"))


def row(task, program, version, what, n_lines, cpu_s, found):
    TABLE.append((task, program, version, what, n_lines, cpu_s, found))


def truth_of(truth):
    return np.array(truth["CT_T_W"]) @ np.array(truth["W_T_C_scan"])


def read_ply(file):
    """The points of a binary PLY of doubles, as `osteoflow simulate` writes."""
    head, _, body = file.read_bytes().partition(b"end_header\n")
    n = int(re.search(rb"element vertex (\d+)", head).group(1))
    kinds = [(name.decode(), {b"double": "<f8", b"float": "<f4"}[kind]) for kind, name in re.findall(rb"property (\w+) (\w+)", head)]
    table = np.frombuffer(body, np.dtype(kinds), n)
    return np.column_stack([table[axis].astype(float) for axis in "xyz"])


def write_ply(file, points):
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
    file.write_text(head + "".join("%.6f %.6f %.6f\n" % tuple(point) for point in points), encoding="utf-8")


def error_mm(pose):
    """Mean error of the scan's points under a pose of the two files."""
    points, true = read_ply(DATA / "scan.ply"), truth_of(json.loads((DATA / "truth.json").read_text()))
    at = lambda matrix: points @ matrix[:3, :3].T + matrix[:3, 3]  # noqa: E731
    return float(np.linalg.norm(at(pose) - at(true), axis=1).mean())


def scans():
    """A bone and five scans of it by the simulated camera, in the bone's coordinates; made once."""
    place = folder() / "study"
    if not place.exists():
        place.mkdir()
        (place / "bone.stl").write_bytes((DATA / "bone.stl").read_bytes())
        for seed in SEEDS:
            made = folder() / f"seed-{seed}"
            run(PROGRAM, "simulate", "--seed", seed, "--points", 10000, "--as", "folder", "--out", made)
            true = truth_of(json.loads((made / "truth.json").read_text()))
            write_ply(place / f"scan_{seed}.ply", read_ply(made / "scan.ply") @ true[:3, :3].T + true[:3, 3])
    return place / "bone.stl", sorted(place.glob("scan_*.ply"))


def live():
    """Runs the live procedure with its page: the mean error at the assessment points, the verdict, and the processor seconds of all of it."""
    out = folder() / "live"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [PROGRAM, "run", "graphs/variants/fibula_live.toml", "--serve", "--out", out]
    served = subprocess.Popen(command, cwd=ROOT, env=QUIET, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    page = next(line.split()[1] for line in served.stderr if line.startswith("page: "))
    threading.Thread(target=served.stderr.read, daemon=True).start()
    assert b"<title>Osteoflow</title>" in urllib.request.urlopen(page, timeout=20).read()
    until = time.monotonic() + 120
    while not (out / "manifest.json").exists():
        assert time.monotonic() < until, "the live run does not end"
        time.sleep(0.05)
    served.send_signal(signal.SIGINT)
    served.wait(timeout=20)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    results = json.loads((out / "results.json").read_text())
    procedure = ROOT / "tests" / "data" / "procedure"
    true, plan = (json.loads((procedure / name).read_text()) for name in ("truth.json", "plan.json"))
    planned = np.array(list(plan["assessment"].values()))
    move = lambda matrix, points: points @ matrix[:3, :3].T + matrix[:3, 3]  # noqa: E731
    in_world = move(np.linalg.inv(np.array(true["CT_T_W"])), planned)
    found = move(np.array(results["poses"]["t_ct_world"]["matrix"]), in_world)
    off = float(np.linalg.norm(found - planned, axis=1).mean())
    return off, results["verdict"]["answer"], after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@client("Osteoflow", version=lambda: run(PROGRAM, "--version").stdout.split()[1])
def osteoflow():
    version = run(PROGRAM, "--version").stdout.split()[1]
    files = [DATA / "bone.stl", DATA / "scan.ply"]
    said, cpu_s = timed(PROGRAM, "register", *files, "--format", "json", "--workers", 1)
    answer = json.loads(said)
    off = error_mm(np.array(answer["T"]).reshape(4, 4))
    row("two files", "Osteoflow", version, "one command", 1, cpu_s, f"{off:.2f} mm off, {answer['verdict']['answer']}")
    yield Row("two files", off, tolerance=RIGHT_MM)

    scans()
    place = folder() / "study"
    graph = (HERE / "study.toml").read_text(encoding="utf-8").replace("../../graphs/", f"{ROOT}/graphs/")
    (place / "study.toml").write_text(graph, encoding="utf-8")
    _, cpu_s = timed(PROGRAM, "sweep", place / "study.toml", "--out", place / "S")
    rows = [line.split(",") for line in (place / "S" / "runs.csv").read_text().splitlines()]
    column = {name: rows[0].index(name) for name in ("method", "error_mm", "status")}
    errors = {}
    for line in rows[1:]:
        errors.setdefault(line[column["method"]].split(".")[1], []).append(float(line[column["error_mm"]]))
    means = {name: float(np.mean(found)) for name, found in errors.items()}
    said = ", ".join(f"{name} {mean:.3f} mm" for name, mean in means.items())
    row("study", "Osteoflow", version, "graph of `study.toml`", lines("study.toml"), cpu_s, said)
    assert all(len(found) == len(SEEDS) for found in errors.values()), errors
    yield Row("study of two methods, larger mean", max(means.values()), tolerance=RIGHT_MM)
    off, answer, cpu_s = live()
    row("live view", "Osteoflow", version, "one command, 10 times the recorded speed", 1, cpu_s, f"bone, scan, residuals, verdict, planes; {off:.2f} mm off, {answer}")
    yield Row("live view, mean at the assessment points", off, tolerance=RIGHT_MM)


@client("Open3D", module="open3d")
def open3d():
    import importlib.metadata

    version = importlib.metadata.version("open3d")
    files = [DATA / "bone.stl", DATA / "scan.ply"]
    script = HERE / "open3d_two_files.py"
    times, offs = [], []
    for seed in range(5):
        said, cpu_s = timed(sys.executable, script, *files, 1, seed)
        times.append(cpu_s)
        offs.append(error_mm(np.loadtxt(said.splitlines())))
    right = sum(off < RIGHT_MM for off in offs)
    what = f"`{script.name}`, one try, with five seeds"
    row("two files", "Open3D", version, what, lines(script.name), float(np.median(times)), f"{right} of {len(offs)} right; {max(offs):.0f} mm off at most")
    said, cpu_s = timed(sys.executable, script, *files, 10)
    off = error_mm(np.loadtxt(said.splitlines()))
    row("two files", "Open3D", version, f"`{script.name}`, the best of ten tries", lines(script.name), cpu_s, f"{off:.2f} mm off")
    yield Row("two files, the best of ten tries", off, tolerance=RIGHT_MM)
    bone, found = scans()
    said, cpu_s = timed(sys.executable, HERE / "open3d_study.py", bone, *found, cwd=bone.parent)
    means = dict(re.findall(r"(point_to_\w+) .*mean ([\d.]+)", said))
    words = ", ".join(f"{name} {float(mean):.3f} mm" for name, mean in means.items())
    row("study", "Open3D", version, "`open3d_study.py`, from starts within 8 degrees and 5 mm", lines("open3d_study.py"), cpu_s, words)
    # Plain point-to-point moves slowly along the bone, and stops early: that is what it gives.
    yield Row("study, mean of point-to-plane", float(means["point_to_plane"]), tolerance=RIGHT_MM)


@client("CloudCompare", version=lambda: debian("cloudcompare"), program="CloudCompare")
def cloudcompare():
    if subprocess.run(["which", "xvfb-run"], capture_output=True).returncode != 0:
        raise Missing("no xvfb-run, without which its command line needs a screen")
    place = folder() / "cloudcompare"
    place.mkdir()
    for name in ("bone.stl", "scan.ply"):
        (place / name).write_bytes((DATA / name).read_bytes())
    # What a person clicks: four places, each to the nearest millimetre; the start is the fit of the pairs.
    true = truth_of(json.loads((DATA / "truth.json").read_text()))
    plan = json.loads((DATA / "plan.json").read_text())
    on_bone = np.array([plan["assessment"][name] for name in ("M1", "M3", "M4", "M5")])
    on_scan = np.round((on_bone - true[:3, 3]) @ true[:3, :3])
    on_bone = np.round(on_bone)
    a, b = on_bone - on_bone.mean(0), on_scan - on_scan.mean(0)
    u, _, v = np.linalg.svd(a.T @ b)
    start = np.eye(4)
    start[:3, :3] = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    start[:3, 3] = on_bone.mean(0) - start[:3, :3] @ on_scan.mean(0)
    np.savetxt(place / "start.txt", start, fmt="%.9f")
    _, cpu_s = timed("bash", HERE / "cloudcompare_two_files.sh", "bone.stl", "scan.ply", "start.txt", cwd=place)
    pose = np.loadtxt(place / "scan_REGISTRATION_MATRIX.txt") @ start
    off = error_mm(pose)
    what = "four pairs clicked in its window, then `cloudcompare_two_files.sh`"
    row("two files", "CloudCompare", debian("cloudcompare"), what, lines("cloudcompare_two_files.sh"), cpu_s, f"{off:.2f} mm off ({error_mm(start):.2f} mm at the start)")
    yield Row("two files, from four pairs", off, tolerance=RIGHT_MM)


@client("evo", module="evo")
def evo():
    import importlib.metadata

    place = folder() / "study"
    if not (place / "point_to_plane.tum").exists():
        raise Missing("no poses of Open3D's study to compare")
    (place / "truth.tum").write_text("".join(f"{k} 0 0 0 0 0 0 1\n" for k in range(len(SEEDS))), encoding="utf-8")
    programs = str(Path(sys.executable).parent)
    QUIET["PATH"] = programs + os.pathsep + os.environ["PATH"]
    QUIET["HOME"] = str(folder())
    QUIET["MPLBACKEND"] = "Agg"
    said, cpu_s = timed("bash", HERE / "evo_study.sh", "truth.tum", "point_to_plane.tum", "point_to_point.tum", cwd=place)
    table = (place / "table.csv").read_text()
    assert "rmse" in table and "point_to_point" in table, said[-800:]
    version = importlib.metadata.version("evo")
    row("study", "evo", version, "`evo_study.sh`, on the poses of Open3D's study", lines("evo_study.sh"), cpu_s, "maximum, mean, median, RMSE, SD of each")
    yield Row("a table of two methods", 0.0, "")


@client("Rerun", module="rerun", package="rerun-sdk")
def rerun():
    import importlib.metadata

    version = importlib.metadata.version("rerun-sdk")
    bone, found = scans()
    out = folder() / "live.rrd"
    _, cpu_s = timed(sys.executable, HERE / "rerun_live.py", "--save", out, bone, *found)
    assert out.stat().st_size > 1_000_000, out.stat().st_size
    row("live view", "Rerun", version, "`rerun_live.py`, registered by Open3D", lines("rerun_live.py"), cpu_s, "bone, scan, residuals, a plot over time")
    yield Row("five scans on a bone logged", 0.0, "")


def page(text):
    """The page with its table as it was found."""
    head, rest = text.split("<!-- measured -->\n")
    _, tail = rest.split("<!-- end -->")
    order = {task: k for k, task in enumerate(["two files", "study", "live view"])}
    table = "| Task | Program | With | Lines | CPU, s | Found |\n|---|---|---|---|---|---|\n"
    for task, program, version, what, n_lines, cpu_s, found in sorted(TABLE, key=lambda line: order[line[0]]):
        cpu = "" if cpu_s is None else f"{cpu_s:.1f}"
        table += f"| {task} | {program} {version} | {what} | {n_lines} | {cpu} | {found} |\n"
    return f"{head}<!-- measured -->\n{table}<!-- end -->{tail}"


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in ("--check", "--write"):
        sys.exit(__doc__)
    writes = sys.argv[1] == "--write"
    rows, skipped, failed = main(True if writes else None)
    if writes and not failed and not skipped:
        file = ROOT / "docs" / "compared.md"
        file.write_text(page(file.read_text(encoding="utf-8")), encoding="utf-8")
    elif writes and skipped:
        print("docs/compared.md is written where all programs are: skipped " + ", ".join(name for name, _ in skipped))
    sys.exit(1 if failed else 0)
