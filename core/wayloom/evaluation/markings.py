"""Markings and kerbs against those of a simulated city: what is found, what is true, and how far off it lies."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.geometry import se3
from wayloom.ground.markings.geometry import inside
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import MarkingSettings
from wayloom.ground.markings.types import LINES, Kerb, Marking
from wayloom.ground.sheet import PIXEL_M
from wayloom.simulation.city.markings import TrueKerb, TrueMarking

FloatArray = NDArray[np.float64]
SAMPLE_M: Final = 0.05
ON_M: Final = 0.25
"""A place on a found line within so much of a true line lies on it."""
ON_KERB_M: Final = 0.35
OVERLAP: Final = 0.5
"""Of two crossings' areas over their union: they are the same."""
SIDE_M: Final = 0.35
SHARP: Final = 4
"""Image pixels a metre: of a camera 1.65 m high at half size the ground to 10 m."""


@dataclass
class Scores:
    """Sums over sheets; lengths m, errors as lists of m.

    found, true         length of lines found, and how much of it lies on true lines
    seen, hit           by kind: length of true lines that the sheets show (and show with SHARP), and how much of it was found
    count               by kind: [found, of them true, true ones seen, of them found], of crossings and symbols
    across, width, ends errors of lines found: of the middle across (of each sample), of the width and of closed ends (of each line)
    ratio               errors across of each line (mean over its samples) over their sigma
    """

    found: float = 0.0
    true: float = 0.0
    seen: dict[str, float] = field(default_factory=dict)
    hit: dict[str, float] = field(default_factory=dict)
    count: dict[str, list[int]] = field(default_factory=dict)
    across: list[float] = field(default_factory=list)
    width: list[float] = field(default_factory=list)
    ends: list[float] = field(default_factory=list)
    ratio: list[float] = field(default_factory=list)
    bars: list[float] = field(default_factory=list)
    kerb_found: float = 0.0
    kerb_true: float = 0.0
    kerb_seen: float = 0.0
    kerb_hit: float = 0.0
    kerb_across: list[float] = field(default_factory=list)
    kerb_height: list[float] = field(default_factory=list)
    height_ratio: list[float] = field(default_factory=list)


def samples(line: FloatArray, step_m: float = SAMPLE_M) -> FloatArray:
    """(S, 2) places step_m apart along a line (N, 2 or 3), from half a step on."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1))])
    at = np.arange(step_m / 2, s[-1], step_m)
    return np.column_stack([np.interp(at, s, line[:, k]) for k in (0, 1)])


def score_markings(
    scores: Scores,
    found: Sequence[Marking],
    true: Sequence[TrueMarking],
    raster: GroundRaster,
    T_raster_enu: FloatArray,
    settings: MarkingSettings,
) -> None:
    """Add one raster: `found` in its frame, `true` in ENU, which T_raster_enu takes into it; only what it shows counts as true."""
    placed = [(mark, se3.transform(T_raster_enu, mark.line), se3.transform(T_raster_enu, mark.ring)) for mark in true]
    lines = [(mark, line) for mark, line, _ in placed if mark.kind in LINES]
    _score_found_lines(scores, [one for one in found if one.kind in LINES], lines)
    _score_true_lines(scores, [one for one in found if one.kind in LINES], lines, raster, settings)
    crossings = [ring for mark, _, ring in placed if mark.kind == "zebra"]
    _score_crossings(scores, [one for one in found if one.kind == "zebra"], crossings, raster, settings)
    for one in found:
        if one.kind in ("symbol", "arrow"):
            scores.count.setdefault(one.kind, [0, 0, 0, 0])[0] += 1


def _seen(raster: GroundRaster, places: FloatArray, least: int) -> NDArray[np.bool_]:
    """(S,) whether the raster shows places (S, 2)."""
    at = np.floor((places - raster.corner_m) / PIXEL_M).astype(np.int64)
    rows, columns = raster.sharpness.shape
    inside = (at >= 0).all(axis=1) & (at[:, 0] < columns) & (at[:, 1] < rows)
    out = np.zeros(len(places), bool)
    out[inside] = raster.sharpness[at[inside, 1], at[inside, 0]] >= least
    return out


def _dense(lines: Sequence[tuple[TrueMarking, FloatArray]]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Places a centimetre apart along all true lines, and the number of each one's line."""
    parts = [samples(line, 0.01) for _, line in lines]
    return np.concatenate([np.zeros((0, 2)), *parts]), np.repeat(np.arange(len(parts)), [len(part) for part in parts])


def _score_found_lines(scores: Scores, found: Sequence[Marking], lines: Sequence[tuple[TrueMarking, FloatArray]]) -> None:
    dense, owner = _dense(lines)
    tree = cKDTree(dense) if len(dense) else None
    for one in found:
        places = samples(one.line)
        scores.found += len(places) * SAMPLE_M
        if tree is None or not len(places):
            continue
        gap, nearest = tree.query(places)
        on = gap < ON_M
        scores.true += float(on.sum()) * SAMPLE_M
        if on.mean() < OVERLAP:
            continue
        aside = _aside(places[on], dense[nearest[on]], one.line)
        scores.across += np.abs(aside).tolist()
        scores.ratio.append(float(np.mean(aside)) / float(one.sigma_m[0]))
        number = int(np.bincount(owner[nearest[on]]).argmax())
        truth, line = lines[number]
        scores.width.append(one.width_m - truth.width_m)
        if truth.kind == "dash":
            d = (one.line[-1] - one.line[0])[:2] / np.hypot(*(one.line[-1] - one.line[0])[:2])
            reach = np.sort((line[[0, -1], :2] - one.line[0, :2]) @ d)
            for at, edge, is_open in ((0.0, reach[0], one.open[0]), (one.length_m, reach[1], one.open[1])):
                if not is_open and abs(at - edge) < 1.0:
                    scores.ends.append(float(at - edge) * (-1.0 if at == 0.0 else 1.0))


