"""A smooth made-up motion with the specific force and angular rate that an ideal IMU feels on it."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3

F64 = NDArray[np.float64]
GRAVITY = np.array([0.3, 9.7, 1.4]) / np.linalg.norm([0.3, 9.7, 1.4]) * 9.81
"""m/s^2 in the world, whose y axis points down, tilted a little."""
STEP_S = 1e-4
T_CAM_IMU = se3.exp(np.array([0.2, -0.4, 0.9, 1.1, -1.2, 1.3]))


def pose(t_s: F64) -> F64:
    """T_world_imu (M, 4, 4): a winding way with sways, at about 9 m/s."""
    turn = np.stack([0.05 * np.sin(1.3 * t_s), 0.5 * np.sin(0.4 * t_s), 0.04 * np.sin(1.7 * t_s + 1)], axis=-1)
    T = se3.exp(np.concatenate([np.zeros_like(turn), turn], axis=-1))
    T[..., 0, 3], T[..., 1, 3], T[..., 2, 3] = 3 * np.sin(0.5 * t_s), 0.1 * np.sin(2.1 * t_s), 9 * t_s + 0.8 * np.sin(0.7 * t_s)
    return np.asarray(T @ se3.inverse(np.eye(4)))


def velocity(t_s: F64) -> F64:
    """(M, 3) m/s."""
    return np.asarray((pose(t_s + STEP_S)[..., :3, 3] - pose(t_s - STEP_S)[..., :3, 3]) / (2 * STEP_S))


def samples(t_s: F64) -> tuple[F64, F64]:
    """Specific force (M, 3) m/s^2 and angular rate (M, 3) rad/s in the IMU's frame, by differences of the motion."""
    before, now, after = (pose(t_s + k * STEP_S) for k in (-1, 0, 1))
    R = now[:, :3, :3]
    acceleration = (after[:, :3, 3] - 2 * now[:, :3, 3] + before[:, :3, 3]) / STEP_S**2
    force = np.einsum("mji,mj->mi", R, acceleration - GRAVITY)
    change = np.einsum("mji,mjk->mik", before[:, :3, :3], after[:, :3, :3])
    rate = np.stack(
        [change[:, 2, 1] - change[:, 1, 2], change[:, 0, 2] - change[:, 2, 0], change[:, 1, 0] - change[:, 0, 1]], axis=1
    )
    return force, rate / (4 * STEP_S)
