#!/usr/bin/env python3
"""A benchmark of verdicts: right and wrong poses of scans whose true pose is known, judged by us and by the measures of others.

trustbench.py FOLDER --out DIR             FOLDER has manifest.json, or the folders hip, range, prints, skull of docs/method/trustbench.md
trustbench.py FOLDER --out DIR --poses 15  so many right and twice as many wrong poses of each scan
trustbench.py FOLDER --out DIR --page FILE writes the tables into FILE between <!-- trustbench --> and <!-- end -->
trustbench.py --figures DIR/answers.json   draws the tables again, as after a column of another measure was added to `scores`

Poses are drawn and registered, judged by `osteoflow sweep`, measured by the others, and drawn; each step is kept in DIR, and the same command
goes on after an interruption. docs/method/trustbench.md has the manifest and what each measure is. It needs Python 3.9, numpy and scipy;
Open3D computes its own measures where this interpreter has it.
"""

import argparse
import csv
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import beta

from benchmark import range_pairs, toml

HERE = Path(__file__).resolve().parent
ANSWERS = ["trusted", "doubtful", "refused"]
OURS = "osteoflow, by its chance of being wrong"
MAX_POINTS = 4000
# Counts up where a measure changes: those that are kept are then measured anew.
MEASURES = 1
# How each wrong pose is made, and how many for one right pose: two in all.
WRONG = {"neighbouring": 8 / 15, "mirrored": 6 / 15, "slid": 4 / 15, "turned": 4 / 15, "wrong model": 4 / 15, "wrong sensor": 4 / 15}
# The logistic regressions, by the features that they are given.
LEARNT = {
    "CorAl: logistic regression of joint and separate entropy": ["joint entropy", "separate entropy"],
    "logistic regression of NDT scores and residuals": ["NDT score, fine", "NDT score, coarse", "residual RMS", "median residual", "fitness"],
}


def digest(value):
    data = value.read_bytes() if isinstance(value, Path) else json.dumps(value, sort_keys=True).encode()
    return hashlib.sha256(data).hexdigest()


def write(path, text):
    """The whole file or none of it, whenever this ends."""
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_name(path.name + ".part")
    scratch.write_text(text, encoding="utf-8")
    os.replace(scratch, path)


def write_json(path, value):
    write(path, json.dumps(value, indent=1) + "\n")


# --- poses ---------------------------------------------------------------------------------------


def about(point, rotation, shift):
    """Turns about a point, then shifts."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, point - rotation @ point + shift
    return pose


def turned(axis, angle_rad):
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross


def moved(pose, points):
    return points @ pose[:3, :3].T + pose[:3, 3]


def principal(points):
    """The centroid, and the principal axes in columns, right-handed, the longest first."""
    centre = points.mean(axis=0)
    axes = np.linalg.svd(points - centre, full_matrices=False)[2].T
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return centre, axes


def drawn(rng, pose, points, turn_deg, shift_mm):
    """The pose turned and shifted about the points, by angles and lengths between the two ends of each range."""
    axis, way = rng.normal(size=3), rng.normal(size=3)
    turn = turned(axis, np.radians(rng.uniform(*turn_deg)))
    return about(moved(pose, points).mean(axis=0), turn, way / np.linalg.norm(way) * rng.uniform(*shift_mm)) @ pose


def kabsch(target, source):
    a, b = target - target.mean(axis=0), source - source.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    pose = np.eye(4)
    pose[:3, :3] = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    pose[:3, 3] = target.mean(axis=0) - pose[:3, :3] @ source.mean(axis=0)
    return pose


def spread(points, n):
    """Points of the cloud that are far from each other."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    far = np.full(len(points), np.inf)
    while len(chosen) < min(n, len(points)):
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(far)))
    return points[chosen]


# --- files ---------------------------------------------------------------------------------------


def rows_of(path):
    return np.array([[float(word) for word in line.replace(",", " ").split()[:3]] for line in path.read_text().splitlines() if line.strip()])


def known_sets(folder, out):
    """The pairs of hip, range, prints and skull, as far as they are there. Limits are those of the sets' authors where they state one, and each
    scan states its sensor."""
    pairs, eye = [], np.eye(4).tolist()

    def add(kind, scan, surface, source, poses, right_mm, truth_mm, sensor, **more):
        pairs.append({"object": kind, "scan": scan, "surface": str(surface.resolve()), "source": str(source.resolve()), "t_surface_scan": poses,
                      "right_mm": right_mm, "truth_mm": truth_mm, "settings": {"ct_surface.sensor.like": sensor}, **more})

    for surface in sorted((folder / "hip").glob("preoperative_*.stl")):
        name = surface.stem.split("operative_")[1]
        source = surface.with_name(f"intraoperative_{name}.xyz")
        if source.exists():
            add(name.replace("_", " "), "tracked ultrasound", surface, source, [eye], 4.0, 2.0, "ultrasound")
            # A limit below what the sensor attains is doubted for that alone; the default gives way to it.
            pairs[-1]["settings"]["verdict.rules.limits.max_tre_mm"] = 1.5
    if (folder / "range/bun.conf").exists():
        (out / "truth").mkdir(parents=True, exist_ok=True)
        for name, surface, source, truth in range_pairs(folder / "range", out / "truth"):
            pose = np.loadtxt(truth).tolist()
            add("bunny", name, surface, source, [pose], 1.5, 0.2, "laser", unit_mm=1000.0, source_unit_mm=1000.0)
    for source in sorted((folder / "prints").glob("*_*.xyz")):
        part = source.stem.rsplit("_", 1)[0]
        known = json.loads(source.with_suffix(".json").read_text())["t_scan_part_mm"]
        add(part, source.stem, folder / "prints" / f"{part}.stl", source, [np.linalg.inv(pose).tolist() for pose in known], 10.0, 2.0, "depth_camera")
    skull = folder / "skull"
    if (skull / "face.ply").exists():
        planned, touched = rows_of(skull / "planned.txt"), rows_of(skull / "touched.txt")
        # Every other landmark has the truth, and the rest are those of the rule of landmarks.
        on_face = kabsch(planned[::2], touched[::2]).tolist()
        for source in sorted(skull.glob("trace*.xyz")):
            add("skull", source.stem, skull / "face.ply", source, [on_face], 3.0, 1.0, "stylus",
                landmarks={"planned": planned[1::2].tolist(), "touched": touched[1::2].tolist()})
    return pairs


