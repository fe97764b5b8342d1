"""Poles and trunks in a view: upright bars of one label, with what lies beside them.

A bar is a chain of pieces, runs of the label in bands of rows, that have one disparity. What stands free has further things on both
sides; a stripe, a pipe or a window's frame on a front has the front beside it, as far away as itself.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, SKY
from wayloom.objects.kernels.pieces import chain_pieces, runs_in_bands
from wayloom.objects.kernels.shapes import DISPARITY, PLACE_U, PLACE_V, TYPICAL, WEIGHT, WIDTH, bar_shapes
from wayloom.objects.measurements import Measurements
from wayloom.objects.types import POLE, TRUNK
from wayloom.objects.view import ObjectView

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
LABEL: Final = {POLE: CLASS_ID["pole"], TRUNK: CLASS_ID["vegetation"]}
WIDEST_M: Final = {POLE: 0.55, TRUNK: 0.9}
NARROWEST_M: Final = {POLE: 0.0, TRUNK: 0.12}
LEAST_HEIGHT_M: Final = {POLE: 0.5, TRUNK: 0.9}
BANDS: Final = 36
"""Bands of an image."""
MOST_GAP: Final = 4
MOST_PIECES: Final = 4096
SIDE_PX, SIDE_GAP_PX = 8, 2
FREE_PX, FREE_SHARE = 0.8, 0.03
"""What is beside a thing is further away where its disparity is less by so many px and this share."""
SIGMA_U_PX: Final = 0.8
"""Of the middle of a piece: labels' borders lie that well."""
SIGMA_D_PX: Final = 0.15
"""Of a bar's disparity, which no number of pieces takes away."""
LEAST_SIGMA_PX: Final = 0.05
"""Of a piece's."""
ALIKE: Final = 4.0
"""Pieces whose columns are wrong together."""


GOES_ON_BANDS: Final = 2
"""Height of what is looked at above a bar, a band over its end."""
POST_PX: Final = 5
"""Width in which the post under a sign is looked for."""
POST_M: Final = 3.0
"""So far down from the sign."""
LEAST_PIECES: Final = 3
POST_WIDTH_M: Final = 0.08
"""Of a post that the label does not show: of most signs' posts."""


