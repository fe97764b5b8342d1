"""Kerbs placed by photo-consistency: where along the border of the road the two images of views agree on a step.

Matching smears a kerb, because what is nearer spreads over its blocks, and labels end some decimetres off. But beside a road the
ground has few profiles: a plane, and a step to what is higher by so much. So at stations along the border every place and height
of a step is tried on the pixels themselves, those of all views together (`kernels.edges`); then once more, finer, along the smooth
line through the steps that were found.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.side_by_side import Each, runs
from wayloom.geometry import se3
from wayloom.geometry.camera import StereoRig
from wayloom.ground.borders import borders_of
from wayloom.ground.kernels.edges import add_step_costs, side_planes
from wayloom.ground.raster import Cells, Raster
from wayloom.ground.sheet import CELL_M
from wayloom.ground.view import BESIDE, ROAD, GroundView, Image, numbers
from wayloom.odometry.tracking.pyramid import grey

FloatArray = NDArray[np.float64]
LOCAL_PX: Final = 9
"""Side of the square whose mean is taken from images: those of a pair differ in brightness."""
MOST_GREY: Final = 24.0
"""Larger differences of two images count as this."""
REACH_M: Final = 18.0
"""Further away a kerb is less than a pixel of disparity at half size."""
ALONG_M: Final = np.asarray(np.arange(-2, 3) * 0.05, np.float64)
ACROSS_M: Final = np.asarray(np.arange(-16, 23) * 0.05, np.float64)
"""Where pixels are compared around a station."""
COARSE_M: Final = np.asarray(np.arange(-12, 13) * 0.05, np.float64)
FINE_M: Final = np.asarray(np.arange(-8, 9) * 0.025, np.float64)
"""Places of the step across the border, and across the line through the steps that those gave."""
RISES_M: Final = np.arange(13) * 0.02
FLAT_RISES, LEAST_RISE = 2, 2
"""Of RISES_M: the first two are no step, those from the third on are kerbs."""
ROAD_SIDE: Final = (-1.3, -0.3, 0.75)
"""m: from where to where across, and half along, the road's plane is taken."""
PLANE_FLAT, PLANE_STEP_M, PLANE_ROUNDS, LEAST_CELLS = 4.0, 0.03, 4, 20
STATIONS_AROUND: Final = 2
"""Costs are summed over so many stations to either side."""
LEAST_GAIN: Final = 0.01
"""Share by which a step has to lower the cost of none."""
LEAST_PIXELS: Final = 60.0
LINE_STATIONS, LEAST_ON_LINE = 6, 4
"""Of the line through the steps: stations to either side, and how many of them have to lie on it."""
LINE_SCALE_M, ON_LINE_M = 0.05, 0.12
LINE_ROUNDS: Final = 4
STATION_RUNS: Final = 4
"""Of stations one after the other, that several threads look at."""
Seen = Sequence[tuple[GroundView, NDArray[np.float32]]]
"""Views, and of each its two images (2, h', w) without the means around their pixels."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Stations along borders of the road one after the other, border k from start[k] on, and the steps found at them.

    xy, normals (S, 2) m in the sheet's frame, unit vectors away from the road; at (S,) m of the step across, from xy along the
    normal; rise (S,) m its height; gain (S,) the share by which it lowers the cost of none. NaN where there is no step.
    """

    xy: FloatArray
    normals: FloatArray
    start: NDArray[np.int64]
    at: FloatArray
    rise: FloatArray
    gain: FloatArray

    @property
    def facts(self) -> FloatArray:
        """(S, 5) of the steps, as kernels take them."""
        return np.column_stack([self.xy, self.normals, self.at])


