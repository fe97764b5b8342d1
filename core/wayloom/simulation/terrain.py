"""The height of the ground: gentle hills."""

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
WAVES = ((0.9, 1 / 70.0, 0.0, 0.3), (0.7, 0.0, 1 / 55.0, 1.9), (0.5, 1 / 90.0, 1 / 120.0, 0.7))
"""Amplitude m, angular frequency east and north 1/m, phase. Short waves are left out, so that streets need no fine meshes."""


def height(x: F64, y: F64) -> F64:
    """Height of the road's plane at x, y (…,) m, m."""
    return np.asarray(sum(a * np.sin(fx * x + fy * y + phase) for a, fx, fy, phase in WAVES))


def gradient(x: F64, y: F64) -> tuple[F64, F64]:
    """Slope towards east and north."""
    c = [(a, fx, fy, np.cos(fx * x + fy * y + phase)) for a, fx, fy, phase in WAVES]
    return np.asarray(sum(a * fx * w for a, fx, _, w in c)), np.asarray(sum(a * fy * w for a, _, fy, w in c))


def pose_on_ground(x: float, y: float, yaw: float) -> F64:
    """T_world_body (4, 4) of a body (x forward, y left, z up) that stands on the ground at x, y (m), heading yaw (rad)."""
    gx, gy = (float(g) for g in gradient(np.array(x), np.array(y)))
    c, s = np.cos(yaw), np.sin(yaw)
    forward = np.array([c, s, gx * c + gy * s])
    forward /= np.linalg.norm(forward)
    left = np.cross((-gx, -gy, 1.0), forward)
    left /= np.linalg.norm(left)
    out = np.eye(4)
    out[:3, 0], out[:3, 1], out[:3, 2] = forward, left, np.cross(forward, left)
    out[:3, 3] = x, y, float(height(np.array(x), np.array(y)))
    return out
