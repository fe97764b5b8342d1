"""The city: built from a seed, laid over the hills, and cut into chunks so that only what is seen is drawn."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import ConfigError
from wayloom.simulation import terrain
from wayloom.simulation.blocks import KIND_SHARES, Kind, Numbers, Site, build_block
from wayloom.simulation.city_settings import CitySettings
from wayloom.simulation.ground import underlay
from wayloom.simulation.mesh import Mesh, MeshBuilder, empty, join
from wayloom.simulation.models import Models
from wayloom.simulation.objects import Area, Change, TrueArea, TrueObject
from wayloom.simulation.streets import StreetGraph, block_shape, clearances, grid_graph
from wayloom.simulation.terrain import Terrain
from wayloom.simulation.vegetation import broadleaf

CHUNK_M = 24.0
MOST_THINGS = 60_000
"""Instance numbers fit 16 bits, and those from here on belong to what moves."""
SURROUNDINGS_M = 90.0
TREES_PER_M_OF_BORDER = 0.12


@dataclass(frozen=True, slots=True)
class City:
    """mesh is ordered by chunk: chunk c holds its triangles starts[c] to starts[c + 1], within low[c] to high[c] (C, 3) m."""

    settings: CitySettings
    graph: StreetGraph
    clear: dict[tuple[int, int], float]
    mesh: Mesh
    starts: NDArray[np.int64]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    models: Models

    @property
    def seed(self) -> int:
        """Of all its random streams."""
        return self.settings.seed

    @property
    def ground(self) -> Terrain:
        """The hills below."""
        return terrain.HILLS

    def chunks(self, chosen: NDArray[np.int64]) -> Mesh:
        """The triangles of the chunks chosen, in that order."""
        parts = [self.mesh.rows(slice(int(self.starts[c]), int(self.starts[c + 1]))) for c in chosen]
        return join(parts) if parts else empty()

    def objects(self, area: Area | None = None) -> list[TrueObject]:
        """Poles, signs and lights in an area (whole city without one), in a fixed order."""
        return []

    def areas(self, area: Area | None = None) -> list[TrueArea]:
        """Roads, sidewalks and lawns that touch an area (whole city without one), as rings."""
        return []

    def changes(self, area: Area | None = None) -> list[Change]:
        """What differs in a changed city from the same seed's unchanged one."""
        return []

    def around(self, x: float, y: float, reach_m: float) -> NDArray[np.int64]:
        """Chunks that overlap a square of half edge reach_m."""
        near = (self.low[:, 0] < x + reach_m) & (self.high[:, 0] > x - reach_m)
        near &= (self.low[:, 1] < y + reach_m) & (self.high[:, 1] > y - reach_m)
        return np.nonzero(near)[0]


def build_city(settings: CitySettings, models: Models) -> City:
    """A city of columns x rows crossings. Each block has its own random stream, so that blocks do not depend on each other.

    Raises ConfigError where the city holds more things than there are instance numbers.
    """
    seed, columns, rows = settings.seed, settings.columns, settings.rows
    graph = grid_graph(np.random.default_rng([seed, 0]), columns, rows)
    shapes = [block_shape(graph, nodes) for nodes in graph.blocks]
    clear = clearances(shapes)
    kinds = np.random.default_rng([seed, 1]).choice(len(Kind), len(shapes), p=KIND_SHARES)
    numbers, m = Numbers(), MeshBuilder()
    for index, shape in enumerate(shapes):
        rng = np.random.default_rng([seed, 2, index])
        count = len(shape.nodes)
        ends = [(shape.nodes[k], shape.nodes[(k + 1) % count]) for k in range(count)]
        build_block(Site(m, shape, rng, numbers, models), Kind(int(kinds[index])), [(clear[a, b], clear[b, a]) for a, b in ends])
    _surroundings(m, graph, numbers, np.random.default_rng([seed, 3]))
    if numbers.next() >= MOST_THINGS:
        raise ConfigError(f"{columns} x {rows} crossings hold more than {MOST_THINGS} things", remedy="build a smaller city")
    mesh, starts, low, high = _chunked(_on_hills(m.build()))
    return City(settings, graph, clear, mesh, starts, low, high, models)


def _surroundings(m: MeshBuilder, graph: StreetGraph, numbers: Numbers, rng: np.random.Generator) -> None:
    """Meadows and a belt of trees around the outermost streets."""
    low, high = graph.nodes.min(axis=0), graph.nodes.max(axis=0)
    underlay(m, low - SURROUNDINGS_M, high + SURROUNDINGS_M)
    size = high - low
    for _ in range(int(2 * size.sum() * TREES_PER_M_OF_BORDER)):
        out, along = rng.uniform(14, 40), rng.random()
        x, y = (
            (low[0] - out, low[1] + along * size[1]),
            (high[0] + out, low[1] + along * size[1]),
            (low[0] + along * size[0], low[1] - out),
            (low[0] + along * size[0], high[1] + out),
        )[rng.integers(4)]
        broadleaf(m, rng, float(x), float(y), numbers.next(), rng.uniform(1.4, 2.2))


def _on_hills(mesh: Mesh) -> Mesh:
    """The flat city lifted by the height of the ground under each corner. Uprights stay upright; slopes are too gentle to tilt."""
    corners = mesh.corners.copy()
    corners[..., 2] += terrain.height(corners[..., 0].astype(float), corners[..., 1].astype(float)).astype(np.float32)
    return replace(mesh, corners=corners)


def _chunked(mesh: Mesh) -> tuple[Mesh, NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """Triangles ordered by the square of CHUNK_M m in which their middle lies, and the box of each square's triangles."""
    cell = np.floor(mesh.corners[..., :2].mean(axis=1) / CHUNK_M).astype(np.int64)
    cell -= cell.min(axis=0)
    key = cell[:, 1] * (cell[:, 0].max() + 1) + cell[:, 0]
    order = np.argsort(key, kind="stable")
    mesh, key = mesh.rows(order), key[order]
    first = np.nonzero(np.r_[True, np.diff(key) > 0])[0]
    low = np.minimum.reduceat(mesh.corners.min(axis=1), first, axis=0)
    high = np.maximum.reduceat(mesh.corners.max(axis=1), first, axis=0)
    return mesh, np.append(first, len(mesh)), low, high
