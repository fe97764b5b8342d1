"""Place of a thing from all views that show it: columns, rows and disparities, by robust Gauss-Newton steps.

The residuals are those of the images, (u - fx x / z - cx, v - fy y / z - cy, d - bf / z): near views give the place across their
rays to centimetres, whatever the disparities say. Of poles and trunks the rows tell nothing, as they are long.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.objects.kernels.placing import NEAREST_M, SCALE, place_by_views
from wayloom.objects.measurements import Measurements
from wayloom.objects.types import STANDING
from wayloom.objects.view import ObjectView

FloatArray = NDArray[np.float64]
TOGETHER: Final = 3.0
"""Views that are wrong together: so many count as one."""
FLOOR_M: Final = 0.015
"""Sigma that no number of views takes away."""


@dataclass(frozen=True, slots=True)
class Cameras:
    """R_level_cam (V, 3, 3) and centre (V, 3) m, level frame, of the views; camera fx, fy, cx, cy, and bf."""

    R: FloatArray
    centre: FloatArray
    numbers: tuple[float, float, float, float]
    bf: float


def cameras_of(views: list[ObjectView]) -> Cameras:
    """Those of the views of one drive; there is at least one."""
    c, T = views[0].rig.camera, np.array([view.T_level_cam for view in views])
    R, centre = np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3])
    return Cameras(R, centre, (c.fx, c.fy, c.cx, c.cy), views[0].rig.bf)


def projected(cameras: Cameras, view: NDArray[np.int64], points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Column, row and disparity (n, 3) px of points (n, 3), level frame, in views (n,), and their derivatives (n, 3, 3)."""
    fx, fy, cx, cy = cameras.numbers
    Rt = cameras.R[view].transpose(0, 2, 1)
    x, y, z = np.einsum("nij,nj->ni", Rt, points - cameras.centre[view]).T
    z = np.maximum(z, NEAREST_M)
    zero = np.zeros(len(z))
    uvd = np.column_stack([fx * x / z + cx, fy * y / z + cy, cameras.bf / z])
    J = np.array([[fx / z, zero, -fx * x / z**2], [zero, fy / z, -fy * y / z**2], [zero, zero, -cameras.bf / z**2]])
    return uvd, np.asarray(J.transpose(2, 0, 1) @ Rt, np.float64)


def first_points(cameras: Cameras, seen: Measurements) -> FloatArray:
    """(n, 3) m, level frame: the place of each measurement by itself."""
    fx, fy, cx, cy = cameras.numbers
    z = cameras.bf / seen.uvd[:, 2]
    in_cam = np.column_stack([(seen.uvd[:, 0] - cx) / fx * z, (seen.uvd[:, 1] - cy) / fy * z, z])
    return np.asarray(np.einsum("nij,nj->ni", cameras.R[seen.view], in_cam) + cameras.centre[seen.view])


def information(cameras: Cameras, seen: Measurements, points: FloatArray) -> FloatArray:
    """(n, 3, 3) 1/m^2 of each measurement about a thing at points (n, 3)."""
    _, J = projected(cameras, seen.view, points)
    weighted = J / seen.sigma[:, :, None] ** 2
    return np.asarray(J.transpose(0, 2, 1) @ weighted)


def triangulate(cameras: Cameras, seen: Measurements, start: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place (3,) m, level frame, of what all of `seen` show; its covariance (3, 3) m^2; residuals (n,) in sigmas.

    The third axis of a pole or trunk is not estimated: it is that of `start`.
    """
    stands = int(seen.kind[0]) in STANDING
    axes = 2 if stands else 3
    place, off, H = start.copy(), np.zeros(len(seen)), np.zeros((axes, axes))
    heights = np.ascontiguousarray(first_points(cameras, seen)[:, 2])
    numbers = np.array([*cameras.numbers, cameras.bf])
    place_by_views(
        cameras.R, cameras.centre, numbers, seen.view, seen.uvd, seen.sigma, heights, stands, place, H, off, np.empty((7, 3))
    )
    weight = 1.0 / (1.0 + (off / SCALE) ** 2)
    ratio = max(1.0, float((weight * off**2).sum() / max(weight.sum(), 1e-9)))
    covariance = np.zeros((3, 3))
    alike = min(TOGETHER, float(len(seen)))
    covariance[:axes, :axes] = alike * ratio * np.linalg.inv(H)
    return place, covariance + FLOOR_M**2 * np.eye(3), off
