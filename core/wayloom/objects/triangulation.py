"""Place of a thing from all views that show it: columns, rows and disparities, by robust Gauss-Newton steps.

The residuals are those of the images, (u - fx x / z - cx, v - fy y / z - cy, d - bf / z): near views give the place across their
rays to centimetres, whatever the disparities say. Of poles and trunks the rows tell nothing, as they are long.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.objects.measurements import Measurements
from wayloom.objects.types import STANDING
from wayloom.objects.view import ObjectView

FloatArray = NDArray[np.float64]
ROUNDS: Final = 8
SCALE: Final = 2.0
"""Sigmas at which a measurement counts half."""
TOGETHER: Final = 3.0
"""Views that are wrong together: so many count as one."""
FLOOR_M: Final = 0.015
"""Sigma that no number of views takes away."""
NEAREST_M: Final = 0.5


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
    return Cameras(T[:, :3, :3], T[:, :3, 3], (c.fx, c.fy, c.cx, c.cy), views[0].rig.bf)


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
    rows, axes = ([0, 2], [0, 1]) if stands else ([0, 1, 2], [0, 1, 2])
    place, off = start.copy(), np.zeros(len(seen))
    heights = first_points(cameras, seen)[:, 2]
    H = np.eye(len(axes))
    for _ in range(ROUNDS):
        points = np.tile(place, (len(seen), 1))
        if stands:
            points[:, 2] = heights
        uvd, J = projected(cameras, seen.view, points)
        r = ((seen.uvd - uvd) / seen.sigma)[:, rows]
        J = (J / seen.sigma[:, :, None])[:, rows][:, :, axes]
        off = np.sqrt((r**2).mean(axis=1))
        weight = 1.0 / (1.0 + (off / SCALE) ** 2)
        H = np.einsum("n,nij,nik->jk", weight, J, J)
        step = np.linalg.solve(H + 1e-9 * np.eye(len(axes)), np.einsum("n,nij,ni->j", weight, J, r))
        place[axes] += step.clip(-1.0, 1.0)
    ratio = max(1.0, float((weight * off**2).sum() / max(weight.sum(), 1e-9)))
    covariance = np.zeros((3, 3))
    alike = min(TOGETHER, float(len(seen)))
    covariance[np.ix_(axes, axes)] = alike * ratio * np.linalg.inv(H + 1e-9 * np.eye(len(axes)))
    return place, covariance + FLOOR_M**2 * np.eye(3), off
