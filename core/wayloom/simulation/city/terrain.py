"""Terrain height as a sum of waves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Wave = tuple[float, float, float, float]
WAVES: tuple[Wave, ...] = (
    (0.9, 1 / 70.0, 0.0, 0.3), (0.7, 0.0, 1 / 55.0, 1.9), (0.5, 1 / 90.0, 1 / 120.0, 0.7), (6.0, 1 / 260.0, 1 / 190.0, 2.2),
)  # fmt: skip
"""Amplitude m, angular frequency east and north 1/m, phase. Short waves are left out, so that streets need no fine meshes."""


@dataclass(frozen=True, slots=True)
class Terrain:
    """A sum of waves; smooth to any order."""

    waves: tuple[Wave, ...]

    def height(self, x: F64, y: F64) -> F64:
        """Height of the road's plane at x, y (…,) m, m."""
        flat = np.zeros(np.broadcast(x, y).shape)
        return np.asarray(sum((a * np.sin(fx * x + fy * y + phase) for a, fx, fy, phase in self.waves), flat))

    def gradient(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Slope towards east and north, (…,) each."""
        flat = np.zeros(np.broadcast(x, y).shape)
        c = [(a, fx, fy, np.cos(fx * x + fy * y + phase)) for a, fx, fy, phase in self.waves]
        return np.asarray(sum((a * fx * w for a, fx, _, w in c), flat)), np.asarray(sum((a * fy * w for a, _, fy, w in c), flat))

    def poses_on_ground(self, x: F64, y: F64, yaw: F64) -> F64:
        """T_enu_body (M, 4, 4) of bodies (x forward, y left, z up) that stand at x, y (M,) m, heading yaw (M,) rad."""
        gx, gy = self.gradient(x, y)
        c, s = np.cos(yaw), np.sin(yaw)
        forward = np.stack([c, s, gx * c + gy * s], axis=-1)
        forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
        up = np.stack([-gx, -gy, np.ones_like(gx)], axis=-1)
        up /= np.linalg.norm(up, axis=-1, keepdims=True)  # forward lies in the ground, so both are at right angles
        out = np.zeros((len(gx), 4, 4))
        out[:, :3, 0], out[:, :3, 1], out[:, :3, 2] = forward, np.cross(up, forward), up
        out[:, 0, 3], out[:, 1, 3], out[:, 2, 3], out[:, 3, 3] = x, y, self.height(x, y), 1.0
        return out

    def pose_on_ground(self, x: float, y: float, yaw: float) -> F64:
        """T_enu_body (4, 4) of one body."""
        return np.asarray(self.poses_on_ground(np.array([x]), np.array([y]), np.array([yaw]))[0])


HILLS = Terrain(WAVES)
FLAT = Terrain(())


def height(x: F64, y: F64) -> F64:
    """Height of the hills at x, y (…,) m, m."""
    return HILLS.height(x, y)


def gradient(x: F64, y: F64) -> tuple[F64, F64]:
    """Slope of the hills towards east and north."""
    return HILLS.gradient(x, y)


def pose_on_ground(x: float, y: float, yaw: float) -> F64:
    """T_enu_body (4, 4) of a body that stands on the hills at x, y (m), heading yaw (rad)."""
    return HILLS.pose_on_ground(x, y, yaw)