def _aside(places: FloatArray, true: FloatArray, line: FloatArray) -> FloatArray:
    """(S,) m by which places (S, 2) lie to the left of the true ones, across the line."""
    d = line[-1, :2] - line[0, :2]
    d = d / np.hypot(*d)
    return np.asarray((places - true) @ np.array([-d[1], d[0]]))


def _score_true_lines(
    scores: Scores,
    found: Sequence[Marking],
    lines: Sequence[tuple[TrueMarking, FloatArray]],
    raster: GroundRaster,
    settings: MarkingSettings,
) -> None:
    parts = [samples(one.line) for one in found]
    tree = cKDTree(np.concatenate(parts)) if parts else None
    for truth, line in lines:
        places = samples(line)
        places = places[_seen(raster, places, settings.least_sharpness)]
        if not len(places):
            continue
        hit = tree.query(places)[0] < ON_M if tree is not None else np.zeros(len(places), bool)
        sharp = _seen(raster, places, SHARP)
        for kind, among in ((truth.kind, np.ones(len(places), bool)), (f"{truth.kind}, sharp", sharp)):
            scores.seen[kind] = scores.seen.get(kind, 0.0) + float(among.sum()) * SAMPLE_M
            scores.hit[kind] = scores.hit.get(kind, 0.0) + float((hit & among).sum()) * SAMPLE_M


def _score_crossings(
    scores: Scores, found: Sequence[Marking], true: Sequence[FloatArray], raster: GroundRaster, settings: MarkingSettings
) -> None:
    """Crossings of which half is seen count; one is found where found and true areas overlap by half of the seen union."""
    count = scores.count.setdefault("zebra", [0, 0, 0, 0])
    count[0] += len(found)
    matched = set()
    for ring in true:
        grid = _grid(ring)
        seen = grid[_seen(raster, grid, settings.least_sharpness)]
        hits = [(float(inside(one.ring, seen).mean()), k) for k, one in enumerate(found)] if len(seen) else []
        best, number = max(hits, default=(0.0, -1))
        if best > OVERLAP:
            matched.add(number)
            scores.bars.append(found[number].width_m - 0.5)
        if len(seen) >= OVERLAP * len(grid):
            count[2] += 1
            count[3] += best > OVERLAP
    for k, one in enumerate(found):
        grid = _grid(one.ring)
        share = max((float(inside(ring, grid).mean()) for ring in true), default=0.0)
        count[1] += k in matched or share > 0.8


def _grid(ring: FloatArray) -> FloatArray:
    """(G, 2) places in a ring, a quarter of a metre apart."""
    low, high = ring[:, :2].min(axis=0), ring[:, :2].max(axis=0)
    x, y = (np.arange(a, b, 0.25) for a, b in zip(low, high, strict=True))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return places[inside(ring, places)]


def score_kerbs(
    scores: Scores, found: Sequence[Kerb], true: Sequence[TrueKerb], raster: GroundRaster, T_raster_enu: FloatArray
) -> None:
    """Add one raster's kerbs; a true kerb counts where the raster has heights on both its sides."""
    lines = [se3.transform(T_raster_enu, kerb.line) for kerb in true]
    dense = [samples(line, 0.02) for line in lines]
    tree = cKDTree(np.concatenate(dense)) if dense else None
    height = np.repeat([kerb.height_m for kerb in true], [len(part) for part in dense])
    parts = []
    for kerb in found:
        places = samples(kerb.line)
        parts.append(places)
        scores.kerb_found += len(places) * SAMPLE_M
        if tree is None:
            continue
        gap, nearest = tree.query(places)
        on = gap < ON_KERB_M
        scores.kerb_true += float(on.sum()) * SAMPLE_M
        if not on.any():
            continue
        scores.kerb_across += gap[on].tolist()
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(kerb.line[:, :2], axis=0), axis=1))])
        heights = np.interp((np.arange(len(places)) + 0.5) * SAMPLE_M, s, kerb.height_m)
        off = heights[on] - height[nearest[on]]
        scores.kerb_height += off.tolist()
        scores.height_ratio.append(float(np.mean(off)) / float(kerb.sigma_m[1]))
    near = cKDTree(np.concatenate(parts)) if parts else None
    for line in lines:
        places = samples(line)
        if len(places) < 2:
            continue
        seen = _both_sides(raster, places)
        scores.kerb_seen += float(seen.sum()) * SAMPLE_M
        if near is not None and seen.any():
            scores.kerb_hit += float((near.query(places[seen])[0] < ON_KERB_M).sum()) * SAMPLE_M


def _both_sides(raster: GroundRaster, places: FloatArray) -> NDArray[np.bool_]:
    """(S,) whether the raster has heights a little to both sides of places along a line."""
    d = np.gradient(places, axis=0)
    normal = np.column_stack([-d[:, 1], d[:, 0]]) / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
    return np.asarray(np.isfinite(raster.z(places + SIDE_M * normal)) & np.isfinite(raster.z(places - SIDE_M * normal)))