def find_steps(
    views: Sequence[GroundView], raster: Raster, cells: Cells, rig: StereoRig, bias_px: float, each: Each = map
) -> Steps:  # fmt: skip
    """The steps that the views see along the borders of what the cells call road."""
    borders = list(borders_of(cells.group == ROAD, cells.group == BESIDE))
    places, normals = (
        np.concatenate([np.zeros((0, 2)), *(getattr(one, name) for one in borders)]) for name in ("places", "normals")
    )
    start = np.cumsum([0, *(len(one.places) for one in borders)])
    nothing = np.full(len(places), np.nan)
    steps = Steps(raster.low + (places + 0.5) * CELL_M, normals, start, np.zeros(len(places)), nothing, nothing)
    if len(places):
        seen = list(zip(views, each(_without_means, views), strict=True))
        steps = _tried(steps, COARSE_M, seen, raster, cells, rig, bias_px, each)
        steps = _tried(_on_line(steps), FINE_M, seen, raster, cells, rig, bias_px, each)
    return steps


def beside_steps(steps: Steps, cells: Cells, group: int, window: tuple[float, float, float], raster: Raster) -> FloatArray:
    """(S, 3): height at the step m, slopes across and along of planes over the cells of a group; NaN where there are too few.

    window : m, from where to where across the step, the road being negative, and half along it
    """
    out, count = np.empty((len(steps.xy), 3)), np.zeros(len(steps.xy), np.int32)
    side_planes(
        steps.facts, cells.height, cells.information, cells.group, group, CELL_M, raster.low, np.array(window), PLANE_FLAT,
        PLANE_STEP_M, PLANE_ROUNDS, LEAST_CELLS, out, count,
    )  # fmt: skip
    return out


def windowed(values: NDArray[Any], start: NDArray[np.int64], around: int) -> NDArray[Any]:
    """Sums of values (S, ...) over the stations of the same border, so many to either side."""
    out = np.zeros_like(values)
    for first, end in itertools.pairwise(start.tolist()):
        for k in range(-around, around + 1):
            low, high = max(first, first - k), min(end, end - k)
            out[low : max(high, low)] += values[low + k : max(high, low) + k]
    return out


def _tried(
    steps: Steps, shifts: FloatArray, seen: Seen, raster: Raster, cells: Cells, rig: StereoRig, bias_px: float, each: Each
) -> Steps:  # fmt: skip
    """The best step at each station, among those at its place `at` plus the shifts."""
    road = beside_steps(steps, cells, ROAD, ROAD_SIDE, raster)
    places = np.column_stack([steps.xy + steps.at[:, None] * steps.normals, steps.normals, road])
    costs, pixels = np.zeros((len(places), len(shifts), len(RISES_M))), np.zeros(len(places))
    camera = numbers(rig.camera)

    def add(some: slice) -> None:
        for view, pair in seen:
            add_step_costs(
                places[some], ALONG_M, ACROSS_M, RISES_M, shifts, pair, view.first_row, view.group > 0, camera, rig.bf, bias_px,
                se3.inverse(view.T_sheet_cam), view.T_sheet_cam[:3, 3].copy(), REACH_M, MOST_GREY, costs[some], pixels[some],
            )  # fmt: skip

    list(each(add, runs(len(places), STATION_RUNS)))
    found = best_steps(windowed(costs, steps.start, STATIONS_AROUND), windowed(pixels, steps.start, STATIONS_AROUND), shifts)
    return Steps(steps.xy, steps.normals, steps.start, steps.at + found[:, 0], found[:, 1], found[:, 2])


def _without_means(view: GroundView) -> NDArray[np.float32]:
    """(2, h', w): a view's two images without the means around their pixels."""
    return np.stack([_without_mean(grey(view.image.squeeze())), _without_mean(view.right)])


def _without_mean(image: Image) -> NDArray[np.float32]:
    """An image without the means around its pixels."""
    values = image.astype(np.float32)
    return np.asarray(values - cv2.boxFilter(values, -1, (LOCAL_PX, LOCAL_PX)), np.float32)


