"""A hole detector as a node of Osteoflow: what the cloud with the laser on it lacks of the cloud without."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from osteoflow_node import Cloud, NodeError, Points, node, param, payload, port
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

LINK = 1.5
"""Missing points at most this many times `radius_mm` apart are of one hole: more than the spacing of a scan."""


@dataclass
class Params:
    radius_mm: float = param(1.0, gt=0, le=20, doc="A point is missing if none lies nearer. 1: twice the spacing of a scan.")
    min_points: int = param(15, ge=3, le=100_000, doc="Smallest number of missing points that are a hole.")


@payload("my_plugin/Report")
class Report:
    """The hole that was taken."""

    n_missing: int
    n_hole: int
    hole_radius_mm: float


class Found(NamedTuple):
    point: Annotated[Points, port("The centre of the hole, named as the cloud.", frame="reference")]
    report: Report


@node("my_plugin.difference")
def difference(
    reference: Annotated[Cloud, port("The scan without the laser.", join="once")],
    cloud: Annotated[Cloud, port("The scan with the laser on a landmark.", frame="reference")],
    params: Params,
) -> Found:
    """Finds the hole that a laser spot burns into a scan: the largest patch of the reference that the other scan lacks."""
    if cloud.frame != reference.frame:
        raise NodeError(f"the scan with the laser is in {cloud.frame}, but the full scan in {reference.frame}")
    distance, _ = cKDTree(cloud.points).query(reference.points)
    missing = reference.points[distance > params.radius_mm]
    hole = missing
    if len(missing) > 0:
        neighbours = cKDTree(missing).sparse_distance_matrix(cKDTree(missing), LINK * params.radius_mm)
        _, patch = connected_components(neighbours, directed=False)
        hole = missing[patch == np.bincount(patch).argmax()]
    if len(hole) < params.min_points:
        found = f"{len(missing)} points are missing, {len(hole)} of them in one place"
        raise NodeError(f"{found}, {params.min_points} are needed; is the laser on the bone?")
    centre = hole.mean(axis=0)
    # A disc of radius r has a mean squared distance of r²/2 from its centre; points at its rim are not missing.
    hole_radius_mm = float(np.sqrt(2.0 * np.mean(np.sum((hole - centre) ** 2, axis=1)))) + params.radius_mm
    point = Points(reference.frame, [cloud.label or "hole"], [centre], cloud.stamp_ns)
    return Found(point, Report(len(missing), len(hole), hole_radius_mm))
