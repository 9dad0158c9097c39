"""Registrations by shape alone of other libraries, as nodes that take the place of `coarse.global` and, from what these find, of `icp.*`.

Open3D 0.19 or later and numpy are needed, for `peers.kiss_matcher` also kiss-matcher. Both clouds are moved to their centroids first, since
ICP far from the origin diverges. The features of the surface are computed at each firing, so they are part of its processor time.
"""

from dataclasses import dataclass

import numpy as np

from osteoflow_node import Cloud, Context, NodeError, Pose, Surface, node, param


@dataclass
class Ransac:
    voxel_mm: float = param(5.0, gt=0, doc="Edge of the grid that both clouds are thinned to, mm; radii of normals and features follow it.")
    max_iterations: int = param(100_000, gt=0, doc="Largest number of samples. 100000: Open3D's own.")
    confidence: float = param(0.999, gt=0, le=1, doc="Samples end at this probability of a better one. 0.999: Open3D's own.")


@dataclass
class Kiss:
    voxel_mm: float = param(5.0, gt=0, doc="Edge of the grid that both clouds are thinned to, mm.")


@dataclass
class Fine:
    first_mm: float = param(10.0, gt=0, doc="Maximum distance of a pair at first, mm: two edges of the grid of the search before.")
    then_mm: float = param(5.0, gt=0, doc="Maximum distance of a pair afterwards, mm, if less.")


def open3d_cloud(points, normals=None):
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(points, float)))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(np.array(normals, float))
    return cloud


def centred(shape):
    """The points about their centroid, and that."""
    centre = np.mean(shape.points, axis=0)
    return np.array(shape.points, float) - centre, centre


def pose(surface, cloud, matrix):
    """The pose between the clouds where they are, with the nearest rotation."""
    u, _, v = np.linalg.svd(matrix[:3, :3])
    rigid = np.eye(4)
    rigid[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    rigid[:3, 3] = matrix[:3, 3] + centred(surface)[1] - rigid[:3, :3] @ centred(cloud)[1]
    return Pose(surface.frame, cloud.frame, rigid)


@node("peers.fpfh_ransac", output="t_target_source")
def fpfh_ransac(cloud: Cloud, surface: Surface, params: Ransac, ctx: Context) -> Pose:
    """FPFH features and RANSAC of Open3D."""
    import open3d as o3d

    method = o3d.pipelines.registration
    o3d.utility.random.seed(ctx.seed)

    def prepared(points):
        thin = open3d_cloud(points).voxel_down_sample(params.voxel_mm)
        thin.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2.0 * params.voxel_mm, 30))
        near = o3d.geometry.KDTreeSearchParamHybrid(5.0 * params.voxel_mm, 100)
        return thin, method.compute_fpfh_feature(thin, near)

    points = centred(cloud)[0]
    (source, of_source), (target, of_target) = prepared(points), prepared(centred(surface)[0])
    reach_mm = 1.5 * params.voxel_mm
    checks = [method.CorrespondenceCheckerBasedOnEdgeLength(0.9), method.CorrespondenceCheckerBasedOnDistance(reach_mm)]
    found = method.registration_ransac_based_on_feature_matching(
        source, target, of_source, of_target, True, reach_mm,
        method.TransformationEstimationPointToPoint(False), 3, checks,
        method.RANSACConvergenceCriteria(params.max_iterations, params.confidence),
    )
    if not found.correspondence_set:
        raise NodeError("no pose agrees with the matched features; try another voxel_mm")
    return pose(surface, cloud, found.transformation)


@node("peers.kiss_matcher", output="t_target_source")
def kiss_matcher(cloud: Cloud, surface: Surface, params: Kiss, ctx: Context) -> Pose:
    """KISS-Matcher."""
    import kiss_matcher as kiss

    matcher = kiss.KISSMatcher(kiss.KISSMatcherConfig(params.voxel_mm))
    points = centred(cloud)[0]
    found = matcher.estimate(points.astype(np.float32), centred(surface)[0].astype(np.float32))
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = found.rotation, np.ravel(found.translation)
    return pose(surface, cloud, start)


@node("peers.point_to_plane", output="t_target_source")
def point_to_plane(source: Cloud, target: Surface, init: Pose, params: Fine) -> Pose:
    """Point-to-plane ICP of Open3D onto all points of the surface."""
    import open3d as o3d

    method = o3d.pipelines.registration
    (points, of_source), (on, of_target) = centred(source), centred(target)
    moved, fixed = open3d_cloud(points), open3d_cloud(on, target.normals)
    if target.normals is None:
        fixed.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
    matrix = np.array(init.matrix, float)
    matrix[:3, 3] += matrix[:3, :3] @ of_source - of_target
    ends = method.ICPConvergenceCriteria(1e-7, 1e-7, 100)
    for reach_mm in (params.first_mm, min(params.first_mm, params.then_mm)):
        matrix = method.registration_icp(
            moved, fixed, reach_mm, matrix, method.TransformationEstimationPointToPlane(), ends
        ).transformation
    return pose(target, source, matrix)
