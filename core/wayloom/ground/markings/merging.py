"""Markings and kerbs of overlapping rasters as one set: each once, lines that continue each other joined."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.markings.geometry import band, inside
from wayloom.ground.markings.types import LINES, Kerb, Marking

FloatArray = NDArray[np.float64]
SAMPLE_M: Final = 0.2
ASIDE_M: Final = 0.3
"""Two sheets of one drive agree so well."""
SAME_KERB_M: Final = 0.5
COVERED: Final = 0.5
LONGER_M: Final = 0.5
"""A line that goes on so far behind the end of another of the same kind lengthens it."""


def merged_markings(found: Sequence[Marking], solid_m: float) -> list[Marking]:
    """The markings (one frame), each once: of two of the same paint the better known stays, in whatever order they come.

    solid_m : lines that become longer than this are solid
    """
    order = sorted(range(len(found)), key=lambda k: (-round(_rank(found[k]), 6), found[k].line.tobytes()))
    kept: list[Marking] = []
    boxes = np.empty((len(found), 4))
    for k in order:
        marking = found[k]
        near = np.flatnonzero(_meets(boxes[: len(kept)], _box(marking.ring)))
        same = next((int(n) for n in near if _is_same(kept[n], marking)), None)
        if same is None:
            boxes[len(kept)] = _box(marking.ring)
            kept.append(marking)
        elif marking.kind in LINES and kept[same].kind in LINES:
            kept[same] = _lengthened(kept[same], marking, solid_m)
            boxes[same] = _box(kept[same].ring)
            _fold_into(kept, boxes, same, solid_m)
    return kept


def _fold_into(kept: list[Marking], boxes: FloatArray, grown: int, solid_m: float) -> None:
    """Join the kept lines that one which has grown has come to, in place; of two the better known, which comes first, stays."""
    while True:
        near = np.flatnonzero(_meets(boxes[: len(kept)], boxes[grown])).tolist()
        lines = (n for n in near if n != grown and kept[n].kind in LINES)
        other = next((n for n in lines if _is_same(kept[grown], kept[n])), None)
        if other is None:
            return
        grown, last = sorted((grown, other))
        joined = kept.pop(last)
        boxes[last : len(kept)] = boxes[last + 1 : len(kept) + 1]
        kept[grown] = _lengthened(kept[grown], joined, solid_m)
        boxes[grown] = _box(kept[grown].ring)


def merged_kerbs(found: Sequence[Kerb], least_length_m: float) -> list[Kerb]:
    """The kerbs (one frame), each stretch once: the longer kerb keeps it."""
    order = sorted(range(len(found)), key=lambda k: (-round(found[k].length_m, 6), found[k].line.tobytes()))
    kept: list[Kerb] = []
    boxes = np.empty((0, 4))
    for k in order:
        kerb = found[k]
        around = _box(kerb.line) + SAME_KERB_M * np.array([-1, -1, 1, 1])
        near = [kept[n] for n in np.flatnonzero(_meets(boxes, around))]
        for part in _uncovered(kerb, near):
            if part.length_m >= least_length_m:
                boxes = np.vstack([boxes, _box(part.line)])
                kept.append(part)
    return kept


def _rank(marking: Marking) -> float:
    """Larger for what is known better: whole before cut, long before short, certain before uncertain."""
    return marking.length_m * max(marking.bars, 1) - 0.5 * sum(marking.open) - 10.0 * float(marking.sigma_m[0])


def _box(points: FloatArray) -> FloatArray:
    """(4,) low x, low y, high x, high y."""
    return np.concatenate([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])


def _meets(boxes: FloatArray, box: FloatArray) -> NDArray[np.bool_]:
    """(N,) whether boxes (N, 4) come within ASIDE_M of a box (4,)."""
    return np.asarray((boxes[:, :2] < box[2:] + ASIDE_M).all(axis=1) & (boxes[:, 2:] > box[:2] - ASIDE_M).all(axis=1))


def _is_same(one: Marking, other: Marking) -> bool:
    """Whether two markings are the same paint, or parts of one line."""
    if one.kind in LINES and other.kind in LINES:
        return _share_on(other.line, one.line, ASIDE_M) > 0.0 and _is_along(one.line, other.line)
    if one.kind in LINES or other.kind in LINES:
        area, line = (one, other) if other.kind in LINES else (other, one)
        return bool(inside(area.ring, _samples(line.line)).mean() > COVERED)
    return bool(inside(one.ring, _samples(other.line)).mean() > COVERED or inside(other.ring, _samples(one.line)).mean() > COVERED)


def _is_along(one: FloatArray, other: FloatArray) -> bool:
    """Whether two lines have about the same direction."""
    d, e = one[-1, :2] - one[0, :2], other[-1, :2] - other[0, :2]
    return bool(abs(d @ e) > 0.9 * np.hypot(*d) * np.hypot(*e))


def _samples(line: FloatArray) -> FloatArray:
    """(S, 2) places at most SAMPLE_M apart along a line (N, 2 or 3)."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1))])
    at = np.linspace(0.0, s[-1], max(2, int(np.ceil(s[-1] / SAMPLE_M)) + 1))
    return np.column_stack([np.interp(at, s, line[:, k]) for k in (0, 1)])


