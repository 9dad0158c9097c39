"""A crop of one's own, as a node of Osteoflow: the points in a sphere."""

from dataclasses import dataclass
from typing import Annotated, Optional

import numpy as np
from osteoflow_node import Cloud, NodeError, Region, node, param, port


@dataclass
class Params:
    centre_mm: tuple[float, float, float] = param(doc="The centre in the cloud's frame.")
    radius_mm: float = param(ge=1e-3, le=1e6, doc="The radius.")


@node("my_plugin.sphere", output="cloud")
def sphere(
    cloud: Annotated[Cloud, port("The cloud to crop.")],
    region: Annotated[Optional[Region], port("Points outside of it are removed, too.", join="once", frame="cloud")],
    params: Params,
) -> Annotated[Cloud, port("The points in the sphere, with all their columns.", frame="cloud")]:
    """The points within a distance of a centre, and within the region of interest where one was drawn."""
    kept = np.linalg.norm(cloud.points - np.array(params.centre_mm), axis=1) <= params.radius_mm
    if region is not None:
        if region.frame != cloud.frame:
            raise NodeError(f"the region is in {region.frame}, but the cloud in {cloud.frame}")
        kept &= ((cloud.points >= region.min) & (cloud.points <= region.max)).all(axis=1)
    if not kept.any():
        near = f"within {params.radius_mm:g} mm of the centre; is it given in mm, in {cloud.frame}?"
        raise NodeError(f"none of {len(cloud)} points is {near}")
    return cloud.chosen(kept)
