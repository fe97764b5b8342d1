"""True road markings and kerbs of a city, as its ground textures paint them and its kerb stones stand."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from wayloom.simulation.city.ground import KERB_M, island_rim
from wayloom.simulation.city.streets import AVENUE_HALF_M, CROSSING_LENGTH_M, F64, ISLAND_M, StreetGraph
from wayloom.simulation.city.terrain import Terrain
from wayloom.simulation.textures.paint_ground import (
    AVENUE_EDGE_M,
    AVENUE_EDGE_WIDTH_M,
    AVENUE_PARKING_M,
    BAR_M,
    BAR_PERIOD_M,
    DASH_M,
    DASH_PERIOD_M,
    DASH_WIDTH_M,
    PARKING_DASH_M,
    PARKING_PERIOD_M,
    PARKING_WIDTH_M,
    STREET_PARKING_M,
)

SHORTEST_M: Final = 0.05
"""Of a piece of paint that counts."""
LINE_STEP_M: Final = 2.0
"""Between the points of a line that follows the terrain."""
Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class TrueMarking:
    """Paint on the road.

    kind      "dash", "solid" or "zebra"
    line      (N, 3) ENU m: its middle, with a step to the side where its width changes; of a zebra the middle across its bars
    ring      (N, 3) ENU m: its outline, counter-clockwise, the last point is the first again; of a zebra the outline of all bars
    width_m   of the line; of a zebra's bars
    length_m  along the line; of a zebra's bars
    """

    kind: str
    line: F64
    ring: F64
    width_m: float
    length_m: float


@dataclass(frozen=True, slots=True)
class TrueKerb:
    """A kerb: line (N, 3) ENU m along its foot, on the road; height_m of its upper edge above it."""

    line: F64
    height_m: float


def true_markings(graph: StreetGraph, ground: Terrain, blocks: Iterable[int]) -> list[TrueMarking]:
    """Markings on the streets around the given blocks, street by street; each block paints its own half of a street."""
    chosen = list(blocks)
    edges = sorted({(min(e), max(e)) for block in chosen for e in graph.shape(block).edges()})
    return [marking for a, b in edges for marking in _street(graph, ground, a, b)]


def true_kerbs(graph: StreetGraph, ground: Terrain, blocks: Iterable[int]) -> list[TrueKerb]:
    """The kerbs around the given blocks, and those of the roundabouts' islands at their corners."""
    out = []
    for block in blocks:
        shape = graph.shape(block)
        loop = shape.kerb_line()
        out.append(TrueKerb(_lifted(ground, _dense(np.vstack([loop, loop[:1]]))), KERB_M))
        out += [
            TrueKerb(_lifted(ground, island_rim(shape.middle[k], shape, k, ISLAND_M)), KERB_M)
            for k in range(len(shape.nodes))
            if shape.roundabout[k]
        ]
    return out


@dataclass(frozen=True, slots=True)
class _Frame:
    """A street: origin (2,) at its first node, d along it, left to the side; the ground that lifts its points."""

    origin: F64
    d: F64
    left: F64
    ground: Terrain

    def points(self, along: Iterable[float], across: Iterable[float]) -> F64:
        """(N, 3) ENU m."""
        xy = self.origin + np.outer(list(along), self.d) + np.outer(list(across), self.left)
        return _lifted(self.ground, xy)


def _street(graph: StreetGraph, ground: Terrain, a: int, b: int) -> Iterator[TrueMarking]:
    """Zebras at both ends, and between them the lines of a street or an avenue."""
    p, q = graph.nodes[a], graph.nodes[b]
    length = float(np.hypot(*(q - p)))
    d = (q - p) / length
    frame = _Frame(p, d, np.array([-d[1], d[0]]), ground)
    sides = _sides(graph, a, b, frame)
    half = graph.street(a, b).half_width_m
    start, end = graph.clear_m(a, b), length - graph.clear_m(b, a)
    for low in (start, end - CROSSING_LENGTH_M):
        yield _zebra(frame, low, half, sides)
    marked = (start + CROSSING_LENGTH_M, end - CROSSING_LENGTH_M)
    avenue = half == AVENUE_HALF_M
    if avenue:
        yield from (_bar(frame, "solid", marked, side * AVENUE_EDGE_M, AVENUE_EDGE_WIDTH_M) for side in sides)
    else:
        yield from _middle(frame, {side: _repeats(marked, length, side, DASH_M, DASH_PERIOD_M) for side in sides})
    for side in sides:
        for dash in _repeats(marked, length, side, PARKING_DASH_M, PARKING_PERIOD_M):
            across = side * (AVENUE_PARKING_M if avenue else STREET_PARKING_M)
            yield _bar(frame, "dash", dash, across, PARKING_WIDTH_M)


