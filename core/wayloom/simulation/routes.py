"""How a vehicle goes along its path: where it is at each frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.paths import Path
from wayloom.simulation.rigs import camera_on_ground
from wayloom.simulation.streets import F64

SIDEWAYS_M_S2 = 3.4
"""Sideways acceleration up to which a driver takes a corner."""
EASE_M = 14.0
"""Over how many metres speed changes."""
STEPS_PER_FRAME = 20


@dataclass(frozen=True, slots=True)
class Route:
    """A drive at its frames: t_s (N,) s since the city's time zero, x, y (N,) m, T_enu_cam (N, 4, 4) of the left camera."""

    t_s: F64
    x: F64
    y: F64
    T_enu_cam: F64


def speed_along(path: Path, fastest_m_s: float) -> F64:
    """(N,) m/s at the points of the path: slow in corners, eased before and after."""
    curvature = np.abs(np.gradient(path.yaw) / np.maximum(np.gradient(path.s), 1e-6))
    wanted = np.minimum(fastest_m_s, np.sqrt(SIDEWAYS_M_S2 / np.maximum(curvature, 1e-6)))
    width = max(3, int(EASE_M / (path.length_m / len(path.s))) | 1)
    window = np.hanning(width + 2)[1:-1]
    padded = np.pad(wanted, width // 2, mode="edge")
    return np.asarray(np.convolve(padded, window / window.sum(), "valid"))


def drive(path: Path, start_m: float, start_s: float, frames: int, rate_hz: float, fastest_m_s: float) -> Route:
    """`frames` poses from start_m on the path, at rate_hz, beginning at time start_s."""
    speed, s, travelled = speed_along(path, fastest_m_s), start_m, []
    for _ in range(frames):
        travelled.append(s)
        for _ in range(STEPS_PER_FRAME):
            s += float(np.interp(s, path.s, speed)) / (rate_hz * STEPS_PER_FRAME)
    places = np.array([path.at(v) for v in travelled])
    poses = np.array([camera_on_ground(x, y, yaw, v) for (x, y, yaw), v in zip(places, travelled, strict=True)])
    return Route(start_s + np.arange(frames) / rate_hz, places[:, 0], places[:, 1], poses)


def nearest_s(path: Path, point: NDArray[np.float64]) -> float:
    """Where on the path, m from its start, it comes nearest to a point (2,) m."""
    return float(path.s[np.argmin(np.linalg.norm(path.xy - point, axis=1))])