class Run:
    """The folder of a benchmark, and the program."""

    def __init__(self, given):
        self.out, self.program, self.workers = given.out, given.program, given.workers

    def command(self, *words):
        return subprocess.run([self.program, *map(str, words)], capture_output=True, text=True)

    def converted(self, source, ending, unit_mm):
        """The file in mm, as the program reads it."""
        target = self.out / "data" / f"{hashlib.sha256(f'{source} {unit_mm}'.encode()).hexdigest()[:12]}{ending}"
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            scratch = target.with_name("part_" + target.name)
            scratch.unlink(missing_ok=True)
            ended = self.command("convert", source, scratch, "--scale", unit_mm, "--quiet")
            if ended.returncode:
                sys.exit(f"{source}: {ended.stderr.strip()}")
            os.replace(scratch, target)
        return target

    def sweep(self, name, nodes, values, so_far=False):
        """What each value's run wrote, in order. A sweep that is there goes on; or gives what is there so far, and None for the rest."""
        file, out = self.out / f"{name}.toml", self.out / name
        if so_far:
            runs = [out / f"runs/{index:06d}.json" for index in range(len(values))]
            return [json.loads(run.read_text()) if run.exists() else None for run in runs]
        if not values:
            return []
        labels = [f"{index:04d}" for index in range(len(values))]
        graph = [f"extends = {json.dumps(str(HERE / 'recover.toml'))}", *nodes, "[sweep]\nrepeat = 1\ntwice = 0.0\nunits = [\"pose\", \"repeat\"]", "[sweep.factor]",
                 f"pose = {toml({'values': values, 'labels': labels})}"]
        write(file, "\n".join(graph) + "\n")
        if out.exists() and not (out / "sweep.json").exists():
            shutil.rmtree(out)  # interrupted before it began
        words = [self.program, "sweep", str(file), "--out", str(out), "--workers", str(self.workers), "--quiet"]
        ended = subprocess.run(words + ["--resume"] * out.exists(), env={"OMP_NUM_THREADS": "1", **os.environ}, stdout=subprocess.DEVNULL)
        runs = sorted((out / "runs").glob("*.json")) if out.exists() else []
        # 3: no pose has results, as where all are refused.
        if len(runs) != len(values) or ended.returncode not in (0, 3):
            sys.exit(f"{out}: the sweep ended with code {ended.returncode} and {len(runs)} of {len(values)} runs; the same command goes on")
        found = [json.loads(run.read_text()) for run in runs]
        if [ran["values"]["pose"] for ran in found] != labels:
            sys.exit(f"{out}: its runs are not in the order of {file}; give another --out")
        return found


def stl(path):
    data = path.read_bytes()
    n = int.from_bytes(data[80:84], "little")
    if len(data) != 84 + 50 * n:
        sys.exit(f"{path}: no binary STL")
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("byte_count", "<u2")])
    return np.frombuffer(data[84:], record)["corners"].astype(float)


def write_stl(path, corners):
    record = np.zeros(len(corners), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("byte_count", "<u2")]))
    record["corners"] = corners
    scratch = path.with_name("part_" + path.name)
    scratch.write_bytes(bytes(80) + len(corners).to_bytes(4, "little") + record.tobytes())
    os.replace(scratch, path)


def drawn_on(rng, corners, n):
    """Points drawn on triangles by area, and their normals."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    face = rng.choice(len(corners), n, p=area / area.sum())
    a, b = rng.random((2, len(face), 1))
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)
    of = corners[face]
    return of[:, 0] + a * (of[:, 1] - of[:, 0]) + b * (of[:, 2] - of[:, 0]), cross[face] / area[face, None]


class Surface:
    """A surface's file, and points drawn on it."""

    known = {}

    def __init__(self, path):
        self.path, self.corners = path, stl(path)
        self.points, _ = drawn_on(np.random.default_rng(7), self.corners, 150_000)
        self.tree = cKDTree(self.points)
        self.centre, self.axes = principal(self.points)
        self.radius = float(np.sqrt(np.mean(np.sum((self.points - self.centre) ** 2, axis=1))))

    @classmethod
    def of(cls, path):
        if Path(path) not in cls.known:
            cls.known[Path(path)] = cls(Path(path))
        return cls.known[Path(path)]

    def mirrored(self):
        """The mirror image, and the reflection that makes it."""
        normal = self.axes[:, 1]
        reflection = about(self.centre, np.eye(3) - 2 * np.outer(normal, normal), 0)
        path = self.path.with_name(self.path.stem + "_mirrored.stl")
        if not path.exists():
            write_stl(path, moved(reflection, self.corners.reshape(-1, 3)).reshape(-1, 3, 3)[:, ::-1])
        return path, reflection


def prepared(run, pairs):
    """Surfaces, scans and targets of the pairs, in mm."""
    for index, pair in enumerate(pairs):
        pair["mesh"] = run.converted(pair["surface"], ".stl", pair.get("unit_mm", 1.0))
        cloud = rows_of_csv(run.converted(pair["source"], ".csv", pair.get("source_unit_mm", 1.0)))
        pair["points"] = cloud[np.linspace(0, len(cloud) - 1, min(len(cloud), MAX_POINTS)).astype(int)]
        pair["poses"] = [np.array(pose, float) for pose in pair["t_surface_scan"]]
        pair["at"] = spread(pair["points"], 20)
        pair["file"] = run.out / "data" / f"scan_{index:03d}.xyz"
        write_points(pair["file"], pair["points"])
    return pairs


