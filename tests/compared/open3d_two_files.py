"""Registers a scan onto a bone without a start, as Open3D's tutorial on global registration does: features, RANSAC, then ICP.

    python3 open3d_two_files.py BONE SCAN [TRIES] [SEED]      prints the pose, 4 x 4, mm

RANSAC is random, so it is tried several times (10), and the try is kept of which most points fit within 1 mm.
"""

import sys

import numpy as np
import open3d as o3d

bone_file, scan_file = sys.argv[1:3]
tries = int(sys.argv[3]) if len(sys.argv) > 3 else 10
o3d.utility.random.seed(int(sys.argv[4]) if len(sys.argv) > 4 else 0)
VOXEL = 2.0  # mm: chosen by hand for a fibula
reg = o3d.pipelines.registration

mesh = o3d.io.read_triangle_mesh(bone_file)
mesh.compute_vertex_normals()
bone = mesh.sample_points_uniformly(150_000)
scan = o3d.io.read_point_cloud(scan_file)


def features(cloud, camera=None):
    few = cloud.voxel_down_sample(VOXEL)
    if camera is not None:
        few.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2 * VOXEL, 30))
        few.orient_normals_towards_camera_location(camera)
    found = reg.compute_fpfh_feature(few, o3d.geometry.KDTreeSearchParamHybrid(5 * VOXEL, 100))
    return few, found


few_scan, scan_features = features(scan, np.zeros(3))
few_bone, bone_features = features(bone)

def attempt():
    fit = reg.registration_ransac_based_on_feature_matching(
        few_scan, few_bone, scan_features, bone_features, True, 1.5 * VOXEL,
        reg.TransformationEstimationPointToPoint(False), 3,
        [reg.CorrespondenceCheckerBasedOnEdgeLength(0.9), reg.CorrespondenceCheckerBasedOnDistance(1.5 * VOXEL)],
        reg.RANSACConvergenceCriteria(1_000_000, 0.999),
    )
    for reach_mm in [5.0, 1.0]:
        fit = reg.registration_icp(scan, bone, reach_mm, fit.transformation, reg.TransformationEstimationPointToPlane(),
                                   reg.ICPConvergenceCriteria(1e-9, 1e-9, 200))
    return fit


fit = max((attempt() for _ in range(tries)), key=lambda fit: (fit.fitness, -fit.inlier_rmse))
print("\n".join(" ".join(f"{number:.9g}" for number in row) for row in fit.transformation))
print(f"fitness {fit.fitness:.3f}, inlier RMSE {fit.inlier_rmse:.4f} mm", file=sys.stderr)