def bars(view: ObjectView, number: int, kind: int, reach_m: float) -> Measurements:
    """The bars of a kind in a view; `number` is the view's row."""
    height = view.label.shape[0]
    band = max(3, height // BANDS)
    out = np.empty((MOST_PIECES, 3), np.int64)
    most_px = int(WIDEST_M[kind] * view.rig.camera.fx / 3.0)
    count = runs_in_bands(view.label, LABEL[kind], band, most_px, out)
    v0, u0, u1 = out[:count].T
    half = np.maximum((u1 - u0) // 3, 2)
    core = (u0 + u1) // 2
    disparity, sigma = view.match(np.column_stack([core - half, v0, core + half + 1, v0 + band]))
    with np.errstate(invalid="ignore"):
        across = (u1 - u0) / view.rig.camera.fx * view.rig.bf / disparity
        good = (disparity > view.rig.bf / reach_m) & (across <= WIDEST_M[kind])
    v0, u0, u1, disparity, sigma = (part[good] for part in (v0, u0, u1, disparity, sigma))
    chain = np.zeros(len(v0), np.int64)
    chains = chain_pieces(v0 // band, 0.5 * (u0 + u1 - 1), (u1 - u0).astype(np.float64), disparity, MOST_GAP, chain)
    order = np.argsort(chain, kind="stable")
    pieces = np.column_stack([u0, v0, u1, v0 + band])[order]
    start = np.searchsorted(chain[order], np.arange(chains + 1))
    return _measured(view, pieces, disparity[order], sigma[order], start, number, kind)


def posts(view: ObjectView, carried: Measurements, number: int) -> Measurements:
    """Poles under the signs and lights of a view, where the label shows none: what is as near as the sign, under its middle."""
    band = max(3, view.label.shape[0] // BANDS)
    found, start = [(np.zeros((0, 4), np.int64), np.zeros(0), np.zeros(0))], [0]
    for k in range(len(carried)):
        u, v, d = carried.uvd[k]
        px_m = d / view.rig.bf * view.rig.camera.fy
        first = int(v + 0.5 * (carried.high[k] - carried.low[k]) * px_m) + 1
        last = min(int(first + POST_M * px_m), view.label.shape[0] - band)
        v0 = np.arange(first, last, band)
        u0 = round(u - 0.5 * (POST_PX - 1))
        pieces = np.column_stack([np.full(len(v0), u0), v0, np.full(len(v0), u0 + POST_PX), v0 + band])
        disparity, sigma = view.match(pieces)
        with np.errstate(invalid="ignore"):
            near = np.abs(disparity - d) <= FREE_PX + FREE_SHARE * d
        if near.sum() >= LEAST_PIECES:
            found.append((pieces[near], disparity[near], sigma[near]))
            start.append(start[-1] + int(near.sum()))
    pieces, disparity, sigma = (np.concatenate(part) for part in zip(*found, strict=True))
    made = _measured(view, pieces, disparity, sigma, np.array(start), number, POLE)
    return replace(made, width=np.minimum(made.width, POST_WIDTH_M))


def _measured(
    view: ObjectView, pieces: IntArray, disparity: FloatArray, sigma: FloatArray, start: IntArray, number: int, kind: int
) -> Measurements:
    """Bars that are as wide and as tall as things of a kind.

    pieces (n, 4), top down, with their disparities (n,) and sigmas, of bars that begin at start (b + 1,). What is beside a bar
    and over it is looked at last: few of them are of the kind.
    """
    shapes = np.empty((len(start) - 1, 6))
    bar_shapes(pieces, disparity, sigma, start, LEAST_SIGMA_PX, shapes, np.empty(len(pieces)))
    top, bottom = pieces[start[:-1]], pieces[start[1:] - 1]
    low, high = _height(view, bottom, bottom[:, 3], shapes[:, TYPICAL]), _height(view, top, top[:, 1], shapes[:, TYPICAL])
    width = shapes[:, WIDTH] / view.rig.camera.fx * view.rig.bf / shapes[:, DISPARITY]
    fits = (NARROWEST_M[kind] <= width) & (width <= WIDEST_M[kind]) & (high - low >= LEAST_HEIGHT_M[kind])
    of_fitting = np.repeat(fits, np.diff(start))
    pieces, disparity, count = pieces[of_fitting], disparity[of_fitting], np.diff(start)[fits]
    shapes, low, high, width = shapes[fits], low[fits], high[fits], width[fits]
    top, bottom = top[fits], bottom[fits]
    band = top[:, 3] - top[:, 1]
    none = np.full(len(top), np.nan)
    first = np.cumsum(count) - count
    free = np.add.reduceat(beside(view, pieces, disparity), first) / count[:, None] if len(top) else np.empty((0, 2))
    sigma_u = SIGMA_U_PX * np.sqrt(np.maximum(1.0, ALIKE / count))
    return Measurements(
        view=np.full(len(top), number),
        kind=np.full(len(top), kind),
        uvd=shapes[:, [PLACE_U, PLACE_V, DISPARITY]],
        sigma=np.column_stack([sigma_u, np.ones(len(top)), np.hypot(SIGMA_D_PX, shapes[:, WEIGHT] ** -0.5)]),
        low=low,
        high=high,
        cut_low=bottom[:, 3] + band > view.label.shape[0],
        cut_high=top[:, 1] < band,
        width=width,
        free=free,
        goes_on=goes_on_over(view, top, shapes[:, TYPICAL]),
        stripe=none,
        slope=none,
        slope_sigma=none,
    )


def _height(view: ObjectView, pieces: IntArray, edge: IntArray, disparity: FloatArray) -> FloatArray:
    """(n,) m, level frame, at which the upper edges of rows are, in the middle of pieces (n, 4)."""
    middle: FloatArray = 0.5 * (pieces[:, 0] + pieces[:, 2] - 1).astype(np.float64)
    return view.points(middle, edge.astype(np.float64) - 0.5, disparity)[:, 2]


def goes_on_over(view: ObjectView, tops: IntArray, disparity: FloatArray) -> FloatArray:
    """(n,) 1 where what is above bars' upper pieces (n, 4) is as near as they are, 0 where it is further or sky; NaN: not known."""
    u0, v0, u1, v1 = tops.T
    band, half, core = v1 - v0, np.maximum((u1 - u0) // 3, 2), (u0 + u1) // 2
    low = v0 - (1 + GOES_ON_BANDS) * band
    found, _ = view.match(np.column_stack([core - half, low, core + half + 1, v0 - band]))
    sky = view.label[np.maximum(low + band, 0), core] == SKY
    with np.errstate(invalid="ignore"):
        near = (found - disparity >= -(FREE_PX + FREE_SHARE * disparity)).astype(np.float64)
    above = np.where(np.isnan(found), np.where(sky, 0.0, np.nan), near)
    return np.where(low < 0, np.nan, above)


def beside(view: ObjectView, rectangles: IntArray, disparity: FloatArray) -> FloatArray:
    """(n, 2) of things in rectangles (n, 4) with their disparities (n,): 1 free to the left, right; -1 attached; 0 not known."""
    u0, v0, u1, v1 = rectangles.T
    width = view.label.shape[1]
    limit = FREE_PX + FREE_SHARE * disparity
    out = np.zeros((len(rectangles), 2))
    edges = ((u0 - SIDE_GAP_PX - SIDE_PX, u0 - SIDE_GAP_PX), (u1 + SIDE_GAP_PX, u1 + SIDE_GAP_PX + SIDE_PX))
    for side, (a, b) in enumerate(edges):
        d, _ = view.match(np.column_stack([a, v0, b, v1]))
        inside = (a >= 0) & (b < width)
        middle = np.clip((a + b) // 2, 0, width - 1)
        sky = inside & (view.label[(v0 + v1) // 2 - 1, middle] == SKY)
        with np.errstate(invalid="ignore"):
            out[inside & (np.abs(disparity - d) <= limit), side] = -1.0
            out[inside & (disparity - d > limit), side] = 1.0
        out[sky & np.isnan(d), side] = 1.0
    return out
