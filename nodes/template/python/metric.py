"""A metric of one's own, as a node of Osteoflow: how far a registration misplaces points."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from osteoflow_node import NodeError, Points, Pose, column, node, param, payload, port


@dataclass
class Params:
    limit_mm: float = param(1.5, ge=0, le=1000, doc="Points off by at most this much are good. 1.5: half of what a cut may be off.")


@payload("my_plugin/Report")
class Report:
    """The errors; fields and columns are numbers of results.json."""

    mean_mm: float
    max_mm: float
    share_good: float
    off_mm: np.ndarray = column("f64", 1, unit="mm", doc="One for each point.")


@node("my_plugin.tre", output="report")
def tre(
    planned: Annotated[Points, port("Points on the bone at which the error is evaluated.", join="once")],
    t_ct_world: Annotated[Pose, port("The registration.", to="planned", from_="t_ct_world_true.from")],
    t_ct_world_true: Annotated[Pose, port("The true one.", join="once", to="planned", from_="t_ct_world.from")],
    params: Params,
) -> Annotated[Report, port("Mean and largest error, the share of good points, and each error.")]:
    """Target registration error: the distances by which a registration misplaces points, where the true one is known."""
    frames = [(pose.to, pose.from_) for pose in (t_ct_world, t_ct_world_true)]
    if frames[0] != frames[1] or frames[0][0] != planned.frame:
        raise NodeError(f"poses to and from {frames[0]} and {frames[1]} do not fit points in {planned.frame}")
    if len(planned.positions) == 0:
        raise NodeError("there are no points to evaluate the error at; does the plan have some?")
    error = t_ct_world.matrix @ np.linalg.inv(t_ct_world_true.matrix)
    moved = planned.positions @ error[:3, :3].T + error[:3, 3]
    off_mm = np.linalg.norm(moved - planned.positions, axis=1)
    return Report(float(off_mm.mean()), float(off_mm.max()), float((off_mm <= params.limit_mm).mean()), off_mm)
