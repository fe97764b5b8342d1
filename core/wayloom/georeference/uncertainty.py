"""Pose covariance conversions; covariances are of the left perturbation (v, omega): T <- exp(xi) T."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3

FloatArray = NDArray[np.float64]


def position_covariance(T_enu_cam: FloatArray, covariance: FloatArray) -> FloatArray:
    """(N, 3, 3) m^2 of the positions of T_enu_cam (N, 4, 4), covariance (N, 6, 6).

    A left perturbation moves the position p by v + omega x p: J = [I, -hat(p)]. So v alone is no position error: far from the
    origin it is dominated by the rotation's lever.
    """
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(T_enu_cam), 3, 3)), -se3.hat(T_enu_cam[:, :3, 3])], axis=2)
    return np.asarray(J @ covariance @ np.swapaxes(J, 1, 2))


def heading_sigma_rad(covariance: FloatArray) -> FloatArray:
    """(N,) rad: sigma of the rotation about the up axis of covariance (N, 6, 6)."""
    return np.sqrt(np.maximum(covariance[:, 5, 5], 0.0))


def moved_covariance(T_to_from: FloatArray, covariance: FloatArray) -> FloatArray:
    """(N, 6, 6) of T_to_from T_from_cam, from that of T_from_cam: exp(xi) moves to the other side as exp(Ad xi)."""
    moved = moved_cross(T_to_from, covariance)
    return np.asarray(0.5 * (moved + np.swapaxes(moved, 1, 2)))


def moved_cross(T_to_from: FloatArray, cross: FloatArray) -> FloatArray:
    """As `moved_covariance`, for covariances (N, 6, 6) of two poses' perturbations each, which are not symmetric."""
    Ad = se3.adjoint(T_to_from)
    return np.asarray(Ad @ cross @ Ad.T)
