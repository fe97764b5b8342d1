"""A small window of the made street in which every unknown is away from zero."""

import numpy as np
from made_street import CAMERA, curve, pair

from wayloom.geometry import se3
from wayloom.geometry.camera import StereoRig
from wayloom.odometry.backend import window as windows
from wayloom.odometry.backend.window import Window
from wayloom.odometry.kernels.arrays import Robust
from wayloom.odometry.tracking.pyramid import rig_numbers

RIG = StereoRig(CAMERA, (-0.5, 0.01, -0.02))
NUMBERS = rig_numbers(CAMERA, RIG.t_right_left)
ROBUST = Robust(huber=9.0, max_energy=1e6, static_weight=0.7, observer_right_weight=0.4)
BIAS_PX = 0.3


def made_window(keyframes: int = 3, points: int = 5, disturbed: bool = True, seed: int = 0) -> Window:
    """keyframes 0.8 m apart with `points` points each; disturbed: poses, brightness and depths a little wrong."""
    rng, places = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    truth = curve(keyframes, step_m=0.8)
    window = windows.empty_window((CAMERA.height, CAMERA.width), keyframes + 1, BIAS_PX, 300.0)
    for i in range(keyframes):
        left, right, rho = pair(truth[i], RIG, BIAS_PX)
        images = [np.clip(np.round(image), 0, 255).astype(np.uint8) for image in (left, right)]
        T = se3.inverse(truth[i])
        affine = np.zeros(2)
        if disturbed:
            T = se3.exp(0.003 * rng.normal(size=6)) @ T
            affine = np.array([0.04, 2.0]) * rng.normal(size=2)
        windows.add_keyframe(window, images[0], images[1], T, affine, i)
        if disturbed:
            window.frames.gain_right[i] = [1.0 + 0.05 * rng.normal(), 2.0 * rng.normal()]
        pixels = np.column_stack([places.integers(70, 250, points), places.integers(50, 150, points)]).astype(np.int64)
        depth_error = 1.0 + (0.02 * rng.normal(size=points) if disturbed else 0.0)
        new = windows.new_points(window, pixels, rho[pixels[:, 1], pixels[:, 0]] * depth_error, 50.0)
        windows.add_points(window, new, np.arange(i * points, (i + 1) * points))
    return window