def rows_of_csv(path):
    with open(path, newline="", encoding="utf-8") as rows:
        return np.array([[float(row[axis]) for axis in "xyz"] for row in csv.DictReader(rows)])


def write_points(path, points):
    if not path.exists():
        write(path, "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in points))


def write_pose(path, pose):
    write(path, "\n".join(" ".join(repr(float(number)) for number in row) for row in pose) + "\n")


# --- the poses that are judged --------------------------------------------------------------------


def error_mm(pair, pose, distort=None):
    """Mean error of the targets against the nearest true pose, where this sensor saw them."""
    seen = pair["at"] if distort is None else moved(distort, pair["at"])
    return min(float(np.mean(np.linalg.norm(moved(pose, seen) - moved(true, pair["at"]), axis=1))) for true in pair["poses"])


def off_by(pair, motion, wanted_mm):
    """The size at which the motion moves the targets by so much on average."""
    low, high = 0.0, 1.0
    while error_at(pair, motion(high)) < wanted_mm and high < 1e6:
        high *= 2
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if error_at(pair, motion(middle)) < wanted_mm else (low, middle)
    return high


def error_at(pair, pose):
    return float(np.mean(np.linalg.norm(moved(pose, pair["at"]) - moved(pair["poses"][0], pair["at"]), axis=1)))


def starts(run, pairs, index, n, seed):
    """What is to be judged of a pair: its kind, and the pose, or where the registration starts."""
    pair, rng = pairs[index], np.random.default_rng([seed, index])
    true, points, limit, truth_mm = pair["poses"][0], pair["points"], pair["right_mm"], pair["truth_mm"]
    surface = Surface.of(pair["mesh"])
    centre, axes = principal(moved(true, points))
    radius = float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
    count = {kind: max(1, round(share * n)) for kind, share in WRONG.items()}
    found = []

    def add(kind, how, pose, mesh=pair["mesh"], scan=pair["file"], **more):
        found.append({"pair": index, "kind": kind, "how": how, "pose": pose, "mesh": mesh, "scan": scan, **more})

    for _ in range(n - n // 2):
        add("registered from near the truth", "start", drawn(rng, true, points, (0, 8), (0, 0.1 * radius)))
    for _ in range(n // 2):
        axis, way, part = rng.normal(size=3), rng.normal(size=3), rng.uniform(0, 1 / 3)

        def near(size, axis=axis, way=way):
            return about(centre, turned(axis, size / radius), size * way / np.linalg.norm(way)) @ true

        add("beside the truth, as given", "given", near(off_by(pair, near, part * limit)))
    for _ in range(count["neighbouring"]):
        add("neighbouring", "start", drawn(rng, true, points, (30, 180), (0.2 * radius, 0.8 * radius)))
    for kind in ("slid", "turned"):
        for _ in range(count[kind]):
            way, part = rng.choice([-1, 1]), rng.uniform(1.5, 4)

            def along(size, kind=kind, way=way):
                turn = turned(axes[:, 0], way * min(size, np.pi)) if kind == "turned" else np.eye(3)
                return about(centre, turn, way * size * axes[:, 0] if kind == "slid" else 0) @ true

            pose = along(off_by(pair, along, part * limit + truth_mm))
            # A thin scan that is turned half way round may still not be off by as much: it is then as far off as it can be.
            add(kind, "given", pose)
    mirrored, reflection = surface.mirrored()
    for number in range(count["mirrored"]):
        normal = principal(points)[1][:, number % 3]
        pose = reflection @ true @ about(points.mean(axis=0), np.eye(3) - 2 * np.outer(normal, normal), 0)
        by_shape = number == count["mirrored"] - 1 and number > 0
        add("mirrored", "shape" if by_shape else "start", drawn(rng, pose, points, (0, 8), (0, 0.1 * radius)), mesh=mirrored, is_other=True)
    others = {other["object"]: Surface.of(other["mesh"]) for other in pairs if other["object"] != pair["object"]}
    others = sorted(others.values(), key=lambda other: abs(np.log(other.radius / surface.radius)))[:2]
    for number in range(count["wrong model"] if others else 0):
        other, flip = others[number % len(others)], np.diag([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]][rng.integers(4)])
        pose = np.eye(4)
        pose[:3, :3] = other.axes @ flip @ surface.axes.T
        pose[:3, 3] = other.centre - pose[:3, :3] @ surface.centre
        by_shape = number == count["wrong model"] - 1 and number > 0
        start = drawn(rng, pose @ true, points, (0, 15), (0, 0.1 * radius))
        add("wrong model", "shape" if by_shape else "start", start, mesh=other.path, is_other=True)
    for number in range(count["wrong sensor"]):
        middle, of_targets = points.mean(axis=0), np.mean(np.linalg.norm(pair["at"] - points.mean(axis=0), axis=1))
        scale = 1 + rng.choice([-1, 1]) * min(0.15, (rng.uniform(1.5, 3) * limit + truth_mm) / of_targets)
        distort = about(middle, scale * np.eye(3), 0)
        scan = run.out / "data" / f"scan_{index:03d}_scaled_{number}.xyz"
        write_points(scan, moved(distort, points))
        add("wrong sensor", "start", drawn(rng, true, points, (0, 8), (0, 0.1 * radius)), scan=scan, distort=distort.tolist())
    return found


def registered(run, asked, how):
    """Registers what starts so, and puts the found pose into its place; None where there is none."""
    chosen = [(index, one) for index, one in enumerate(asked) if one["how"] == how]
    values = []
    for index, one in chosen:
        start = run.out / "starts" / f"{index:04d}.txt"
        write_pose(start, one["pose"])
        values.append({"bone.path": str(one["mesh"].resolve()), "scan.path": str(one["scan"].resolve()), "perturb.truth": str(start.resolve())})
    begin = 'coarse.t_target_source' if how == "shape" else "perturb.pose"
    left_out = ["node.verdict", "node.score", "results.judged", "results.score", "results.start", "sweep.factor", "sweep.columns", "record"]
    graph = [f"remove = {toml(left_out + ['node.coarse'] * (how != 'shape'))}",
             f'[graph]\nname = "trustbench_{how}"\nseed = 1', "[node.perturb]\nmax_turn_deg = 0.0\nmax_shift_mm = 0.0",
             f'[node.icp]\nin = {{ init = "{begin}" }}']
    for (_, one), ran in zip(chosen, run.sweep(f"registered_by_{how}", graph, values)):
        found = ((ran.get("results") or {}).get("poses") or {}).get("t_ct_camera")
        one["pose"] = None if found is None else np.array(found["matrix"], float).reshape(4, 4)


def judged_poses(run, pairs, n, seed):
    """All poses with their true error; as they were made, if they were."""
    path = run.out / "poses.json"
    if not path.exists():
        asked = [one for index in range(len(pairs)) for one in starts(run, pairs, index, n, seed)]
        registered(run, asked, "start")
        registered(run, asked, "shape")
        rows = []
        for one in asked:
            if one["pose"] is None:
                continue
            pair, file = pairs[one["pair"]], run.out / "poses" / f"{len(rows):04d}.txt"
            write_pose(file, one["pose"])
            distort = None if "distort" not in one else np.array(one["distort"])
            error = None if one.get("is_other") else error_mm(pair, one["pose"], distort)
            at = moved(one["pose"], pair["at"] if distort is None else moved(distort, pair["at"]))
            targets = file.with_suffix(".csv")
            # A plan's points lie on its surface.
            at = Surface.of(one["mesh"]).points[Surface.of(one["mesh"]).tree.query(at)[1]]
            write(targets, "label,x,y,z\n" + "".join(f"M{k + 1},{x:.6f},{y:.6f},{z:.6f}\n" for k, (x, y, z) in enumerate(at)))
            label = "wrong" if error is None or error > pair["right_mm"] + pair["truth_mm"] else "right"
            # The truth does not tell near its limit, and a scan of a wrong sensor whose pose is right may be refused.
            if label == "right" and (error > pair["right_mm"] or distort is not None):
                label = "between"
            rows.append({"id": f"{len(rows):04d}", "pair": one["pair"], "object": pair["object"], "scan": pair["scan"], "kind": one["kind"],
                         "mesh": str(one["mesh"]), "file": str(one["scan"]), "label": label, "error_mm": error,
                         "sha256": digest(file), "targets_sha256": digest(targets)})
        write_json(path, {"n_without_pose": len(asked) - len(rows), "rows": rows})
    made = json.loads(path.read_text())
    for row in made["rows"]:
        file = run.out / "poses" / f"{row['id']}.txt"
        for name, expected in ((file, row["sha256"]), (file.with_suffix(".csv"), row["targets_sha256"])):
            if not name.exists() or digest(name) != expected:
                sys.exit(f"{name}: changed since it was made, so another pose was judged; put it back, or give another --out")
        row["pose"] = np.loadtxt(file)
    return made


# --- ours -----------------------------------------------------------------------------------------


def ask_us(run, pairs, rows, so_far):
    """The answer, the chance of being wrong, the predicted interval, and the processor time of each pose; gives the rows that have them. They
    are given in a random order, but a sweep takes those with one surface together: what is judged so far is no random sample."""
    rows = [rows[index] for index in np.random.default_rng(5).permutation(len(rows))]
    values = []
    for row in rows:
        pair, file = pairs[row["pair"]], run.out / "poses" / f"{row['id']}.txt"
        values.append({"bone.path": str(Path(row["mesh"]).resolve()), "scan.path": str(Path(row["file"]).resolve()),
                       "perturb.truth": str(file.resolve()), "targets.path": str(file.with_suffix(".csv").resolve()),
                       "verdict.rules.limits.max_tre_mm": pair["right_mm"], **pair.get("settings", {})})
    left_out = ["node.coarse", "node.icp", "node.score", "node.verdict.in.icp", "node.verdict.in.start", "results.score", "results.start",
                "results.icp", "results.poses.t_ct_camera", "results.t_ct_camera", "sweep.factor", "sweep.columns", "record"]
    graph = [f"remove = {toml(left_out)}",
             '[graph]\nname = "trustbench"\nseed = 1', "[node.perturb]\nmax_turn_deg = 0.0\nmax_shift_mm = 0.0",
             f'[node.targets]\nkind = "acquire.points"\nframe = "ct"\npath = {json.dumps(values[0]["targets.path"])}',
             '[node.verdict]\nin = { t_target_source = "perturb.pose", assessment = "targets.points" }']
    judged = []
    for index, (row, ran) in enumerate(zip(rows, run.sweep("judged", graph, values, so_far))):
        if ran is None:
            continue
        times = json.loads((run.out / f"judged/runs/times/{index:06d}.json").read_text())["nodes"]
        verdict = (ran.get("results") or {}).get("judged") or {}
        predicted = verdict.get("predicted") or {}
        row["answer"] = verdict.get("answer", "refused")
        row["reason"] = None if verdict else ran.get("reason")
        row["rules"] = [reason["rule"] for reason in verdict.get("reasons", [])]
        row["stated_chance"] = verdict.get("chance_of_being_wrong")
        row["signs"] = verdict.get("signs")
        row["beyond_limits"] = predicted.get("beyond_limits")
        row["interval_mm"] = (predicted.get("assessment") or {}).get("interval_mm")
        row["cpu_s"] = {OURS: sum(node["cpu_ms"] for node in times if node["node"] == "verdict") / 1000}
        judged.append(row)
    return sorted(judged, key=lambda row: row["id"])


def our_order(row):
    """What the answers are ordered by: the chance that is stated of each; of answers without one, the answer, then what is predicted."""
    if row["stated_chance"] is not None:
        return row["stated_chance"]
    beyond = row["beyond_limits"]
    return (ANSWERS.index(row["answer"]) + min(max(1.0 if beyond is None else beyond, 0.0), 1.0)) / 3


# --- others ---------------------------------------------------------------------------------------


def entropies(points, tree_points, k, radius):
    """The differential entropy of the Gaussian of the neighbours of each point; NaN with fewer than six of them."""
    distance, index = cKDTree(tree_points).query(points, k=min(k, len(tree_points)), distance_upper_bound=radius)
    is_near = np.isfinite(distance)
    near = tree_points[np.where(is_near, index, 0)]
    n = is_near.sum(axis=1)
    weight = is_near[:, :, None] / np.maximum(n, 1)[:, None, None]
    off = (near - (near * weight).sum(axis=1)[:, None]) * is_near[:, :, None]
    covariance = np.einsum("nki,nkj->nij", off, off) / np.maximum(n - 1, 1)[:, None, None]
    floor = (1e-3 * radius) ** 2
    found = 0.5 * np.log((2 * np.pi * np.e) ** 3 * np.maximum(np.linalg.det(covariance + floor * np.eye(3)), 1e-300))
    return np.where(n >= 6, found, np.nan)


def coral(points, surface, limit_mm):
    """Joint and separate entropy of CorAl over the points of both clouds that have a neighbour in the other; the surface is sampled as densely
    as the scan."""
    points = points[np.linspace(0, len(points) - 1, min(len(points), 800)).astype(int)]
    middle = points.mean(axis=0)
    reach = np.max(np.linalg.norm(points - middle, axis=1))
    radius = max(1.5 * float(np.median(cKDTree(points).query(points, k=min(11, len(points)))[0][:, -1])), limit_mm)
    beside = surface.points[np.linalg.norm(surface.points - middle, axis=1) < reach + radius]
    # One point of the surface in each cell as wide as the scan's points are apart.
    step = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1])) or radius / 3
    beside = beside[np.unique(np.floor(beside / step).astype(int), axis=0, return_index=True)[1]] if len(beside) else beside
    if len(beside) < 6:
        return None
    on_scan = np.isfinite(cKDTree(beside).query(points, distance_upper_bound=radius)[0])
    on_surface = np.isfinite(cKDTree(points).query(beside, distance_upper_bound=radius)[0])
    both, separate, joint = np.vstack([points, beside]), [], []
    for chosen, own in ((points[on_scan], points), (beside[on_surface], beside)):
        if len(chosen):
            separate.append(entropies(chosen, own, 64, radius))
            joint.append(entropies(chosen, both, 128, radius))
    if not joint:
        return None
    separate, joint = np.concatenate(separate), np.concatenate(joint)
    is_known = np.isfinite(separate) & np.isfinite(joint)
    return (float(joint[is_known].mean()), float(separate[is_known].mean())) if is_known.any() else None


