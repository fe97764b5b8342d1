"""Direct image alignment of a frame with a keyframe, coarse to fine, from several motion hypotheses where one does not do."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.odometry.backend.window import Window, project_into
from wayloom.odometry.kernels.arrays import Rig
from wayloom.odometry.kernels.linear import exp_se3, log_se3, orthonormalise, relative
from wayloom.odometry.kernels.tracking import align_level, pool, pool_spread
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.tracking.pyramid import Pyramid

FloatArray = NDArray[np.float64]
SPREAD_FROM_LEVEL = 2
"""Pyramid level from which on pixels beside one with a depth are reference points too: coarse levels have few of their own."""
ENOUGH, ENOUGH_FOR_THE_NEXT = 0.01, 0.3
"""`enough` of `align_level` on the finest level and on those above it: squares of a step in its standard deviations."""
START_SPEEDS_M_S = (4.0, 8.0, 12.0, 16.0, 20.0, 26.0, 32.0)
TURNS_RAD = (-0.03, -0.015, 0.015, 0.03)
PITCH_PERTURBATIONS_RAD = (-0.015, 0.015)
FORWARD_PERTURBATIONS_M = (-0.6, -0.3, 0.3, 0.6)


@dataclass(frozen=True, slots=True)
class Reference:
    """Reference points of a keyframe that frames are aligned with: keyframe is its row in the result; levels (n, 4) each, finest
    first: normalised x, y of the ray, inverse depth 1/m along z, grey levels."""

    keyframe: int
    levels: list[FloatArray]


@dataclass(frozen=True, slots=True)
class Alignment:
    """T_frame_keyframe (4, 4); brightness (2,) gain, offset of frame against keyframe; rms in grey levels; the shares of the
    reference in view, and of those beyond the cut-off."""

    T_frame_keyframe: FloatArray
    brightness: FloatArray
    rms: float
    visible: float
    saturated: float


def make_reference(window: Window, index: int, pyramid: Pyramid, cameras: list[FloatArray], rig: Rig, border: int) -> Reference:
    """The live points seen in keyframe `index` of the window, averaged down its pyramid."""
    points = window.points
    projected = project_into(window, points, index, rig, border)
    seen = ~np.isnan(projected[:, 0]) & ((points.host == index) | (points.closed[:, index] == 0))
    return Reference(int(window.keyframe[index]), reference_levels(projected[seen, :2], projected[seen, 2], pyramid, cameras))


def reference_levels(uv: FloatArray, rho: FloatArray, pyramid: Pyramid, cameras: list[FloatArray]) -> list[FloatArray]:
    """`Reference.levels` of points at uv (n, 2) px of the pyramid's image with inverse depths rho (n,) 1/m."""
    return [
        (pool_spread if level >= SPREAD_FROM_LEVEL else pool)(uv, rho, level, image, camera)
        for level, (image, camera) in enumerate(zip(pyramid, cameras, strict=True))
    ]


def align(
    pyramid: Pyramid, reference: Reference, T_guess: FloatArray, brightness: FloatArray, cameras: list[FloatArray],
    coarsest: int, finest: int, settings: OdometrySettings,
) -> Alignment:  # fmt: skip
    """Alignment from level `coarsest` down to `finest`, starting at T_guess (4, 4) T_frame_keyframe and brightness (2,)."""
    T, brightness, out = T_guess.copy(), brightness.copy(), np.zeros(3)
    for level in range(coarsest, finest - 1, -1):
        iterations = settings.track_iterations[min(level, len(settings.track_iterations) - 1)]
        align_level(
            pyramid[level], reference.levels[level], T, brightness, cameras[level], settings.huber, settings.cutoff, iterations,
            ENOUGH if level == finest else ENOUGH_FOR_THE_NEXT, out,
        )  # fmt: skip
    energy, count, beyond = out
    return Alignment(
        T, brightness, math.sqrt(energy / max(count, 1)), count / max(1, len(reference.levels[finest])), beyond / max(count, 1)
    )


def constant_motion(T_last: FloatArray, T_before: FloatArray, dt_before_s: float, dt_s: float) -> FloatArray:
    """(4, 4) T_cam_world of the new frame by constant velocity: the motion from T_before to T_last (T_cam_world),
    dt_before_s apart, goes on for dt_s."""
    twist = log_se3(relative(T_last, T_before))
    T = np.asarray(exp_se3(twist * (dt_s / max(dt_before_s, 1e-9))) @ T_last)
    orthonormalise(T)
    return T


def further_guesses(
    T_constant: FloatArray, T_last: FloatArray, T_keyframe: FloatArray, dt_s: float, starting: bool
) -> list[FloatArray]:
    """T_cam_world (4, 4) to try where constant motion fails: double, half, no motion, the keyframe's place; at a start several
    speeds; constant motion with some yaw, pitch or way added."""
    twist = se3.log(T_constant @ se3.inverse(T_last))
    guesses = [se3.exp(twist * share) @ T_last for share in (2.0, 0.5, 0.0)] + [T_keyframe]
    if starting:
        guesses += start_guesses(T_last, dt_s)
    extras = [(0.0, 0.0, 0.0, 0.0, yaw, 0.0) for yaw in TURNS_RAD] + [
        (0.0, 0.0, 0.0, pitch, 0.0, 0.0) for pitch in PITCH_PERTURBATIONS_RAD
    ]
    extras += [(0.0, 0.0, way, 0.0, 0.0, 0.0) for way in FORWARD_PERTURBATIONS_M]
    return guesses + [se3.exp(np.array(xi)) @ T_constant for xi in extras]


def start_guesses(T_last: FloatArray, dt_s: float) -> list[FloatArray]:
    """T_cam_world (4, 4) of a frame dt_s after T_last if the car drives straight on at one of several speeds."""
    return [se3.exp(np.array([0, 0, -speed * dt_s, 0, 0, 0])) @ T_last for speed in START_SPEEDS_M_S]


def best_alignment(
    pyramid: Pyramid, reference: Reference, guesses: Iterable[FloatArray], brightness: FloatArray, best: Alignment,
    T_world_keyframe: FloatArray, cameras: list[FloatArray], settings: OdometrySettings,
) -> Alignment:  # fmt: skip
    """The best of `best` and the alignments from guesses (T_cam_world of the frame): coarse levels first, the finest only
    from where they lead."""
    top = len(pyramid) - 1
    for T_guess in guesses:
        coarse = align(pyramid, reference, T_guess @ T_world_keyframe, brightness, cameras, top, min(2, top), settings)
        fine = align(pyramid, reference, coarse.T_frame_keyframe, coarse.brightness, cameras, min(1, top), 0, settings)
        if better(fine, best, settings.min_visible):
            best = fine
    return best


def better(new: Alignment, old: Alignment, min_visible: float) -> bool:
    """Whether new fits better than old; one that sees too little of the reference never beats one that sees enough."""
    if old.visible < min_visible:
        return new.visible > old.visible
    return new.visible >= min_visible and new.rms < 0.98 * old.rms
