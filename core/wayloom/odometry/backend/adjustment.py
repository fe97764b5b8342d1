"""Photometric bundle adjustment over the window, and removal of its outliers."""

import math

import numpy as np

from wayloom.odometry.backend.window import Window, keep_points
from wayloom.odometry.kernels.adjustment import adjust_window
from wayloom.odometry.kernels.arrays import Rig, Robust

MIN_INVERSE_DEPTH = 1e-4


def adjust(window: Window, rig: Rig, robust: Robust, affine_prior: tuple[float, float], iterations: int) -> float:
    """Minimise the window's energy over poses, brightness, inverse depths and bias, in place; returns the energy reached."""
    inlier, own, information, energy = adjust_window(
        window.images, rig, window.frames, window.points, window.inertial, window.disparity_bias, window.prior_H, window.prior_g,
        np.array(affine_prior), 0.0 if window.has_prior else 1.0, int(window.hold_disparity_bias), window.held_bias_step, robust,
        iterations, MIN_INVERSE_DEPTH,
    )  # fmt: skip
    window.inlier, window.information, window.H = inlier, own[:, 0].copy(), information
    return float(energy)


def cull(window: Window) -> None:
    """Close for good every residual that was an outlier or out of view; forget points that no other keyframe confirms."""
    F, points = len(window), window.points
    seen = window.inlier[:, :F] > 0
    points.closed[:, :F] |= ~seen & (points.host[:, None] != np.arange(F))
    points.has_static[:] = points.has_static & window.inlier[:, F]
    keep_points(window, np.asarray(seen.any(axis=1)))


def bias_is_significant(window: Window, grey_sigma: float, sigmas: float) -> bool:
    """Whether the disparity bias, held so far, wants to move by more than `sigmas` of its standard deviation, that of residuals of
    grey_sigma (grey levels) that are independent of each other."""
    step, variance = window.held_bias_step
    return bool(abs(step) > sigmas * grey_sigma * math.sqrt(variance))
