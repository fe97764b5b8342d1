"""Poles and trunks in a view: upright bars of one label, with what lies beside them.

A bar is a chain of pieces, runs of the label in bands of rows, that have one disparity. What stands free has further things on both
sides; a stripe, a pipe or a window's frame on a front has the front beside it, as far away as itself.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, SKY
from wayloom.objects.kernels.pieces import chain_pieces, runs_in_bands
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


@dataclass(frozen=True, slots=True)
class Bar:
    """One measurement of a pole or trunk, as `Measurements` has them."""

    uvd: FloatArray
    sigma: FloatArray
    low: float
    high: float
    cut_low: bool
    cut_high: bool
    width: float
    free: FloatArray
    goes_on: float

    def is_of(self, kind: int) -> bool:
        """Whether it is as wide and as tall as things of this kind are."""
        return NARROWEST_M[kind] <= self.width <= WIDEST_M[kind] and self.high - self.low >= LEAST_HEIGHT_M[kind]


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
    rectangles = np.column_stack([u0, v0, u1, v0 + band])
    made = [_bar(view, rectangles[rows], disparity[rows], sigma[rows]) for rows in (chain == k for k in range(chains))]
    found = [one for one in made if one.is_of(kind)]
    return _measurements(found, number, kind)


def _measurements(found: list[Bar], number: int, kind: int) -> Measurements:
    none = np.full(len(found), np.nan)
    column = {name: [getattr(one, name) for one in found] for name in Bar.__dataclass_fields__}
    return Measurements(
        view=np.full(len(found), number),
        kind=np.full(len(found), kind),
        uvd=np.array(column["uvd"]).reshape(-1, 3),
        sigma=np.array(column["sigma"]).reshape(-1, 3),
        low=np.array(column["low"], np.float64),
        high=np.array(column["high"], np.float64),
        cut_low=np.array(column["cut_low"], bool),
        cut_high=np.array(column["cut_high"], bool),
        width=np.array(column["width"], np.float64),
        free=np.array(column["free"]).reshape(-1, 2),
        goes_on=np.array(column["goes_on"], np.float64),
        stripe=none,
        slope=none,
        slope_sigma=none,
    )


def posts(view: ObjectView, carried: Measurements, number: int) -> Measurements:
    """Poles under the signs and lights of a view, where the label shows none: what is as near as the sign, under its middle."""
    band = max(3, view.label.shape[0] // BANDS)
    found = []
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
        if near.sum() >= LEAST_PIECES and (bar := _bar(view, pieces[near], disparity[near], sigma[near])).is_of(POLE):
            found.append(replace(bar, width=min(bar.width, POST_WIDTH_M)))
    return _measurements(found, number, POLE)


def _bar(view: ObjectView, pieces: IntArray, disparity: FloatArray, sigma: FloatArray) -> Bar:
    """The bar of pieces (n, 4), top down, with their disparities (n,) and sigmas: outliers are held down."""
    u0, v0, u1, v1 = pieces.T
    middle = 0.5 * (u0 + u1 - 1)
    weight = 1.0 / (np.maximum(sigma, LEAST_SIGMA_PX) ** 2 + (disparity - np.median(disparity)) ** 2)
    d = float((weight * disparity).sum() / weight.sum())
    ends = view.points(middle[[-1, 0]], np.array([v1[-1] - 0.5, v0[0] - 0.5]), np.full(2, np.median(disparity)))
    band = int(v1[0] - v0[0])
    return Bar(
        uvd=np.array([np.median(middle), 0.5 * (v0 + v1 - 1).mean(), d]),
        sigma=np.array([SIGMA_U_PX * max(1.0, ALIKE / len(v0)) ** 0.5, 1.0, np.hypot(SIGMA_D_PX, weight.sum() ** -0.5)]),
        low=float(ends[0, 2]),
        high=float(ends[1, 2]),
        cut_low=bool(v1[-1] + band > view.label.shape[0]),
        cut_high=bool(v0[0] < band),
        width=float(np.median(u1 - u0)) / view.rig.camera.fx * view.rig.bf / d,
        free=beside(view, pieces, disparity).mean(axis=0),
        goes_on=goes_on_over(view, pieces[0], float(np.median(disparity))),
    )


def goes_on_over(view: ObjectView, top: IntArray, disparity: float) -> float:
    """1 where what is above a bar's upper piece (4,) is as near as the bar, 0 where it is further or sky; NaN: not known."""
    u0, v0, u1, v1 = top.tolist()
    band, half = v1 - v0, max((u1 - u0) // 3, 2)
    core = (u0 + u1) // 2
    low = v0 - (1 + GOES_ON_BANDS) * band
    if low < 0:
        return np.nan
    found = view.match(np.array([[core - half, low, core + half + 1, v0 - band]]))[0][0]
    if np.isnan(found):
        return 0.0 if view.label[low + band, core] == SKY else np.nan
    return float(found - disparity >= -(FREE_PX + FREE_SHARE * disparity))


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
