"""Faces of traffic signs and lights in a view: pieces of one label, with disparity and its slope along the columns.

Of a plane with normal n and distance h, d = bf n·ray / h is linear in u and v: its slope along the columns over the disparity is
n_x / (fx n_z) where the face is upright, which tells where it looks.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.objects.bars import beside
from wayloom.objects.measurements import Measurements
from wayloom.objects.types import LIGHT, SIGN
from wayloom.objects.view import ObjectView

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
LABEL: Final = {SIGN: CLASS_ID["traffic sign"], LIGHT: CLASS_ID["traffic light"]}
LEAST_PX: Final = 5
LEAST_FILLED: Final = 0.35
SMALLEST_M, LARGEST_M = 0.15, 2.5
SIGMA_U_PX, SIGMA_D_PX = 0.8, 0.15
INSIDE_PX: Final = 6
"""Least side of the middle of a face that is matched by itself."""
STRIP_PX: Final = 5
"""Width of the strips whose disparities tell the slope."""
LEAST_STRIPS: Final = 3
STRIP_SIGMA_PX: Final = 0.12
STRIPE_ASIDE_M: Final = 0.1
"""How far from the middle of a post what is beside it is looked at."""
STRIPE_MARGIN, STRIPE_HALF, STRIPE_PARTS = 0.08, 0.2, 6
"""Shares of a face's height left out above and below, and of its width in which a post may stand to each side of the middle; parts
of the height."""
DARK: Final = 4.0
"""Grey values that no camera tells apart."""


def faces(view: ObjectView, number: int, kind: int, reach_m: float) -> Measurements:
    """The faces of a kind in a view; `number` is the view's row."""
    u0, v0, wide, tall, area = _pieces(view.label == LABEL[kind]).T
    large = (wide >= LEAST_PX) & (tall >= LEAST_PX) & (area >= LEAST_FILLED * wide * tall)
    u0, v0, u1, v1 = u0[large], v0[large], (u0 + wide)[large], (v0 + tall)[large]
    rectangles = np.column_stack([u0, v0, u1, v1])
    d, sigma = match_inside(view, rectangles)
    size = np.column_stack([u1 - u0, v1 - v0]) / view.rig.camera.fx * (view.rig.bf / np.where(d > 0.0, d, np.nan))[:, None]
    with np.errstate(invalid="ignore"):
        good = (d > view.rig.bf / reach_m) & (size.min(axis=1) >= SMALLEST_M) & (size.max(axis=1) <= LARGEST_M)
    rectangles, d, sigma, size = rectangles[good], d[good], sigma[good], size[good]
    u0, v0, u1, v1 = rectangles.T
    middle = np.column_stack([0.5 * (u0 + u1 - 1), 0.5 * (v0 + v1 - 1)])
    slopes = [slope(view, *box) if kind == SIGN else (np.nan, np.nan) for box in rectangles.tolist()]
    height, width = view.label.shape
    return Measurements(
        view=np.full(len(d), number),
        kind=np.full(len(d), kind),
        uvd=np.column_stack([middle, d]),
        sigma=np.column_stack([np.full(len(d), SIGMA_U_PX), np.full(len(d), SIGMA_U_PX), np.hypot(SIGMA_D_PX, sigma)]),
        low=view.points(middle[:, 0], v1 - 0.5, d)[:, 2],
        high=view.points(middle[:, 0], v0 - 0.5, d)[:, 2],
        cut_low=(v1 >= height - 1) | (u0 <= 1) | (u1 >= width - 1),
        cut_high=(v0 <= 1) | (u0 <= 1) | (u1 >= width - 1),
        width=size[:, 0],
        free=beside(view, rectangles, d),
        goes_on=np.full(len(d), np.nan),
        stripe=np.array([stripe(view, box, at) for box, at in zip(rectangles.tolist(), d.tolist(), strict=True)], np.float64),
        slope=np.array([one for one, _ in slopes]),
        slope_sigma=np.array([one for _, one in slopes]),
    )