def ndt_score(points, surface, edge):
    """Mean NDT score of the points in the surface's cells: exp(-d^2 / 2), 0 where the cell is empty."""
    cells = surface.__dict__.setdefault("ndt", {})
    if edge not in cells:
        key = np.floor(surface.points / edge).astype(int)
        _, inverse, n = np.unique(key, axis=0, return_inverse=True, return_counts=True)
        inverse = inverse.ravel()
        mean = np.array([np.bincount(inverse, surface.points[:, axis]) for axis in range(3)]).T / n[:, None]
        off = surface.points - mean[inverse]
        covariance = np.array([[np.bincount(inverse, off[:, i] * off[:, j]) for j in range(3)] for i in range(3)]).transpose(2, 0, 1)
        covariance = covariance / np.maximum(n - 1, 1)[:, None, None] + (0.05 * edge) ** 2 * np.eye(3)
        names = {tuple(cell): number for number, cell in enumerate(np.unique(key, axis=0)) if n[number] >= 6}
        cells[edge] = names, mean, np.linalg.inv(covariance)
    names, mean, inverse = cells[edge]
    which = np.array([names.get(tuple(cell), -1) for cell in np.floor(points / edge).astype(int)])
    found = which >= 0
    off = points[found] - mean[which[found]]
    return float(np.exp(-0.5 * np.einsum("ni,nij,nj->n", off, inverse[which[found]], off)).sum() / len(points))


