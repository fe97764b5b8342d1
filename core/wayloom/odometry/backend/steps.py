"""Covariance of the step to a new keyframe from the one before, marginal in the window of keyframes.

With T_before_cam = T_before_world T_cam_world^-1 and left perturbations x of every T_cam_world,
    exp(xi) T_before_cam:  xi = x_before - Ad(T_before_cam) x_cam.
Only the window's place in the world is tied to the camera before, x_before = 0: where the drive began tells nothing of a step. Then
    Cov(xi) = grey_sigma^2 Ad (H^-1)_cam,cam Ad^T
with H the window's information, prior included and points eliminated, without the rows of the camera before.

It is taken when the keyframe comes in. What later keyframes add moves this one against them, while the one before may have left:
over the step itself the result errs as the first adjustment says.
"""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.odometry.backend.window import Window
from wayloom.odometry.kernels.linear import relative, solve_spd_rows

FloatArray = NDArray[np.float64]


def step_covariance(window: Window, grey_sigma: float) -> FloatArray:
    """(6, 6) m and rad, as of `Keyframes.step_covariance`, of the step to the newest of two keyframes or more, after an
    adjustment.

    Residuals are taken for independent, of sigma grey_sigma (grey levels). NaN where the window does not determine the step.
    """
    T_cam_world, f = window.frames.T_cam_world, len(window) - 1
    Ad = se3.adjoint(relative(T_cam_world[f - 1], T_cam_world[f]))
    before, own = 1 + 8 * (f - 1), slice(3 + 8 * (f - 1), 9 + 8 * (f - 1))
    rest = np.r_[:before, before + 6 : len(window.H)]
    H, units, columns = window.H.take(rest, axis=0).take(rest, axis=1), np.zeros((6, len(rest))), np.empty((6, len(rest)))
    units[:, own] = np.eye(6)
    if not solve_spd_rows(H, units, columns):
        return np.full((6, 6), np.nan)
    covariance = grey_sigma**2 * np.einsum("ij,jk,lk->il", Ad, columns[:, own], Ad)
    return np.asarray(0.5 * (covariance + covariance.T))
