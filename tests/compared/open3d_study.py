"""Two methods on the same scans, which lie where they belong: each is turned and shifted, registered back, and compared.

    python3 open3d_study.py BONE SCAN ..      prints each error, means, and the paired difference

The remaining poses, about each scan's middle, are written to point_to_plane.tum and point_to_point.tum, for evo.
"""

import sys

import numpy as np
import open3d as o3d
from scipy import stats
from scipy.spatial.transform import Rotation

reg = o3d.pipelines.registration
METHODS = {
    "point_to_plane": reg.TransformationEstimationPointToPlane(),
    "point_to_point": reg.TransformationEstimationPointToPoint(),
}
mesh = o3d.io.read_triangle_mesh(sys.argv[1])
mesh.compute_vertex_normals()
bone = mesh.sample_points_uniformly(150_000)
# Far from the origin its ICP diverges, so both are moved there.
origin = bone.get_center()
bone.translate(-origin)
rng = np.random.default_rng(1)
errors = {name: [] for name in METHODS}
poses = {name: [] for name in METHODS}
for file in sys.argv[2:]:
    scan = o3d.io.read_point_cloud(file).translate(-origin)
    centre = scan.get_center()
    axis, shift = rng.normal(size=3), rng.uniform(-5, 5, 3)
    away = np.eye(4)
    away[:3, :3] = Rotation.from_rotvec(np.radians(rng.uniform(0, 8)) * axis / np.linalg.norm(axis)).as_matrix()
    away[:3, 3] = centre - away[:3, :3] @ centre + shift
    for name, method in METHODS.items():
        pose = away
        for reach_mm in [10.0, 5.0, 1.0]:
            stop = reg.ICPConvergenceCriteria(1e-9, 1e-9, 500)
            pose = reg.registration_icp(scan, bone, reach_mm, pose, method, stop).transformation
        off = pose[:3, :3] @ centre + pose[:3, 3] - centre
        errors[name].append(np.linalg.norm(off))
        poses[name].append([len(poses[name]), *off, *Rotation.from_matrix(pose[:3, :3]).as_quat()])
for name, found in errors.items():
    np.savetxt(f"{name}.tum", poses[name])
    print(name, " ".join(f"{error:.3f}" for error in found), f"mean {np.mean(found):.3f} mm, SD {np.std(found, ddof=1):.3f}")
difference = np.subtract(errors["point_to_point"], errors["point_to_plane"])
low, high = stats.t.interval(0.95, len(difference) - 1, np.mean(difference), stats.sem(difference))
print(f"difference {np.mean(difference):.3f} mm, 95 % interval {low:.3f} to {high:.3f}, Wilcoxon p {stats.wilcoxon(difference).pvalue:.3f}")
