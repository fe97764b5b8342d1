"""Kerbs on a raster of the ground: steps of the height along the borders of the road."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.ground.kernels import kerbs as kernels
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import KerbSettings
from wayloom.ground.markings.types import Kerb
from wayloom.ground.sheet import CELL_M

FloatArray = NDArray[np.float64]
ROAD, BESIDE = CLASS_ID["road"], (CLASS_ID["sidewalk"], CLASS_ID["terrain"])
STATION_CELLS: Final = 2.5
SMOOTH_CELLS: Final = 5
"""Half the window over which the border of the cells is smoothed."""
SIDE_M: Final = (0.1, 0.2, 0.3, 0.4)
SMEARS_CELLS: Final = (0.2, 0.8, 1.5, 2.5)
"""Sigmas over which stereo smears a step."""
SHIFT_CELLS: Final = 0.5
LEAST_CELLS: Final = 6
FLOOR_M: Final = 0.004
"""A cell's height is not known better."""
EXPLAINED: Final = 0.6
"""A step leaves at most this share of the squares that a slope alone leaves."""
BREAK_STATIONS: Final = 4
MEDIAN_STATIONS: Final = 3
"""Half the window of medians along a kerb, and of the means after them."""
AWAY_M: Final = 0.12
"""A station whose step lies further from its neighbours' median is left out."""
MOST_CORRELATED: Final = 4.0
"""Neighbouring stations share so many windows."""
SMEAR_SHARE: Final = 0.5
"""A smeared step lies off its place by so much of its smear, sigma: stereo smears it to one side."""
HEIGHT_SIGMA_M: Final = 0.01
"""Of a step's height, what a kerb's stations share."""
FOOT_M: Final = 0.15


@dataclass(frozen=True, slots=True)
class _Border:
    """Stations along a border of the road: places (S, 2) column and row of cells, normals (S, 2) away from the road."""

    places: FloatArray
    normals: FloatArray


def find_kerbs(raster: GroundRaster, settings: KerbSettings = KerbSettings()) -> list[Kerb]:
    """All kerbs, in the raster's frame; the same for the same raster."""
    known = np.isfinite(raster.height)
    weight = np.where(known, 1.0 / (np.maximum(raster.sigma_m, FLOOR_M) ** 2), 0.0)
    out: list[Kerb] = []
    for border in _borders(raster):
        out += _kerbs_of(border, np.nan_to_num(raster.height), weight, raster, settings)
    return out


def _borders(raster: GroundRaster) -> list[_Border]:
    """The borders between road and what lies beside it, with stations every quarter of a metre."""
    road = (raster.label == ROAD).astype(np.uint8)
    road = cv2.morphologyEx(
        cv2.morphologyEx(road, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)
    )
    contours, _ = cv2.findContours(road, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    out = []
    for contour in contours:
        places = contour[:, 0].astype(np.float64)
        if len(places) < 4 * SMOOTH_CELLS:
            continue
        window = np.hanning(2 * SMOOTH_CELLS + 3)[1:-1]
        padded = np.vstack([places[-SMOOTH_CELLS:], places, places[:SMOOTH_CELLS]])
        smooth = np.column_stack([np.convolve(padded[:, k], window / window.sum(), "valid") for k in (0, 1)])
        stations = _spaced(smooth)
        if len(stations) < 8:
            continue
        d = np.roll(stations, -2, axis=0) - np.roll(stations, 2, axis=0)
        normals = np.column_stack([d[:, 1], -d[:, 0]]) / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
        out += _beside(raster, stations, normals)
    return out


def _spaced(loop: FloatArray) -> FloatArray:
    """(S, 2) places STATION_CELLS apart along a closed loop (N, 2)."""
    closed = np.vstack([loop, loop[:1]])
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(0.0, s[-1], STATION_CELLS)
    return np.column_stack([np.interp(at, s, closed[:, k]) for k in (0, 1)])


def _beside(raster: GroundRaster, stations: FloatArray, normals: FloatArray) -> list[_Border]:
    """The stretches of a loop with road on one side and sidewalk or terrain on the other; normals are turned away from the road."""
    sides = np.array([_any_of(raster, stations, sign * normals, BESIDE) for sign in (1.0, -1.0)])
    roads = np.array([_any_of(raster, stations, -sign * normals, (ROAD,)) for sign in (1.0, -1.0)])
    good = sides & roads
    way = np.where(good[0].sum() >= good[1].sum(), 1.0, -1.0)
    keep = good[0] if way > 0 else good[1]
    if keep.all():
        return [_Border(stations, way * normals)]
    first = int(np.flatnonzero(~keep)[0])  # a loop is cut where there is no border
    order = np.r_[first : len(keep), 0:first]
    runs = _runs(keep[order], BREAK_STATIONS)
    return [_Border(stations[order[a:b]], way * normals[order[a:b]]) for a, b in runs]


def _any_of(raster: GroundRaster, stations: FloatArray, normals: FloatArray, classes: tuple[int, ...]) -> NDArray[np.bool_]:
    """(S,) whether one of the classes lies a little along the normals."""
    rows, columns = raster.label.shape
    found = np.zeros(len(stations), bool)
    for distance in SIDE_M:
        at = np.rint(stations + normals * distance / CELL_M).astype(np.int64)
        inside = (at[:, 0] >= 0) & (at[:, 1] >= 0) & (at[:, 0] < columns) & (at[:, 1] < rows)
        label = np.full(len(at), 255)
        label[inside] = raster.label[at[inside, 1], at[inside, 0]]
        found |= np.isin(label, classes)
    return found


def _runs(keep: NDArray[np.bool_], most_gap: int) -> list[tuple[int, int]]:
    """(first, last + 1) of stretches of what is kept; gaps of up to most_gap are bridged."""
    at = np.flatnonzero(keep)
    if not len(at):
        return []
    cuts = np.flatnonzero(np.diff(at) > most_gap + 1)
    return [(int(a[0]), int(a[-1]) + 1) for a in np.split(at, cuts + 1)]


def _kerbs_of(border: _Border, height: FloatArray, weight: FloatArray, raster: GroundRaster, settings: KerbSettings) -> list[Kerb]:
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
    for a, b in _runs(kept, BREAK_STATIONS):
        rows = np.arange(a, b)[kept[a:b]]
        kerb = _kerb(border, rows, steps[rows], raster, len(rows) / (b - a))
        if kerb is not None and kerb.length_m >= settings.least_length_m:
            out.append(kerb)
    return out


def _kerb(border: _Border, rows: NDArray[np.int64], steps: FloatArray, raster: GroundRaster, share: float) -> Kerb | None:
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
