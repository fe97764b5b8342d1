"""Street graph on a jittered grid, and the block shapes between its streets."""

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import ConfigError
from wayloom.simulation.city.city_settings import CitySettings

F64 = NDArray[np.float64]
STREET_HALF_M, AVENUE_HALF_M = 6.0, 9.0
SIDEWALK_M = 3.5
CORNER_RADIUS_M = 5.0
CORNER_STEPS = 6
JITTER_M = 7.0
STREET_SPACING_M = (64.0, 92.0)
HARD_SPACING_M = 84.0
"""A whole number of repeats of all textures that lie on the ground."""
CROSSING_LENGTH_M = 4.0
AVENUE_EVERY = 5
ROUNDABOUT_M, ISLAND_M = 15.0, 8.0
"""Outer radius of a roundabout's carriageway, and radius of its island."""
FLARE_M, FLARE_STEPS, RING_STEPS = 3.0, 4, 8
KEPT_SHAPES = 512


class Control(Enum):
    """Right-of-way control of a crossing."""

    SIGNALS = 0
    SIGNS = 1
    ROUNDABOUT = 2


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


class StreetGraph:
    """A grown-over grid: uneven spacing, every crossing moved at random, avenues every few streets, roundabouts.

    nodes  (N, 2) m; node = row * columns + column, rows from south to north; their middle lies near the origin
    Blocks lie between four nodes each: block = row * (columns - 1) + column.
    """

    def __init__(self, settings: CitySettings) -> None:
        self.columns, self.rows, self.hard = settings.columns, settings.rows, settings.hard
        self.nodes = _hard_nodes(self.columns, self.rows) if settings.hard else _grown_nodes(settings)
        first_column, first_row = min(self.columns // 2 + 1, self.columns - 2), min(self.rows // 2 + 1, self.rows - 2)
        self._avenue_column, self._avenue_row = first_column % AVENUE_EVERY, first_row % AVENUE_EVERY
        self._signs = np.random.default_rng([settings.seed, 4]).random(len(self.nodes)) < 0.35
        grid = self.nodes.reshape(self.rows, self.columns, 2)
        self._east, self._north = grid[..., 0].max(axis=0), grid[..., 1].max(axis=1)
        self._west, self._south = grid[..., 0].min(axis=0), grid[..., 1].min(axis=1)
        self.shape = lru_cache(KEPT_SHAPES)(self._shape)

    @property
    def block_count(self) -> int:
        """Number of blocks."""
        return (self.columns - 1) * (self.rows - 1)

    def loop(self, block: int) -> tuple[int, int, int, int]:
        """The nodes around a block, counter-clockwise from its south-western one."""
        row, column = divmod(block, self.columns - 1)
        n = row * self.columns + column
        return n, n + 1, n + self.columns + 1, n + self.columns

    def blocks_within(self, low: F64, high: F64) -> list[int]:
        """Blocks that may reach into the rectangle from low to high (2,) m, in order."""
        columns = np.nonzero((self._west[:-1] < high[0]) & (self._east[1:] > low[0]))[0]
        rows = np.nonzero((self._south[:-1] < high[1]) & (self._north[1:] > low[1]))[0]
        return [int(r) * (self.columns - 1) + int(c) for r in rows for c in columns]

    def neighbours(self, node: int) -> list[int]:
        """Nodes with a street to this one: east, north, west, south."""
        row, column = divmod(node, self.columns)
        out = [node + 1] if column + 1 < self.columns else []
        out += [node + self.columns] if row + 1 < self.rows else []
        out += [node - 1] if column else []
        return out + ([node - self.columns] if row else [])

    def street(self, a: int, b: int) -> Street:
        """The street between two neighbouring nodes. Raises ConfigError where there is none."""
        if not (0 <= a < len(self.nodes) and b in self.neighbours(a)):
            raise ConfigError(f"there is no street from crossing {a} to {b}", remedy="name crossings that lie side by side")
        a, b = min(a, b), max(a, b)
        line, last, avenue = (
            (a // self.columns, self.rows - 1, self._avenue_row)
            if b == a + 1
            else (a % self.columns, self.columns - 1, self._avenue_column)
        )
        wide = not self.hard and 0 < line < last and line % AVENUE_EVERY == avenue
        return Street(a, b, AVENUE_HALF_M if wide else STREET_HALF_M)

    def is_outer(self, a: int, b: int) -> bool:
        """Whether a street has a block on one side only."""
        (ra, ca), (rb, cb) = divmod(a, self.columns), divmod(b, self.columns)
        return (ra == rb and ra in (0, self.rows - 1)) or (ca == cb and ca in (0, self.columns - 1))

    def is_edge(self, node: int) -> bool:
        """Whether a node lies on the city's outermost streets."""
        row, column = divmod(node, self.columns)
        return row in (0, self.rows - 1) or column in (0, self.columns - 1)

    def is_corner(self, node: int) -> bool:
        """Whether a node is one of the city's four corners."""
        row, column = divmod(node, self.columns)
        return row in (0, self.rows - 1) and column in (0, self.columns - 1)

    def is_at_border(self, block: int) -> bool:
        """Whether there are no blocks on all sides of a block."""
        row, column = divmod(block, self.columns - 1)
        return row in (0, self.rows - 2) or column in (0, self.columns - 2)

    def blocks_at(self, node: int) -> list[int]:
        """The blocks around a node, counter-clockwise from the north-eastern one."""
        row, column = divmod(node, self.columns)
        places = ((row, column), (row, column - 1), (row - 1, column - 1), (row - 1, column))
        return [r * (self.columns - 1) + c for r, c in places if 0 <= r < self.rows - 1 and 0 <= c < self.columns - 1]

    def inner_streets(self) -> list[Street]:
        """Streets with a block on either side, in a fixed order."""
        pairs = ((n, m) for n in range(len(self.nodes)) for m in (n + 1, n + self.columns))
        return [self.street(n, m) for n, m in pairs if m < len(self.nodes) and m in self.neighbours(n) and not self.is_outer(n, m)]

    def control(self, node: int) -> Control:
        """Right-of-way control of a crossing: roundabouts lie between avenues, and avenues always have signals."""
        row, column = divmod(node, self.columns)
        if self.hard or not (0 < row < self.rows - 1 and 0 < column < self.columns - 1):
            return Control.SIGNALS if self.hard else Control.SIGNS
        east, north = (column - self._avenue_column) % AVENUE_EVERY, (row - self._avenue_row) % AVENUE_EVERY
        if east == AVENUE_EVERY - 2 and north == AVENUE_EVERY - 1:
            return Control.ROUNDABOUT
        return Control.SIGNS if east and north and self._signs[node] else Control.SIGNALS

    def clear_m(self, a: int, b: int) -> float:
        """Distance from node a to the end of its crossing on the street to b, m: behind all rounded corners."""
        starts = []
        for shape in self.shapes_beside(a, b):
            k = shape.nodes.index(a)
            d = (self.nodes[b] - self.nodes[a]) / np.hypot(*(self.nodes[b] - self.nodes[a]))
            end = shape.arcs[k][-1] if shape.nodes[(k + 1) % 4] == b else shape.arcs[k][0]
            starts.append(float((end - self.nodes[a]) @ d) + 0.3)
        return max(starts)

    def shapes_beside(self, a: int, b: int) -> "list[BlockShape]":
        """The one or two blocks along a street."""
        (ra, ca), (rb, cb) = divmod(a, self.columns), divmod(b, self.columns)
        row, column = min(ra, rb), min(ca, cb)
        places = ((row, column), (row - (ra == rb), column - (ca == cb)))
        inside = [(r, c) for r, c in places if 0 <= r < self.rows - 1 and 0 <= c < self.columns - 1]
        return [self.shape(r * (self.columns - 1) + c) for r, c in inside]

    def _shape(self, block: int) -> "BlockShape":
        nodes = self.loop(block)
        half = np.array([self.street(nodes[k], nodes[(k + 1) % 4]).half_width_m for k in range(4)])
        return block_shape(nodes, self.nodes[list(nodes)], half, [self.control(n) is Control.ROUNDABOUT for n in nodes])


def _grown_nodes(settings: CitySettings) -> F64:
    rng = np.random.default_rng([settings.seed, 0])
    x = np.cumsum(rng.uniform(*STREET_SPACING_M, settings.columns))
    y = np.cumsum(rng.uniform(*STREET_SPACING_M, settings.rows))
    moved = rng.uniform(-JITTER_M, JITTER_M, (settings.rows, settings.columns, 2))
    return np.asarray((np.stack(np.meshgrid(x - x.mean(), y - y.mean()), axis=-1) + moved).reshape(-1, 2))


def _hard_nodes(columns: int, rows: int) -> F64:
    x, y = (HARD_SPACING_M * (np.arange(count) - count // 2) for count in (columns, rows))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def inset(corners: F64, offsets: F64) -> F64:
    """Convex loop (K, 2), counter-clockwise, with edge k (corner k to k + 1) moved inwards by offsets[k] m."""
    along = np.roll(corners, -1, axis=0) - corners
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    base = corners + np.column_stack([-along[:, 1], along[:, 0]]) * offsets[:, None]
    return np.array([meeting_point(base[k - 1], along[k - 1], base[k], along[k]) for k in range(len(corners))])


def meeting_point(p: F64, d: F64, q: F64, e: F64) -> F64:
    """(2,) where the line through p along d meets that through q along e, all (2,); not for parallel lines."""
    s = ((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / (d[0] * e[1] - d[1] * e[0])
    return np.asarray(p + s * d)


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


def roundabout_corner(node: F64, kerb: F64, before: F64, after: F64, radius_m: float = ROUNDABOUT_M) -> F64:
    """(S, 2): the kerb of a block around a roundabout, from the edge before its corner to the edge after it.

    A circle around `node`, with flares to the kerb lines that meet in `kerb` and run to `before` and `after`; all (2,).
    """
    ends = []
    for other in (before, after):
        d = (other - kerb) / np.hypot(*(other - kerb))
        across, along = (kerb - node) @ np.array([-d[1], d[0]]), (node - kerb) @ d
        ends.append((kerb + d * (along + np.sqrt(radius_m**2 - across**2)), d))
    (p, d_p), (q, d_q) = ends
    a0, a1 = np.arctan2(*(p - node)[::-1]), np.arctan2(*(q - node)[::-1])
    a1 = a0 + (a1 - a0 + np.pi) % (2 * np.pi) - np.pi
    trim = np.sign(a1 - a0) * FLARE_M / radius_m
    angle = np.linspace(a0 + trim, a1 - trim, RING_STEPS + 1)
    ring = node + radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    t = np.linspace(0, 1, FLARE_STEPS, endpoint=False)[:, None]
    into = (1 - t) ** 2 * (p + d_p * FLARE_M) + 2 * t * (1 - t) * p + t**2 * ring[0]
    out = (1 - t) ** 2 * (q + d_q * FLARE_M) + 2 * t * (1 - t) * q + t**2 * ring[-1]
    return np.vstack([into, ring, out[::-1]])


@dataclass(frozen=True, slots=True)
class BlockShape:
    """The lines of one block, counter-clockwise; edge k runs from corner k to corner k + 1 with the block on its left.

    nodes       node numbers (K,)
    middle      (K, 2) street nodes
    half_m      (K,) half widths of the streets
    kerb        (K, 2) corners of the kerb before rounding
    arcs        K of (S, 2): kerb corners, rounded, or around a roundabout
    back        (K, 2, 2) the back of the sidewalk along each edge, from its start to its end
    roundabout  K: whether there is one at the corner
    """

    nodes: tuple[int, ...]
    middle: F64
    half_m: F64
    kerb: F64
    arcs: tuple[F64, ...]
    back: F64
    roundabout: tuple[bool, ...]

    @property
    def inner(self) -> F64:
        """(M, 2) convex loop behind the sidewalks: one corner a node, two where there is a roundabout."""
        points = [p for k, (a, b) in enumerate(self.back) for p in ([a, b] if self.roundabout[(k + 1) % len(self.nodes)] else [a])]
        return np.array(points)

    def edge(self, k: int) -> tuple[F64, F64, float]:
        """Direction (2,), inward normal (2,) and length m of street edge k."""
        d = self.middle[(k + 1) % len(self.middle)] - self.middle[k]
        length = float(np.hypot(*d))
        d = d / length
        return d, np.array([-d[1], d[0]]), length

    def edges(self) -> list[tuple[int, int]]:
        """The two nodes of each edge."""
        return [(a, self.nodes[(k + 1) % len(self.nodes)]) for k, a in enumerate(self.nodes)]

    def kerb_line(self) -> F64:
        """(N, 2) the whole kerb, a loop without its first point again."""
        return np.vstack(self.arcs)


def block_shape(nodes: tuple[int, ...], middle: F64, half_m: F64, roundabout: list[bool]) -> BlockShape:
    """The lines of the block between nodes at `middle` (K, 2) m, along streets of half widths half_m (K,)."""
    count = len(nodes)
    kerb = inset(middle, half_m)
    inner = inset(kerb, np.full(count, SIDEWALK_M))
    back = np.stack([inner, np.roll(inner, -1, axis=0)], axis=1)
    arcs = []
    for k in range(count):
        before, after = kerb[k - 1], kerb[(k + 1) % count]
        if not roundabout[k]:
            arcs.append(rounded_corner(before, kerb[k], after, CORNER_RADIUS_M))
            continue
        arcs.append(roundabout_corner(middle[k], kerb[k], before, after))
        d_in, d_out = (inner[k] - inner[k - 1]), (inner[(k + 1) % count] - inner[k])
        away = d_out / np.hypot(*d_out) - d_in / np.hypot(*d_in)
        away /= np.hypot(*away)
        cut, along = middle[k] + away * (ROUNDABOUT_M + SIDEWALK_M), np.array([-away[1], away[0]])
        back[k - 1, 1], back[k, 0] = meeting_point(cut, along, inner[k], d_in), meeting_point(cut, along, inner[k], d_out)
    return BlockShape(nodes, middle, half_m, kerb, tuple(arcs), back, tuple(roundabout))
