"""An ICP of one's own, as a node of Osteoflow: point-to-plane, with all pairs alike.

Unchanged, it gives the pose of the built-in `icp.point_to_plane` with `gate_sigmas = 0`, `one_sided = false`, `levels = []` and
`pairing = "tree"`, within 1e-6 mm on the simulated procedure without outliers (`recording.camera.edge_outliers = 0.0`) when both stop
at `stop_step_mm = 1e-8`. With outliers its pairs may change in a cycle, and it ends some hundredths of a millimetre away. The
built-in one is faster, and takes tissue and outliers.
"""

import weakref
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from osteoflow_node import Cloud, Context, NodeError, Pose, Surface, node, param, payload, port
from scipy.spatial import cKDTree


@dataclass
class Params:
    max_pair_distance_mm: float = param(5.0, gt=0, le=1000, doc="Pairs farther apart are left out. 5: less than half the bone.")
    max_iterations: int = param(200, ge=1, le=100_000, doc="Largest number of steps. 200: ten times those on real bones.")
    stop_step_mm: float = param(1e-4, gt=0, le=10, doc="Converged if a step moves the scan by less (RMS).")


@payload("my_plugin/Report")
class Report:
    """Convergence of the fit; the verdict of a run reads `converged` and `stop_reason`."""

    converged: bool
    stop_reason: str
    iterations: int
    n_pairs: int
    rms_mm: float


class Fit(NamedTuple):
    t_target_source: Annotated[Pose, port("The registration.", to="target", from_="source")]
    report: Report


@node("my_plugin.point_to_plane", literature=["Chen & Medioni 1992"])
class PointToPlane:
    """Registers a scan onto the CT surface by point-to-plane ICP.

    Each step pairs every point with the nearest point of the surface, and minimises the distances along its normals.
    """

    def __init__(self, params: Params):
        self.params = params

    def process(
        self,
        source: Annotated[Cloud, port("The scan, cropped.")],
        target: Annotated[Surface, port("The CT surface.", frame="init.to")],
        init: Annotated[Pose, port("The start.", to="target", from_="source")],
        ctx: Context,
    ) -> Fit:
        if (init.to, init.from_) != (target.frame, source.frame):
            frames = f"source is in {source.frame} and target in {target.frame}"
            raise NodeError(f"init maps {init.from_} -> {init.to}, but {frames}")
        if target.normals is None:
            raise NodeError("the target has no normals; prepare it with normals")
        tree, points = tree_of(target), source.points
        t = init.matrix
        converged, rms, n_pairs = False, float("nan"), 0
        for iteration in range(1, self.params.max_iterations + 1):
            if ctx.cancelled():
                raise NodeError("interrupted")
            moved = points @ t[:3, :3].T + t[:3, 3]
            distance, nearest = tree.query(moved, distance_upper_bound=self.params.max_pair_distance_mm, workers=1)
            near = np.isfinite(distance)
            n_pairs = int(near.sum())
            if n_pairs < 10:
                raise NodeError(f"{n_pairs} of {len(points)} points lie near the target, 10 are needed; is init right?")
            normals, paired = target.normals[nearest[near]], moved[near]
            residuals = np.einsum("ij,ij->i", target.points[nearest[near]] - paired, normals)
            rms = float(np.sqrt(np.mean(residuals**2)))
            # Turns are about the centre of the pairs, which keeps the system well conditioned.
            centre = paired.mean(axis=0)
            rows = np.hstack([np.cross(paired - centre, normals), normals])
            step = np.linalg.solve(rows.T @ rows, rows.T @ residuals)
            turn = rotation(step[:3])
            motion = np.eye(4)
            motion[:3, :3], motion[:3, 3] = turn, centre - turn @ centre + step[3:]
            t = motion @ t
            t[:3, :3] = nearest_rotation(t[:3, :3])
            after = points @ t[:3, :3].T + t[:3, 3]
            if np.sqrt(np.mean(np.sum((after - moved) ** 2, axis=1))) < self.params.stop_step_mm:
                converged = True
                break
        report = Report(converged, "step" if converged else "max_iterations", iteration, n_pairs, rms)
        return Fit(Pose(target.frame, source.frame, t, source.stamp_ns), report)


# A constant is the same object at every firing, and in a sweep in every run with that bone.
TREES = weakref.WeakKeyDictionary()


def tree_of(target):
    if target not in TREES:
        TREES[target] = cKDTree(target.points)
    return TREES[target]


def rotation(vector):
    """The rotation about a vector by its length (Rodrigues)."""
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def nearest_rotation(matrix):
    """What rounding made of a rotation, made a rotation again."""
    u, _, v = np.linalg.svd(matrix)
    return u @ v
