"""Shows scans on a bone while they are registered one after the other.

    python3 rerun_live.py BONE SCAN ..                in Rerun's viewer
    python3 rerun_live.py --save FILE BONE SCAN ..    into a file instead
"""

import sys

import numpy as np
import open3d as o3d
import rerun as rr

rr.init("scans", spawn=sys.argv[1] != "--save")
if sys.argv[1] == "--save":
    rr.save(sys.argv[2])
    del sys.argv[1:3]
reg = o3d.pipelines.registration
mesh = o3d.io.read_triangle_mesh(sys.argv[1])
mesh.compute_vertex_normals()
bone = mesh.sample_points_uniformly(150_000)
rr.log("bone", rr.Mesh3D(vertex_positions=np.asarray(mesh.vertices), triangle_indices=np.asarray(mesh.triangles), vertex_normals=np.asarray(mesh.vertex_normals)), static=True)
rays = o3d.t.geometry.RaycastingScene()
rays.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
for number, file in enumerate(sys.argv[2:]):
    rr.set_time("scan", sequence=number)
    scan = o3d.io.read_point_cloud(file)
    fit = reg.registration_icp(scan, bone, 5.0, np.eye(4), reg.TransformationEstimationPointToPlane())
    points = np.asarray(scan.transform(fit.transformation).points)
    off_mm = rays.compute_signed_distance(points.astype(np.float32)).numpy()
    share = np.clip(off_mm, -1, 1)[:, None] / 2 + 0.5
    colours = (255 * np.hstack([share, np.full_like(share, 0.4), 1 - share])).astype(np.uint8)
    rr.log("scan", rr.Points3D(points, colors=colours, radii=0.2))
    rr.log("residual_rms_mm", rr.Scalars(fit.inlier_rmse))
