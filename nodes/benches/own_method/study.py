"""A study of registrations: starts, two methods of others, and the error of a pose."""
from dataclasses import dataclass

import numpy as np
from osteoflow_node import Cloud, Pose, node, param, payload, source


@dataclass
class Start:
    truth: str = param(path=True, doc="The true pose, 4 x 4.")
    x_mm: float = param(0.0, doc="Off along x.")
    y_mm: float = param(0.0, doc="Off along y.")
    z_mm: float = param(0.0, doc="Off along z.")
    turn_deg: float = param(0.0, doc="Turned about z.")


@source("study.start", output="t_ct_camera")
def start(params: Start) -> Pose:
    """The true pose, off by the parameters."""
    t = np.loadtxt(params.truth)
    a = np.deg2rad(params.turn_deg)
    d = np.array([[np.cos(a), -np.sin(a), 0, params.x_mm], [np.sin(a), np.cos(a), 0, params.y_mm], [0, 0, 1, params.z_mm], [0, 0, 0, 1]])
    yield 0, Pose("ct", "camera", t @ d)


@dataclass
class Truth:
    truth: str = param(path=True, doc="The true pose, 4 x 4.")


@source("study.truth", output="t_ct_camera")
def truth(params: Truth) -> Pose:
    """The true pose."""
    yield 0, Pose("ct", "camera", np.loadtxt(params.truth))


@payload("study/Error")
class Error:
    """How far a pose is from the true one, at the points of the scan."""
    rms_mm: float


@node("study.error", output="error")
def error(source: Cloud, found: Pose, true: Pose) -> Error:
    """RMS distance of the scan under two poses."""
    p = source.points
    d = p @ (found.matrix - true.matrix)[:3, :3].T + (found.matrix - true.matrix)[:3, 3]
    return Error(float(np.sqrt((d * d).sum(axis=1).mean())))
