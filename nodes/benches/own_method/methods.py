"""Two methods of others as nodes."""
import weakref
from typing import Annotated

import numpy as np
from osteoflow_node import Cloud, Pose, Surface, node, port

TREES, CLOUDS = weakref.WeakKeyDictionary(), weakref.WeakKeyDictionary()


def once(kept, what, make):
    if what not in kept:
        kept[what] = make(what)
    return kept[what]


@node("methods.small_gicp", output="t_target_source", literature=["Koide 2024, small_gicp"])
def small_gicp(source: Cloud, target: Surface, init: Annotated[Pose, port("The start.", to="target", from_="source")]) -> Annotated[Pose, port("The pose.", to="target", from_="source")]:
    """Point-to-plane ICP of small_gicp."""
    import small_gicp as sg

    def prepare(surface):
        cloud = sg.PointCloud(surface.points)
        tree = sg.KdTree(cloud, num_threads=1)
        sg.estimate_normals_covariances(cloud, tree, num_neighbors=20, num_threads=1)
        return cloud, tree
    cloud, tree = once(TREES, target, prepare)
    scan = once(CLOUDS, source, lambda s: sg.PointCloud(s.points))
    r = sg.align(cloud, scan, tree, init_T_target_source=init.matrix, registration_type="PLANE_ICP", max_correspondence_distance=5.0, num_threads=1, max_iterations=50)
    return Pose(target.frame, source.frame, r.T_target_source)


@node("methods.open3d", output="t_target_source", literature=["Zhou 2018, Open3D"])
def open3d(source: Cloud, target: Surface, init: Annotated[Pose, port("The start.", to="target", from_="source")]) -> Annotated[Pose, port("The pose.", to="target", from_="source")]:
    """Point-to-plane ICP of Open3D."""
    import open3d as o3d

    def prepare(surface):
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(surface.points)))
        cloud.normals = o3d.utility.Vector3dVector(np.array(surface.normals))
        return cloud
    cloud = once(TREES, target, prepare)
    scan = once(CLOUDS, source, lambda s: o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(s.points))))
    reg = o3d.pipelines.registration
    r = reg.registration_icp(scan, cloud, 5.0, init.matrix, reg.TransformationEstimationPointToPlane(), reg.ICPConvergenceCriteria(1e-7, 1e-7, 50))
    return Pose(target.frame, source.frame, r.transformation)
