"""Markings and kerbs of one square, of those found on a raster that reaches beyond it, so that a grid of squares has each once.

What is shorter than the raster reaches beyond the square is seen whole by every square that it touches, and belongs to that in
which its middle lies. What is as long is cut at the square's border: its other part is the next square's.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.markings.geometry import band
from wayloom.ground.markings.types import LINES, Kerb, Marking

FloatArray = NDArray[np.float64]
MIDDLES_M = 0.001
"""Middles are rounded to so much, so that two rasters put the same marking into the same square."""
LEAST_M = 0.01
"""A part that is shorter is left out."""


def markings_of_square(found: Sequence[Marking], low: FloatArray, edge_m: float, halo_m: float) -> list[Marking]:
    """Of markings found up to halo_m around a square those that are its own; low (2,) m: its corner. A line's end at the border is
    `open`."""
    out: list[Marking] = []
    for one in found:
        if one.kind not in LINES or one.length_m < halo_m:
            out += [one] if _is_inside(one.line, low, edge_m) else []
        else:
            out += [_marking_part(one, *span) for span in spans_inside(one.line[:, :2], low, low + edge_m)]
    return [one for one in out if one.length_m >= LEAST_M]


def kerbs_of_square(found: Sequence[Kerb], low: FloatArray, edge_m: float, halo_m: float) -> list[Kerb]:
    """The same of kerbs."""
    out: list[Kerb] = []
    for one in found:
        if one.length_m < halo_m:
            out += [one] if _is_inside(one.line, low, edge_m) else []
        else:
            out += [_kerb_part(one, *span) for span in spans_inside(one.line[:, :2], low, low + edge_m)]
    return [one for one in out if one.length_m >= LEAST_M]


def spans_inside(xy: FloatArray, low: FloatArray, high: FloatArray) -> Iterator[tuple[float, float]]:
    """From where to where a line (N, 2) runs within a box (2,) to (2,): as numbers of vertices, 1.5 lies between the second and
    the third (Liang and Barsky 1984)."""
    step = np.diff(xy, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low = np.nan_to_num((low - xy[:-1]) / step, nan=-np.inf, posinf=np.inf, neginf=-np.inf)
        to_high = np.nan_to_num((high - xy[:-1]) / step, nan=np.inf, posinf=np.inf, neginf=-np.inf)
    enter = np.maximum(np.minimum(to_low, to_high).max(axis=1), 0.0)
    leave = np.minimum(np.maximum(to_low, to_high).min(axis=1), 1.0)
    held: tuple[float, float] | None = None
    for k in np.flatnonzero(enter < leave).tolist():
        here = (k + float(enter[k]), k + float(leave[k]))
        if held is not None and held[1] == here[0]:
            here = (held[0], here[1])
        elif held is not None:
            yield held
        held = here
    if held is not None:
        yield held


def _is_inside(line: FloatArray, low: FloatArray, edge_m: float) -> bool:
    middle = np.rint((line[0, :2] + line[-1, :2]) / 2.0 / MIDDLES_M) * MIDDLES_M
    return bool((np.floor((middle - low) / edge_m) == 0).all())


def _part(values: FloatArray, first: float, last: float) -> FloatArray:
    """(M, K): the rows (N, K) from one number of a vertex to another, those at both ends interpolated."""
    between = np.arange(int(np.floor(first)) + 1, int(np.ceil(last)))
    at = np.concatenate([[first], between, [last]])
    return np.column_stack([np.interp(at, np.arange(len(values)), column) for column in values.T])


def _marking_part(one: Marking, first: float, last: float) -> Marking:
    line = _part(one.line, first, last)
    length = float(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1).sum())
    opened = (one.open[0] or first > 0.0, one.open[1] or last < len(one.line) - 1.0)
    return replace(one, line=line, ring=band(line, one.width_m), length_m=length, open=opened)


def _kerb_part(one: Kerb, first: float, last: float) -> Kerb:
    part = _part(np.column_stack([one.line, one.height_m]), first, last)
    return replace(one, line=part[:, :3], height_m=part[:, 3])
