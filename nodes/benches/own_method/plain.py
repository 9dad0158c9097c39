"""The registrations of study.toml by one method, as a plain script: one import, one tree for each bone.

    OMP_NUM_THREADS=1 time python3 plain.py small_gicp|open3d N

Run in a folder with TLEM2 and MC22, each with target.ply (points and normals, float32), source.ply and truth.txt (4 x 4), beside
which `osteoflow sweep study.toml` runs the same. Prints processor time and the median error in mm. It draws its own starts from the
distributions of study.toml.
"""

import re
import sys
import time

import numpy as np


def load(path):
    raw = open(path, "rb").read()
    begin = raw.index(b"end_header\n") + 11
    n_columns = len(re.findall(r"property float (\w+)", raw[:begin].decode()))
    return np.frombuffer(raw, "<f4", offset=begin).reshape(-1, n_columns).astype(float)


def small_gicp(target, scan):
    import small_gicp as sg

    cloud = sg.PointCloud(target[:, :3])
    tree = sg.KdTree(cloud, num_threads=1)
    sg.estimate_normals_covariances(cloud, tree, num_neighbors=20, num_threads=1)
    source = sg.PointCloud(scan)
    options = {"registration_type": "PLANE_ICP", "max_correspondence_distance": 5.0, "num_threads": 1, "max_iterations": 50}
    return lambda init: sg.align(cloud, source, tree, init_T_target_source=init, **options).T_target_source


def open3d(target, scan):
    import open3d as o3d

    def cloud_of(points):
        return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))

    cloud, source = cloud_of(target[:, :3]), cloud_of(scan)
    cloud.normals = o3d.utility.Vector3dVector(target[:, 3:])
    reg = o3d.pipelines.registration
    how = reg.TransformationEstimationPointToPlane(), reg.ICPConvergenceCriteria(1e-7, 1e-7, 50)
    return lambda init: reg.registration_icp(source, cloud, 5.0, init, *how).transformation


def main(method, n):
    rng, errors = np.random.default_rng(1), []
    for bone in ("TLEM2", "MC22"):
        target, scan, truth = load(f"{bone}/target.ply"), load(f"{bone}/source.ply")[:, :3], np.loadtxt(f"{bone}/truth.txt")
        register = {"small_gicp": small_gicp, "open3d": open3d}[method](target, scan)
        for _ in range(n):
            x, y, z, a = rng.normal(0, [1, 1, 1.5, np.deg2rad(2)])
            off = np.array([[np.cos(a), -np.sin(a), 0, x], [np.sin(a), np.cos(a), 0, y], [0, 0, 1, z], [0, 0, 0, 1]])
            moved = register(truth @ off) - truth
            error = scan @ moved[:3, :3].T + moved[:3, 3]
            errors.append(np.sqrt((error * error).sum(axis=1).mean()))
    print(f"{method}: {2 * n} registrations, {time.process_time():.1f} CPU-s, median error {np.median(errors):.4f} mm")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