def _sides(graph: StreetGraph, a: int, b: int, frame: _Frame) -> list[float]:
    """1 and -1 for the sides, left first, on which a block paints the street."""
    middles = [shape.middle.mean(axis=0) for shape in graph.shapes_beside(a, b)]
    return sorted((float(np.sign((middle - frame.origin) @ frame.left)) for middle in middles), reverse=True)


def _repeats(marked: Interval, length: float, side: float, dash_m: float, period_m: float) -> list[Interval]:
    """The dashes of one half of a street, along it: the block on its right counts from the other end."""
    low, high = marked if side > 0 else (length - marked[1], length - marked[0])
    starts = np.arange(np.floor(low / period_m), np.ceil(high / period_m) + 1) * period_m
    cut = [(max(low, s), min(high, s + dash_m)) for s in starts.tolist()]
    kept = [(s, e) for s, e in cut if e - s > SHORTEST_M]
    return kept if side > 0 else [(length - e, length - s) for s, e in reversed(kept)]


def _bar(frame: _Frame, kind: str, along: Interval, across: float, width: float) -> TrueMarking:
    """A straight line of one width."""
    length = along[1] - along[0]
    stations = np.linspace(*along, max(2, int(np.ceil(length / LINE_STEP_M)) + 1)).tolist()
    right, left = across - width / 2, across + width / 2
    outline = [*stations, *reversed(stations), stations[0]]
    sides = [right] * len(stations) + [left] * len(stations) + [right]
    return TrueMarking(
        kind, frame.points(stations, [across] * len(stations)), frame.points(outline, sides), width, along[1] - along[0]
    )


def _middle(frame: _Frame, halves: dict[float, list[Interval]]) -> Iterator[TrueMarking]:
    """The dashes between the lanes: each side's block paints its half of the width, and halves that touch are one marking."""
    cuts = sorted({s for dashes in halves.values() for dash in dashes for s in dash})
    run: list[tuple[float, float, float, float]] = []
    for s, e in pairwise(cuts):
        painted = [side for side, dashes in halves.items() if any(low <= s and e <= high for low, high in dashes)]
        if painted:
            run.append((s, e, min(0.0, *painted) * DASH_WIDTH_M / 2, max(0.0, *painted) * DASH_WIDTH_M / 2))
        elif run:
            yield _pieces(frame, run)
            run = []
    if run:
        yield _pieces(frame, run)


def _pieces(frame: _Frame, run: list[tuple[float, float, float, float]]) -> TrueMarking:
    """A dash of pieces (from, to, right, left): each of one width."""
    along = [s for piece in run for s in piece[:2]]
    right, left = ([piece[k] for piece in run for _ in range(2)] for k in (2, 3))
    length = run[-1][1] - run[0][0]
    area = sum((e - s) * (high - low) for s, e, low, high in run)
    middle = [(low + high) / 2 for low, high in zip(right, left, strict=True)]
    ring = frame.points([*along, *reversed(along), along[0]], [*right, *reversed(left), right[0]])
    return TrueMarking("dash", frame.points(along, middle), ring, area / length, length)


def _zebra(frame: _Frame, low: float, half: float, sides: list[float]) -> TrueMarking:
    """The outline of a crossing's bars: each block begins with a bar at the street's middle."""
    last = (np.ceil(half / BAR_PERIOD_M) - 1) * BAR_PERIOD_M + BAR_M
    right, left = min(0.0, *sides) * last, max(0.0, *sides) * last
    high, middle = low + CROSSING_LENGTH_M, low + CROSSING_LENGTH_M / 2
    ring = frame.points([low, high, high, low, low], [right, right, left, left, right])
    return TrueMarking("zebra", frame.points([middle, middle], [right, left]), ring, BAR_M, CROSSING_LENGTH_M)


def _dense(line: F64) -> F64:
    """Points at most LINE_STEP_M apart along a line (N, 2)."""
    parts = [np.linspace(p, q, max(1, int(np.ceil(np.hypot(*(q - p)) / LINE_STEP_M))), endpoint=False) for p, q in pairwise(line)]
    return np.vstack([*parts, line[-1:]])


def _lifted(ground: Terrain, xy: F64) -> F64:
    return np.column_stack([xy, ground.height(xy[:, 0], xy[:, 1])])
