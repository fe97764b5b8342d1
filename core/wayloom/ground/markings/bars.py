"""Straight pieces of paint: axis, width and ends from the half-height crossings of profiles across and along them."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from wayloom.ground.kernels import lines
from wayloom.ground.markings.paint import DARK, ROAD, Paint
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import MarkingSettings
from wayloom.ground.sheet import CELL_M, PIXEL_M

FloatArray = NDArray[np.float64]
SECTION_PX: Final = 10
"""Length of a section whose profiles are averaged: half a metre."""
STEP_PX: Final = 0.25
CORE_SHARE, LEAST_CORE = 0.5, 8
"""The pixels that tell where a piece lies have this share of its contrast."""
BESIDE_PX: Final = 12.0
"""How far beyond its edge the road beside a piece is looked at."""
END_PX: Final = 14.0
GAP_PX, SHALLOW, SHORTEST_RUN_PX = 2.5, 0.3, 3.0
"""Of gaps along a piece that are worn paint: length at most, or least contrast as a share of the paint's."""
BEND_PX: Final = 1.2
"""A piece whose middle leaves its axis further is cut in two."""
SHORTEST_CUT_PX: Final = 40.0
SAMPLE_PX: Final = 0.3
"""Sigma of the blur by the raster's own pixels, in pixels."""
ACROSS_VIEW: Final = 15.0
"""Pixels a metre across a view's direction, over the square root of those along it: sqrt(f / h) of a camera h m over the road."""
NARROWEST_M: Final = 0.06
"""Lines are painted no narrower; of what the blur hides this is said."""
LAID_M: Final = 0.03
"""Sigma with which the views of one place are laid on each other."""
OPTICS: Final = 0.5
"""Sigma of a view's blur, in its image pixels."""
RAIL_SHARE: Final = 0.4
"""A bright line between lines darker than the road by this share of its contrast is a rail."""
END_SIGMA_PX: Final = 0.6
LEAST_MOVE_PX: Final = 0.06
"""A position within a raster is not known better, sigma."""


@dataclass(frozen=True)
class Bar:
    """A straight piece of paint; positions are column and row in pixels of the raster.

    ends          (2, 2) its middle at both ends
    width_px      of the paint, the blur taken out
    sigma_px      (3,) of the middle across, of an end along, of the width
    open          (2,) whether the paint goes on where nothing is seen, at each end
    contrast      brighter than the road beside it, as a share of that
    filled        share of its sections with paint
    ragged_px     standard deviation of its edges about straight ones
    grain         of the road around it, as a share of its brightness
    on_road       share of its middle on cells of the road
    rows          how many probable pieces lie in one line with it, as far as counted
    """

    ends: FloatArray
    width_px: float
    sigma_px: FloatArray
    open: NDArray[np.bool_]
    contrast: float
    filled: float
    ragged_px: float
    grain: float
    on_road: float
    rows: int = 0

    @property
    def length_px(self) -> float:
        """From end to end."""
        return float(np.hypot(*(self.ends[1] - self.ends[0])))

    @property
    def d(self) -> FloatArray:
        """(2,) unit vector from the first end to the second."""
        return np.asarray((self.ends[1] - self.ends[0]) / max(self.length_px, 1e-9))


def bars_of(pixels: FloatArray, raster: GroundRaster, paint: Paint, settings: MarkingSettings) -> list[Bar]:
    """The straight pieces that a group of pixels (N, 2) column and row consists of, in order along it.

    A bend is cut until its pieces are straight.
    """
    column, row = pixels.astype(np.int64).T
    contrast = paint.contrast[row, column]
    core = contrast >= CORE_SHARE * np.quantile(contrast, 0.9)
    if core.sum() >= LEAST_CORE:
        pixels, contrast = pixels[core], contrast[core]
    middle, d = _axis(pixels, contrast.astype(np.float64) ** 2)
    along, across = (pixels - middle) @ d, (pixels - middle) @ np.array([-d[1], d[0]])
    length = float(np.ptp(along))
    if length > SHORTEST_CUT_PX and _bend(along, across) > BEND_PX:
        cut = along < (along.min() + along.max()) / 2
        if 8 < cut.sum() < len(cut) - 8:
            return bars_of(pixels[cut], raster, paint, settings) + bars_of(pixels[~cut], raster, paint, settings)
    return _fitted(middle, d, (float(along.min()), float(along.max())), float(np.std(across)), raster, paint, settings)