def open3d():
    try:
        import open3d as library

        return library
    except ImportError:
        return None


def measured_by_others(pair, row, points, library):
    """What each measure says of a pose, larger being worse, and its processor time, s."""
    surface, near_mm = Surface.of(row["mesh"]), pair["right_mm"] / 2
    scores, features, cpu_s = {}, {}, {}

    def timed(name, work):
        begin = time.process_time()
        found = work()
        cpu_s[name] = time.process_time() - begin
        return found

    at = moved(row["pose"], points)
    distance = timed("residual RMS", lambda: surface.tree.query(at)[0])
    scores["residual RMS"] = float(np.sqrt(np.mean(distance**2)))

    def evaluate():
        if library is None:
            inlier = distance[distance < near_mm]
            return len(inlier) / len(distance), float(np.sqrt(np.mean(inlier**2))) if len(inlier) else 0.0
        cloud = library.geometry.PointCloud(library.utility.Vector3dVector(points))
        if not hasattr(surface, "open3d"):
            surface.open3d = library.geometry.PointCloud(library.utility.Vector3dVector(surface.points))
        found = library.pipelines.registration.evaluate_registration(cloud, surface.open3d, near_mm, row["pose"])
        return found.fitness, found.inlier_rmse

    fitness, rmse = timed("Open3D fitness (overlap)", evaluate)
    scores["Open3D fitness (overlap)"], scores["Open3D inlier RMSE"] = -fitness, rmse if fitness else 2 * near_mm
    cpu_s["Open3D inlier RMSE"] = cpu_s["Open3D fitness (overlap)"]
    if pair.get("landmarks") and row["kind"] != "wrong model":
        planned, touched = (np.array(pair["landmarks"][name], float) for name in ("planned", "touched"))
        planned = moved(Surface.of(pair["mesh"]).mirrored()[1], planned) if row["kind"] == "mirrored" else planned
        scores["FRE of other landmarks"] = timed("FRE of other landmarks", lambda: float(
            np.sqrt(np.mean(np.sum((moved(row["pose"], touched) - planned) ** 2, axis=1)))))
    entropy = timed("CorAl: joint less separate entropy", lambda: coral(at, surface, pair["right_mm"]))
    joint, separate = entropy or (np.nan, np.nan)
    scores["CorAl: joint less separate entropy"] = joint - separate if entropy else 20.0
    fine, coarse = timed("NDT score", lambda: (ndt_score(at, surface, 2 * near_mm), ndt_score(at, surface, 4 * near_mm)))
    scores["NDT score"] = -fine
    features = {"joint entropy": joint if entropy else 20.0, "separate entropy": separate if entropy else 0.0, "NDT score, fine": fine,
                "NDT score, coarse": coarse, "residual RMS": np.log(scores["residual RMS"] / near_mm),
                "median residual": np.log(float(np.median(distance)) / near_mm + 1e-3), "fitness": fitness}
    return {"scores": scores, "features": {name: float(value) for name, value in features.items()}, "cpu_s": cpu_s}


