"""Stereo rectification of two calibrated lenses: the common orientation and pinhole of the pair (Fusiello et al. 2000)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.rectification import LensCamera, distorted_rays

Array = NDArray[np.float64]
MOST_TANGENT = 1.5
"""Of a ray of a rectified image against its axis, 56 degrees: beyond, a pinhole's pixels at the border take most of the image."""
ALREADY_RAD, ALREADY_PX = 1e-9, 1e-6
LEAST_ALONG = 0.5
"""Share of the baseline that must lie along the left image's rows: less is one camera above the other."""


@dataclass(frozen=True, slots=True)
class Rectification:
    """A rectified pair: the rig, R_rect_cam (3, 3) of both cameras, and whether the cameras are rectified as they stand."""

    rig: StereoRig
    R_left: Array
    R_right: Array
    is_given: bool


def is_left(T_left_right: Array) -> bool:
    """Whether the second camera of T_left_right (4, 4) stands to the right of the first."""
    return bool(T_left_right[0, 3] > 0)


def stands_beside(T_left_right: Array) -> bool:
    """Whether the cameras stand beside each other, rather than one above or before the other."""
    t = T_left_right[:3, 3]
    return bool(np.linalg.norm(t) > 0 and abs(t[0]) > LEAST_ALONG * np.linalg.norm(t))


def rectify_stereo(left: LensCamera, right: LensCamera, T_left_right: Array, file: Path | None = None) -> Rectification:
    """The pair as one pinhole of the left image's size: x along the baseline, z the mean of both views as near as that allows.

    T_left_right (4, 4), m; the right camera must stand to the right (`is_left`). The focal length is the least with which both
    rectified images hold nothing that the lenses did not see, so that no border of black is taken for an edge.
    Raises CalibrationError, which names the calibration's `file`, where the lenses see nothing together.
    """
    if (given := _given(left, right, T_left_right)) is not None:
        return given
    x = T_left_right[:3, 3] / np.linalg.norm(T_left_right[:3, 3])
    z = np.array([0.0, 0.0, 1.0]) + T_left_right[:3, 2]
    z = z - (z @ x) * x
    z /= np.linalg.norm(z)
    R_left = np.stack([x, np.cross(z, x), z])
    R_right = R_left @ T_left_right[:3, :3]
    width, height = left.camera.width, left.camera.height
    low, high = zip(_seen(left, R_left), _seen(right, R_right), strict=True)
    first, last = np.max(low, axis=0), np.min(high, axis=0)
    if not np.all(last > first):
        span = last - first
        what = f"the two cameras see nothing together: their common view is {span[0]:.3g} by {span[1]:.3g} at a distance of 1"
        raise CalibrationError(what, file=file, remedy="calibrate the cameras as a pair that looks the same way")
    f = float(max((width - 1) / (last[0] - first[0]), (height - 1) / (last[1] - first[1])))
    cx, cy = (0.5 * (size - 1) - 0.5 * f * (a + b) for size, a, b in zip((width, height), first, last, strict=True))
    camera = PinholeCamera(f, f, float(cx), float(cy), width, height)
    return Rectification(StereoRig(camera, (-float(np.linalg.norm(T_left_right[:3, 3])), 0.0, 0.0)), R_left, R_right, False)


def _given(left: LensCamera, right: LensCamera, T_left_right: Array) -> Rectification | None:
    """The pair as it stands, where both are the same straight pinhole and look the same way."""
    straight = not (np.any(left.distortion) or np.any(right.distortion)) and type(left) is type(right)
    same = np.allclose(left.camera.K, right.camera.K, atol=ALREADY_PX, rtol=0.0) and (
        (left.camera.width, left.camera.height) == (right.camera.width, right.camera.height)
    )
    turn = np.linalg.norm(se3.log(se3.from_rotation_translation(T_left_right[:3, :3], np.zeros(3))))
    if not (straight and same and turn < ALREADY_RAD):
        return None
    tx, ty, tz = (-float(value) for value in T_left_right[:3, 3])
    return Rectification(StereoRig(left.camera, (tx, ty, tz)), np.eye(3), np.eye(3), True)


def _seen(lens: LensCamera, R_rect_cam: Array) -> tuple[Array, Array]:
    """The largest upright rectangle, x / z and y / z of its corners (2,), that the image's border leaves inside."""
    w, h = lens.camera.width - 1.0, lens.camera.height - 1.0
    u, v = np.linspace(0.0, w, lens.camera.width), np.linspace(0.0, h, lens.camera.height)
    sides = (
        np.column_stack([np.zeros_like(v), v]),
        np.column_stack([np.full_like(v, w), v]),
        np.column_stack([u, np.zeros_like(u)]),
        np.column_stack([u, np.full_like(u, h)]),
    )
    left, right, top, bottom = (_tangents(uv, lens, R_rect_cam) for uv in sides)
    most = MOST_TANGENT
    x0, x1 = max(float(np.max(left[:, 0], initial=-most)), -most), min(float(np.min(right[:, 0], initial=most)), most)
    y0, y1 = max(float(np.max(top[:, 1], initial=-most)), -most), min(float(np.min(bottom[:, 1], initial=most)), most)
    return np.array([x0, y0]), np.array([x1, y1])


def _tangents(uv: Array, lens: LensCamera, R_rect_cam: Array) -> Array:
    """x / z and y / z (n, 2) in the rectified camera of the pixels before it, uv (N, 2)."""
    rays = distorted_rays(uv, lens) @ R_rect_cam.T
    rays = rays[np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0)]
    return np.asarray(rays[:, :2] / rays[:, 2:])
