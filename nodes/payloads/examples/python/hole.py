"""A hole detector as a node of Osteoflow: what the cloud with the laser on it lacks of the cloud without."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from osteoflow_node import Cloud, NodeError, Points, node, param, payload, port
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree


@dataclass
class Params:
    radius_mm: float = param(1.0, gt=0, le=20, doc="A point is missing if none lies nearer. 1: twice the spacing of a scan.")
    min_points: int = param(15, ge=3, le=100_000, doc="Smallest number of missing points that are a hole.")


@payload("hole_example/Report")
class Report:
    """The hole that was taken."""

    n_missing: int
    n_hole: int
    radius_mm: float


class Found(NamedTuple):
    point: Annotated[Points, port("The centre of the hole, named as the cloud.", frame="reference")]
    report: Report


@node("hole_example.difference")
def difference(
    reference: Annotated[Cloud, port("The scan without the laser.", join="once")],
    cloud: Annotated[Cloud, port("The scan with the laser on a landmark.", frame="reference")],
    params: Params,
) -> Found:
    """Finds the hole that a laser spot burns into a scan: the largest patch of the reference that the other scan lacks."""
    distance, _ = cKDTree(cloud.points).query(reference.points)
    missing = reference.points[distance > params.radius_mm]
    if len(missing) < params.min_points:
        raise NodeError(f"{len(missing)} points are missing, a hole has {params.min_points}; is the laser on the bone?")
    neighbours = cKDTree(missing).sparse_distance_matrix(cKDTree(missing), 1.5 * params.radius_mm)
    _, patch = connected_components(neighbours, directed=False)
    hole = missing[patch == np.bincount(patch).argmax()]
    if len(hole) < params.min_points:
        raise NodeError(f"the largest patch has {len(hole)} points, a hole has {params.min_points}")
    centre = hole.mean(axis=0)
    spread = float(np.sqrt(2.0 * np.mean(np.sum((hole - centre) ** 2, axis=1) / 2.0)))
    point = Points(reference.frame, [cloud.label or "hole"], [centre], cloud.stamp_ns)
    return Found(point, Report(len(missing), len(hole), spread))
