"""The time of `register` from Python, beside the command and, where they are installed, small_gicp and Open3D.

    cargo build --release --example register_case
    python compare_speed.py CASE [--threads 1] [--repeat 15]

CASE is a folder with source.ply, target.ply (with normals) and init.txt. Each repeat runs every method once, in turn; the table
shows medians in ms: of the time to prepare and align, and of the whole call with its minimum; and how far each pose is from ours,
mm. The Rust call is the same function called from Rust, `nodes/benches/register_case.rs`. All methods are
point-to-plane, at most 100 steps, pairs within 5 mm, each with its own rule to stop; small_gicp estimates the target's normals, as
its Python interface takes none, and that is part of its time.
A method that has used up its steps has not converged, which the last column shows.
"""

import argparse
import json
import os
import statistics
import subprocess
import time
from pathlib import Path

import numpy as np
import osteoflow


def ours(case, threads):
    target, source = osteoflow.read(case / "target.ply"), osteoflow.read(case / "source.ply")
    init = np.loadtxt(case / "init.txt")

    def run():
        began = time.perf_counter()
        fit = osteoflow.register(target, source, init, workers=threads, verdict=False, cache=False, progress=False)
        whole_ms = 1e3 * (time.perf_counter() - began)
        return fit.prep_target_ms[0] + fit.align_ms[0], whole_ms, fit.t_target_source

    return run


def rust(case, threads, program):
    if not Path(program).is_file():
        raise ImportError(f"there is no {program}; cargo build --release --example register_case")
    pipe = subprocess.PIPE
    process = subprocess.Popen([program, str(case), str(threads)], stdin=pipe, stdout=pipe, text=True)

    def run():
        process.stdin.write("\n")
        process.stdin.flush()
        told = json.loads(process.stdout.readline())
        return told["prep_target_ms"][0] + told["align_ms"][0], told["whole_ms"], np.array(told["T"]).reshape(4, 4)

    return run


def command(case, threads, program):
    words = [program, "register", case / "target.ply", case / "source.ply", "--init", case / "init.txt", "--no-verdict"]
    words += ["--no-cache", "--workers", str(threads), "--format", "json"]

    def run():
        began = time.perf_counter()
        told = json.loads(subprocess.run([str(word) for word in words], capture_output=True, check=True).stdout)
        whole_ms = 1e3 * (time.perf_counter() - began)
        return told["prep_target_ms"][0] + told["align_ms"][0], whole_ms, np.array(told["T"]).reshape(4, 4)

    return run


def small_gicp(case, threads):
    import small_gicp

    target, source = osteoflow.read(case / "target.ply"), osteoflow.read(case / "source.ply")
    init, centre = np.loadtxt(case / "init.txt"), target.points.mean(axis=0)
    # Far from the origin the peers lose digits, so the clouds are moved to the target's centroid.
    shift = np.eye(4)
    shift[:3, 3] = -centre
    moved = source.points @ init[:3, :3].T + init[:3, 3] - centre

    def run():
        began = time.perf_counter()
        cloud = small_gicp.PointCloud(target.points - centre)
        tree = small_gicp.KdTree(cloud, num_threads=threads)
        small_gicp.estimate_normals(cloud, tree, num_neighbors=20, num_threads=threads)
        result = small_gicp.align(
            cloud, small_gicp.PointCloud(moved), tree, registration_type="PLANE_ICP", max_correspondence_distance=5.0,
            num_threads=threads, max_iterations=100, translation_epsilon=1e-4, rotation_epsilon=1e-6,
        )
        ms = 1e3 * (time.perf_counter() - began)
        return ms, ms, np.linalg.inv(shift) @ result.T_target_source @ shift @ init

    return run


def open3d(case, threads):
    os.environ["OMP_NUM_THREADS"] = str(threads)
    import open3d

    target, source = osteoflow.read(case / "target.ply"), osteoflow.read(case / "source.ply")
    init, centre = np.loadtxt(case / "init.txt"), target.points.mean(axis=0)
    shift = np.eye(4)
    shift[:3, 3] = -centre
    registration = open3d.pipelines.registration

    def cloud(points):
        made = open3d.geometry.PointCloud()
        made.points = open3d.utility.Vector3dVector(points)
        return made

    fixed, moving = cloud(target.points - centre), cloud(source.points @ init[:3, :3].T + init[:3, 3] - centre)
    fixed.normals = open3d.utility.Vector3dVector(target.normals)

    def run():
        began = time.perf_counter()
        result = registration.registration_icp(
            moving, fixed, 5.0, np.eye(4), registration.TransformationEstimationPointToPlane(),
            registration.ICPConvergenceCriteria(1e-9, 1e-9, 100),
        )
        ms = 1e3 * (time.perf_counter() - began)
        return ms, ms, np.linalg.inv(shift) @ result.transformation @ shift @ init

    return run


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", type=Path)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeat", type=int, default=15)
    parser.add_argument("--program", default="osteoflow")
    target = Path(os.environ.get("CARGO_TARGET_DIR", Path(__file__).resolve().parents[2] / "target"))
    parser.add_argument("--rust", default=target / "release/examples/register_case")
    asked = parser.parse_args()
    runs = {}
    makers = {
        "osteoflow, Python": lambda: ours(asked.case, asked.threads),
        "osteoflow, Rust": lambda: rust(asked.case, asked.threads, asked.rust),
        "osteoflow, command": lambda: command(asked.case, asked.threads, asked.program),
        "small_gicp": lambda: small_gicp(asked.case, asked.threads),
        "Open3D": lambda: open3d(asked.case, asked.threads),
    }
    for name, make in makers.items():
        try:
            runs[name] = make()
        except ImportError as error:
            print(f"skipped: {name}: {error}")
    times = {name: [] for name in runs}
    poses = {}
    for _ in range(asked.repeat):
        for name, run in runs.items():
            ms, whole_ms, poses[name] = run()
            times[name].append((ms, whole_ms))
    points = osteoflow.read(asked.case / "source.ply").points

    def off_mm(name):
        difference = poses[name] - poses["osteoflow, Python"]
        return np.linalg.norm(points @ difference[:3, :3].T + difference[:3, 3], axis=1).max()

    print(f"{'':20} {'prepare + align':>16} {'whole call':>11} {'minimum':>11}   from ours")
    for name, all_ms in times.items():
        columns = [*zip(*all_ms)]
        ms, whole_ms = map(statistics.median, columns)
        print(f"{name:20} {ms:13.1f} ms {whole_ms:8.1f} ms {min(columns[1]):8.1f} ms   {off_mm(name):.2e} mm")


if __name__ == "__main__":
    main()
