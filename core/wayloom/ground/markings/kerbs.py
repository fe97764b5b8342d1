"""Kerbs on a raster of the ground: steps of the height along the borders of the road."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.ground.borders import BREAK_STATIONS, Border, borders_of, runs
from wayloom.ground.kernels import kerbs as kernels
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import KerbSettings
from wayloom.ground.markings.types import Kerb
from wayloom.ground.sheet import CELL_M

FloatArray = NDArray[np.float64]
ROAD, BESIDE = CLASS_ID["road"], (CLASS_ID["sidewalk"], CLASS_ID["terrain"])
SMEARS_CELLS: Final = (0.2, 0.8, 1.5, 2.5)
"""Sigmas over which stereo smears a step."""
SHIFT_CELLS: Final = 0.5
LEAST_CELLS: Final = 6
FLOOR_M: Final = 0.004
"""A cell's height is not known better."""
EXPLAINED: Final = 0.6
"""A step leaves at most this share of the squares that a slope alone leaves."""
MEDIAN_STATIONS: Final = 3
"""Half the window of medians along a kerb, and of the means after them."""
AWAY_M: Final = 0.12
"""A station whose step lies further from its neighbours' median is left out."""
MOST_CORRELATED: Final = 4.0
"""Neighbouring stations share so many windows."""
SMEAR_SHARE: Final = 0.5
"""A smeared step lies off its place by so much of its smear, sigma: stereo smears it to one side."""
HEIGHT_SIGMA_M: Final = 0.02
"""Of a step's height, what a kerb's stations share."""
FOOT_M: Final = 0.15


def find_kerbs(raster: GroundRaster, settings: KerbSettings = KerbSettings()) -> list[Kerb]:
    """All kerbs, in the raster's frame; the same for the same raster."""
    known = np.isfinite(raster.height)
    weight = np.where(known, 1.0 / (np.maximum(raster.sigma_m, FLOOR_M) ** 2), 0.0)
    height = np.where(known, raster.height, 0.0)
    out: list[Kerb] = []
    for border in borders_of(raster.label == ROAD, np.isin(raster.label, BESIDE)):
        out += _kerbs_of(border, height, weight, raster, settings)
    return out


def _kerbs_of(border: Border, height: FloatArray, weight: FloatArray, raster: GroundRaster, settings: KerbSettings) -> list[Kerb]:
    """The stretches of a border along which the ground steps up."""
    reach = settings.reach_m / CELL_M
    half = settings.window_m / 2 / CELL_M
    most = settings.shift_m / CELL_M
    shifts = np.arange(-most, most + SHIFT_CELLS / 2, SHIFT_CELLS)
    steps, scratch = np.empty((len(border.places), 6)), np.empty((3, int(4 * (reach + 2) * (half + 2)) + 16))
    across, found, found_weight = scratch
    kernels.steps_along(
        border.places, border.normals, height, weight, half, reach, shifts, np.array(SMEARS_CELLS), LEAST_CELLS,
        across, found, found_weight, steps,
    )  # fmt: skip
    shift, step, sigma, cost, before, _ = steps.T
    with np.errstate(invalid="ignore"):
        kept = (step >= settings.height_m[0]) & (step <= settings.height_m[1]) & (step > settings.sigmas * sigma)
        kept &= (cost < EXPLAINED * before) & (np.abs(shift) < most - SHIFT_CELLS / 2)
    out = []
    for a, b in runs(kept, BREAK_STATIONS):
        rows = np.arange(a, b)[kept[a:b]]
        kerb = _kerb(border, rows, steps[rows], raster, len(rows) / (b - a))
        if kerb is not None and kerb.length_m >= settings.least_length_m:
            out.append(kerb)
    return out


def _kerb(border: Border, rows: NDArray[np.int64], steps: FloatArray, raster: GroundRaster, share: float) -> Kerb | None:
    """One kerb of the stations `rows` with their steps (R, 6), as `kernels.best_step` tells them; None where too few agree."""
    shift = steps[:, 0]
    agree = np.abs(shift - _median(shift)) * CELL_M < AWAY_M
    if agree.sum() < 4:
        return None
    rows, (shift, step, sigma, _, _, smear) = rows[agree], steps[agree].T
    even = _mean(_median(shift))
    places = border.places[rows] + border.normals[rows] * even[:, None]
    xy = raster.corner_m + (places + 0.5) * CELL_M
    heights = _mean(_median(step))
    foot = raster.z(xy - border.normals[rows] * FOOT_M)
    foot = np.where(np.isfinite(foot), foot, np.nanmedian(foot) if np.isfinite(foot).any() else 0.0)
    count = max(1.0, min(len(rows), 2 * MEDIAN_STATIONS + 1) / MOST_CORRELATED)
    across = float(np.std(shift - even)) * CELL_M / np.sqrt(count)
    high = float(np.hypot(np.std(step - heights), np.median(sigma))) / np.sqrt(count)
    line = np.column_stack([xy, foot])[::-1]  # the road is on its left
    if _is_left(line, border.normals[rows[0]]):
        line, heights = line[::-1], heights[::-1]
    else:
        heights = heights[::-1]
    return Kerb(
        line,
        heights,
        np.array([np.hypot(across, SMEAR_SHARE * float(np.median(smear)) * CELL_M), np.hypot(high, HEIGHT_SIGMA_M)]),
        float(np.clip(share * agree.mean(), 0.0, 0.99)),
    )


def _is_left(line: FloatArray, normal: FloatArray) -> bool:
    """Whether the normal at a line's last point lies to its left."""
    d = line[-1, :2] - line[-2, :2]
    return bool(d[0] * normal[1] - d[1] * normal[0] > 0)


def _windows(values: FloatArray) -> FloatArray:
    half = MEDIAN_STATIONS
    return np.lib.stride_tricks.sliding_window_view(np.pad(values, half, mode="edge"), 2 * half + 1)


def _median(values: FloatArray) -> FloatArray:
    """(S,) medians of the stations around each."""
    return np.asarray(np.median(_windows(values), axis=1))


def _mean(values: FloatArray) -> FloatArray:
    """(S,) means of the stations around each."""
    return np.asarray(_windows(values).mean(axis=1))