def _axis(pixels: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted mean (2,) and unit direction (2,) of the greatest spread."""
    middle = np.average(pixels, axis=0, weights=weight)
    _, vectors = np.linalg.eigh(np.cov((pixels - middle).T, aweights=weight) + 1e-9 * np.eye(2))
    return middle, np.asarray(vectors[:, 1])


def _bend(along: FloatArray, across: FloatArray) -> float:
    """How far the middle of half-metre sections leaves the straight line through them, px."""
    section = np.floor((along - along.min()) / SECTION_PX).astype(np.int64)
    count = np.bincount(section)
    full = count > 2
    s, a = np.bincount(section, along)[full] / count[full], np.bincount(section, across)[full] / count[full]
    if len(s) < 4:
        return 0.0
    return float(np.abs(a - np.polyval(np.polyfit(s, a, 1), s)).max())


def _fitted(
    middle: FloatArray,
    d: FloatArray,
    span: tuple[float, float],
    spread: float,
    raster: GroundRaster,
    paint: Paint,
    settings: MarkingSettings,
) -> list[Bar]:
    """The bars along d (2,) through `middle` (2,), from span[0] to span[1] px; none where edges are not found."""
    seen = paint.seen.view(np.uint8)
    half = float(np.clip(np.sqrt(3.0) * spread, 1.0, settings.most_width_m / PIXEL_M))
    for _ in range(2):  # the second time along the axis that the first found
        sections = _sections(middle, d, span)
        left = np.array([-d[1], d[0]])
        reach = half + BESIDE_PX
        steps = np.arange(-reach, reach + STEP_PX / 2, STEP_PX)
        profiles = np.empty((len(sections), len(steps)))
        lines.mean_profiles(raster.grey, seen, sections, left, steps, profiles)
        edges = _edges(profiles, steps, half)
        found = np.isfinite(edges.middle) & (edges.contrast > settings.edge_contrast)
        if not found.any():
            return []
        s = (sections.mean(axis=1) - middle) @ d
        offset, slope, rms = _line(s[found], edges.middle[found])
        middle, d = middle + left * offset, d + left * slope
        d = d / np.hypot(*d)
        half = float(np.clip(_median(edges.width[found]) / 2, 0.7, settings.most_width_m / PIXEL_M))
    widest, blur = _blur_px(raster, sections)
    measured = _median(edges.width[found])
    (width, width_sigma), (least, _) = _unblurred(measured, blur), _unblurred(measured, widest)
    width_sigma = float(np.hypot(width_sigma, (width - least) / 4))  # lines across the view are blurred more
    width = max(width, NARROWEST_M / PIXEL_M)
    if edges.rail[found].mean() > 0.5:
        return []
    count = int(found.sum())
    edge_px = float(np.std(edges.width[found]))
    sigma = np.array([
        np.hypot(LEAST_MOVE_PX, max(rms, 0.1 * blur) / np.sqrt(max(count - 2, 1))), END_SIGMA_PX,
        np.hypot(width_sigma, edge_px / np.sqrt(count)),
    ])  # fmt: skip
    column, row = np.clip(np.rint(middle).astype(int), 0, np.array(paint.grain.shape[::-1]) - 1)
    seen_sections = max(1, int(np.isfinite(edges.contrast).sum()))
    whole = Bar(
        np.array([middle + d * span[0], middle + d * span[1]]), width, sigma, np.zeros(2, bool),
        _median(edges.contrast[found]), count / seen_sections, edge_px / np.sqrt(2) + rms,
        float(paint.grain[row, column]), 0.0,
    )  # fmt: skip
    runs = _runs(middle, d, span, width, raster, seen)
    return [_cut(whole, middle, d, run, raster) for run in runs]


def _cut(whole: Bar, middle: FloatArray, d: FloatArray, run: tuple[float, float, bool, bool], raster: GroundRaster) -> Bar:
    """The part of a bar that a painted stretch is."""
    ends = np.array([middle + d * run[0], middle + d * run[1]])
    return replace(whole, ends=ends, open=np.array(run[2:]), on_road=_on_road(raster, ends))


def _on_road(raster: GroundRaster, ends: FloatArray) -> float:
    """Share of places along a line (2, 2) px whose cells are labelled as road."""
    places = np.floor((np.linspace(ends[0], ends[1], 21) + 0.5) * PIXEL_M / CELL_M).astype(np.int64)
    rows, columns = raster.label.shape
    return float((raster.label[np.clip(places[:, 1], 0, rows - 1), np.clip(places[:, 0], 0, columns - 1)] == ROAD).mean())


@dataclass(frozen=True, slots=True)
class _Edges:
    """Of each profile (S,), as `lines.band_edges` tells them: middle and width px, contrast, whether it looks like a rail."""

    middle: FloatArray
    width: FloatArray
    contrast: FloatArray
    rail: NDArray[np.bool_]


def _edges(profiles: FloatArray, steps: FloatArray, half: float) -> _Edges:
    """Edges of bright bands about half px to each side of the middle of profiles (S, T)."""
    middle, width, contrast, flank = np.empty((4, len(profiles)))
    lines.band_edges(profiles, steps, half, DARK, middle, width, contrast, flank)
    height = contrast * np.nanmedian(profiles) if np.isfinite(profiles).any() else contrast
    return _Edges(middle, width, contrast, np.asarray(np.nan_to_num(flank) > RAIL_SHARE * height))


def _line(s: FloatArray, a: FloatArray) -> tuple[float, float, float]:
    """Offset, slope and the residuals' robust deviation of the straight line a(s), outliers weighed down (Huber)."""
    weight = np.ones(len(s))
    offset, slope, rms = _median(a), 0.0, 0.0
    for _ in range(4):
        if len(s) < 3 or np.ptp(s) < SECTION_PX:
            offset, slope = float(np.average(a, weights=weight)), 0.0
        else:
            slope, offset = np.polyfit(s, a, 1, w=np.sqrt(weight))
        residual = a - offset - slope * s
        rms = 1.4826 * _median(np.abs(residual))
        weight = np.minimum(1.0, 1.5 * max(rms, 0.05) / np.maximum(np.abs(residual), 1e-9))
    return float(offset), float(slope), rms


def _median(values: FloatArray) -> float:
    """Of (N,) numbers, one at least, as of `np.median`, which takes some ten times as long for so few."""
    ordered = np.sort(values)
    half = len(ordered) // 2
    if np.isnan(ordered[-1]):  # they are the last ones
        return np.nan
    return float(ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2)


def _sections(middle: FloatArray, d: FloatArray, span: tuple[float, float]) -> FloatArray:
    """(S, M, 2) places a pixel apart along the axis, in sections."""
    length = span[1] - span[0]
    count = max(1, round(length / SECTION_PX))
    each = max(2, int(np.ceil(length / count)))
    s = np.linspace(span[0], span[1], count * each + 1)
    s = ((s[1:] + s[:-1]) / 2).reshape(count, each)
    return np.asarray(middle + s[..., None] * d)


def _runs(
    middle: FloatArray, d: FloatArray, span: tuple[float, float], width: float, raster: GroundRaster, seen: NDArray[np.uint8]
) -> list[tuple[float, float, bool, bool]]:
    """Painted stretches (from, to, open there, open there) px along an axis, within and a little beyond span.

    Along the axis the paint is compared with the road on both sides; a stretch begins and ends at half its contrast, or where
    nothing is seen; gaps that are shorter than GAP_PX, or not deep, are worn paint.
    """
    left = np.array([-d[1], d[0]])
    steps = np.arange(span[0] - END_PX, span[1] + END_PX + STEP_PX / 2, STEP_PX)
    strip = max(width, 1.0) / 4
    beside = max(width, 2.0) / 2 + 4.0
    profile = np.empty((3, len(steps)))
    offsets = ((-strip, 0.0, strip), (-beside - 1, -beside, -beside + 1), (beside - 1, beside, beside + 1))
    places = np.array([[middle + left * offset for offset in three] for three in offsets])
    lines.mean_profiles(raster.grey, seen, places, d, steps, profile)
    side = np.where(
        np.isfinite(profile[1]) & np.isfinite(profile[2]), (profile[1] + profile[2]) / 2, np.fmax(profile[1], profile[2])
    )
    contrast = (profile[0] - side) / (side + DARK)
    inside = (steps >= span[0]) & (steps <= span[1]) & np.isfinite(contrast)
    if not inside.any():
        return []
    full = float(np.quantile(contrast[inside], 0.75))
    return _stretches(contrast, steps, full, span)


def _stretches(
    contrast: FloatArray, steps: FloatArray, full: float, span: tuple[float, float]
) -> list[tuple[float, float, bool, bool]]:
    """Stretches of the contrast (T,) above half of `full`; NaN is unseen."""
    above = np.nan_to_num(contrast, nan=-1.0) > full / 2
    edges = np.flatnonzero(np.diff(np.concatenate([[False], above, [False]]).astype(np.int8)))
    out: list[tuple[float, float, bool, bool]] = []
    for first, last in zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True):
        starts = _edge_at(contrast, steps, first, -1, full / 2)
        ends = _edge_at(contrast, steps, last, 1, full / 2)
        if out and _is_worn(contrast, steps, out[-1][1], starts[0], full):
            out[-1] = (out[-1][0], ends[0], out[-1][2], ends[1])
        else:
            out.append((starts[0], ends[0], starts[1], ends[1]))
    return [run for run in out if run[1] > span[0] and run[0] < span[1] and run[1] - run[0] > SHORTEST_RUN_PX]


