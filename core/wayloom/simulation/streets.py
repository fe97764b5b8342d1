"""The street graph, and the blocks between its streets."""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
STREET_HALF_M, AVENUE_HALF_M = 6.0, 9.0
SIDEWALK_M = 3.5
CORNER_RADIUS_M = 5.0
CORNER_STEPS = 6
JITTER_M = 7.0
STREET_SPACING_M = (64.0, 92.0)
CROSSING_LENGTH_M = 4.0


@dataclass(frozen=True, slots=True)
class Street:
    """One street between two nodes."""

    a: int
    b: int
    half_width_m: float

    @property
    def is_avenue(self) -> bool:
        """Whether trams run in its middle."""
        return self.half_width_m == AVENUE_HALF_M


@dataclass(frozen=True, slots=True)
class StreetGraph:
    """nodes (N, 2) m; streets by (smaller, larger) node; blocks as node loops, counter-clockwise, convex."""

    nodes: F64
    streets: dict[tuple[int, int], Street]
    blocks: tuple[tuple[int, ...], ...]

    def street(self, a: int, b: int) -> Street:
        """The street between two neighbouring nodes."""
        return self.streets[min(a, b), max(a, b)]

    def inner_streets(self) -> list[Street]:
        """Streets with a block on either side, in a fixed order."""
        sides = Counter(tuple(sorted((loop[k - 1], loop[k]))) for loop in self.blocks for k in range(len(loop)))
        return [street for ends, street in self.streets.items() if sides[ends] == 2]


def grid_graph(rng: np.random.Generator, columns: int, rows: int) -> StreetGraph:
    """A grown-over grid: uneven spacing, every crossing moved at random, one avenue each way. Node = row * columns + column.

    Its middle lies near the origin.
    """
    x = np.cumsum(rng.uniform(*STREET_SPACING_M, columns))
    y = np.cumsum(rng.uniform(*STREET_SPACING_M, rows))
    grid = np.stack(np.meshgrid(x - x.mean(), y - y.mean()), axis=-1) + rng.uniform(-JITTER_M, JITTER_M, (rows, columns, 2))
    avenue_column, avenue_row = min(columns // 2 + 1, columns - 2), min(rows // 2 + 1, rows - 2)
    streets = {}
    for r in range(rows):
        for c in range(columns):
            n = r * columns + c
            if c + 1 < columns:
                streets[n, n + 1] = Street(n, n + 1, AVENUE_HALF_M if r == avenue_row else STREET_HALF_M)
            if r + 1 < rows:
                streets[n, n + columns] = Street(n, n + columns, AVENUE_HALF_M if c == avenue_column else STREET_HALF_M)
    corner = [r * columns + c for r in range(rows - 1) for c in range(columns - 1)]
    blocks = tuple((n, n + 1, n + columns + 1, n + columns) for n in corner)
    return StreetGraph(grid.reshape(-1, 2), streets, blocks)


def inset(corners: F64, offsets: F64) -> F64:
    """Convex loop (K, 2), counter-clockwise, with edge k (corner k to k + 1) moved inwards by offsets[k] m."""
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    inward = np.column_stack([-along[:, 1], along[:, 0]])
    base = corners + inward * offsets[:, None]
    out = np.empty_like(corners)
    for k in range(len(corners)):  # corner k is where the edges k - 1 and k meet
        j = k - 1
        s, _ = np.linalg.solve(np.column_stack([along[j], -along[k]]), base[k] - base[j])
        out[k] = base[j] + s * along[j]
    return out


def rounded_corner(before: F64, corner: F64, after: F64, radius_m: float) -> F64:
    """(CORNER_STEPS + 1, 2): the arc that replaces a corner, from the edge before it to the edge after it."""
    to_before, to_after = (before - corner) / np.linalg.norm(before - corner), (after - corner) / np.linalg.norm(after - corner)
    half_angle = 0.5 * np.arccos(np.clip(to_before @ to_after, -1, 1))
    middle = (to_before + to_after) / np.linalg.norm(to_before + to_after)
    centre = corner + middle * radius_m / np.sin(half_angle)
    start, end = corner + to_before * radius_m / np.tan(half_angle), corner + to_after * radius_m / np.tan(half_angle)
    a0, a1 = np.arctan2(*(start - centre)[::-1]), np.arctan2(*(end - centre)[::-1])
    a1 = a0 + (a1 - a0 + np.pi) % (2 * np.pi) - np.pi
    angle = np.linspace(a0, a1, CORNER_STEPS + 1)
    return np.asarray(centre + radius_m * np.column_stack([np.cos(angle), np.sin(angle)]))


@dataclass(frozen=True, slots=True)
class BlockShape:
    """The lines of one block, counter-clockwise; edge k runs from corner k to corner k + 1 with the block on its left.

    nodes       node numbers (K,)
    middle      (K, 2) street nodes
    half_m      (K,) half widths of the streets
    kerb        (K, 2) corners of the kerb before rounding
    arcs        (K, S, 2) rounded kerb corners
    inner       (K, 2) back of the sidewalk
    """

    nodes: tuple[int, ...]
    middle: F64
    half_m: F64
    kerb: F64
    arcs: F64
    inner: F64

    def edge(self, k: int) -> tuple[F64, F64, float]:
        """Direction (2,), inward normal (2,) and length m of street edge k."""
        d = self.middle[(k + 1) % len(self.middle)] - self.middle[k]
        length = float(np.hypot(*d))
        d = d / length
        return d, np.array([-d[1], d[0]]), length


def block_shape(graph: StreetGraph, nodes: tuple[int, ...]) -> BlockShape:
    """The lines of the block inside a loop of nodes."""
    middle, count = graph.nodes[list(nodes)], len(nodes)
    half = np.array([graph.street(nodes[k], nodes[(k + 1) % count]).half_width_m for k in range(count)])
    kerb = inset(middle, half)
    arcs = np.stack([rounded_corner(kerb[k - 1], kerb[k], kerb[(k + 1) % count], CORNER_RADIUS_M) for k in range(count)])
    return BlockShape(nodes, middle, half, kerb, arcs, inset(kerb, np.full(count, SIDEWALK_M)))


def clearances(shapes: list[BlockShape]) -> dict[tuple[int, int], float]:
    """For each street end (node, other node): how far from the node the crossing begins, m, behind all rounded corners there."""
    out: dict[tuple[int, int], float] = {}
    for shape in shapes:
        count = len(shape.nodes)
        for k in range(count):
            d, _, length = shape.edge(k)
            n = (k + 1) % count
            start = float((shape.arcs[k, -1] - shape.middle[k]) @ d) + 0.3
            end = length - float((shape.arcs[n, 0] - shape.middle[k]) @ d) + 0.3
            a, b = shape.nodes[k], shape.nodes[n]
            out[a, b] = max(out.get((a, b), 0.0), start)
            out[b, a] = max(out.get((b, a), 0.0), end)
    return out