def _pieces(mask: NDArray[np.bool_]) -> IntArray:
    """First column, first row, width, height and area (n, 5) of the pieces of a mask (h, w), whose corners do not connect."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return np.zeros((0, 5), np.int64)
    part = mask[rows[0] : rows[-1] + 1].astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(part, connectivity=4)
    pieces = stats[1:].astype(np.int64)
    pieces[:, 1] += rows[0]
    return pieces


def match_inside(view: ObjectView, rectangles: IntArray) -> tuple[FloatArray, FloatArray]:
    """Disparity and sigma (n,) of the middle half of rectangles (n, 4), where it has one, else of the whole of them.

    Labels are wider than what they are of: what lies around it is behind it, and would often win.
    """
    u0, v0, u1, v1 = rectangles.T
    aside, over = np.maximum(((u1 - u0) - INSIDE_PX) // 2, 0), np.maximum(((v1 - v0) - INSIDE_PX) // 2, 0)
    aside, over = np.minimum(aside, (u1 - u0) // 4), np.minimum(over, (v1 - v0) // 4)
    inside = view.match(np.column_stack([u0 + aside, v0 + over, u1 - aside, v1 - over]))
    whole = view.match(rectangles)
    known = np.isfinite(inside[0])
    return np.where(known, inside[0], whole[0]), np.where(known, inside[1], whole[1])


def stripe(view: ObjectView, box: tuple[int, int, int, int], disparity: float) -> float:
    """How much brighter than what is beside it a stripe is that runs down the middle of a face, over the grey value of the middle.

    A post stands before the back of its sign and behind its face. What a face shows ends above or below: the stripe counts as
    much as its faintest part. NaN where the face is too small or at the image's border.
    """
    u0, v0, u1, v1 = box
    aside = max(2, round(STRIPE_ASIDE_M * view.rig.camera.fx * disparity / view.rig.bf))
    low, high = round(v0 + STRIPE_MARGIN * (v1 - v0)), round(v1 - STRIPE_MARGIN * (v1 - v0))
    middle, half = 0.5 * (u0 + u1 - 1), STRIPE_HALF * (u1 - u0)
    first, last = round(middle - half), round(middle + half) + 1
    if first < aside or last + aside > view.left.shape[1] or high - low < STRIPE_PARTS:
        return np.nan
    grey = view.left[low:high, first - aside : last + aside].astype(np.float64)
    over = grey[:, aside:-aside] - 0.5 * (grey[:, 2 * aside :] + grey[:, : -2 * aside])
    parts = np.array([part.mean(axis=0) for part in np.array_split(over, STRIPE_PARTS)])
    return max(float(parts.min(axis=0).max()), 0.0) / (float(grey[:, aside:-aside].mean()) + DARK)


def slope(view: ObjectView, u0: int, v0: int, u1: int, v1: int) -> tuple[float, float]:
    """Slope of the disparity along the columns over the disparity, and its sigma, 1/px; NaN where it is not known."""
    edges = np.linspace(u0, u1, max(1, (u1 - u0) // STRIP_PX) + 1).round().astype(np.int64)
    strips = np.column_stack([edges[:-1], np.full(len(edges) - 1, v0), edges[1:], np.full(len(edges) - 1, v1)])
    d, _ = view.match(strips)
    known = np.isfinite(d)
    if known.sum() < LEAST_STRIPS:
        return np.nan, np.nan
    known[known] = np.abs(d[known] - np.median(d[known])) < 1.0 + 0.05 * np.median(d[known])
    u = 0.5 * (edges[:-1] + edges[1:] - 1)[known]
    off = u - u.mean() if len(u) else u
    if len(u) < LEAST_STRIPS:
        return np.nan, np.nan
    steep = float((off * d[known]).sum() / (off**2).sum())
    residual = d[known] - d[known].mean() - steep * off
    noise = np.sqrt(STRIP_SIGMA_PX**2 + float((residual**2).sum()) / max(len(u) - 2, 1))
    return steep / float(d[known].mean()), float(noise / np.sqrt((off**2).sum()) / d[known].mean())