def _distances(places: FloatArray, line: FloatArray) -> FloatArray:
    """(S,) m from places (S, 2) to a line (N, 2 or 3); beyond its ends to the ends."""
    p, d = line[:-1, :2], np.diff(line[:, :2], axis=0)
    t = np.einsum("snk,nk->sn", places[:, None] - p, d) / np.maximum((d**2).sum(axis=1), 1e-12)
    gap = places[:, None] - (p + np.clip(t, 0, 1)[..., None] * d)
    return np.asarray(np.sqrt((gap**2).sum(axis=2)).min(axis=1))


def _share_on(line: FloatArray, other: FloatArray, within_m: float) -> float:
    """Share of a line's places that lie within so many metres of another."""
    return float((_distances(_samples(line), other) < within_m).mean())


def _lengthened(kept: Marking, other: Marking, solid_m: float) -> Marking:
    """A line with the part of another that goes on behind its ends."""
    line = other.line if _runs_with(kept.line, other.line) else other.line[::-1]
    opened = other.open if line is other.line else other.open[::-1]
    before = line[(line[:, :2] - kept.line[0, :2]) @ (kept.line[1, :2] - kept.line[0, :2]) < 0]
    after = line[(line[:, :2] - kept.line[-1, :2]) @ (kept.line[-1, :2] - kept.line[-2, :2]) > 0]
    starts = len(before) > 0 and np.hypot(*(before[0] - kept.line[0])[:2]) > LONGER_M
    ends = len(after) > 0 and np.hypot(*(after[-1] - kept.line[-1])[:2]) > LONGER_M
    if not (starts or ends):
        return kept
    whole = np.vstack([*([before] if starts else []), kept.line, *([after] if ends else [])])
    length = float(np.linalg.norm(np.diff(whole[:, :2], axis=0), axis=1).sum())
    kind = "solid" if kept.kind == "dash" and length >= solid_m else kept.kind
    both = (opened[0] if starts else kept.open[0], opened[1] if ends else kept.open[1])
    return replace(kept, kind=kind, line=whole, ring=band(whole, kept.width_m), length_m=length, open=both)


def _runs_with(one: FloatArray, other: FloatArray) -> bool:
    return bool((one[-1, :2] - one[0, :2]) @ (other[-1, :2] - other[0, :2]) >= 0)


def _uncovered(kerb: Kerb, others: Sequence[Kerb]) -> list[Kerb]:
    """The stretches of a kerb that no other covers."""
    free = np.ones(len(kerb.line), bool)
    for other in others:
        free &= _distances(kerb.line[:, :2], other.line) > SAME_KERB_M
    edges = np.flatnonzero(np.diff(np.concatenate([[False], free, [False]]).astype(np.int8)))
    spans = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [replace(kerb, line=kerb.line[a:b], height_m=kerb.height_m[a:b]) for a, b in spans if b - a > 1]
