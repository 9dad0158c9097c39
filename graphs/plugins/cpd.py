"""Coherent point drift, rigid: a registration by probabilities instead of nearest points, as a node of Osteoflow in numpy.

    osteoflow register BONE SCAN --plugin graphs/plugins/cpd.py
    osteoflow run graphs/two_files.toml --plugin graphs/plugins/cpd.py --set icp.kind=cpd.rigid

The bone's surface is a mixture of Gaussians, of which each point of the scan is a draw or, with the weight `outliers`, none. All have one
width, which falls as they come to lie on each other. It takes O(n m) for each step, so that both are thinned.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from osteoflow_node import Cloud, Context, NodeError, Pose, Surface, node, param, payload, port


@dataclass
class Params:
    n_source: int = param(800, ge=20, le=20_000, doc="Points of the scan, evenly through their order. 800: more take longer and change little.")
    n_target: int = param(4000, ge=100, le=100_000, doc="Points of the surface around the start. 4000: 1 to 2 mm apart under a scan of 95 mm.")
    around_mm: float = param(15.0, gt=0, le=1000, doc="Points of the surface this far from the box of the scan count. 15: a start is off by less.")
    sigma_mm: float = param(3.0, gt=0, le=1000, doc="Width of the Gaussians at the start. 3: the error of a start from landmarks.")
    outliers: float = param(0.1, ge=0, lt=1, doc="Share of the scan that is not of the bone.")
    max_iterations: int = param(150, ge=1, le=10_000, doc="Largest number of steps.")
    stop_step_mm: float = param(1e-3, gt=0, le=10, doc="Converged if a step moves the scan by less (RMS).")


@payload("cpd/Report")
class Report:
    """Convergence of the fit; the verdict of a run reads `converged` and `stop_reason`."""

    converged: bool
    stop_reason: str
    iterations: int
    sigma_mm: float


class Fit(NamedTuple):
    t_target_source: Annotated[Pose, port("The registration.", to="target", from_="source")]
    report: Report


@node("cpd.rigid", literature=["Myronenko and Song 2010"])
def rigid(
    source: Annotated[Cloud, port("The scan, cropped.")],
    target: Annotated[Surface, port("The CT surface.", frame="init.to")],
    init: Annotated[Pose, port("The start.", to="target", from_="source")],
    params: Params,
    ctx: Context,
) -> Fit:
    """Registers a scan onto the CT surface by rigid coherent point drift without a scale."""
    x = thinned(source.points, params.n_source)
    t = init.matrix
    moved = x @ t[:3, :3].T + t[:3, 3]
    low, high = moved.min(axis=0) - params.around_mm, moved.max(axis=0) + params.around_mm
    y = thinned(target.points[np.all((target.points > low) & (target.points < high), axis=1)], params.n_target)
    if len(x) < 10 or len(y) < 10:
        raise NodeError(f"{len(x)} points of the scan and {len(y)} of the surface around it, 10 are needed; is init right?")
    variance, converged = params.sigma_mm**2, False
    for iteration in range(1, params.max_iterations + 1):
        if ctx.cancelled():
            raise NodeError("interrupted")
        square = (moved**2).sum(axis=1)[:, None] + (y**2).sum(axis=1) - 2.0 * moved @ y.T
        p = np.exp(-np.maximum(square, 0.0) / (2.0 * variance))
        # The density of what is no point of the bone, in the same units. Equation 6 of the paper, by points of the scan.
        none = (2.0 * np.pi * variance) ** 1.5 * params.outliers / (1.0 - params.outliers) * len(y) / len(x)
        p /= p.sum(axis=1, keepdims=True) + none + np.finfo(float).tiny
        weights = p.sum(axis=1)
        if weights.sum() < 3.0:
            raise NodeError("hardly a point of the scan is near the surface; is init right, or sigma_mm too small?")
        # Each point of the scan goes to the mean of the surface's points, by what they explain of it.
        means = (p @ y) / np.maximum(weights, np.finfo(float).tiny)[:, None]
        centre_x, centre_y = np.average(moved, axis=0, weights=weights), np.average(means, axis=0, weights=weights)
        u, _, v = np.linalg.svd(((moved - centre_x) * weights[:, None]).T @ (means - centre_y))
        turn = (u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v).T
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = turn, centre_y - turn @ centre_x
        t = step @ t
        after = x @ t[:3, :3].T + t[:3, 3]
        left = weights @ (after**2).sum(axis=1) + p.sum(axis=0) @ (y**2).sum(axis=1) - 2.0 * ((p @ y) * after).sum()
        variance = max(left / (3.0 * weights.sum()), 1e-6)
        moved, before = after, moved
        if np.sqrt(((moved - before) ** 2).sum(axis=1).mean()) < params.stop_step_mm:
            converged = True
            break
    u, _, v = np.linalg.svd(t[:3, :3])
    t[:3, :3] = u @ v
    report = Report(converged, "step" if converged else "max_iterations", iteration, float(np.sqrt(variance)))
    return Fit(Pose(target.frame, source.frame, t, source.stamp_ns), report)


def thinned(points, n):
    """At most n of the points, evenly through their order."""
    return points[:: max(1, -(-len(points) // n))]