def ask_others(run, pairs, rows):
    """The measures of each pose, kept pose by pose."""
    library, points = open3d(), {}
    name = f"Open3D {library.__version__}" if library else "its definition, as Open3D is not installed"
    for row in rows:
        file = run.out / "measured" / f"{row['id']}.json"
        key = digest([row["sha256"], digest(Path(row["mesh"])), digest(Path(row["file"])), name, pairs[row["pair"]].get("landmarks"), MEASURES])
        kept = json.loads(file.read_text()) if file.exists() else {}
        if kept.get("key") != key:
            if row["file"] not in points:
                points[row["file"]] = rows_of(Path(row["file"]))
            kept = {"key": key, **measured_by_others(pairs[row["pair"]], row, points[row["file"]], library)}
            write_json(file, kept)
        row["scores"], row["features"] = kept["scores"], kept["features"]
        row["cpu_s"].update(kept["cpu_s"])
    return name


def name_twins(pairs, rows):
    """A wrong pose of an object with several true poses that fits as well as a right one of the same scan is a twin: nothing on it tells."""
    best = {}
    for row in rows:
        if row["label"] == "right":
            best[row["pair"]] = min(best.get(row["pair"], np.inf), row["scores"]["residual RMS"])
    for row in rows:
        if row["label"] == "wrong" and len(pairs[row["pair"]]["poses"]) > 1 and row["scores"]["residual RMS"] <= 1.05 * best.get(row["pair"], 0):
            row["label"] = "twin"


# --- figures --------------------------------------------------------------------------------------


class Resampled:
    """Weights of the poses under a bootstrap over objects, then over the scans of each."""

    def __init__(self, rows, n=2000):
        rng, scans = np.random.default_rng(11), sorted({(row["object"], row["scan"]) for row in rows})
        objects = sorted({name for name, _ in scans})
        of = {name: [index for index, scan in enumerate(scans) if scan[0] == name] for name in objects}
        self.weights = np.zeros((n, len(scans)))
        for draw in self.weights:
            for chosen in rng.integers(len(objects), size=len(objects)):
                inside = of[objects[chosen]]
                np.add.at(draw, rng.choice(inside, len(inside)), 1)
        self.of_row, self.n_objects, self.n_scans = {scan: index for index, scan in enumerate(scans)}, len(objects), len(scans)

    def interval(self, rows, statistic, ends=(2.5, 97.5)):
        at = np.array([self.of_row[(row["object"], row["scan"])] for row in rows])
        if self.n_scans < 2:
            return None
        found = np.array([statistic(draw[at]) for draw in self.weights])
        found = found[np.isfinite(found)]
        return np.percentile(found, ends) if len(found) else None


def auroc_of(rows, scores):
    """The function that gives the AUROC of wrong against right poses under weights."""
    wrong = np.array([row["label"] == "wrong" for row in rows])
    inverse = np.unique(np.asarray(scores, float), return_inverse=True)[1].ravel()

    def found(weight):
        right_at = np.bincount(inverse, weight * ~wrong)
        wrong_at = np.bincount(inverse, weight * wrong, minlength=len(right_at))
        total = right_at.sum() * wrong_at.sum()
        return float((wrong_at * (np.cumsum(right_at) - right_at / 2)).sum() / total) if total else np.nan

    return found


def learnt(rows, names):
    """The chance of being wrong by a logistic regression that has seen all objects but the one it judges; None with one object."""
    values = np.array([[row["features"][name] for name in names] for row in rows])
    wrong = np.array([row["label"] == "wrong" for row in rows], float)
    kind = np.array([row["object"] for row in rows])
    found = np.full(len(rows), np.nan)
    for out in set(kind):
        train = kind != out
        if len(set(wrong[train])) < 2:
            return None
        mean, sd = values[train].mean(axis=0), values[train].std(axis=0) + 1e-9
        x = np.column_stack([np.ones(len(rows)), np.clip((values - mean) / sd, -10, 10)])
        balance = np.where(wrong == 1, 0.5 / wrong[train].mean(), 0.5 / (1 - wrong[train].mean()))
        b, ridge = np.zeros(x.shape[1]), 1e-2 * train.sum() * np.diag([1e-6] + [1.0] * len(names))
        for _ in range(100):
            p = 1 / (1 + np.exp(-np.clip(x[train] @ b, -30, 30)))
            weight = balance[train] * np.maximum(p * (1 - p), 1e-6)
            slope = x[train].T @ (balance[train] * (wrong[train] - p)) - ridge @ b
            step = np.linalg.solve((x[train] * weight[:, None]).T @ x[train] + ridge, slope)
            b += step
            if np.abs(step).max() < 1e-9:
                break
        found[kind == out] = x[kind == out] @ b
    return found


