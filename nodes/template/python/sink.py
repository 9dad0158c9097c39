"""A sink of one's own, as a node of Osteoflow: clouds as text files."""

import os
from dataclasses import dataclass
from typing import Annotated

from osteoflow_node import Cloud, Context, NodeError, Text, node, param, port


@dataclass
class Params:
    unit_mm: float = param(1.0, ge=1e-6, le=1e6, doc="Millimetres in the file's unit. 1: the file is in mm; 1000: in metres.")


@node("my_plugin.xyz", output="file")
def xyz(
    cloud: Annotated[Cloud, port("A cloud; one file for each.")],
    params: Params,
    ctx: Context,
) -> Annotated[Text, port("The name of the file.")]:
    """Writes clouds as text files of points into the run's folder, named after the node: one point per line, x y z.

    The numbers read back to the same bits. The first line is a comment with frame and unit.
    """
    if ctx.out_dir is None:
        raise NodeError("the run has no folder to write into; name one with --out")
    name = f"{ctx.node}-{ctx.item}.xyz"
    path = os.path.join(ctx.out_dir, name)
    rows = (cloud.points / params.unit_mm).tolist()
    try:
        with open(path, "w", encoding="utf-8") as file:
            file.write(f"# frame {cloud.frame}, unit {params.unit_mm} mm\n")
            file.writelines(f"{x!r} {y!r} {z!r}\n" for x, y, z in rows)
    except OSError as error:
        raise NodeError(f"{path} cannot be written: {error}") from error
    return Text(name)
