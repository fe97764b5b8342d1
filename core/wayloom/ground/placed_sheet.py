"""Ground sheet where its submap lies in the map, and the arrays of it that the kernels read."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.ground.ground_map import LARGEST_SIGMA_MM
from wayloom.ground.sheet import CELL_M, NO_HEIGHT, GroundSheet

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlacedSheet:
    """A sheet, read when it is needed: a region has more of them than fit in memory.

    digest        of the sheet; read() gives it
    T_map_submap  (4, 4) of its submap, and covariance (6, 6) of the left perturbation (v, omega) of that, m^2 and rad^2
    """

    drive_id: str
    digest: str
    read: Callable[[], GroundSheet]
    T_map_submap: FloatArray
    covariance: FloatArray


def canonical_sheets(placed: Iterable[PlacedSheet]) -> list[PlacedSheet]:
    """Each sheet of each drive once, by drive and digest."""
    by_name = {(one.drive_id, one.digest): one for one in placed}
    return [by_name[name] for name in sorted(by_name)]


def kernel_arrays(sheet: GroundSheet, T_map_submap: FloatArray) -> tuple[Any, ...]:
    """What `kernels.resampling` reads of a sheet."""
    T = np.ascontiguousarray(T_map_submap @ sheet.T_submap_sheet)
    known = sheet.height_mm[sheet.height_mm != NO_HEIGHT]
    middle_m = float(np.median(known)) / 1000.0 if len(known) else 0.0
    rasters = (sheet.height_mm, sheet.sigma_mm, sheet.votes, sheet.colour, sheet.sharpness)
    packed = tuple(np.ascontiguousarray(raster, raster.dtype.newbyteorder("=")) for raster in rasters)
    return (*packed, sheet.corner.astype(np.int64), T, np.linalg.inv(T[:2, :2]), middle_m)


def reach(sheet: GroundSheet, T_map_submap: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners (2,), m east and north, of a box around the sheet."""
    T = T_map_submap @ sheet.T_submap_sheet
    rows, columns = sheet.height_mm.shape
    known = sheet.height[sheet.height_mm != NO_HEIGHT]
    heights = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    low, high = sheet.corner_m, sheet.corner_m + CELL_M * np.array([columns, rows])
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in heights])
    places = corners @ T[:2, :3].T + T[:2, 3]
    return places.min(axis=0), places.max(axis=0)


def place_sigma_mm(one: PlacedSheet) -> int:
    """Sigma of a sheet's place in the plane along its worst axis, mm; LARGEST_SIGMA_MM where it is not known.

    A left perturbation (v, omega) moves the submap's place p by v + omega x p: J = [I, -hat(p)].
    """
    J = np.hstack([np.eye(3), -se3.hat(one.T_map_submap[:3, 3])])
    S = (J @ one.covariance @ J.T)[:2, :2]
    if not np.isfinite(S).all():
        return LARGEST_SIGMA_MM
    return int(min(np.ceil(1000.0 * np.sqrt(max(np.linalg.eigvalsh(S)[-1], 0.0))), LARGEST_SIGMA_MM))


def place_variance(covariance: FloatArray) -> FloatArray:
    """(6,) mm^2: the variance of the height of what lies at x, y in the map's frame, as 1, x, y, x^2, x y, y^2 of a polynomial.

    J S J^T with J = [0, 0, 1, y, -x, 0], the third row of [I, -hat(p)]; zero where the covariance is not known.
    """
    S = covariance if np.isfinite(covariance).all() else np.zeros((6, 6))
    return 1e6 * np.array([S[2, 2], -2.0 * S[2, 4], 2.0 * S[2, 3], S[4, 4], -2.0 * S[3, 4], S[3, 3]])
