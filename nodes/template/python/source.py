"""A source of one's own, as a node of Osteoflow: the points of a text file."""

import math
from dataclasses import dataclass
from typing import Annotated

from osteoflow_node import Cloud, NodeError, param, port, source


@dataclass
class Params:
    path: str = param(path=True, doc="The file.")
    frame: str = param("camera", doc="The frame of its coordinates. camera: a scan is in the frame of the camera that made it.")
    unit_mm: float = param(1.0, ge=1e-6, le=1e6, doc="Millimetres in the file's unit. 1: the file is in mm; 1000: in metres.")


@source("my_plugin.xyz", output="cloud")
def xyz(params: Params) -> Annotated[Cloud, port("The points, once, in the order of the file.", frame="$frame")]:
    """The points of a text file: one per line, x y z, separated by spaces; `#` begins a comment.

    The last line must end, since a file that was cut within its last number would otherwise give a wrong point.
    """
    try:
        with open(params.path, encoding="utf-8") as file:
            lines = file.readlines()
    except (OSError, UnicodeDecodeError) as error:
        raise NodeError(f"{params.path}: cannot be read: {error}") from error
    points = []
    for number, line in enumerate(lines, start=1):
        content = line.split("#")[0].strip()
        if not line.endswith("\n"):
            raise NodeError(f"{params.path}:{number}: the last line does not end; is the file whole?")
        if content:
            try:
                x, y, z = (float(word) * params.unit_mm for word in content.split())
            except ValueError:
                x = y = z = math.nan
            if not math.isfinite(x + y + z):
                raise NodeError(f'{params.path}:{number}: three numbers are expected, found "{content}"')
            points.append((x, y, z))
    if not points:
        raise NodeError(f"{params.path}:1: the file has no points")
    yield 0, Cloud(params.frame, points)