def best_steps(costs: FloatArray, seen: FloatArray, shifts: FloatArray) -> FloatArray:
    """(S, 3): place m, height m and gain of the step with the least cost; NaN where none is much better than no step.

    costs (S, K, Z) of steps at shifts (K,) m, evenly spaced, and RISES_M (Z,); seen (S,) image pixels
    """
    station = np.arange(len(seen))
    of_kerbs = costs[:, :, LEAST_RISE:]
    k, h = np.unravel_index(of_kerbs.reshape(len(seen), -1).argmin(axis=1), of_kerbs.shape[1:])
    h = h + LEAST_RISE
    flat = costs[:, :, :FLAT_RISES].reshape(len(seen), -1).min(axis=1)
    gain = 1.0 - costs[station, k, h] / np.maximum(flat, 1e-9)
    inside = (k > 0) & (k < len(shifts) - 1) & (h < len(RISES_M) - 1)
    good = (gain > LEAST_GAIN) & (seen > LEAST_PIXELS) & inside
    k, h = np.where(good, k, 1), np.where(good, h, LEAST_RISE)
    at = shifts[k] + (shifts[1] - shifts[0]) * _vertex(*(costs[station, k + n, h] for n in (-1, 0, 1)))
    rise = RISES_M[h] + RISES_M[1] * _vertex(*(costs[station, k, h + n] for n in (-1, 0, 1)))
    return np.where(good[:, None], np.column_stack([at, rise, gain]), np.nan)


def _vertex(before: FloatArray, here: FloatArray, after: FloatArray) -> FloatArray:
    """Places of the vertices of parabolas through three values, -0.5 to 0.5 steps off the middle ones."""
    bend = before - 2.0 * here + after
    return np.where(bend > 0.0, np.clip(0.5 * (before - after) / np.where(bend > 0.0, bend, 1.0), -0.5, 0.5), 0.0)


def _on_line(steps: Steps) -> Steps:
    """The stations with their places on the smooth line through the steps around, NaN where too few lie on one."""
    at, normals = np.full(len(steps.xy), np.nan), steps.normals.copy()
    for first, end in itertools.pairwise(steps.start.tolist()):
        found = first + np.flatnonzero(np.isfinite(steps.at[first:end]))
        places = steps.xy[found] + steps.normals[found] * steps.at[found, None]
        for station in range(first, end):
            low, high = np.searchsorted(found, [station - LINE_STATIONS, station + LINE_STATIONS + 1])
            if high - low < LEAST_ON_LINE:
                continue
            n, d = steps.normals[station], places[low:high] - steps.xy[station]
            nearness = 1.0 - ((found[low:high] - station) / (LINE_STATIONS + 1.0)) ** 2
            line = _line(d[:, 1] * n[0] - d[:, 0] * n[1], d[:, 0] * n[0] + d[:, 1] * n[1], steps.gain[found[low:high]] * nearness)
            if line is not None:
                at[station], turned = line[0], n + line[1] * np.array([n[1], -n[0]])
                normals[station] = turned / np.hypot(*turned)
    return Steps(steps.xy, normals, steps.start, at, steps.rise, steps.gain)


def _line(along: FloatArray, across: FloatArray, weight: FloatArray) -> tuple[float, float] | None:
    """Level at 0 and slope of the robust line through places along and across (N,), weighted (N,); None where too few lie on it."""
    level, slope = float(np.median(across)), 0.0
    for _ in range(LINE_ROUNDS):
        w = weight / (1.0 + ((across - level - slope * along) / LINE_SCALE_M) ** 2)
        total, x, y = w.sum(), (w * along).sum() / w.sum(), (w * across).sum() / w.sum()
        slope = float((w * (along - x) * (across - y)).sum() / ((w * (along - x) ** 2).sum() + 0.1 * total))
        level = float(y - slope * x)
    on_line = np.abs(across - level - slope * along) < ON_LINE_M
    return (level, slope) if on_line.sum() >= LEAST_ON_LINE else None