def _edge_at(contrast: FloatArray, steps: FloatArray, at: int, way: int, level: float) -> tuple[float, bool]:
    """Where a stretch that ends at index `at` crosses the level, and whether it is open: nothing is seen behind it."""
    beyond = at + way
    if not 0 <= beyond < len(steps) or not np.isfinite(contrast[beyond]):
        return float(steps[at]), True
    share = (contrast[at] - level) / max(contrast[at] - contrast[beyond], 1e-9)
    return float(steps[at] + way * STEP_PX * np.clip(share, 0.0, 1.0)), False


def _is_worn(contrast: FloatArray, steps: FloatArray, low: float, high: float, full: float) -> bool:
    """Whether the gap from low to high px is worn paint: seen, and short or shallow."""
    gap = contrast[(steps > low) & (steps < high)]
    if not len(gap):
        return True
    return bool(np.isfinite(gap).all() and (high - low < GAP_PX or gap.min() > SHALLOW * full))


def _blur_px(raster: GroundRaster, sections: FloatArray) -> tuple[float, float]:
    """Sigma of the blur along a piece, px, of the views and of the raster: seen along the view, and seen across it."""
    at = np.rint(sections.reshape(-1, 2)).astype(np.int64)
    rows, columns = raster.sharpness.shape
    sharp = raster.sharpness[np.clip(at[:, 1], 0, rows - 1), np.clip(at[:, 0], 0, columns - 1)]
    sharp = sharp[sharp > 0]
    fewest = float(np.median(sharp)) if len(sharp) else 1.0
    own = np.hypot(SAMPLE_PX, LAID_M / PIXEL_M)
    along, across = (float(np.hypot(own, OPTICS / per_m / PIXEL_M)) for per_m in (fewest, ACROSS_VIEW * np.sqrt(fewest)))
    return along, min(along, across)


def _unblurred(width: float, blur: float) -> tuple[float, float]:
    """Width of the band that a Gaussian blur widens to `width` at half height, and its sigma, px."""
    true = np.linspace(0.0, 20.0, 401)
    widths = _half_height_widths()
    measured = widths * blur
    best = float(np.interp(width, measured, true * blur))
    if width >= measured[-1]:
        return width, 0.1 * blur
    slope = float(np.interp(width, measured, np.gradient(true, widths + 1e-9 * true)))
    return best, 0.1 * blur * min(slope, 5.0)


@cache
def _half_height_widths() -> FloatArray:
    """Widths at half height, in sigmas, of bands of 0 to 20 sigmas that a Gaussian has blurred."""
    x = np.linspace(0.0, 14.0, 1401)
    out = [2.3548]
    for band in np.linspace(0.0, 20.0, 401)[1:]:
        profile = erf((x + band / 2) / np.sqrt(2)) - erf((x - band / 2) / np.sqrt(2))
        out.append(2 * float(np.interp(-profile[0] / 2, -profile, x)))
    return np.maximum.accumulate(np.array(out) + 1e-9 * np.arange(401))
