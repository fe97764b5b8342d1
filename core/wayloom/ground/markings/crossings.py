"""Zebra crossings: broad bars side by side at an even distance."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.markings.bars import Bar
from wayloom.ground.markings.geometry import confidence, lifted, total_sigma
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import MarkingSettings
from wayloom.ground.markings.types import Marking
from wayloom.ground.sheet import PIXEL_M

FloatArray = NDArray[np.float64]
BAR_WIDTH_M: Final = (0.25, 1.3)
BAR_LENGTH_M: Final = 1.0
PARALLEL_RAD: Final = np.radians(7.0)
OVERLAP: Final = 0.4
WELL_ALIGNED, MISSING = 0.8, 1.6
"""Bars that end at the same height may have a bar between them that was not found: so many times the period."""
EVEN: Final = 0.25
"""Spread of the distances between neighbouring bars over their median, at most."""
INSIDE_M: Final = 0.3
LEAST_CONFIDENCE: Final = 0.05
"""Of a single bar: they confirm each other."""


def find_crossings(bars: list[Bar], raster: GroundRaster, settings: MarkingSettings) -> tuple[list[Marking], list[Bar]]:
    """The crossings, and the pieces that are no part of one."""
    broad = [bar for bar in bars if _is_broad(bar)]
    found, inside = [], np.zeros(len(bars), bool)
    for group in _groups(broad, settings):
        crossing = _crossing([broad[k] for k in group], raster, settings)
        if crossing is not None:
            found.append(crossing)
            inside |= np.array([_lies_in(bar, crossing.ring[:, :2], raster) for bar in bars])
    return found, [bar for bar, used in zip(bars, inside.tolist(), strict=True) if not used]


def _is_broad(bar: Bar) -> bool:
    width, length = bar.width_px * PIXEL_M, bar.length_px * PIXEL_M
    return BAR_WIDTH_M[0] <= width <= BAR_WIDTH_M[1] and length >= BAR_LENGTH_M and confidence(bar) > LEAST_CONFIDENCE


def _groups(bars: list[Bar], settings: MarkingSettings) -> list[list[int]]:
    """Numbers of bars that lie side by side, connected from neighbour to neighbour."""
    near = np.zeros((len(bars), len(bars)), bool)
    for a in range(len(bars)):
        for b in range(a + 1, len(bars)):
            near[a, b] = near[b, a] = _side_by_side(bars[a], bars[b], settings)
    groups, left = [], set(range(len(bars)))
    while left:
        todo, group = [min(left)], set()
        while todo:
            k = todo.pop()
            if k in left:
                left.remove(k)
                group.add(k)
                todo += np.flatnonzero(near[k]).tolist()
        groups.append(sorted(group))
    return [group for group in groups if len(group) >= settings.bars]


def _side_by_side(a: Bar, b: Bar, settings: MarkingSettings) -> bool:
    """Whether two bars are parallel, overlap along, and lie a crossing's period apart, or more where one between is missing."""
    if abs(a.d @ b.d) < np.cos(PARALLEL_RAD):
        return False
    step = (b.ends.mean(axis=0) - a.ends.mean(axis=0)) * PIXEL_M
    across = abs(float(step[0] * -a.d[1] + step[1] * a.d[0]))
    s = np.sort((b.ends - a.ends[0]) @ a.d)
    overlap = min(a.length_px, s[1]) - max(0.0, s[0])
    share = overlap / max(min(a.length_px, b.length_px), 1e-9)
    farthest = settings.period_m[1] * (MISSING if share > WELL_ALIGNED else 1.0)
    return settings.period_m[0] <= across <= farthest and share > OVERLAP


def _crossing(bars: list[Bar], raster: GroundRaster, settings: MarkingSettings) -> Marking | None:
    """The crossing of bars side by side; None where they lie unevenly."""
    weight = np.array([bar.length_px for bar in bars])
    angle = np.array([np.arctan2(bar.d[1], bar.d[0]) for bar in bars])
    mean = np.arctan2((weight * np.sin(2 * angle)).sum(), (weight * np.cos(2 * angle)).sum()) / 2
    d = np.array([np.cos(mean), np.sin(mean)])
    left = np.array([-d[1], d[0]])
    origin = np.average([bar.ends.mean(axis=0) for bar in bars], axis=0, weights=weight)
    across = np.array([(bar.ends.mean(axis=0) - origin) @ left for bar in bars])
    places, widths = _lanes(across, np.array([bar.width_px for bar in bars]), weight)
    if len(places) < settings.bars:
        return None
    step = np.diff(places)
    period = float(np.median(step))
    if np.mean(np.abs(step / period - np.maximum(np.rint(step / period), 1)) < EVEN) < 0.6:
        return None
    lengths = np.array([np.sort((bar.ends - origin) @ d) for bar in bars])
    low, high = np.quantile(lengths[:, 0], 0.3), np.quantile(lengths[:, 1], 0.7)
    first, last = places[0] - widths[0] / 2, places[-1] + widths[-1] / 2
    corners = np.array([(low, first), (high, first), (high, last), (low, last), (low, first)])
    ring = raster.xy(origin + corners[:, :1] * d + corners[:, 1:] * left)
    middle = (low + high) / 2
    line = raster.xy(origin + np.array([middle * d + first * left, middle * d + last * left]))
    sigma = np.array([bar.sigma_px for bar in bars]).mean(axis=0)[[1, 0, 2]]  # its line lies across its bars
    doubt = float(np.prod([1 - confidence(bar) for bar in bars]))
    opened = tuple(_is_open(bars, across, place) for place in places[[0, -1]])
    return Marking(
        "zebra", lifted(line, raster), lifted(ring, raster), float(np.median(widths)) * PIXEL_M, float(high - low) * PIXEL_M,
        total_sigma(sigma, ring, raster, settings), min(1 - doubt, 0.999), (opened[0], opened[1]), len(places), period * PIXEL_M,
    )  # fmt: skip


def _lanes(across: FloatArray, widths: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places across and widths of the bars, pieces of one bar taken together, in order."""
    order = np.argsort(across, kind="stable")
    lanes: list[list[int]] = []
    for k in order.tolist():
        if lanes and across[k] - across[lanes[-1][0]] < 0.3 / PIXEL_M:
            lanes[-1].append(k)
        else:
            lanes.append([k])
    places = [np.average(across[lane], weights=weight[lane]) for lane in lanes]
    return np.array(places), np.array([np.average(widths[lane], weights=weight[lane]) for lane in lanes])


def _is_open(bars: list[Bar], across: FloatArray, place: float) -> bool:
    return bool(np.any([bar.open.all() for bar, at in zip(bars, across.tolist(), strict=True) if abs(at - place) < 2.0]))


def _lies_in(bar: Bar, ring: FloatArray, raster: GroundRaster) -> bool:
    """Whether most of a piece lies within a convex ring (M, 2) m, counter-clockwise, or within a margin around it."""
    places = raster.xy(np.linspace(bar.ends[0], bar.ends[1], 9))
    edge = np.diff(ring, axis=0)
    edge = edge / np.linalg.norm(edge, axis=1, keepdims=True)
    to = places[:, None] - ring[None, :-1]
    inside = (edge[None, :, 0] * to[..., 1] - edge[None, :, 1] * to[..., 0]) > -INSIDE_M
    return bool(inside.all(axis=1).mean() > 0.6)