def upper_limit(rows, is_bad):
    """Upper 95 % limit of a share: Clopper and Pearson with the number of poses that clusters leave (Korn and Graubard 1998); of none, with the
    number of objects."""
    objects = sorted({row["object"] for row in rows})
    n = np.array([sum(row["object"] == name for row in rows) for name in objects], float)
    bad = np.array([sum(bool(is_bad(row)) for row in rows if row["object"] == name) for name in objects], float)
    share, m = bad.sum() / n.sum(), len(objects)
    effective = m
    if 0 < bad.sum() < n.sum() and m > 1:
        variance = m / (m - 1) * np.sum((bad - share * n) ** 2) / n.sum() ** 2
        effective = min(max(share * (1 - share) / variance if variance else n.sum(), m), n.sum())
    hits = share * effective
    return float(beta.ppf(0.95, hits + 1, effective - hits)) if hits < effective else 1.0


def table(head, rows):
    return "\n".join(["| " + " | ".join(head) + " |", "|" + "---|" * len(head)] + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def counts(rows):
    return [sum(row["answer"] == answer for row in rows) for answer in ANSWERS]


def n_of(rows):
    return f"{len({(row['object'], row['scan']) for row in rows})}, {len({row['object'] for row in rows})}"


def number(value, digits=3):
    return "" if value is None or not np.isfinite(value) else f"{value:.{digits}f}"


def figures(answers):
    """The tables in Markdown, computed from the rows alone."""
    everything = answers["rows"]
    by = {label: [row for row in everything if row["label"] == label] for label in ("right", "wrong", "twin", "between")}
    rows = by["right"] + by["wrong"]
    if not by["right"] or not by["wrong"]:
        sys.exit(f"{len(by['right'])} right and {len(by['wrong'])} wrong poses: both are needed")
    resampled = Resampled(rows)
    orders = {OURS: [our_order(row) for row in rows]}
    for name in rows[0]["scores"] | {name: 0 for row in rows for name in row["scores"]}:
        orders[name] = [row["scores"].get(name) for row in rows]
    for name, features in LEARNT.items():
        found = learnt(rows, features)
        if found is not None:
            orders[name] = list(found)
    is_false = lambda row: row["answer"] == "trusted"  # noqa: E731
    n_false = sum(map(is_false, by["wrong"]))
    cost_of = {name: "CorAl: joint less separate entropy" if name.startswith("CorAl") else "NDT score" for name in LEARNT}
    of_methods, of_kinds, kinds = [], [], sorted({row["kind"] for row in by["wrong"]})
    for name, order in orders.items():
        chosen = [index for index, value in enumerate(order) if value is not None]
        some, values = [rows[index] for index in chosen], np.array([order[index] for index in chosen], float)
        right, wrong = values[[row["label"] == "right" for row in some]], np.sort(values[[row["label"] == "wrong" for row in some]])
        if not len(right) or not len(wrong):
            continue
        auroc = auroc_of(some, values)
        ends = resampled.interval(some, auroc)
        allowed = int(n_false * len(wrong) / len(by["wrong"]))
        kept = np.mean(right < wrong[allowed]) if allowed < len(wrong) else 1.0
        cost = [row["cpu_s"].get(cost_of.get(name, name)) for row in some]
        cost = [value for value in cost if value is not None]
        of_methods.append([name, len(right), len(wrong), n_of(some), number(auroc(np.ones(len(some)))),
                           "" if ends is None else f"{ends[0]:.3f} to {ends[1]:.3f}", f"{100 * kept:.0f} %",
                           number(np.median(cost) if cost else None)])
        cells = []
        for kind in kinds:
            part = [index for index, row in enumerate(some) if row["label"] == "right" or row["kind"] == kind]
            cells.append(number(auroc_of([some[index] for index in part], values[part])(np.ones(len(part))), 2))
        of_kinds.append([name, *cells])
    groups = [(f"right: {kind}", [row for row in by["right"] if row["kind"] == kind]) for kind in sorted({row["kind"] for row in by["right"]})]
    groups += [("right, all", by["right"])] + [(f"wrong: {kind}", [row for row in by["wrong"] if row["kind"] == kind]) for kind in kinds]
    groups += [("wrong, all", by["wrong"]), ("twins", by["twin"]), ("neither", by["between"])]
    of_answers = [[name, len(group), n_of(group), *counts(group)] for name, group in groups if group]
    of_objects = []
    for name in sorted({row["object"] for row in rows}):
        own = {label: [row for row in by[label] if row["object"] == name] for label in by}
        some = [index for index, row in enumerate(rows) if row["object"] == name]
        cells = [number(auroc_of([rows[index] for index in some], [order[index] for index in some])(np.ones(len(some))), 2)
                 if all(order[index] is not None for index in some) else "" for order in orders.values()]
        of_objects.append([name, *(len(own[label]) for label in ("right", "wrong", "twin")), counts(own["right"])[0], counts(own["wrong"])[0],
                           *cells])
    covered = [row for row in by["right"] if row["interval_mm"] and row["answer"] != "refused"]
    covered.sort(key=lambda row: row["interval_mm"][1] - row["interval_mm"][0])
    quarters = [[row for index, row in enumerate(covered) if 4 * index // len(covered) == k] for k in range(4)]
    parts = [("all", covered), ("trusted", [row for row in covered if row["answer"] == "trusted"])]
    parts += [(f"quarter {k + 1} of all by width", quarter) for k, quarter in enumerate(quarters)]

    def within(row, wider_mm):
        return row["interval_mm"][0] - wider_mm <= row["error_mm"] <= row["interval_mm"][1] + wider_mm

    of_intervals = []
    for name, part in parts:
        if part:
            width = np.median([row["interval_mm"][1] - row["interval_mm"][0] for row in part])
            inside = [sum(within(row, wide * row["truth_mm"]) for row in part) / len(part) for wide in (0, 1)]
            of_intervals.append([name, len(part), n_of(part), number(width, 2), *(f"{100 * share:.0f} %" for share in inside)])
    stated = sum(row["stated_chance"] is not None for row in everything)
    given = sum(row["answer"] != "refused" for row in by["right"])
    twins = ", ".join(f"{name} {sum(row['object'] == name for row in by['twin'])}" for name in sorted({row["object"] for row in by["twin"]}))
    text = [
        f"Objects: {resampled.n_objects}. Scans: {resampled.n_scans}. Poses: {len(by['right'])} right, {len(by['wrong'])} wrong, "
        f"{len(by['twin'])} twins" + (f" ({twins})" if twins else "")
        + f". Left out: {len(by['between'])} too near the limit, or right of a wrong sensor; {answers['n_without_pose']} registrations without "
        + "a pose" + (f"; {answers['n_unjudged']} poses that are not judged yet, by whole surfaces rather than at random" if answers["n_unjudged"] else "") + ". "
        f"Open3D's measures by {answers['open3d']}. {answers['program']}, seed {answers['seed']}.",
        f"**Trusted and wrong: {n_false} of {len(by['wrong'])} ({100 * n_false / len(by['wrong']):.1f} %), upper 95 % limit "
        f"{100 * upper_limit(by['wrong'], is_false):.1f} % by objects. Of right poses {100 * given / len(by['right']):.0f} % are given, "
        f"{100 * counts(by['right'])[0] / len(by['right']):.0f} % trusted.** Of the twins {counts(by['twin'])[0]} are trusted.",
        f"Ours is ordered by the chance of being wrong that is stated of {stated} of {len(everything)} answers"
        + ("." if stated == len(everything) else ", by answer and predicted chance of an error beyond the limit where none is stated."),
        table(["Measure", "Right", "Wrong", "Scans, objects", "AUROC", "95 %", "Right kept at our false trust", "CPU, s"], of_methods),
        "AUROC of all right poses against one kind of wrong ones:",
        table(["Measure", *kinds], of_kinds),
        "Our answers:",
        table(["Poses", "n", "Scans, objects", *ANSWERS], of_answers),
        "By object, with the AUROC of each measure within it, in the order of the first table:",
        table(["Object", "Right", "Wrong", "Twins", "Right trusted", "Wrong trusted", *(f"AUROC {k + 1}" for k in range(len(orders)))],
              of_objects),
        "Right poses that are given, and their predicted 90 % interval of the mean error at the targets:",
        table(["Poses", "n", "Scans, objects", "Width, mm, median", "Within", "Within, as wide as the truth is uncertain"], of_intervals),
    ]
    return "\n\n".join(text) + "\n"


def put_into(page, text):
    old = page.read_text(encoding="utf-8")
    begin, end = "<!-- trustbench -->\n", "<!-- end -->"
    if begin not in old or end not in old.split(begin)[1]:
        sys.exit(f"{page}: no lines <!-- trustbench --> and <!-- end -->, between which the tables go")
    head, rest = old.split(begin, 1)
    write(page, head + begin + text + rest[rest.index(end):])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="the sets, or manifest.json in a folder")
    parser.add_argument("--out", type=Path, help="what is kept; the same command goes on there")
    parser.add_argument("--poses", type=int, default=15, help="right poses of each scan; twice as many wrong ones")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", default="osteoflow")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--so-far", action="store_true", help="draws the poses that are judged so far, and judges no more")
    parser.add_argument("--page", type=Path, help="a page with the lines <!-- trustbench --> and <!-- end -->")
    parser.add_argument("--figures", type=Path, help="answers.json of a benchmark: draws its tables and nothing else")
    given = parser.parse_args()
    if given.figures:
        answers = json.loads(given.figures.read_text())
    else:
        if not given.folder or not given.out:
            parser.error("FOLDER and --out are needed, or --figures")
        run, listed = Run(given), given.folder / "manifest.json"
        run.out.mkdir(parents=True, exist_ok=True)
        pairs = json.loads(listed.read_text())["pairs"] if listed.exists() else known_sets(given.folder, run.out)
        if not pairs:
            sys.exit(f"{given.folder}: no manifest.json, and none of the folders hip, range, prints, skull; docs/method/trustbench.md has both")
        for pair in pairs:
            pair["surface"], pair["source"] = (str((given.folder / pair[key]).resolve()) for key in ("surface", "source"))
        asked = {"pairs": pairs, "poses": given.poses, "seed": given.seed,
                 "files": {name: digest(Path(name)) for pair in pairs for name in (pair["surface"], pair["source"])}}
        kept = run.out / "manifest.json"
        if kept.exists() and json.loads(kept.read_text()) != json.loads(json.dumps(asked)):
            sys.exit(f"{kept}: made of other pairs, files, --poses or --seed; give another --out")
        write_json(kept, asked)
        pairs = prepared(run, pairs)
        made = judged_poses(run, pairs, given.poses, given.seed)
        rows = ask_us(run, pairs, made["rows"], given.so_far)
        named = ask_others(run, pairs, rows)
        name_twins(pairs, rows)
        for row in rows:
            row.pop("pose")
            row["truth_mm"], row["limit_mm"] = pairs[row["pair"]]["truth_mm"], pairs[row["pair"]]["right_mm"]
        version = re.sub(r"\s+", " ", run.command("--version").stdout).strip()
        n_unjudged = len(made["rows"]) - len(rows)
        answers = {"program": version, "seed": given.seed, "open3d": named, "n_without_pose": made["n_without_pose"],
                   "n_unjudged": n_unjudged, "rows": rows}
        write_json(run.out / "answers.json", answers)
    text = figures(answers)
    print(text, end="")
    if given.page:
        put_into(given.page, text)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("interrupted; the same command goes on")
